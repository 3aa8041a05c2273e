"""A suite is a recipe that anyone renders the same."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path

import pytest
from gcbench import GcbenchError
from gcbench.benchmark.run import datasets
from gcbench.benchmark.run.suite import builtin_suites, parse_suite, read_suite
from gcbench.renderer import generate
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.scene.models import draw_instance
from gcbench.renderer.scene.sampling import Streams
from gcbench.robots.catalog import is_category
from gcbench.robots.files import lock_folder

from ...support import bench_data

MINE = b"""
name = "mine"
[defaults]
seed = 5
[defaults.randomization.background]
room = 0.0
[[dataset]]
name = "one"
n = 2
[[dataset]]
name = "two"
n = 3
robot = "iiwa14"
seed = 6
randomization.motion.max_step = 3.0
"""


def test_the_shipped_suites_are_the_protocols() -> None:
    assert builtin_suites() == ("mini", "paper", "standard")
    sizes = {s: {d.name: d.n for d in read_suite(s).datasets} for s in builtin_suites()}
    robots = ("ur5", "ur5-textured", "iiwa14", "irb2400", "owi535")
    objects = ("microwave", "dishwasher", "oven")
    assert sizes["mini"] == dict.fromkeys(robots + objects, 8)
    assert sizes["standard"] == dict.fromkeys(robots + objects, 100)
    assert sizes["paper"] == {
        **dict(zip(robots, (1000, 200, 200, 200, 200), strict=True)), **dict.fromkeys(objects, 63)}
    for name in builtin_suites():
        suite = read_suite(name)
        assert suite.name == name
        for d in suite.datasets:
            c = d.config
            frames = 16 if d.name in objects else 15
            assert (c.frames, c.width, c.height, c.stream) == (frames, 640, 480, "test")
            assert not c.keep_unobservable
            assert c.randomization.motion.total == (10, 70)
        assert suite.datasets[1].config.randomization.textures.probability == 1
    assert [read_suite(s).title for s in builtin_suites()] == ["mini-2", "paper-2", "standard"]


def test_no_two_sequences_of_the_shipped_suites_share_draws() -> None:
    motions: dict[float, str] = {}
    instances: list[str] = []
    for suite in map(read_suite, builtin_suites()):
        for d in suite.datasets:
            streams = [Streams(d.config, i) for i in range(d.n)]
            drawn = dict.fromkeys((s.rng("motion").random() for s in streams), suite.name)
            if d.name == "ur5-textured":  # the only twin
                assert drawn.items() <= motions.items()
            else:
                assert not drawn.keys() & motions.keys()
            motions |= drawn
            instances += map(draw_instance, streams) if is_category(d.config.robot) else []
    assert len(set(instances)) == len(instances) == 3 * (8 + 63 + 100)


def test_a_users_own_file_works(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(MINE)
    suite = read_suite(path)
    one, two = suite.datasets
    assert (suite.name, one.name, one.n, one.config.seed) == ("mine", "one", 2, 5)
    assert (two.config.robot, two.config.seed) == ("iiwa14", 6)
    assert two.config.randomization.motion.max_step == 3
    assert one.config.randomization.motion == RenderConfig().randomization.motion
    assert one.config.randomization.background.room == 0 == two.config.randomization.background.room


@pytest.mark.parametrize(("old", "new", "message"), [
    (b'"mine"', b'"../mine"', r"\$\.name: expected str matching"),
    (b"n = 2", b"n = 0", r"dataset: \$\.n: expected int >= 1, got 0"),
    (b"n = 2", b'n = "2"', r"dataset: \$\.n: expected int, got '2'"),
    (b"n = 2", b"n = 2\ncolour = 1", r"one: \$\.colour: unknown field; there are robot"),
    (b"n = 2", b'n = 2\nstream = "train"', "one: stream is 'train'"),
    (b"n = 2", b"n = 2\nkeep_unobservable = true", "observable sequences only"),
    (b'"two"', b'"one"', "two datasets have the name 'one'"),
    (b"seed = 6", b"seed = -1", r"two: \$\.seed: -1: give 0"),
    (b"[defaults]", b"[default]", r"\$\.default: unknown field; there are name, dataset, about"),
    (b"iiwa14", b"r2d2", "two: no robot 'r2d2'; there are ur5"),
    (b"[[dataset]]", b"[[dataset", "not TOML"),
])
def test_what_cannot_be_meant_is_told(old: bytes, new: bytes, message: str) -> None:
    with pytest.raises(GcbenchError, match=f"mine.toml: .*{message}"):
        parse_suite(MINE.replace(old, new, 1), "mine.toml")


def test_unknown_suites_list_what_exists(tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="no suite 'maxi'; there are mini, paper, standard, and"):
        read_suite("maxi")
    with pytest.raises(GcbenchError, match="No such file"):
        read_suite(tmp_path / "none.toml")
    with pytest.raises(GcbenchError, match=r"x: \$\.dataset: missing"):
        parse_suite(b'name = "x"', "x")


def test_what_is_missing_is_rendered_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[str, int]] = []

    def render(
        config: RenderConfig, wanted: list[int], out: Path, *_: object, **__: object
    ) -> None:
        asked.append((config.robot, len(wanted)))
        if not out.exists():
            bench_data.make_dataset(out, len(wanted) + 1, unobservable=(0,))

    monkeypatch.setattr(generate, "render_dataset", render)
    suite = parse_suite(MINE, "mine")
    for _ in range(2):
        data = datasets.from_suite(suite, tmp_path)
    assert asked == [("ur5", 2), ("iiwa14", 3)] * 2
    assert capsys.readouterr().err.splitlines() == [
        "mine/one: 2 of 2 sequences to render", "mine/two: 3 of 3 sequences to render"]
    assert [d.name for d in datasets.from_suite(replace(suite, version=2), tmp_path)] == [
        "mine-2/one", "mine-2/two"]  # never the folders or the rows of another version
    one, two = data
    assert (one.name, one.sequences, one.left_out) == ("mine/one", ("000001",), 1)
    assert two.sequences == ("000001", "000002")
    chosen = datasets.from_suite(suite, tmp_path, datasets.Selection(
        "2", keep_unobservable=True, datasets=("two",)))
    assert chosen[0].sequences == ("000002",) and asked[-1] == ("iiwa14", 1)
    with pytest.raises(GcbenchError, match="mine/one has no sequence 2; there are 0 to 1"):
        datasets.from_suite(suite, tmp_path, datasets.Selection("0-2"))
    with pytest.raises(GcbenchError, match=r"no dataset 'tow' \(perhaps you meant two\)"):
        datasets.from_suite(suite, tmp_path, datasets.Selection(datasets=("one", "tow")))
    with pytest.raises(GcbenchError, match="--datasets chooses from a suite; with --data"):
        datasets.from_folders([tmp_path / "mine/one"], datasets.Selection(datasets=("one",)))


def test_what_another_process_renders_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mine/one"
    bench_data.make_dataset(folder, 2)
    waited: list[float] = []

    def wait(seconds: float) -> None:
        waited.append(seconds)
        if len(waited) == 3:
            lock.close()

    def render(*_: object) -> None:
        with lock_folder(folder):
            pass

    monkeypatch.setattr(datasets.time, "sleep", wait)
    monkeypatch.setattr(generate, "render_dataset", render)
    with ExitStack() as lock:
        lock.enter_context(lock_folder(folder))
        data = datasets.from_suite(parse_suite(MINE, "mine"), tmp_path,
                                   datasets.Selection(datasets=("one",)))
    assert len(data[0].sequences) == 2
    assert len(waited) == 3
    assert capsys.readouterr().err == (
        "gcbench: mine/one: waits for another gcbench that renders it\n")


def test_the_recipes_are_in_the_wheel() -> None:
    try:
        files = distribution("gcbench").files
    except ModuleNotFoundError:
        pytest.skip("gcbench is not installed")
    names = {str(file) for file in files or ()}
    if not any(name.endswith("benchmark/run/suite.py") for name in names):
        pytest.skip("gcbench is installed in place")
    assert any(name.endswith("suites/mini.toml") for name in names)


def test_a_folder_with_a_dataset_of_a_suite_has_its_name(tmp_path: Path) -> None:
    folder = bench_data.make_dataset(tmp_path / "copy")
    suite = read_suite("standard").datasets[0].config
    for config, name in ((suite, "standard/ur5"), (replace(suite, seed=1), "copy")):
        write_provenance(folder, new_provenance(config))
        assert [data.name for data in datasets.from_folders([folder])] == [name]
