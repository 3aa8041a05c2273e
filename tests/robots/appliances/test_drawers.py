"""Sliding joints from the renderer to the score: drawers of several chests, and a slide that hangs
on a hinge."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from gcbench.__main__ import main
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.scene.config import RandomizationConfig, RenderConfig
from gcbench.renderer.verify.driver import verify_dataset

from ...renderer.generate.test_render import JOINT, LINK

pytestmark = pytest.mark.gl
SCARA = "\n".join([
    LINK.format("base", "0 0 0.25", "0.14 0.12 0.5"),
    LINK.format("arm", "0.2 0 0", "0.46 0.12 0.06"),
    LINK.format("quill", "0 0 -0.05", "0.07 0.06 0.5"),
    LINK.format("tool", "0 0 0", "0.05 0.16 0.06"),
    JOINT.format("turn", "revolute", "base", "arm", "0 0 0.54", "0 0 1", -2.5, 2.5),
    JOINT.format("drop", "prismatic", "arm", "quill", "0.38 0 0.05", "0 0 -1", -0.12, 0.12),
    JOINT.format("flange", "fixed", "quill", "tool", "0.03 0.03 -0.3", "0 0 1", 0, 0),
])
SMALL = RenderConfig(frames=10, width=320, height=240, seed=9301)


def errors(data: Path, knowledge: str, out: Path) -> list[tuple[str, str, float]]:
    """Unit, status and error in the last frame of each joint of each sequence."""
    assert main(["eval", "--method", "gcpose", "--data", str(data), "--inputs", "rgbd",
                 "--knowledge", knowledge, "--results", str(out)]) == 0
    (scores,) = out.rglob("scores.csv")
    rows = csv.DictReader(scores.read_text().splitlines())
    return [(row["unit"], row["status"], float(row["value"])) for row in rows
            if row["metric"] == "final_error"]


@pytest.fixture(scope="module", params=[2, pytest.param(20, marks=pytest.mark.slow)])
def drawers(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "drawers"
    render_dataset(replace(SMALL, robot="drawer"), request.param, folder, workers=1, progress=False)
    return folder


@pytest.mark.parametrize("knowledge", ["free", "axes", "kinematics"])
@pytest.mark.ci
def test_gcpose_finds_how_far_a_drawer_slides(
    knowledge: str, drawers: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = errors(drawers, knowledge, tmp_path)
    assert len(found) == len(list((drawers / "sequences").glob("*.zip")))
    assert {(unit, status) for unit, status, _ in found} == {("m", "ok")}
    assert max(error for *_, error in found) < 1e-3
    assert " cm" in capsys.readouterr().out


@pytest.mark.parametrize("knowledge", ["free", "axes"])
@pytest.mark.ci
def test_gcpose_finds_a_slide_on_a_hinge(knowledge: str, tmp_path: Path) -> None:
    model, data = tmp_path / "scara.urdf", tmp_path / "data"
    model.write_text(f'<robot name="scara">{SCARA}</robot>')
    ranges = RandomizationConfig()
    ranges = replace(ranges, background=replace(ranges.background, room=0.0))
    config = replace(SMALL, robot=str(model), scored_joints=("turn", "drop"), randomization=ranges)
    render_dataset(config, 2, data, workers=1, progress=False)
    assert verify_dataset(data, progress=False).ok
    found = errors(data, knowledge, tmp_path / "results")
    assert [unit for unit, *_ in found] == ["rad", "m"] * 2 or [
        unit for unit, *_ in found] == ["deg", "m"] * 2
    assert all(error < (2e-3 if unit == "m" else 0.2) for unit, _, error in found), found
