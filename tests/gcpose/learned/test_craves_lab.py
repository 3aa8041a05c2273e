"""CRAVES' Lab data: the truth scores 0, its keypoints are those of the renderer, hostile files end
in one line."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gcbench as gb
import numpy as np
import pytest
from gcbench.__main__ import main
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.catalog import load_robot

from ...support.craves_lab import write_lab

torch = pytest.importorskip("torch", reason="networks need PyTorch")

from gcbench.gcpose.learned.arm_fit import ArmFit, ArmPose  # noqa: E402
from gcbench.gcpose.learned.craves_images import _images_of, arm_errors  # noqa: E402
from gcbench.gcpose.learned.craves_lab import read_lab  # noqa: E402


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    return gb.render_sequence(gb.RenderConfig(
        robot="owi535", frames=3, width=160, height=120, layers=("keypoints",), seed=9))


@pytest.fixture
def lab(tmp_path: Path, sequence: Sequence) -> Path:
    write_lab(tmp_path / "lab", sequence)
    return tmp_path / "lab"


def errors(fit: ArmFit, images: list[Any], turned: float = 0.0, shifted: float = 0.0) -> Any:
    """The errors of the truth, with another rotation (rad) or keypoints (px)."""
    left = iter(images)

    def poses(rgb: Any, intrinsics: Any, fit: ArmFit) -> Any:
        image = next(left)
        assert rgb[0] is image.rgb and intrinsics is image.intrinsics
        moved = image.angles + np.array([turned, 0.0, 0.0, 0.0])
        return [(image.keypoints + shifted, ArmPose(moved, None, 0.0))]

    return arm_errors(SimpleNamespace(poses=poses), fit, images)  # type: ignore[arg-type]


def test_the_truth_of_the_lab_data_is_that_of_the_renderer(lab: Path, sequence: Sequence) -> None:
    fit = ArmFit(load_robot("owi535"))
    images = list(read_lab(lab, fit))
    assert len(images) == 3
    for t, image in enumerate(images):
        assert np.array_equal(image.rgb, sequence.rgb[t])
        assert np.allclose(image.angles, sequence.state.joint_positions[t, :4])
        assert np.allclose(image.intrinsics, sequence.state.intrinsics)
        assert np.allclose(image.keypoints, sequence.state.keypoint_image[t], atol=1e-3)
    perfect = errors(fit, images)
    assert perfect.angle.max() == 0 and perfect.pixels.max() == 0 and perfect.close.all()
    assert "3 images, PCK@0.2 100.0 %" in perfect.table()
    turned = errors(fit, images, turned=2 * np.pi + 0.1, shifted=0.5 * 160)
    assert np.allclose(turned.angle[:, 0], np.degrees(0.1)) and not turned.close.any()


def test_the_better_half_is_of_the_images(sequence: Sequence) -> None:
    fit = ArmFit(load_robot("owi535"))
    images = list(_images_of([sequence]))  # type: ignore[arg-type]
    found = errors(fit, images)
    found.angle[:] = np.array([[4.0], [1.0], [2.0]])
    head, every, half, median, _ = found.table().splitlines()
    assert head.split()[1:] == ["rotation", "base", "elbow", "wrist", "mean"]
    assert every.split()[-1] == "2.33" and half.split()[-1] == "1.50"
    assert median.split()[-1] == "2.00"


def test_keypoints_are_unknown_where_the_joints_contradict_the_angles(lab: Path) -> None:
    fit, path = ArmFit(load_robot("owi535")), lab / "joint/00000001.json"
    tree = json.loads(path.read_text())
    tree["actor"]["WorldJoints"]["Wrist"]["X"] += 5
    path.write_text(json.dumps(tree))
    images = list(read_lab(lab, fit))
    assert np.isnan(images[1].keypoints).all() and np.isfinite(images[0].keypoints).all()
    found = errors(fit, images)
    assert found.angle.max() == 0 and "PCK@0.2 100.0 %" in found.table()


@pytest.mark.parametrize(("file", "text", "said"), [
    ("angles/00000001.json", "[1, 2]", "2 numbers; expected rotation"),
    ("angles/00000001.json", "[1, 2, 3, 1e400]", "not a list of angles"),
    ("angles/00000001.json", "[" * 10_000, "not a list of angles"),
    ("angles/00000001.json", None, "cannot be read"),
    ("joint/00000001.json", "{}", "WorldJoints"),
    ("joint/00000001.json", '{"actor": {"WorldJoints": {"Base": 1}}}', "Base"),
    ("FusionCameraActor3_2/caminfo/00000001.json", '{"Fov": 300}', "caminfo"),
    ("FusionCameraActor3_2/lit/00000001.png", "no image", "not an image"),
    ("FusionCameraActor3_2/lit/a b.png", "", "the name of an image"),
])
def test_a_damaged_file_is_one_line(lab: Path, file: str, text: str | None, said: str) -> None:
    path = lab / file
    path.unlink(missing_ok=True)
    if text is not None:
        path.write_text(text)
    with pytest.raises(gb.GcbenchError, match=said) as error:
        list(read_lab(lab, ArmFit(load_robot("owi535"))))
    assert "\n" not in str(error.value)


def test_the_command_needs_weights_and_images(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["craves-images", str(tmp_path), "--weights", str(tmp_path / "no")]) == 2
    listed = "craves needs weights: --weights owi535, or your own: gcbench train craves"
    assert listed in capsys.readouterr().err
    with pytest.raises(gb.DatasetError, match="expected CRAVES' Lab data"):
        list(read_lab(tmp_path, ArmFit(load_robot("owi535"))))
