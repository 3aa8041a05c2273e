"""Datasets of a category: each sequence shows another instance, whoever renders it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError, open_dataset
from gcbench.benchmark.run.datasets import select
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.scene.config import (
    FRONT,
    STUDIO,
    CameraConfig,
    MotionConfig,
    RandomizationConfig,
    RenderConfig,
    resolve,
)
from gcbench.renderer.scene.models import (
    dataset_asset,
    draw_instance,
    model_of,
    model_source,
    robot_of,
)
from gcbench.renderer.scene.motion import MotionSampler
from gcbench.renderer.scene.sampling import Streams
from gcbench.renderer.show.overlay import Painter
from gcbench.renderer.verify.driver import verify_dataset
from gcbench.robots.appliances.generator import APPLIANCE_SOURCE
from gcbench.robots.catalog import instance_numbers, load_robot
from gcbench.robots.motion.collision import CollisionChecker
from gcbench.robots.motion.trajectory import retract_slides, sample_trajectory

SMALL = RenderConfig(
    robot="microwave", frames=4, width=160, height=120, seed=3, randomization=replace(
        RandomizationConfig(), motion=MotionConfig(total=(15, 30), max_step=12)))


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GCBENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory, cache: None) -> Path:
    """Four small sequences, by one process."""
    out = tmp_path_factory.mktemp("data") / "microwave"
    render_dataset(SMALL, 4, out, workers=1, progress=False)
    return out


def drawn(config: RenderConfig, n: int = 50) -> list[str]:
    return [draw_instance(Streams(config, i)) for i in range(n)]


def test_an_instance_is_a_function_of_config_and_index() -> None:
    test, train = drawn(SMALL), drawn(replace(SMALL, stream="train"))
    assert test == drawn(replace(SMALL, width=320, frames=9))
    assert len({*test}) > 45 and not {*test} & {*train}
    for names, stream in ((test, "test"), (train, "train")):
        numbers = instance_numbers("microwave", stream)
        assert all(int(name.removeprefix("microwave:")) in numbers for name in names)
    assert test != drawn(replace(SMALL, seed=4))
    assert len({*drawn(replace(SMALL, vary=("lights",)))}) == 1
    assert drawn(replace(SMALL, robot="oven:17"), 3) == ["oven:17"] * 3


def test_an_instance_has_the_joints_that_are_asked_for() -> None:
    config = replace(SMALL, robot="oven", scored_joints=("rack", "door"))
    for index in range(3):
        cast = model_source(config, index)
        assert cast.scored == ("door", "rack")  # base outward
    with pytest.raises(GcbenchError, match="has no joint 'lid' of its own; there are door"):
        model_source(replace(SMALL, robot="oven:3", scored_joints=("lid",)), 0)


def test_the_camera_stands_before_the_front() -> None:
    assert resolve(SMALL).randomization.camera.azimuth == FRONT
    assert resolve(resolve(SMALL)) == resolve(SMALL)
    low, high = resolve(replace(SMALL, randomization=STUDIO)).randomization.camera.azimuth
    assert FRONT[0] < low == high < FRONT[1]
    mine = replace(SMALL.randomization, camera=CameraConfig(azimuth=(0.0, 90.0)))
    kept = resolve(replace(SMALL, robot="partnet:7310", randomization=mine))
    assert kept.randomization.camera.azimuth == (0, 90)
    assert resolve(RenderConfig()).randomization.camera.azimuth == (-180, 180)
    with pytest.raises(GcbenchError, match="oven:NUMBER"):
        resolve(replace(SMALL, robot="oven:one"))


@pytest.mark.parametrize("name", ["dishwasher:4", "oven:8", "microwave:15"])
def test_doors_start_anywhere_and_go_both_ways(name: str) -> None:
    model = load_robot(name)
    j = model.joint_names.index("door")
    low, high = model.limits[j]
    q = np.array([sample_trajectory(model, ("door",), 16, rng=np.random.default_rng(k))
                  .positions[:, j] for k in range(200)])
    assert (q >= low).all() and (q <= high).all()
    assert 60 < (q[:, -1] > q[:, 0]).sum() < 140
    assert np.ptp(q[:, 0]) > 0.9 * (high - low)
    assert np.std(np.abs(q[:, -1] - q[:, 0])) > np.radians(10)


def test_racks_are_drawn_in_where_the_door_would_hit_them() -> None:
    model = load_robot("dishwasher:4")
    motions = MotionSampler(model, ("door",), replace(SMALL, frames=8), None)
    slides = [model.joint_names.index(name) for name in ("rack", "rack_2")]
    out = 0
    for k in range(30):
        motion = motions.draw(np.random.default_rng(k))
        assert not motion.touches
        positions = motion.trajectory.positions
        assert (np.ptp(positions[:, slides], axis=0) == 0).all()
        out += bool((positions[0, slides] > 0.05).any())
    assert 0 < out < 30  # before an open door they may stand out
    still = retract_slides(model, ("door", "rack"), motion.trajectory)
    np.testing.assert_array_equal(still.positions[:, slides[0]], positions[:, slides[0]])
    assert (still.positions[:, slides[1]] == 0).all()
    assert retract_slides(model, ("door", "rack"), still) is still
    checker = CollisionChecker(model)
    groups = list(checker.groups.surfaces)  # the door against the racks counts
    assert any((a, b) not in checker.ignored for a, b in combinations(groups, 2))


@pytest.mark.gl
@pytest.mark.ci
def test_workers_and_restarts_make_the_same_bytes(dataset: Path, tmp_path: Path) -> None:
    render_dataset(SMALL, 1, tmp_path / "b", workers=1, progress=False)
    render_dataset(SMALL, 4, tmp_path / "b", workers=2, progress=False)
    for index in range(4):
        name = Path("sequences") / f"{index:06d}.zip"
        assert (dataset / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    one, two = (json.loads((d / "dataset.json").read_text()) for d in (dataset, tmp_path / "b"))
    assert one == two
    (asset,) = one["assets"]
    assert (asset["name"], asset["source"]) == (
        "microwave", APPLIANCE_SOURCE)


@pytest.mark.gl
def test_each_sequence_says_what_it_shows(dataset: Path) -> None:
    data = open_dataset(dataset)
    metas = [sequence.meta for sequence in data]
    shown = [meta.asset["instance"] for meta in metas]
    assert shown == drawn(resolve(SMALL), 4) and len({*shown}) == 4
    assert [robot_of(data.config, meta) for meta in metas] == shown
    assert len({meta.asset["sha256"] for meta in metas}) == 4
    assert all(meta.scored_joints == ("door",) for meta in metas)
    chosen = select("microwave", dataset)
    assert [chosen.cluster(name) for name in chosen.sequences] == shown
    for meta in metas:  # for methods that know the model
        assert model_of(data.config, meta).part_names == meta.part_names


def test_a_dataset_names_the_files_of_its_model(tmp_path: Path) -> None:
    urdf = tmp_path / "bar.urdf"
    urdf.write_text('<robot name="bar"><link name="a"><visual><geometry><box size="1 1 1"/>'
                    "</geometry></visual></link></robot>")
    config = resolve(replace(SMALL, robot=str(urdf)))
    source = model_source(config, 0)
    assert dataset_asset(config, source)["files"] == {"bar.urdf": source.model.sha256}
    assert "files" not in source.asset  # of each sequence's meta.json


@pytest.mark.gl
def test_one_instance_is_clustered_by_sequence(tmp_path: Path) -> None:
    render_dataset(replace(SMALL, robot="oven:17"), 2, tmp_path / "a", 1, progress=False)
    category = replace(SMALL, robot="oven", vary=("motion",))
    render_dataset(category, 2, tmp_path / "b", 1, progress=False)
    for name in ("a", "b"):
        chosen = select(name, tmp_path / name)
        assert [chosen.cluster(s) for s in chosen.sequences] == ["000000", "000001"]
    (asset,) = json.loads((tmp_path / "a" / "dataset.json").read_text())["assets"]
    assert asset["name"] == "oven:17" and len(asset["sha256"]) == 64


@pytest.mark.gl
def test_verify_proves_each_sequence_by_its_own_instance(dataset: Path) -> None:
    report = verify_dataset(dataset, progress=False)
    assert report.ok, report.table()
    by_name = {check.name: check for check in report.checks}
    assert by_name["poses from the URDF: position"].samples >= 4 * 4 * 3
    assert by_name["poses from the model: position"].samples >= 4 * 4 * 3
    data = open_dataset(dataset)
    for wrong in ("oven:3", "microwave:200000", "partnet:1", "../1", ""):
        meta = replace(data[0].meta, asset={**data[0].meta.asset, "instance": wrong})
        with pytest.raises(GcbenchError, match=r"names no object|is no microwave of the stream"):
            robot_of(data.config, meta)


@pytest.mark.gl
def test_estimates_are_painted_on_the_instance(dataset: Path) -> None:
    data = open_dataset(dataset)
    with Painter(model_of(data.config, data[0].meta), 160, 120) as painter:
        for sequence in data:
            painter.model = model_of(data.config, sequence.meta)
            q = sequence.state.joint_positions
            moved = q[-1] - q[0]
            truth = dict(zip(sequence.meta.joint_names, moved.tolist(), strict=True))
            image = painter.paint(sequence, truth)
            red = (image[..., 0].astype(int) - image[..., 1] > 40)
            there = sequence.part[-1] > 0
            assert (red & there).sum() > 0.99 * there.sum()
            assert (red & ~there).sum() < 0.35 * there.sum()  # its outline, a pixel wide
