"""The report: its numbers are those of the statistics, its text cannot become anything else."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import re
import shutil
from pathlib import Path

import gcbench
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.report import gallery, leaderboard
from gcbench.benchmark.report import published_numbers as paper
from gcbench.benchmark.report.calibration import LEVELS
from gcbench.benchmark.report.conditions import error_by_condition
from gcbench.benchmark.report.figure import draw_figure
from gcbench.benchmark.report.formats import (
    CSV_COLUMNS,
    escape_csv,
    escape_latex,
    escape_markdown,
    leaderboard_csv,
    leaderboard_text,
)
from gcbench.benchmark.report.gallery import (
    MAX_LINES,
    Picture,
    draw_pictures,
    select_pictures,
    sequence_errors,
    write_pages,
)
from gcbench.benchmark.report.leaderboard import build_leaderboard, read_leaderboard
from gcbench.benchmark.report.page import FILES, report
from gcbench.benchmark.report.statistics import paired_difference, pcp, shared_ranks, summarize
from gcbench.benchmark.report.suite_scores import suite_scores, suite_sizes
from gcbench.benchmark.report.tables import format_error, paper_tables
from gcbench.benchmark.results.rows import Attribution, Row, write_scores
from gcbench.benchmark.results.runs import RUN, SCORES, find_runs, read_run, write_run
from gcbench.benchmark.run.suite import read_suite
from PIL import Image

from ...support.fake_results import (
    FREE,
    GCPOSE,
    ICP,
    JOINTS,
    NOISY,
    ORACLE,
    STILL,
    read_results,
    write_results,
)

HOSTILE = "=cmd|' /C calc'!A0 </script><img src=x onerror=alert(1)> $\\x_{1}^2 & 5% #~ | `b` [a](b)"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five rows on two datasets."""
    folder = tmp_path_factory.mktemp("results")
    for dataset in ("mini/ur5", "mini/iiwa14"):
        write_results(folder, GCPOSE, 0.002, dataset, seed=1)
        write_results(folder, NOISY, 0.002, dataset, seed=2)
        write_results(folder, FREE, 0.01, dataset, seed=3)
        write_results(folder, ICP, 0.05, dataset, seed=4, failing=(2,))
        write_results(folder, STILL, None, dataset)
    return folder


def data_of(page: Path) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>',
                      page.read_text(), re.DOTALL)
    assert found
    return json.loads(found[1])


def test_a_report_is_four_files(results: Path, tmp_path: Path) -> None:
    written = report([results], tmp_path / "deep" / "report", progress=False)
    assert [p.name for p in written] == list(FILES)
    assert all(p.read_bytes() for p in written)
    assert sorted(p.name for p in (tmp_path / "deep" / "report").iterdir()) == sorted(FILES)


