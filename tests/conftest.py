"""What this machine lacks is skipped with the reason; in CI, where nothing may lack, it fails."""

from __future__ import annotations

import os
import shlex
import signal
from collections.abc import Callable, Generator
from functools import cache
from typing import Any

import hypothesis
import pytest

hypothesis.settings.register_profile("no-deadline", deadline=None)  # machines differ in speed
hypothesis.settings.load_profile("no-deadline")
# a shell's background jobs ignore SIGINT, and so would the processes that tests start
signal.signal(signal.SIGINT, signal.default_int_handler)
IN_CI = os.environ.get("CI", "").lower() in ("1", "true")


@cache
def why_nothing_renders() -> str:
    """The reason in one line, or nothing if this machine renders."""
    from gcbench import GcbenchError
    from gcbench.renderer.gl.rasterizer import Rasterizer

    try:
        Rasterizer(16, 16).close()
    except GcbenchError as error:
        return str(error)
    return ""


@pytest.fixture
def parses(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], bool]:
    """Whether the options of a line "gcbench COMMAND ..." are understood; nothing is done."""
    from gcbench.__main__ import main
    from gcbench.renderer.runtime import command_line

    def parse(*args: Any) -> None:
        understood(*args)
        raise KeyboardInterrupt

    understood = command_line.parse_options
    monkeypatch.setattr(command_line, "parse_options", parse)
    return lambda line: main(shlex.split(line, comments=True)[1:]) == 130


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("gl") and (reason := why_nothing_renders()):
        pytest.skip(reason)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    error = call.excinfo.value if call.excinfo else None
    if type(error).__name__ == "NoRendererError" and why_nothing_renders():
        report.outcome = "skipped"
        report.longrepr = str(item.path), item.location[1] or 0, f"Skipped: {error}"
    if report.skipped and not hasattr(report, "wasxfail"):
        _not_in_ci(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, Any, Any]:
    report = yield
    if report.skipped:
        _not_in_ci(report)
    return report


def _not_in_ci(report: Any) -> None:
    if IN_CI:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.outcome, report.longrepr = "failed", f"nothing is skipped in CI: {reason}"
