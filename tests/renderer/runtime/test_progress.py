"""Bars and messages share stderr; each message has a line of its own."""

from __future__ import annotations

import pytest
from gcbench.renderer.runtime.progress import frame_bar, say


def test_a_message_after_a_bar_without_frames_begins_a_line(
    capsys: pytest.CaptureFixture[str]
) -> None:
    with frame_bar(8, 4, True):
        say("a worker died")
    say("the end")
    lines = capsys.readouterr().err.replace("\r", "\n").split("\n")
    assert "gcbench: a worker died" in lines and "gcbench: the end" in lines
