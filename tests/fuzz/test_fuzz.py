"""The fuzzers in short, and each case of the corpus. `make fuzz` runs them for an hour."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from .campaign import KINDS, make
from .corpus import CORPUS

CHECKOUT = Path(__file__).resolve().parents[2]
CASES = 12
"""Of each kind. With the corpus they take a minute on two cores."""


def fuzz(*args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.fuzz", *args],
        cwd=CHECKOUT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


@pytest.mark.gl
def test_no_input_does_harm() -> None:
    kinds = [*KINDS]
    runs = [fuzz(*half, "--seed", "1", "--count", str(CASES)) for half in (kinds[:3], kinds[3:])]
    for run in runs:
        said, errors = run.communicate()
        assert run.returncode == 0, said + errors
        assert said.count(f": {CASES} cases") in (3, len(kinds) - 3)


@pytest.fixture(scope="module")
def corpus() -> dict[str, list[str]]:
    """What is wrong with each case of the corpus."""
    said, errors = fuzz("--corpus").communicate()
    assert said, errors
    return json.loads(said)


@pytest.mark.gl
@pytest.mark.parametrize("name", CORPUS)
@pytest.mark.ci
def test_the_corpus(name: str, corpus: dict[str, list[str]]) -> None:
    assert corpus[name] == [], f"python -m tests.fuzz --corpus {name}"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind in ("urdf", "mesh", "gltf")])
def test_a_case_is_a_function_of_seed_and_index(kind: str) -> None:
    first, again, other = make(kind, 3, 5), make(kind, 3, 5), make(kind, 4, 5)
    assert (first.files, first.commands, first.steps) == (again.files, again.commands, again.steps)
    assert first.files != other.files
