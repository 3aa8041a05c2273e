"""The options of `gcbench render` that choose sequences."""

from __future__ import annotations

import pytest
from gcbench.errors import ConfigError
from gcbench.renderer.generate.options import render_options


def test_sequences_are_chosen_by_number_and_range() -> None:
    assert render_options(["--sequences", "12-14,3,13"], None).n == [3, 12, 13, 14]
    assert render_options(["--sequences=0"], None).n == [0]
    assert render_options([], None).n == 10


@pytest.mark.parametrize(
    ("text", "message"),
    [("a", "give numbers and ranges, as in 0-9,15"), ("1-", "give numbers"), ("-1", "give numbers"),
     ("9-3", "give the smaller number first"), ("0-99999999", "more than 1000000 at once"),
     ("\u0663", "give numbers")],
)
def test_wrong_sequences_are_one_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        render_options([f"--sequences={text}"], None)
    assert "\n" not in str(caught.value)


def test_a_number_and_a_choice_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="--n and --sequences exclude each other"):
        render_options(["--sequences", "1", "--n", "10"], None)