def test_the_command_names_its_files_and_opens_the_page(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = list[str]()
    monkeypatch.setattr("webbrowser.open", opened.append)
    out = tmp_path / "out"
    assert main(["report", str(results), "--out", str(out), "--no-pictures", "--open"]) == 0
    assert capsys.readouterr().out.split() == [str(out / name) for name in FILES]
    assert opened == [(out / "index.html").as_uri()]
    assert main(["report", str(tmp_path / "lost")]) == 2
    assert "lost" in capsys.readouterr().err


def test_the_same_results_give_the_same_bytes(results: Path, tmp_path: Path) -> None:
    a = report([results], tmp_path / "a", progress=False)
    b = report([results], tmp_path / "b", progress=False)
    assert [p.read_bytes() for p in a] == [p.read_bytes() for p in b]


def test_csv_has_a_row_for_each_dataset_and_method(results: Path, tmp_path: Path) -> None:
    report([results], tmp_path, progress=False)
    text = (tmp_path / "leaderboard.csv").read_text()
    assert text.splitlines()[0] == (
        "dataset,method,inputs,knowledge,sequences,joints,mean,std,ci_low,ci_high,median,p90,pcp5,"
        "coverage,seconds_per_frame,unit,published,version,training,sign,rank"
    )
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 10 and tuple(rows[0]) == CSV_COLUMNS
    for row, line in zip(rows, read_leaderboard([results]).lines, strict=True):
        named = (line.dataset, line.row.name, line.row.inputs, line.row.knowledge)
        assert (row["dataset"], row["method"], row["inputs"], row["knowledge"]) == named
        finals = [r for r in line.run.results() if r.metric == "final_error"]
        m = summarize([r.value for r in finals], [r.status == "ok" for r in finals],
                      [r.sequence for r in finals], [r.sequence for r in finals], (5.0,),
                      np.random.default_rng(0))
        numbers = [m.mean, m.std, m.ci_low, m.ci_high, m.median, m.p90, m.pcp[0], m.coverage]
        assert [float(row[k]) for k in CSV_COLUMNS[6:14]] == pytest.approx(numbers, rel=1e-5)
        assert (int(row["sequences"]), int(row["joints"])) == (6, 18)
        assert row["unit"] == "deg"
        assert (row["version"], row["training"]) == (line.row.version, line.row.training)
        assert row["sign"] == line.sign and int(row["rank"]) >= 1
        seconds = [r.value for r in line.run.results() if r.metric == "seconds_per_frame"]
        assert row["seconds_per_frame"] == (f"{np.mean(seconds):.6g}" if seconds else "")


def test_the_terminal_shows_the_leaderboard_of_the_report(results: Path, tmp_path: Path) -> None:
    report([results], tmp_path, progress=False)
    document = (tmp_path / "leaderboard.md").read_text().replace("\\", "")
    cells = [re.split(r" *\| *", line)[1:-1] for line in document.splitlines() if "|" in line]
    shown = leaderboard_text(build_leaderboard(find_runs(results))).splitlines()
    table = [re.split("  +", line.strip()) for line in shown if "  " in line]
    rows = [row for row in cells if "---" not in row[0]][:len(table)]
    assert table == [row if len(row) == 5 else [*row[:2], *row[3:]] for row in rows]


def test_the_order_of_scores_changes_nothing(results: Path, tmp_path: Path) -> None:
    shuffled = tmp_path / "shuffled"
    shutil.copytree(results, shuffled)
    rng = np.random.default_rng(8)
    for folder in find_runs(shuffled):
        lines = (folder.path / SCORES).read_text().splitlines()
        head, rest = lines[0], [lines[1 + k] for k in rng.permutation(len(lines) - 1)]
        assert rest != lines[1:]
        (folder.path / SCORES).write_text("\n".join([head, *rest]) + "\n")
    a = report([results], tmp_path / "a", progress=False)
    b = report([shuffled], tmp_path / "b", progress=False)
    for one, other in zip(a[1:], b[1:], strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name


def test_a_failure_counts_and_is_told(results: Path, tmp_path: Path) -> None:
    report([results], tmp_path, progress=False)
    data = data_of(tmp_path / "index.html")
    icp = [line for line in data["lines"] if line["method"] == "icp"]
    assert [line["failed"] for line in icp] == [1, 1]
    assert [line["coverage"] for line in icp] == pytest.approx([5 / 6] * 2, rel=1e-4)
    told = [row for row in data["failures"] if row[1] == "mini/ur5"]
    assert told == [["icp (rgbd, axes)", "mini/ur5", "000002", "raised", "ValueError: no"]]


def test_drift_and_curve_are_means_and_shares_of_the_lines(results: Path) -> None:
    board = read_leaderboard([results])
    for line in board.lines:
        scores = read_results(line.run.path / SCORES)
        for t in range(1, 5):
            at = [r.value for r in scores if r.metric == "error" and r.frame == t]
            assert line.drift[t] == pytest.approx(np.mean(at))
        assert line.drift[0] == 0.0
        assert line.drift[-1] == pytest.approx(line.summary.mean)
        finals = np.array(list(line.error.values()))
        covered = np.array([name not in line.failed for name, _ in line.error])
        assert line.curve[-1] == pcp(finals, covered, (90.0,))[0]
        assert line.means["seconds_per_frame"] if line.row != STILL else True


def test_ranks_and_differences_are_those_of_the_statistics(results: Path, tmp_path: Path) -> None:
    board = read_leaderboard([results])
    found = board.differences
    assert len(found) == 2 * 10
    for (a, b), d in found.items():
        one, other = board.lines[a], board.lines[b]
        assert one.group == other.group
        again = paired_difference(one.error, other.error, np.random.default_rng(0))
        assert d.mean == pytest.approx(again.mean) and d.pairs == 18
    assert list(board.ranks) == shared_ranks(len(board.lines), found)
    assert len(set(board.ranks[:5])) < 5, "two rows are alike, and share"
    report([results], tmp_path, progress=False)
    pairs = data_of(tmp_path / "index.html")["pairs"]
    for (a, b), d in found.items():
        assert pairs[f"{a} {b}"]["mean"] == pytest.approx(d.mean, rel=1e-4)
        assert (pairs[f"{a} {b}"]["low"] > 0) == (d.ci_low > 0)
        assert pairs[f"{a} {b}"]["significant"] == d.is_significant


def test_one_sequence_ranks_nothing(tmp_path: Path) -> None:
    write_results(tmp_path, GCPOSE, 0.001, sequences=1)
    write_results(tmp_path, STILL, None, sequences=1)
    board = read_leaderboard([tmp_path])
    assert not board.differences
    assert board.ranks == (1, 1)
    report([tmp_path], tmp_path / "out", progress=False)
    assert "| – |" in (tmp_path / "out" / "leaderboard.md").read_text()
    assert data_of(tmp_path / "out" / "index.html")["lines"][0]["low"] is None


def test_prismatic_joints_have_lines_of_their_own(tmp_path: Path) -> None:
    write_results(tmp_path, GCPOSE, 0.01, prismatic=1)
    lines = read_leaderboard([tmp_path]).lines
    assert [(line.unit, line.summary.joints) for line in lines] == [("deg", 12), ("m", 6)]
    assert [[j.name for j in line.joints] for line in lines] == [["pan", "lift"], ["elbow"]]
    report([tmp_path], tmp_path / "out", progress=False)
    text = (tmp_path / "out" / "leaderboard.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["unit"] for row in rows] == ["deg", "m"]
    assert "(prismatic joints)" in (tmp_path / "out" / "leaderboard.md").read_text()


def test_tables_of_prismatic_joints_are_told_apart_and_have_no_degrees(tmp_path: Path) -> None:
    for robot in ("slider", "oven"):
        write_results(tmp_path / "r", GCPOSE, 0.01, robot, prismatic=2, joints=("a", "b", "c", "d"))
    file = tmp_path / "papers.csv"
    file.write_text("method,robot,mean,joint\nPaper,slider,3.5,\nPaper,oven,3.5,\n"
                    "Paper,slider,3.5,1\nPaper,slider,3.5,3\n")
    tables = paper_tables(read_leaderboard([tmp_path / "r", file]))
    titles = [table.title for table in tables]
    assert len({*titles}) == len(titles) == 7
    assert "Datasets (prismatic joints)" in titles
    for table in tables:
        slides = table.title.endswith(" (prismatic joints)")
        assert slides == ("frame in m," in table.caption)
        if slides:
            assert not any(table.reference) and not any(row.reference for row in table.rows)
    shown = {table.title for table in tables if any(table.reference)}
    assert shown == {"Robots", "Articulated objects", "Joints of slider, seed 7"}


def test_errors_by_condition_are_medians_of_equal_bins(results: Path) -> None:
    lines = [x for x in read_leaderboard([results]).lines if x.dataset == "mini/ur5"]
    for found in error_by_condition(lines):
        known = lines[0].conditions[found["name"]]
        order = sorted(known, key=lambda pair: (known[pair], pair))
        assert found["pairs"] == [5, 5, 4, 4] and len(order) == 18
        first, last = order[:5], order[-4:]
        assert found["at"][0] == pytest.approx(np.median([known[p] for p in first]), rel=1e-4)
        for line, medians in zip(lines, found["medians"], strict=True):
            for pairs, median in ((first, medians[0]), (last, medians[-1])):
                errors = [line.error[pair] for pair in pairs]
                assert median == pytest.approx(np.median(errors), rel=1e-4)
    still = next(x for x in lines if x.row == STILL)
    assert still.conditions["displacement"] == pytest.approx(still.error)


def test_conditions_of_earlier_scores_are_not_recorded(tmp_path: Path) -> None:
    path = write_results(tmp_path, GCPOSE, 0.01)
    write_results(tmp_path, ICP, 0.01)
    kept = [r for r in read_results(path / SCORES) if r.metric not in ("pixels", "distance")]
    write_scores(path / SCORES, kept)
    lines = read_leaderboard([tmp_path]).lines
    old = [line.row for line in lines].index(GCPOSE)
    displacement, pixels, distance = error_by_condition(lines)
    assert displacement["medians"][old] and pixels["medians"][1 - old]
    assert pixels["medians"][old] is distance["medians"][old] is None


def test_authors_link_and_date_are_in_the_report(tmp_path: Path) -> None:
    by = Attribution("A. Author, B. Author", "https://example.org/@paper?a=1&b=<2>", "2024-05")
    path = write_results(tmp_path, GCPOSE, 0.01)
    assert read_run(path / RUN).attribution == Attribution()
    write_run(path, dataclasses.replace(read_run(path / RUN), attribution=by))
    report([tmp_path], tmp_path / "out", progress=False)
    data = data_of(tmp_path / "out" / "index.html")
    line = data["lines"][0]
    assert (line["authors"], line["link"], line["date"]) == dataclasses.astuple(by)
    assert "A. Author, B. Author; 2024-05; https://example.org" in json.dumps(data["about"])


@pytest.mark.parametrize("wrong", [
    {"link": "javascript:alert(1)"}, {"link": "https://a b"}, {"link": "data:text/html,x"},
    {"link": "https://a\nb"}, {"authors": "a\nb"}, {"authors": 301 * "a"}, {"date": "May"},
])  # fmt: skip
def test_an_invalid_attribution_is_refused(tmp_path: Path, wrong: dict[str, str]) -> None:
    path = write_results(tmp_path, GCPOSE, 0.01)
    tree = json.loads((path / RUN).read_text())
    (path / RUN).write_text(json.dumps({**tree, "attribution": wrong}))
    with pytest.raises(GcbenchError, match=rf"attribution\.{next(iter(wrong))}"):
        report([tmp_path], tmp_path / "out")


# -- the paper's tables -----------------------------------------------------------------------


def test_the_papers_numbers() -> None:
    assert len(paper.PUBLISHED) == 4 * 3 + 2 + 3 * 4 + 2 + 5 * 4
    cells = {k: [p for p in paper.PUBLISHED if p.table == k] for k in (1, 2, 3)}
    full = {p.robot: (p.mean, p.pcp5) for p in cells[3] if p.method == paper.FULL}
    assert full == {"ur5": (2.2132, 91.6), "ur5-textured": (1.4633, 96.5),
                    "iiwa14": (2.5158, 89.0), "irb2400": (3.1479, 93.5)}
    ours = np.mean([p.mean for p in cells[2] if p.method == "GC-Pose, RGB-D"])
    assert ours == pytest.approx(1.96, abs=0.005)  # as its text says
    craves = np.mean([p.mean for p in cells[2] if p.method == "CRAVES" and p.joint])
    assert craves == pytest.approx(3.03, abs=0.005)
    own = np.mean([p.mean for p in cells[1] if p.method == "GC-Pose"])
    assert own == pytest.approx(1.391, abs=0.001)


def test_tables_have_our_numbers_and_the_papers_apart(results: Path) -> None:
    board = read_leaderboard([results])
    robots, *joints = paper_tables(board)
    assert robots.groups == (("", 1), ("ur5", 3), ("iiwa14", 3))  # the paper's order
    assert robots.columns[1:4] == ("mean ± std", "PCP@5°", "paper")
    assert robots.reference == (False, *(False, False, True) * 2)
    rows = {row.cells[0]: row for row in robots.rows}
    line = next(x for x in board.lines if x.dataset == "mini/ur5" and x.row == GCPOSE)
    s = line.summary
    assert rows["gcpose · rgbd · axes"].cells[1:4] == (
        f"{format_error(s.mean)} ± {format_error(s.std)}", f"{s.pcp[2]:.1f} %", "2.21, 91.6 %")
    assert rows["gcpose · rgbd-noise · axes"].cells[6] == "3.22, 87.0 %"
    assert rows["gcpose · rgbd · free*"].cells[3] == "–", "the paper's method knows the axes"
    assert "better of the two signs" in robots.caption
    theirs = [row for row in robots.rows if row.reference]
    assert [row.cells[0] for row in theirs] == [
        "FlowNet2 alone (paper)", "FlowNet2, epipolar (paper)", "GC-Pose, estimated depth (paper)"]
    assert all(row.cells[1] == row.cells[2] == "–" for row in theirs)
    assert robots.rows[-3:] == tuple(theirs), "never among ours"

    assert [t.title for t in joints] == ["Joints of mini/ur5", "Joints of mini/iiwa14"]
    assert joints[0].groups == (("", 1), *((name, 1) for name in JOINTS))
    first = {row.cells[0]: row.cells for row in joints[0].rows}["gcpose · rgbd · axes"]
    for cell, joint in zip(first[1:], line.joints, strict=True):
        finals = [value for (_, name), value in line.error.items() if name == joint.name]
        assert cell == f"{format_error(np.mean(finals))} ± {format_error(np.std(finals))}"


def test_tables_in_the_papers_form_are_in_every_format(results: Path, tmp_path: Path) -> None:
    report([results], tmp_path, progress=False)
    tables = paper_tables(read_leaderboard([results]))
    with (tmp_path / "tables.csv").open() as file:
        cells = {(r["table"], r["row"], r["group"], r["column"]): r for r in csv.DictReader(file)}
    assert len(cells) == sum(len(t.rows) * (len(t.columns) - 1) for t in tables)
    paper_cell = cells["Robots of mini", "gcpose · rgbd · axes", "ur5", "paper"]
    assert (paper_cell["value"], paper_cell["source"]) == ("2.21, 91.6 %", "paper")
    assert cells["Robots of mini", "gcpose · rgbd · axes", "ur5", "PCP@5°"]["source"] == ""
    markdown = (tmp_path / "leaderboard.md").read_text()
    assert "## Robots of mini" in markdown
    assert "| ur5 mean ± std | ur5 PCP@5° | ur5 paper |" in markdown
    assert "table 3 of the GC-Pose paper" in markdown
    for name in ("index.html", "tables.tex"):
        assert "Robots of mini" in (tmp_path / name).read_text()


def test_the_figure_has_the_best_median_picture_of_each_dataset(results: Path) -> None:
    board = read_leaderboard([results])
    colors = np.random.default_rng(5).integers(0, 255, (len(board.lines), 3), np.uint8)
    pictures = [
        Picture(p.line, p.kind, p.sequence, p.error, p.joints, gallery._film_url([
            np.broadcast_to(colors[p.line], (48, 64, 3)).copy()], quality=82))
        for p in select_pictures(board.lines)
    ]
    drawn = draw_figure(board.lines, board.labels, pictures)
    assert drawn
    image = np.asarray(Image.open(io.BytesIO(drawn)), int)
    assert image.shape == (66, 128, 3), "two robots in one row, with a line of text"
    best = [mine[0] for mine in board.groups.values()]
    for k, number in enumerate(best):
        assert np.abs(image[24, 32 + 64 * k] - colors[number]).max() < 30
    assert draw_figure(board.lines, board.labels, select_pictures(board.lines)) is None


def test_owi_and_objects(tmp_path: Path) -> None:
    names = ("Rotation", "Base", "Elbow", "Wrist")
    write_results(tmp_path, GCPOSE, 0.01, "owi535", joints=names)
    write_results(tmp_path, GCPOSE, 0.01, "oven", joints=("door",))
    tables = {t.title: t for t in paper_tables(read_leaderboard([tmp_path]))}
    assert set(tables) == {"Robots", "Articulated objects", "Joints of owi535, seed 7"}
    owi = tables["Joints of owi535, seed 7"]
    assert owi.rows[0].cells[2::2] == ("1.76 ± 1.09", "1.37 ± 1.09", "1.74 ± 1.37", "2.98 ± 1.73")
    real = [row.cells[-1] for row in owi.rows]
    assert owi.groups[-1][0] == "real images, all joints" and real == [
        "–", "4.41 ± 1.93", "3.14 ± 2.85"], "there are no real images here"
    assert owi.rows[1].cells[0] == "CRAVES (paper)" and "sign" not in owi.caption
    half = [c for c, name in zip(tables["Robots"].rows[0].cells, tables["Robots"].columns,
                                 strict=True) if name == "best half"]  # fmt: skip
    line = next(x for x in read_leaderboard([tmp_path]).lines if x.robot == "owi535")
    assert half == [format_error(np.sort(list(line.error.values()))[:12].mean())]
    objects = {row.cells[0]: row.cells[3] for row in tables["Articulated objects"].rows}
    assert objects["ScrewNet (paper)"] == "0.72 ± 0.14"
    assert objects["gcpose · rgbd · axes"] == "1.34 ± 1.20" and "GC-Pose (paper)" not in objects
    assert objects["ScrewNet (oven, trained on other classes) (paper)"] == "8.65 ± 0.21"


def test_numbers_of_other_papers_stand_beside_ours(tmp_path: Path) -> None:
    write_results(tmp_path / "results", GCPOSE, 0.01)
    file = tmp_path / "papers.csv"
    file.write_text("method,robot,mean,std,pcp5,joint\nPoser <b>,ur5,1.5,0.25,91,\n"
                    "Poser <b>,ur5,0.5,,,1\nPoser <b>,crane,9,,,\n")
    board = read_leaderboard([tmp_path / "results", file])
    robots, joints = paper_tables(board)
    rows = {row.cells[0]: row.cells for row in robots.rows}
    assert "1.50 ± 0.25, 91.0 %" in rows["Poser <b> (paper)"]
    assert f"{paper.FULL} (paper)" not in rows and f"{paper.NOISY} (paper)" in rows
    (own,) = (row.cells for row in joints.rows if row.cells[0] == "Poser <b> (paper)")
    assert [cell for cell in own[1:] if cell.strip("–- ")] == ["0.50"]
    report([tmp_path / "results", file], tmp_path / "out", progress=False)
    assert "Poser <b>" not in (tmp_path / "out/index.html").read_text()  # as text only
    assert "Poser" in (tmp_path / "out/tables.tex").read_text()


def test_papers_numbers_on_what_nobody_measured_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_results(tmp_path / "r", GCPOSE, 0.01)
    file = tmp_path / "papers.csv"
    file.write_text("method,robot,mean\nA,ur5,1\nA,UR5,1\nA,drawer,1\n")
    for progress in True, False:
        report([tmp_path / "r", file], tmp_path / "out", pictures=False, progress=progress)
        told = "numbers of papers on UR5, drawer, on which there are no" in capsys.readouterr().err
        assert told == progress


@pytest.mark.parametrize(("text", "said"), [
    ("method,mean\nA,1", "line 1: the first line names columns"),
    ("method,robot,mean,colour\nA,ur5,1,red", "line 1: the first line names columns"),
    ("method,robot,mean\nA,ur5,nan", r"line 2: .*\$\.mean"),
    ("method,robot,mean\nA@B,ur5,1", "line 2: a name is not printable"),
    ("method,robot,mean\nA,ur5,-1", r"line 2: .*\$\.mean"),
    ("method,robot,mean\nA,ur5", "line 2: expected 3 cells"),
    ("method,robot,mean\nA,ur5,1,2", "line 2: expected 3 cells"),
    ("method,robot,mean,pcp5\nA,ur5,1,101", r"line 2: .*\$\.pcp5"),
    ("method,robot,mean\n,ur5,1", r"line 2: .*method"),
    ("", "line 0: the first line names columns"),
    ("method,robot,mean\nA,ur5,1\nA,ur5,2", "line 3: A on ur5 is there twice; leave one out"),
    ("method,robot,mean,joint\nA,ur5,1,\nA,ur5,2,0", "line 3: A on ur5 is there twice"),
])  # fmt: skip
def test_wrong_numbers_of_papers_are_refused(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "papers.csv"
    file.write_text(text)
    with pytest.raises(GcbenchError, match=rf"papers\.csv: {said}"):
        paper.read_published(file)


@pytest.mark.parametrize(("method", "robot", "name"), [
    ("screwnet microwave width=16", "microwave", "ScrewNet"),
    ("screwnet microwave", "oven", "ScrewNet (oven, trained on other classes)"),
    ("screwnet oven", "microwave", ""),
    ("screwnet arm", "oven", ""),
    ("screwnet dishwasher+microwave", "oven", "ScrewNet (oven, trained on other classes)"),
    ("screwnet dishwasher+oven width=16", "oven", "ScrewNet"),
    ("abbatematteo oven", "oven", "Abbatematteo et al."),
])  # fmt: skip
def test_a_learned_row_stands_beside_the_paper_by_what_it_has_learned_from(
    method: str, robot: str, name: str
) -> None:
    row = dataclasses.replace(GCPOSE, method=method, inputs="rgbd", knowledge="free")
    assert paper.counterpart(row, 1, robot) == name
    assert name in {"", *(p.method for p in paper.PUBLISHED if (p.table, p.robot) == (1, robot))}
    assert paper.counterpart(row, 3, robot) == ""


def test_an_oracle_is_said_everywhere_and_has_no_counterpart(tmp_path: Path) -> None:
    oracle = dataclasses.replace(GCPOSE, oracles=("true-parts",))
    write_results(tmp_path, oracle, 0.01)
    report([tmp_path], tmp_path / "out", progress=False)
    assert paper.counterpart(oracle, 3, "ur5") == ""
    assert paper.counterpart(GCPOSE, 3, "ur5") == paper.FULL
    data = data_of(tmp_path / "out" / "index.html")
    assert data["lines"][0]["oracles"] == "true-parts"
    assert "oracles: true-parts" in json.dumps(data["about"])
    for name in FILES[1:]:
        text = (tmp_path / "out" / name).read_text()
        assert re.search("gcpose(@|&#64;)true(-|{-})parts", text), name


# -- text from outside ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    row = Row(HOSTILE, HOSTILE, "rgbd", "axes", HOSTILE)
    path = write_results(
        folder, row, 0.01, joints=(HOSTILE, "b"), failing=(1,), reason=HOSTILE,
        config={"robot": HOSTILE, "seed": HOSTILE}, assets=({"name": HOSTILE, "source": HOSTILE},))
    run = find_runs(folder)[0].run
    write_run(path, dataclasses.replace(run, dataset=HOSTILE, data=HOSTILE))
    scores = [dataclasses.replace(r, dataset=HOSTILE) for r in read_results(path / SCORES)]
    write_scores(path / SCORES, scores)
    return report([folder], folder / "out", progress=False)[0].parent


def test_hostile_names_in_the_page(hostile: Path) -> None:
    html = (hostile / "index.html").read_text()
    assert html.count("</script>") == 2 and "<img" not in html
    assert data_of(hostile / "index.html")["lines"][0]["method"] == HOSTILE


def test_hostile_names_in_csv_markdown_and_latex(hostile: Path) -> None:
    rows = list(csv.reader(io.StringIO((hostile / "leaderboard.csv").read_text(), newline="")))
    assert [len(row) for row in rows] == [21, 21]
    assert rows[1][1] == "'" + HOSTILE and rows[1][0] == "'" + HOSTILE
    text = (hostile / "leaderboard.md").read_text()
    assert "<" not in text.replace("&lt;", "") and "[a](b)" not in text
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1
    assert len(re.findall(r"(?<!\\)\|", tables[0][0])) == 13
    tex = (hostile / "tables.tex").read_text()
    for line in tex.splitlines():
        if not line.startswith("%"):
            assert re.search(r"(?<!\\)#", line) is None
            assert re.search(r"(?<!\\)%(?!$)", line) is None
    assert r"\textbackslash{}x\_\{1\}\textasciicircum{}2 \& 5\% \#\textasciitilde{}" in tex


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r\n=1", " =1", "\u200b=1"])
def test_no_cell_is_a_formula(text: str) -> None:
    assert escape_csv(text).startswith("'")


def test_escapes() -> None:
    assert escape_csv("a,b\nc") == "a,b c"
    assert escape_latex("a_b 50% {x} \\y ~ ^ $ # & |<>") == (
        r"a\_b 50\% \{x\} \textbackslash{}y \textasciitilde{} \textasciicircum{} \$ \# \& "
        r"\textbar{}\textless{}\textgreater{}")
    assert escape_latex("0.1 ± 0.2° · – é 世") == r"0.1 $\pm$ 0.2$^{\circ}$ $\cdot$ -- é ?"
    assert escape_latex('a "b"') == "a ''b''", "no other quote is in the encoding OT1"
    assert escape_latex("a\\\nb") == r"a\textbackslash{} b"
    assert escape_markdown("a|b\n<i> *x* _y_ http://z www.z") == (
        r"a\|b &lt;i&gt; \*x\* \_y\_ http&#58;//z www&#46;z")


# -- what may be missing ----------------------------------------------------------------------


def test_no_results_are_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="gcbench eval") as error:
        report([tmp_path], tmp_path / "out")
    assert "\n" not in str(error.value) and not (tmp_path / "out").exists()
    with pytest.raises(GcbenchError, match="gcbench eval"):
        report([tmp_path / "nowhere"], tmp_path / "out")


def test_a_table_of_scores_is_no_results_folder(tmp_path: Path) -> None:
    path = write_results(tmp_path / "r", GCPOSE, 0.01)
    with pytest.raises(GcbenchError, match=r"scores\.csv is a table of scores; give its results f"):
        report([path / SCORES], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_unfinished_run_is_told_and_left_out(tmp_path: Path) -> None:
    write_results(tmp_path, GCPOSE, 0.01)
    write_results(tmp_path, ICP, 0.01, scores=False)
    report([tmp_path], tmp_path / "out", progress=False)
    data = data_of(tmp_path / "out" / "index.html")
    assert len(data["lines"]) == 1
    assert data["failures"][0][:4] == ["icp (rgbd, axes)", "ur5, seed 7", "", "unfinished"]
    assert data["failures"][0][4].startswith("6 of 6")


def test_missing_metrics_and_sequences(tmp_path: Path) -> None:
    """Scores of another version, with the final errors only, and of fewer sequences."""
    path = write_results(tmp_path, GCPOSE, 0.01)
    kept = [r for r in read_results(path / SCORES)
            if r.metric == "final_error" and r.sequence != "000005"]
    write_scores(path / SCORES, kept)
    report([tmp_path], tmp_path / "out", progress=False)
    data = data_of(tmp_path / "out" / "index.html")
    line = data["lines"][0]
    assert line["seconds"] is None and line["within_sigma"] is None and line["drift"] == [0.0]
    assert line["coverage"] == 0.0, "nothing says that anything was estimated"
    assert (line["sequences"], line["expected"]) == (5, 6)
    assert [row[2:4] for row in data["failures"]] == [["000005", "not scored"]]


def test_copies_of_a_row_count_once_and_others_need_a_label(tmp_path: Path) -> None:
    write_results(tmp_path / "a", GCPOSE, 0.01)
    shutil.copytree(tmp_path / "a", tmp_path / "copy")
    (line,) = read_leaderboard([tmp_path / "a", tmp_path / "copy"]).lines
    assert line.run.path.is_relative_to(tmp_path / "a")
    write_results(tmp_path / "b", GCPOSE, 0.02)
    with pytest.raises(GcbenchError, match=(
            "same row with other scores of the sequences 000000, 000001, 000002 and 3 more; give "
            "one a label: --label")):
        read_leaderboard([tmp_path / "a", tmp_path / "b"])
    label = f"theirs={tmp_path / 'b'}"
    for folders in ([tmp_path / "a", tmp_path / "b"], [tmp_path / "a"]):
        board = read_leaderboard(folders, [label])
        assert board.labels == ["gcpose · rgbd · axes", "gcpose (theirs) · rgbd · axes"]
    for wrong in ("theirs", "=b", "a@b=c"):
        with pytest.raises(GcbenchError, match="expected NAME=RESULTS_FOLDER"):
            read_leaderboard([tmp_path / "a"], [wrong])


def test_parts_of_a_row_are_joined(tmp_path: Path) -> None:
    whole = write_results(tmp_path / "whole", GCPOSE, 0.01)
    run, scores = read_run(whole / RUN), read_results(whole / SCORES)
    for name, part in ("one", run.sequences[:2]), ("two", run.sequences[2:]):
        path = write_results(tmp_path / name, GCPOSE, 0.01)
        write_run(path, dataclasses.replace(run, sequences=part))
        write_scores(path / SCORES, [r for r in scores if r.sequence in part])
    (line,) = read_leaderboard([tmp_path / "two", tmp_path / "one"]).lines
    (same,) = read_leaderboard([tmp_path / "whole"]).lines
    assert {name: value for name, value in vars(line).items() if name != "run"} == {
        name: value for name, value in vars(same).items() if name != "run"}
    assert {*line.run.run.sequences} == {*run.sequences}
    paths = [line.run.estimate_path(name).parts[-5] for name in ("000001", "000002")]
    assert paths == ["one", "two"]


def test_parts_that_overlap_are_joined_in_any_order(tmp_path: Path) -> None:
    whole = write_results(tmp_path / "whole", GCPOSE, 0.01)
    run, scores = read_run(whole / RUN), read_results(whole / SCORES)

    def write_part(name: str, part: tuple[str, ...]) -> Path:
        path = write_results(tmp_path / name, GCPOSE, 0.01)
        write_run(path, dataclasses.replace(run, sequences=part))
        write_scores(path / SCORES, [r for r in scores if r.sequence in part])
        return path

    last = write_part("c", run.sequences[2:])
    write_part("a", run.sequences[:3])
    write_part("b", run.sequences[3:])
    folders = [tmp_path / name for name in "abc"]
    (same,) = read_leaderboard([tmp_path / "whole"]).lines
    for order in itertools.permutations(folders):
        (line,) = read_leaderboard(order).lines
        assert {name: value for name, value in vars(line).items() if name != "run"} == {
            name: value for name, value in vars(same).items() if name != "run"}
        assert {*line.run.run.sequences} == {*run.sequences} and not line.extent
    changed = [dataclasses.replace(r, value=r.value + (r.sequence == "000004"))
               for r in read_results(last / SCORES) if r.metric != "seconds_per_frame"]
    write_scores(last / SCORES, changed)
    said = r"/b/.* and .*/c/.* are the same row with other scores of the sequences 000004; give"
    for order in itertools.permutations(folders):
        with pytest.raises(GcbenchError, match=said):
            read_leaderboard(order)


def test_a_copy_without_final_errors_takes_those_of_another(tmp_path: Path) -> None:
    for name in "a", "b":
        path = write_results(tmp_path / name, GCPOSE, 0.01)
        scores = read_results(path / SCORES)
        left = [r for r in scores if r.metric != "final_error" or (name == "a") != (
            r.sequence > "000002")]
        write_scores(path / SCORES, left)
    write_results(tmp_path / "whole", GCPOSE, 0.01)
    (line,) = read_leaderboard([tmp_path / "b", tmp_path / "a"]).lines
    (same,) = read_leaderboard([tmp_path / "whole"]).lines
    assert (line.error, line.summary, line.extent) == (same.error, same.summary, "")


def test_a_table_without_final_errors_is_unfinished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_results(tmp_path, ICP, 0.01)
    write_scores(path / SCORES, [
        r for r in read_results(path / SCORES) if r.metric != "final_error"])
    with pytest.raises(GcbenchError, match=r"no scores in .*icp .*: 6 of 6 sequences estimated"):
        report([tmp_path], tmp_path / "out", progress=False)
    write_results(tmp_path, GCPOSE, 0.01)
    report([tmp_path], tmp_path / "out", pictures=False)
    said = "not in the report: icp (rgbd, axes) on ur5, seed 7: 6 of 6 sequences estimated and none"
    assert said in " ".join(capsys.readouterr().err.split())
    data = data_of(tmp_path / "out" / "index.html")
    assert [row[0] for row in data["failures"]] == ["icp (rgbd, axes)"]


def test_a_copy_may_have_another_name_and_another_order(tmp_path: Path) -> None:
    """The seed is a part of the name where the results hold another dataset of the same name."""
    write_results(tmp_path / "a", GCPOSE, 0.01)
    for folder, dataset in ("b", "ur5-seed-7"), ("c", "ur5"):
        config = {"robot": "ur5", "seed": 7, "frames": 5}
        path = write_results(tmp_path / folder, GCPOSE, 0.01, dataset, config=config)
        lines = sorted(read_results(path / SCORES), key=lambda r: -int(r.sequence))
        write_scores(path / SCORES, lines)
    (line,) = read_leaderboard([tmp_path / name for name in "abc"]).lines
    assert line.run.path.is_relative_to(tmp_path / "a")
    write_scores(path / SCORES, [dataclasses.replace(lines[0], value=9.0), *lines[1:]])
    with pytest.raises(GcbenchError, match="same row with other scores"):
        read_leaderboard([tmp_path / name for name in "abc"])


def test_results_of_colleagues_merge(tmp_path: Path) -> None:
    """Of another machine: its speed, its rounding, and its folders are others."""
    def written(who: str, digit: int, row: Row, scale: float | None, robot: str = "x.urdf") -> Path:
        config = {"robot": f"/home/{who}/robots/{robot}", "seed": 7, "frames": 5, "width": 640}
        path = write_results(tmp_path / who, row, scale, "arm", config=config)
        run = read_run(path / RUN)
        truth = {name: f"{digit}{name}" for name in run.sequences}
        write_run(path, dataclasses.replace(run, digests=truth, data=f"/home/{who}/data"))
        faster = {"me": 1.0, "you": 0.25}.get(who, 1.0)
        scores = [dataclasses.replace(r, value=r.value * faster) if "seconds" in r.metric
                  else dataclasses.replace(r, value=r.value * (1 + 1e-9 * (faster < 1)))
                  for r in read_results(path / SCORES)]
        write_scores(path / SCORES, scores)
        return tmp_path / who

    mine, newer = GCPOSE, dataclasses.replace(GCPOSE, version="2.0")
    for who, row in (("me", mine), ("you", newer)):
        written(who, 1, STILL, None)
        written(who, 1, ICP, 0.02)
        folder = written(who, 1, row, 0.01)
    assert main(["report", str(tmp_path / "me"), str(folder), "--out", str(tmp_path / "r"),
                 "--no-pictures", "--quiet"]) == 0
    board = read_leaderboard([tmp_path / "me", tmp_path / "you"])
    assert sorted(board.labels) == ["gcpose · rgbd · axes · 1.0", "gcpose · rgbd · axes · 2.0",
                                    "hold-still", "icp · rgbd · axes"]
    assert len({line.dataset for line in board.lines}) == 1
    assert len(board.differences) == 6  # each pair is compared
    for who, digit, robot in (("other-truth", 2, "x.urdf"), ("other-file", 1, "y.urdf")):
        with pytest.raises(GcbenchError, match="are on two datasets of one name"):
            read_leaderboard([tmp_path / "me", written(who, digit, FREE, 0.1, robot)])


def test_rows_on_other_motions_are_not_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The configurations may be equal, as of data that another version of gcbench rendered."""
    def written(who: str, row: Row, factor: float) -> Path:
        path = write_results(tmp_path / who, row, 0.02)
        run = read_run(path / RUN)
        write_run(path, dataclasses.replace(run, digests={n: who + n for n in run.sequences}))
        write_scores(path / SCORES, [
            dataclasses.replace(r, value=factor * r.value) if r.metric == "displacement" else r
            for r in read_results(path / SCORES)])
        return tmp_path / who

    mine = written("mine", ICP, 1.0)
    assert len(read_leaderboard([mine, written("rounded", GCPOSE, 1.0001)]).differences) == 1
    with pytest.raises(GcbenchError, match=r"of one name \(their motions differ\); rep"):
        read_leaderboard([mine, written("other", GCPOSE, 1.1)])
    theirs = [dataclasses.replace(line, published="2026-01-01", extent="n = 6")
              for name in ("rounded", "other")
              for line in read_leaderboard([tmp_path / name]).lines]
    monkeypatch.setattr(leaderboard, "published_lines", lambda *_: theirs)
    board = read_leaderboard([mine], published=tmp_path)
    assert [line.run.path.parts[-3] for line in board.lines] == ["rounded", "mine"]


def test_rows_on_other_sequences_than_most_have_no_rank(tmp_path: Path) -> None:
    write_results(tmp_path / "all", GCPOSE, 0.002)
    write_results(tmp_path / "all", STILL, None)
    write_results(tmp_path / "two", ICP, 0.001, sequences=2)
    board = read_leaderboard([tmp_path / "all", tmp_path / "two"])
    ranks = dict(zip(board.labels, board.ranks, strict=True))
    assert ranks == {"icp · rgbd · axes · n = 2": 0, "gcpose · rgbd · axes": 1, "hold-still": 2}
    assert len(board.differences) == 1
    alone = read_leaderboard([tmp_path / "two"])
    assert (alone.labels, alone.ranks) == (["icp · rgbd · axes"], (1,))


def test_a_method_counts_once_in_the_ranks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one's own row and as a published row, it would take two ranks from each worse row."""
    for dataset in "mini/ur5", "mini/oven":
        write_results(tmp_path / "mine", GCPOSE, 0.001, dataset, sequences=8)
        write_results(tmp_path / "mine", STILL, None, dataset, sequences=8)
        published = dataclasses.replace(GCPOSE, training="said otherwise")
        write_results(tmp_path / "theirs", published, 0.001, dataset, sequences=8, seed=1)
        write_results(tmp_path / "theirs", ICP, 0.01, dataset, sequences=8)
    theirs = [dataclasses.replace(line, published="2026-01-01", extent="n = 8")
              for line in read_leaderboard([tmp_path / "theirs"]).lines]
    monkeypatch.setattr(leaderboard, "published_lines", lambda *_: theirs)
    board = read_leaderboard([tmp_path / "mine"], published=tmp_path)
    found = [(line.row.method, bool(line.published), rank)
             for line, rank in zip(board.lines, board.ranks, strict=True)]
    assert sorted(found) == sorted(2 * [
        ("gcpose", False, 1), ("gcpose", True, 1), ("icp", True, 2), ("hold-still", False, 3)])
    assert {s.label: s.mean_rank for s in suite_scores(board)}["hold-still"] == 3
    assert {board.lines[k].row.training for k in board.repeated} == {"said otherwise"}
    report([tmp_path / "mine"], tmp_path / "out", progress=False)
    shown = data_of(tmp_path / "out" / "index.html")["lines"]
    assert [line["repeated"] for line in shown] == [
        k in board.repeated for k in range(len(board.lines))]
    monkeypatch.undo()
    alone = [line for line in theirs if line.row.method == "gcpose"]
    shutil.rmtree(tmp_path / "mine/gcpose_rgbd_axes")
    monkeypatch.setattr(leaderboard, "published_lines", lambda *_: alone)
    board = read_leaderboard([tmp_path / "mine"], published=tmp_path)
    assert sorted(board.ranks) == [1, 1, 2, 2] and not board.repeated


def test_of_equally_frequent_sequences_those_of_published_rows_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_results(tmp_path / "mine", GCPOSE, 0.01, "mini/ur5", sequences=5)
    write_results(tmp_path / "mine", STILL, None, "mini/ur5", sequences=8)
    write_results(tmp_path / "theirs", ICP, 0.02, "mini/ur5", sequences=5)
    board = read_leaderboard([tmp_path / "mine"])
    assert dict(zip(board.labels, board.ranks, strict=True)) == {
        "gcpose · rgbd · axes · n = 5": 0, "hold-still": 1}
    theirs = [dataclasses.replace(line, published="2026-01-01", extent="n = 5")
              for line in read_leaderboard([tmp_path / "theirs"]).lines]
    asked = list[dict[str, list[frozenset[str]]]]()

    def find(_: Path, sequences: dict[str, list[frozenset[str]]]) -> list[leaderboard.Line]:
        asked.append(sequences)
        return theirs

    monkeypatch.setattr(leaderboard, "published_lines", find)
    board = read_leaderboard([tmp_path / "mine"], published=tmp_path)
    assert dict(zip(board.labels, board.ranks, strict=True)) == {
        "gcpose · rgbd · axes": 1, "icp · rgbd · axes · published, n = 5": 1,
        "hold-still · n = 8": 0}
    assert [len(names) for names in asked[0]["mini/ur5"]] == [8, 5]
    report([tmp_path / "mine"], tmp_path / "out", pictures=False)
    said = " ".join(capsys.readouterr().err.split())
    assert said.count("without a rank") == 1
    assert "without a rank: hold-still · n = 8 on mini/ur5: it is on other sequences" in said


def test_two_seeds_stand_side_by_side(tmp_path: Path) -> None:
    config = {"robot": "ur5", "seed": 8, "frames": 5}
    write_results(tmp_path / "a", GCPOSE, 0.01)
    write_results(tmp_path / "b", GCPOSE, 0.01, config=config)
    write_results(tmp_path / "c", ICP, 0.01, "ur5-seed-8", config=config)
    board = read_leaderboard([tmp_path / name for name in "abc"])
    assert [line.dataset for line in board.lines] == ["ur5, seed 7", "ur5, seed 8", "ur5, seed 8"]
    write_results(tmp_path / "d", STILL, None, config={**config, "frames": 6})
    with pytest.raises(GcbenchError, match=r"two datasets of one name .*frames: 5 -> 6"):
        read_leaderboard([tmp_path / "b", tmp_path / "d"])


# -- one score for all datasets ---------------------------------------------------------------


def test_a_suite_has_one_score_for_each_row(results: Path, tmp_path: Path) -> None:
    board = read_leaderboard([results])
    scores = suite_scores(board)
    assert [s.suite for s in scores] == ["mini"] * 5
    assert [s.mean_rank for s in scores] == sorted(s.mean_rank for s in scores)
    for score in scores:
        mine = [k for k, label in enumerate(board.labels) if label == score.label]
        means = [board.lines[k].summary.mean for k in mine]
        assert (score.datasets, score.of, score.is_complete) == (2, 2, True)
        assert score.mean == pytest.approx(np.mean(means))
        assert score.mean_rank == np.mean([board.ranks[k] for k in mine])
        assert score.interval is not None
        assert score.interval[0] <= score.mean <= score.interval[1]
        widths = [board.lines[k].summary.ci_high - board.lines[k].summary.ci_low for k in mine]
        assert score.interval[1] - score.interval[0] <= np.mean(widths) + 1e-9, "independent draws"
    report([results], tmp_path, progress=False)
    heads = [x for x in (tmp_path / "leaderboard.md").read_text().splitlines() if x[:3] == "## "]
    assert heads[:3] == ["## All datasets of mini", "## mini/ur5", "## mini/iiwa14"]
    assert data_of(tmp_path / "index.html")["suites"][0]["title"] == "All datasets of mini"
    shown = leaderboard_text(build_leaderboard(find_runs(results)))
    assert shown.startswith("All datasets of mini\nmethod ")


def test_a_row_on_fewer_datasets_comes_last(tmp_path: Path) -> None:
    write_results(tmp_path, ICP, 0.05, "mini/ur5", seed=1)
    write_results(tmp_path, ICP, 0.05, "mini/oven", seed=2)
    write_results(tmp_path, GCPOSE, 0.001, "mini/ur5", seed=3)
    scores = suite_scores(read_leaderboard([tmp_path]))
    assert [(s.label.split(" ")[0], s.datasets, s.of) for s in scores] == [
        ("icp", 2, 2), ("gcpose", 1, 2)]


def test_the_score_of_a_suite_says_what_it_is_of(tmp_path: Path) -> None:
    for dataset in "standard/ur5", "standard/oven":
        write_results(tmp_path, STILL, None, dataset)
        write_results(tmp_path, GCPOSE, 0.01, dataset)
    board = read_leaderboard([tmp_path])
    assert {(s.datasets, s.of, s.is_complete) for s in suite_scores(board)} == {(2, 8, False)}
    shown = leaderboard_text(board).splitlines()
    assert shown[0] == "2 of the 8 datasets of standard"
    cells = [re.split("  +", line)[:2] for line in shown[2:4]]
    assert cells == [["gcpose · rgbd · axes", "2 of 8"], ["hold-still (best sign)", "2 of 8"]]
    folder = Path(str(gcbench.__file__)).parent / "benchmark/suites"
    suites = [read_suite(path.stem) for path in folder.glob("*.toml")]
    assert suite_sizes() == {suite.title: len(suite.datasets) for suite in suites}


def test_twins_get_the_same_draws(tmp_path: Path) -> None:
    """Errors on two datasets with one scene are alike: their mean is less exact than that of two
    others."""
    widths: list[float] = []
    for name, twin in ("twins", "ur5"), ("others", "ur5-textured"):
        for dataset, of in ("ur5", "ur5"), ("ur5-textured", twin):
            config = {"robot": dataset, "seed": 7, "frames": 5, "twin_of": of}
            write_results(tmp_path / name, GCPOSE, 0.05, f"mini/{dataset}", 20, config=config)
        board = read_leaderboard([tmp_path / name])
        ((low, high),) = [s.interval or (0.0, 0.0) for s in suite_scores(board)]
        widths.append(high - low)
    assert 1.2 < widths[0] / widths[1] < 1.7


def test_a_suite_row_of_several_versions_names_them(tmp_path: Path) -> None:
    for version, dataset in ("9", "mini/ur5"), ("10", "mini/iiwa14"):
        row = dataclasses.replace(GCPOSE, version=version)
        write_results(tmp_path, row, 0.01, dataset)
        write_results(tmp_path, ICP, 0.01, dataset)
    board = read_leaderboard([tmp_path])
    joined = {"gcpose · rgbd · axes · versions 9, 10", "icp · rgbd · axes"}
    assert {*board.labels} == {"gcpose · rgbd · axes", "icp · rgbd · axes"}, "one each a dataset"
    scores = suite_scores(board)
    assert {score.label: score.datasets for score in scores} == dict.fromkeys(joined, 2)
    robots, *joints = paper_tables(board)
    ours = {row.cells[0]: row.cells for row in robots.rows if not row.reference}
    assert {*ours} >= joined and all("–" not in ours[label][1] for label in joined)
    assert all(" · versions" not in row.cells[0] for table in joints for row in table.rows)


def test_rows_that_differ_in_training_are_never_joined(tmp_path: Path) -> None:
    other = dataclasses.replace(GCPOSE, training="supervised: x")
    for dataset in ("mini/ur5", "mini/iiwa14"):
        write_results(tmp_path / "a", GCPOSE, 0.05, dataset, seed=1)
        write_results(tmp_path / "b", other, 0.001, dataset, seed=2)
    label = "gcpose · rgbd · axes"
    board = read_leaderboard([tmp_path / "a", tmp_path / "b"])
    means = {score.label: score.mean for score in suite_scores(board)}
    assert means.keys() == {f"{label} · none", f"{label} · supervised: x"}
    assert means[f"{label} · none"] > 10 * means[f"{label} · supervised: x"]
    for table in paper_tables(board):
        assert {row.cells[0] for row in table.rows if not row.reference} >= means.keys()
    shutil.rmtree(tmp_path / "a/gcpose_rgbd_axes/mini/ur5")
    shutil.rmtree(tmp_path / "b/gcpose_rgbd_axes/mini/iiwa14")
    scores = suite_scores(read_leaderboard([tmp_path / "a", tmp_path / "b"]))
    assert {score.label: score.datasets for score in scores} == dict.fromkeys(means, 1)


def test_few_sequences_have_no_interval(tmp_path: Path) -> None:
    for dataset in ("mini/ur5", "mini/oven"):
        write_results(tmp_path, ICP, 0.05, dataset, sequences=4)
        write_results(tmp_path, GCPOSE, 0.001, dataset, sequences=4)
    board = read_leaderboard([tmp_path])
    assert not board.differences and set(board.ranks) == {1}
    assert all(score.interval is None for score in suite_scores(board))
    rows = list(csv.DictReader(io.StringIO(leaderboard_csv(board))))
    assert [(row["ci_low"], row["ci_high"]) for row in rows] == [("", "")] * 4
    assert " to " not in leaderboard_text(build_leaderboard(find_runs(tmp_path)))


@pytest.mark.parametrize(("x", "text"), [
    (0.0, "0"), (0.001234, "0.00123"), (1.0, "1.00"), (12.345, "12.3"), (123.4, "123"),
    (1234.5, "1234"), (0.00000123, "1.2e-06"), (-0.5, "-0.500"), (float("nan"), "–"),
])  # fmt: skip
def test_numbers_have_three_significant_digits(x: float, text: str) -> None:
    assert format_error(x) == text


def test_two_versions_are_two_rows(tmp_path: Path) -> None:
    write_results(tmp_path / "a", GCPOSE, 0.01)
    write_results(tmp_path / "b", dataclasses.replace(GCPOSE, version="2.0"), 0.02)
    board = read_leaderboard([tmp_path / "a", tmp_path / "b"])
    assert sorted(board.labels) == ["gcpose · rgbd · axes · 1.0", "gcpose · rgbd · axes · 2.0"]


def test_a_report_that_cannot_be_written(results: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GcbenchError, match="cannot write"):
        report([results], tmp_path / "file", progress=False)


# -- pictures ---------------------------------------------------------------------------------


def test_the_worst_and_the_median_are_chosen(results: Path) -> None:
    lines = read_leaderboard([results]).lines
    pictures = select_pictures(lines)
    assert len(pictures) == 2 * len(lines)
    for picture in pictures:
        errors = sequence_errors(lines[picture.line])
        assert picture.error == errors[picture.sequence]
        position = sorted(errors.values()).index(picture.error)
        assert position == (5 if picture.kind == "worst" else 2)
        assert np.mean([e for _, e in picture.joints]) == pytest.approx(picture.error)


def test_the_best_rows_of_each_dataset_have_pictures(results: Path) -> None:
    lines = read_leaderboard([results]).lines
    many = [line for line in lines for _ in range(9 if line.dataset == "mini/ur5" else 1)]
    chosen = {picture.line for picture in select_pictures(many * 2)}
    assert len(chosen) == MAX_LINES < len(many * 2)
    few = [k for k, line in enumerate(many * 2) if line.dataset == "mini/iiwa14"]
    assert set(few) < chosen, "all rows of the dataset with few rows"
    assert chosen - set(few) == set(range(MAX_LINES - len(few))), "and the best of the other"


def test_a_command_is_quoted(results: Path) -> None:
    line = read_leaderboard([results]).lines[0]
    run = dataclasses.replace(line.run.run, data="data; rm -r x")
    line = dataclasses.replace(line, run=dataclasses.replace(line.run, run=run))
    for picture in select_pictures([line]):
        assert picture.command == f"gcbench show 'data; rm -r x' --index {int(picture.sequence)}"


def test_without_the_dataset_there_is_a_reason_instead_of_a_picture(results: Path) -> None:
    lines = read_leaderboard([results]).lines
    pictures = draw_pictures(lines, select_pictures(lines), progress=False)
    assert all(not p.image and "not a dataset" in p.reason for p in pictures)
    assert write_pages(lines, pictures, results / "out") == pictures
    assert not (results / "out").exists()


def test_oracle_and_plain_are_different_rows(tmp_path: Path) -> None:
    write_results(tmp_path, ICP, 0.02)
    write_results(tmp_path, ORACLE, 0.01)
    text = leaderboard_csv(read_leaderboard([tmp_path]))
    assert [row["method"] for row in csv.DictReader(io.StringIO(text))] == ["icp@true-parts", "icp"]


# -- calibration ------------------------------------------------------------------------------


def test_errors_are_compared_with_their_standard_deviations_and_flags(tmp_path: Path) -> None:
    write_results(tmp_path, GCPOSE, 0.1, sequences=60, failing=(3,))
    write_results(tmp_path, STILL, None, sequences=60)
    sure, still = read_leaderboard([tmp_path]).lines
    assert (sure.row, still.calibration) == (GCPOSE, None)
    found = sure.calibration
    assert found is not None
    assert found.joints == 3 * 59, "a failed sequence has no standard deviation"
    assert list(found.inside) == pytest.approx(LEVELS, abs=0.08)
    assert found.reliable == pytest.approx(2 / 3)
    first = [e for (name, joint), e in sure.error.items() if joint == "pan" and name != "000003"]
    assert found.other_error == pytest.approx(np.mean(first))
    assert found.large == sum(
        e > 10 for (name, _), e in sure.error.items() if name != "000003")
    assert found.large_told == pytest.approx(sum(e > 10 for e in first) / found.large)
    sure_large = sum(e > 10 for (name, joint), e in sure.error.items()
                     if joint != "pan" and name != "000003")
    assert found.large_reliable == sure_large > 0
    assert sure.answers == {"within_sigma": 3 * 59, "reliable": 3 * 59} and not still.answers
    report([tmp_path], tmp_path / "out", progress=False)
    data = data_of(tmp_path / "out" / "index.html")
    assert data["lines"][0]["calibration"]["large_reliable"] == sure_large
    assert data["lines"][0]["answers"] == sure.answers
    assert [line["calibration"] is None for line in data["lines"]] == [False, True]
    assert data["lines"][0]["reliable"] == pytest.approx(2 / 3)


def test_flags_without_standard_deviations_are_told(tmp_path: Path) -> None:
    path = write_results(tmp_path, GCPOSE, 0.01)
    kept = [r for r in read_results(path / SCORES) if r.metric in ("final_error", "reliable")]
    write_scores(path / SCORES, kept)
    found = read_leaderboard([tmp_path]).lines[0].calibration
    assert found is not None
    assert (found.joints, found.inside, found.large, found.large_told) == (0, (), 0, None)
