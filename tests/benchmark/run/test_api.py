"""The functions of the package that evaluate, score and report, as their documentation shows."""

from __future__ import annotations

import doctest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gcbench as gb
import pytest

from ...support import bench_data

HEADER = "# method: mine\n# inputs: rgbd\n# knowledge: free\n# training: none\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a dataset and a file of predictions."""
    data = bench_data.make_dataset(tmp_path / "data" / "ur5", 2)
    rows = [
        f"{index:06d},{t},{j + 1},{float(q)!r}"
        for index in range(2)
        for t, positions in enumerate(bench_data.truth(data, index)) if t
        for j, q in enumerate(positions)
    ]
    table = "\n".join(["sequence,frame,joint,displacement", *rows, ""])
    (tmp_path / "mine.csv").write_text(HEADER + table)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_examples_hold(folder: Path) -> None:
    runner = doctest.DocTestRunner()
    functions: tuple[Callable[..., Any], ...] = (gb.evaluate, gb.score, gb.report)
    for function in functions:
        tests = doctest.DocTestFinder(recurse=False).find(function, function.__name__)
        assert any(test.examples for test in tests)
        for test in tests:
            runner.run(test)
    assert not runner.failures


def test_folders_may_be_texts(folder: Path) -> None:
    config = gb.EvalConfig(method=["hold-still"], data=("data/ur5",), results="r2")  # pyright: ignore
    assert gb.evaluate(config, progress=False).estimated == 2
    assert list((folder / "r2").iterdir())


@pytest.mark.parametrize(("fields", "message"), [
    ({"executor": "ray2"}, "EvalConfig.executor: expected one of local, ray, got 'ray2'"),
    ({"retry": ("fail",)},
     r"EvalConfig.retry\[0\]: expected one of ok, raised, timeout, crashed, invalid, got 'fail'"),
    ({"knowledge": ("axis",)},
     r"EvalConfig.knowledge\[0\]: expected one of none, free, .*, all, got 'axis'"),
    ({"method": "hold-still"}, r"EvalConfig.method: write a tuple, method=\('hold-still',\)"),
    ({"inputs": "rgbd"}, r"EvalConfig.inputs: write a tuple, inputs=\('rgbd',\)"),
    ({"data": Path("data/ur5")}, r"EvalConfig.data: write a tuple, data=\('data/ur5',\)"),
    ({"limit": 1.5}, "EvalConfig.limit: expected a whole number, got 1.5"),
    ({"results": None}, "EvalConfig.results: expected a path, as text or Path, got None"),
])
def test_options_of_another_type_are_refused(
    folder: Path, fields: dict[str, Any], message: str
) -> None:
    options = {"method": ("hold-still",), "data": ("data/ur5",), **fields}
    with pytest.raises(gb.ConfigError, match=f"^{message}$"):
        gb.evaluate(gb.EvalConfig(**options), progress=False)
    assert not (folder / "results").exists()


def test_results_of_several_kinds_make_one_report(folder: Path) -> None:
    evaluated = gb.evaluate(
        gb.EvalConfig(method=("hold-still",), data=(Path("data/ur5"),)), progress=False
    )
    assert evaluated.estimated == 2
    assert list(evaluated.frame["method"].unique()) == ["hold-still"]
    scored = gb.score("mine.csv", "data/ur5")
    assert scored.frame.query("metric == 'final_error'")["value"].max() < 1e-6
    written = [gb.report(results, folder / name, pictures=False) for name, results in (
        ("one", "results"), ("two", gb.Results(evaluated.runs + scored.runs)),
        ("three", ["results"]),
    )]
    for other in written[1:]:
        assert [p.read_bytes() for p in written[0]] == [p.read_bytes() for p in other]
