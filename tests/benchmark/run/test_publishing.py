"""Published rows: what is stored is what was measured, and what is shown is what is stored."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.methods.registry import options_of, with_options
from gcbench.benchmark.protocol.scoring import score_motion
from gcbench.benchmark.protocol.truth import truth_of
from gcbench.benchmark.report.leaderboard import build_leaderboard, read_leaderboard
from gcbench.benchmark.report.lines import OPTIONAL
from gcbench.benchmark.report.published_rows import (
    PUBLISHED_ROWS,
    pack_truth,
    published_files,
    published_lines,
    read_row,
    read_truth,
    score_published,
    truth_path,
    write_record,
)
from gcbench.benchmark.results.runs import Results, write_run
from gcbench.benchmark.run import publishing
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.benchmark.run.publishing import check_published, publish
from gcbench.benchmark.run.suite import read_suite
from gcbench.renderer.scene.config_files import config_tree

from ...support import analytic, bench_data

METHODS = Path(__file__).parents[2] / "support/bad_methods.py"
SUITE = """
name = "small"
[[dataset]]
name = "arm"
n = 6
robot = "owi535"
frames = 4
width = 48
height = 36
"""


@pytest.fixture
def evaluated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Results]:
    """Evaluates a method on sequences of a suite of one dataset, which needs no renderer."""
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    suite = tmp_path / "small.toml"
    suite.write_text(SUITE)
    data = bench_data.make_dataset(tmp_path / "suites/small/arm", 6)
    config = read_suite(suite).datasets[0].config
    provenance = json.loads((data / "dataset.json").read_text())
    (data / "dataset.json").write_text(json.dumps(provenance | {"config": config_tree(config)}))
    monkeypatch.setattr(publishing, "builtin_datasets",
                        lambda: {"small/arm": read_suite(suite).datasets[0]})
    monkeypatch.setattr("gcbench.renderer.generate.render_dataset", lambda *_, **__: None)

    def run(method: str, results: str, sequences: str = "", name: str = "small") -> Results:
        return evaluate(EvalConfig(
            method=(method,), suite=str(tmp_path / f"{name}.toml"), suites=tmp_path / "suites",
            results=tmp_path / results, sequences=sequences, workers=1), progress=False)

    return run


def test_a_published_row_has_the_scores_of_the_evaluation(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    for method in ("hold-still", f"{METHODS}:Raises"):
        evaluated(method, "results")
    folder = tmp_path / "published"
    files = publish([tmp_path / "results"], folder)
    assert files == sorted(files) == published_files(folder)
    own = build_leaderboard(publishing.find_runs(tmp_path / "results")).lines
    lines = published_lines(folder)
    by_name = {line.row.name: line for line in lines}
    assert len(by_name) == len(own) == 2
    for line in own:
        shown = by_name[line.row.name]
        assert shown.published and shown.extent == "n = 6"
        assert shown.summary.sequences == 6 and shown.summary.coverage == line.summary.coverage
        assert shown.summary.mean == pytest.approx(line.summary.mean, rel=1e-6)
        assert shown.error == pytest.approx(line.error, rel=1e-6)
        assert shown.drift == pytest.approx(line.drift, rel=1e-6)
        assert (shown.failed, shown.cluster, shown.sign) == (line.failed, line.cluster, line.sign)
        for name, values in line.conditions.items():
            assert shown.conditions[name] == pytest.approx(values, rel=1e-6)
    before = [path.read_bytes() for path in files]
    publish([tmp_path / "results"], folder)
    assert [path.read_bytes() for path in files] == before, "published again, nothing changes"
    assert not any(b"/tmp" in data or str(tmp_path).encode() in data for data in before)


def test_sequences_are_added_to_a_row_of_the_same_version(
    evaluated: Callable[..., Results], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for results, sequences in (("a", "0-2"), ("b", "4,5"), ("all", "")):
        evaluated("hold-still", results, sequences)
    parts, whole = tmp_path / "parts", tmp_path / "whole"
    (path,) = publish([tmp_path / "a"], parts)
    assert read_row(path, parts, {}).command.endswith(
        "--suite small --datasets arm --inputs none --knowledge none --sequences 0-2")
    publish([tmp_path / "b"], parts)
    row = read_row(path, parts, {})
    assert [int(name) for name in row.run.sequences] == [0, 1, 2, 4, 5]
    assert row.command.endswith("--sequences 0-2,4-5")
    publish([tmp_path / "all"], parts)
    publish([tmp_path / "all"], whole)
    (a,), (b,) = published_lines(parts), published_lines(whole)
    assert a.error == b.error and a.summary == b.summary
    older = dataclasses.replace(row.run, row=dataclasses.replace(row.run.row, version="0"))
    write_record(path, dataclasses.replace(row, run=older))
    assert "replaces" not in capsys.readouterr().err
    publish([tmp_path / "a"], parts)
    said = "replaces a row of version 0 that had 2 more sequences"
    assert said in " ".join(capsys.readouterr().err.split())
    assert len(read_row(path, parts, {}).run.sequences) == 3, "another version is replaced"


def test_another_method_of_the_same_version_replaces_nothing(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    (run,) = evaluated("hold-still", "results").runs
    folder = tmp_path / "published"
    (path,) = publish([tmp_path / "results"], folder)
    before = path.read_bytes(), truth_path(folder, "small/arm").read_bytes()
    other = dataclasses.replace(run.run, source="/home/me/other.py:Still")
    trained = dataclasses.replace(
        run.run, row=dataclasses.replace(run.run.row, training="supervised: x"))
    for changed, said in (other, "the source 'hold-still', and this one has 'other.py:Still'"), (
            trained, "the training 'none', and this one has 'supervised: x'"):
        write_run(run.path, changed)
        with pytest.raises(GcbenchError, match=re.escape(said) + "; raise the version") as error:
            publish([tmp_path / "results"], folder)
        assert "\n" not in str(error.value)
    assert before == (path.read_bytes(), truth_path(folder, "small/arm").read_bytes())


def test_published_predictions_have_a_command_that_scores(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    (run,) = evaluated("hold-still", "results").runs
    write_run(run.path, dataclasses.replace(run.run, source="predictions"))
    folder = tmp_path / "published"
    (path,) = publish([tmp_path / "results"], folder)
    assert read_row(path, folder, {}).command == (
        "gcbench score --predictions predictions.csv --suite small --datasets arm --sequences 0-5")


def test_the_check_finds_changed_estimates_scores_and_truth(
    evaluated: Callable[..., Results], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    evaluated("constant-velocity", "results")
    folder = tmp_path / "published"
    (path,) = publish([tmp_path / "results"], folder)
    truths: dict = {}
    row = read_row(path, folder, truths)
    assert not check_published(folder, 0).problems
    moved = row.arrays["displacement"].copy()
    moved[2, -1, 0] += 0.01
    score = dataclasses.replace(row.scores[0], drift=(*row.scores[0].drift[:-1], 0.5))
    for changed in (
        dataclasses.replace(row, arrays={**row.arrays, "displacement": moved}),
        dataclasses.replace(row, scores=(score,)),
        dataclasses.replace(row, arrays={**row.arrays, "error": 0 * row.arrays["error"]}),
    ):
        write_record(path, changed)
        assert "its scores are not those of its estimates" in check_published(folder, 0).problems[0]
    write_record(path, row)
    scored = path.read_bytes()
    write_record(path, dataclasses.replace(row, scores=(score,)))
    assert main(["publish", "--rescore", "--to", str(folder)]) == 0
    assert path.read_bytes() == scored and str(path) in capsys.readouterr().out
    write_record(path, dataclasses.replace(row, scores=(score,)))
    assert main(["publish", "--check", "--draw", "0", "--to", str(folder)]) == 1
    assert "1 rows, 6 estimates scored again" in capsys.readouterr().out
    # The suite's robot is not the arm of these sequences: every truth that is drawn again differs.
    write_record(path, row)
    truth = truths["small/arm"]
    real = dataclasses.replace(truth, joint_names=("rotation", "base"))
    write_record(truth_path(folder, "small/arm"), real)
    write_record(path, score_published(row, real))
    found = check_published(folder, 1)
    assert found.drawn == 1 and len(found.problems) == 3


def test_the_check_compares_the_configuration_with_the_suite(
    evaluated: Callable[..., Results], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Truth that follows from another configuration is that of the suite as little as any other."""
    evaluated("hold-still", "results")
    folder = tmp_path / "published"
    publish([tmp_path / "results"], folder)
    path = truth_path(folder, "small/arm")
    truth = read_truth(path)
    for change, said in ({"seed": 999}, "(seed: "), ({"frames": "many"}, "(frames: 4 -> "), (
            {"robot": 5}, "(robot: "), ({"new": 1}, "(new"):
        write_record(path, dataclasses.replace(truth, config={**truth.config, **change}))
        for draw in (0, 1):
            found = check_published(folder, draw)
            (problem,) = found.problems
            assert problem.startswith(f"{path}: its configuration is not that of the suite ")
            assert said in problem and not found.skipped and not found.drawn
    write_record(path, dataclasses.replace(truth, config={}))
    assert len(check_published(folder).problems) == 1
    write_record(path, truth)
    monkeypatch.setattr(publishing, "builtin_datasets", dict)
    assert check_published(folder).problems == (f"{path}: no built-in suite has this dataset",)


@pytest.mark.parametrize(("given", "said"), [
    (["--check", "--rescore"], "--check and --rescore exclude each other"),
    (["mine", "--check"], "mine: --check and --rescore are for published rows"),
    (["results", "--rescore"], "results: --check and --rescore are for published rows"),
    (["mine", "--draw", "3"], "--draw is for --check"),
])
def test_no_option_of_publish_is_ignored(
    tmp_path: Path, given: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["publish", *given, "--to", str(tmp_path / "published")]) == 2
    assert said in capsys.readouterr().err


def test_only_finished_results_on_the_data_of_a_suite_are_published(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    data = bench_data.make_dataset(tmp_path / "own", 1)
    evaluate(EvalConfig(method=("hold-still",), data=(data,), results=tmp_path / "own-results"),
             progress=False)
    with pytest.raises(GcbenchError, match="no results on a built-in suite"):
        publish([tmp_path / "own-results"], tmp_path / "published")
    (folder,) = evaluated("hold-still", "results").runs
    (tmp_path / "small.toml").write_text(SUITE.replace("frames = 4", "frames = 5"))
    with pytest.raises(GcbenchError, match=r"not the data of the suite \(frames: 5 -> 4"):
        publish([tmp_path / "results"], tmp_path / "published")
    (tmp_path / "small.toml").write_text(SUITE)
    folder.estimate_path("000003").unlink()
    with pytest.raises(GcbenchError, match="not finished, no estimates of 000003; continue"):
        publish([tmp_path / "results"], tmp_path / "published")
    assert not (tmp_path / "published").exists()


def make_again(data: Path, faster: float) -> None:
    """The same dataset with other motions, as another version would draw them."""
    base = analytic.render(width=48, height=36, frames=4, room=False)
    for index in range(6):
        bench_data.save(base, data, index, faster + index, observable=True)


def test_only_results_on_the_sequences_that_were_estimated_are_published(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    (found,) = evaluated("hold-still", "results").runs
    folder, data = tmp_path / "published", tmp_path / "suites/small/arm"
    make_again(data, 2.0)
    with pytest.raises(GcbenchError, match=r"sequence 000000 of .* changed after it was estimated"):
        publish([tmp_path / "results"], folder)
    assert not folder.exists()
    make_again(data, 1.0)
    files = publish([tmp_path / "results"], folder)
    before = [path.read_bytes() for path in (*files, truth_path(folder, "small/arm"))]
    make_again(data, 2.0)
    write_run(found.path, dataclasses.replace(found.run, digests={}))  # of an earlier version
    with pytest.raises(GcbenchError, match=r"000000 is not the one that is published: its displ"):
        publish([tmp_path / "results"], folder)
    make_again(data, 1.0)
    publish([tmp_path / "results"], folder)
    assert [path.read_bytes() for path in (*files, truth_path(folder, "small/arm"))] == before


@pytest.mark.ci
def test_published_rows_are_ranked_only_on_the_same_sequences(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    folder = tmp_path / "published"
    evaluated("constant-velocity", "theirs")
    publish([tmp_path / "theirs"], folder)
    evaluated("hold-still", "same")
    board = read_leaderboard([tmp_path / "same"], published=folder)
    assert len(board.differences) == 1 and 0 not in board.ranks
    evaluated("constant-velocity", "again")
    board = read_leaderboard([tmp_path / "again"], published=folder)
    assert board.ranks == (1, 1), "the rounding of published numbers decides nothing"
    evaluated("icp-first", "more", "0-4")
    publish([tmp_path / "more"], folder)
    board = read_leaderboard([tmp_path / "same"], published=folder)
    ranks = dict(zip(board.labels, board.ranks, strict=True))
    assert ranks["icp-first · rgbd · axes · published, n = 5"] == 0 and len(board.differences) == 1
    evaluated("constant-velocity", "few", "0-1")
    few = read_leaderboard([tmp_path / "same", tmp_path / "few"], published=folder)
    mine = few.labels.index("constant-velocity · n = 2")
    assert few.ranks[mine] == 0 and "constant-velocity · published, n = 6" in few.labels


@pytest.mark.ci
def test_a_published_row_is_scored_on_the_sequences_of_ones_own(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    folder = tmp_path / "published"
    evaluated("constant-velocity", "theirs")
    publish([tmp_path / "theirs"], folder)
    evaluated("hold-still", "fewer", "0-4")
    evaluated("constant-velocity", "same", "0-4")
    board = read_leaderboard([tmp_path / "fewer", tmp_path / "same"], published=folder)
    label = "constant-velocity · published, n = 5"
    assert {*board.labels} == {"hold-still", "constant-velocity", label}
    assert 0 not in board.ranks and len(board.differences) == 3
    theirs, mine = (board.lines[board.labels.index(x)] for x in (label, "constant-velocity"))
    assert theirs.sequences == mine.sequences
    assert theirs.summary.mean == pytest.approx(mine.summary.mean, rel=1e-5)
    assert theirs.summary.sequences == 5 and theirs.drift == pytest.approx(mine.drift, rel=1e-5)


@pytest.mark.ci
def test_published_rows_are_scored_on_the_sequences_that_most_of_them_have(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    evaluated("hold-still", "theirs", "0-2")
    evaluated("constant-velocity", "theirs")
    publish([tmp_path / "theirs"], tmp_path / "published")
    few, many = (frozenset(f"{k:06d}" for k in range(n)) for n in (3, 6))
    for sets, n in ([many, few], 3), ([many], 6), ([few], 3):
        lines = published_lines(tmp_path / "published", {"small/arm": sets})
        assert [len(line.sequences) for line in lines] == [n, 3], "the first is constant-velocity"


def test_published_rows_stand_only_beside_runs_on_the_same_dataset(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    evaluated("constant-velocity", "theirs")
    folder = tmp_path / "published"
    publish([tmp_path / "theirs"], folder)
    (line,) = published_lines(folder)
    assert build_leaderboard([], folder).lines == (line,), "without runs, all are shown"
    data = bench_data.make_dataset(tmp_path / "own", 1)
    config = EvalConfig(method=("hold-still",), data=(data,), results=tmp_path / "own-results")
    own = evaluate(config, progress=False)
    suite = evaluated("hold-still", "mine")
    for runs, names in ((own.runs, ["own"]), (suite.runs, ["small/arm"] * 2),
                        (own.runs + suite.runs, ["own", "small/arm", "small/arm"])):
        board = build_leaderboard(runs, folder)
        assert [line.dataset.partition(",")[0] for line in board.lines] == names
    path = truth_path(folder, "small/arm")
    truth = read_truth(path)
    write_record(path, dataclasses.replace(truth, config={**truth.config, "width": 50}))
    assert len(build_leaderboard(suite.runs, folder).lines) == 1, "another dataset of its name"


def test_a_report_shows_published_rows_unless_told_not_to(
    evaluated: Callable[..., Results], tmp_path: Path
) -> None:
    evaluated("constant-velocity", "theirs")
    folder = tmp_path / "published"
    publish([tmp_path / "theirs"], folder)
    evaluated("hold-still", "mine")
    for given, shown in (["--published", str(folder)], True), (["--published", "none"], False):
        command = ["report", str(tmp_path / "mine"), "--no-pictures", "--quiet", *given]
        assert main([*command, "--out", str(tmp_path / "out")]) == 0
        for name in ("leaderboard.md", "leaderboard.csv", "tables.tex", "index.html"):
            text = (tmp_path / "out" / name).read_text()
            assert ("velocity" in text) == shown, name  # LaTeX writes another hyphen
            assert "still" in text
    with pytest.raises(GcbenchError, match="no scores in a folder: none is given"):
        read_leaderboard([], published=folder)


def test_a_damaged_file_is_one_error(evaluated: Callable[..., Results], tmp_path: Path) -> None:
    evaluated("hold-still", "results")
    folder = tmp_path / "published"
    (path,) = publish([tmp_path / "results"], folder)
    data = path.read_bytes()
    for bad in (data[:100], data.replace(b'"ok"', b'"KO"'), data.replace(b"000005", b"000009")):
        path.write_bytes(bad)
        with pytest.raises(GcbenchError, match=r"arm\.zip"):
            published_lines(folder)
    path.write_bytes(data)
    shutil.move(path, path.with_name("leg.zip"))
    with pytest.raises(GcbenchError, match="rename the file"):
        published_lines(folder)
    with pytest.raises(GcbenchError, match="no published rows"):
        published_lines(tmp_path / "none")


def test_published_rows_say_of_how_many_joints_they_tell_more() -> None:
    """Counted without scoring the estimates again, as the scores of the estimates say."""
    seen: set[str] = set()
    for line in published_lines(PUBLISHED_ROWS, {"standard/oven": []}):
        row = read_row(line.run.path, PUBLISHED_ROWS, {})
        truth = read_truth(truth_path(PUBLISHED_ROWS, "standard/oven"))
        found = Counter(
            r.metric for name, stored in zip(row.run.sequences, row.unpack_estimates(), strict=True)
            for r in score_motion(truth.of(name), stored, line.run.run, name)
            if r.metric in OPTIONAL)
        assert line.answers == found, line.run.path
        seen |= {*found}
    assert seen == {*OPTIONAL}


@pytest.mark.ci
def test_the_rows_of_this_package_are_what_their_estimates_score() -> None:
    found = check_published(PUBLISHED_ROWS, draw=0)
    assert found.rows >= 8 and found.problems == ()


@pytest.mark.slow
def test_the_truth_of_this_package_is_that_of_the_suite() -> None:
    found = check_published(PUBLISHED_ROWS, draw=-1)
    assert found.drawn and not found.skipped and not found.problems


def test_the_truth_of_a_robot_is_drawn_again_without_images() -> None:
    """As the check draws it; the robot and the appliances need no download."""
    for name in ("owi535", "oven"):
        truth = read_truth(truth_path(PUBLISHED_ROWS, f"standard/{name}"))
        drawn = publishing._draw_again(truth, np.array([len(truth.sequences) - 1]))
        for k, found in drawn:
            assert np.allclose(found["displacement"], truth.arrays["displacement"][k], atol=1e-5)


@pytest.mark.parametrize(("given", "kept"), [
    ("raft:/w/sintel.pth", "raft:sintel.pth"), ("dis-fine", "dis-fine"),
    ("dis-fine+flownet2:~/ck.pth", "dis-fine+flownet2:ck.pth"),
    ("torchvision:raft_small:./w/x.pth", "torchvision:raft_small:x.pth"),
    ("hf:depth-anything/V2-Small", "hf:depth-anything/V2-Small"),
    ("hf-metric:depth-anything/V2-Small", "hf-metric:depth-anything/V2-Small"),
    ("hf:/home/me/V2", "hf:V2"), ("hf:../me/V2", "hf:V2"), ("hf:~/V2", "hf:V2"),
    ("hf:./V2", "hf:V2"), ("hf:home/me/V2", "hf:V2"), ("mono:/w/mono_640/", "mono:mono_640"),
    ("/home/me+you/my models:x/a.pth", "a.pth"), ("raft:/home/a+b:c/x.pth", "raft:x.pth"),
    ("mine/oven.npz", "oven.npz"), ("oven", "oven"),
])
def test_a_published_option_keeps_its_kind_and_no_folder(given: str, kept: str) -> None:
    options = {"flow": given, "set": f"rgb.x=1 rgb.y={given.replace(' ', '')}"}
    published = publishing._without_folders(with_options("/home/me/m.py:M", options))
    assert published.partition("?")[0] == "m.py:M"
    assert options_of(published) == {"flow": kept, "set": f"rgb.x=1 rgb.y={kept}"}


def test_packed_truth_is_the_truth(tmp_path: Path) -> None:
    from gcbench.renderer.dataset.reader import open_dataset

    dataset = open_dataset(bench_data.make_dataset(tmp_path / "arm", 3))
    truths = [truth_of(dataset[k]) for k in range(3)]
    packed = pack_truth(truths)
    assert packed["displacement"].shape == (3, 4, bench_data.JOINTS)
    for k, truth in enumerate(truths):
        for name in ("displacement", "screw", "origin", "pixels"):
            assert np.allclose(packed[name][k], getattr(truth, name), rtol=1e-6)


def test_a_suite_configuration_is_complete_in_the_truth() -> None:
    for path in (PUBLISHED_ROWS / "truth/standard").glob("*.zip"):
        config = read_truth(path).config
        (entry,) = [d for d in read_suite("standard").datasets if d.name == path.stem]
        assert config == json.loads(json.dumps(config_tree(entry.config)))
