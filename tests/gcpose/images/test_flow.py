"""Two flows, and the evidence by each of them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench.errors import ConfigError
from gcbench.gcpose.chain import joint_priors
from gcbench.gcpose.images import FrontEnd, ImageSettings, subtract_background, video_evidence
from gcbench.gcpose.images.flow import Flow, FlowPair, dis_flow, find_flow, fine_dis_flow
from gcbench.gcpose.images.raft_network import RAFT_WEIGHTS, RaftInference, load_raft
from gcbench.gcpose.method import GCPose, two_flows_pay
from gcbench.gcpose.paper.pipeline import FlowOnly
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from ...support.boxes import scene, told
from ...support.ray_scenes import door, texture

SETTINGS = ImageSettings()


def constant(left: float, right: float) -> Flow:
    """A flow to the right, in px: one number in the left half of the image, another in the
    right half."""

    def flow(rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        height, width = rgb_a.shape[:2]
        out, middle = np.zeros((height, width, 2), np.float32), width // 2
        out[:, :middle, 0], out[:, middle:, 0] = left, right
        return out

    return flow


def test_a_name_makes_two_flows() -> None:
    rng = np.random.default_rng(5)
    a, b = texture(rng, 64, 96, 3.0), texture(rng, 64, 96, 3.0)
    flow = find_flow("dis-fine+dis")
    assert isinstance(flow, FlowPair)
    one, two = fine_dis_flow(a, b), dis_flow(a, b)
    assert np.abs(one - two).max() > 1
    np.testing.assert_allclose(flow(a, b), (one + two) / 2, atol=1e-5)
    method = GCPose(flow="dis-fine+dis")
    end = method.front_end
    assert end.second_flow is dis_flow
    np.testing.assert_array_equal(end.flow(a, b), one)
    assert method.name == "gcpose flow=dis-fine+dis"
    assert method.training == GCPose("dis-fine").training
    with pytest.raises(ConfigError, match="no flow 'raft2'"):
        find_flow("dis-fine+raft2")


@pytest.mark.parametrize(("kind", "knowledge", "inputs", "two"), [
    ("arm", "axes", "rgb", True), ("arm", "kinematics", "rgb", False),
    ("arm", "free", "rgb", False), ("arm", "axes", "rgbd", False), ("slide", "axes", "rgb", False),
])
def test_two_flows_are_the_default_where_they_pay(
    kind: str, knowledge: str, inputs: str, two: bool
) -> None:
    seen = told(scene(kind)[0], knowledge)
    if inputs == "rgb":
        seen = replace(seen, depth=None)
    assert two_flows_pay(seen, joint_priors(seen)) == two
    second = GCPose().front_end.second_flow
    assert isinstance(second, RaftInference) and second.training in GCPose().training
    assert GCPose("dis-fine").front_end.second_flow is None


def test_the_network_takes_gates_that_are_shut(tmp_path: Path) -> None:
    tensors = load_file(RAFT_WEIGHTS)
    tensors["gates.bias"] = np.full_like(tensors["gates.bias"], -200)  # exp(200) overflows
    save_file(tensors, tmp_path / "shut.safetensors")
    image = texture(np.random.default_rng(5), 64, 96, 3.0)
    assert np.isfinite(load_raft(tmp_path / "shut.safetensors")(image, image)).all()


def test_a_method_without_searches_takes_the_mean_of_two_flows() -> None:
    front = FrontEnd(FlowPair(constant(3, 3), constant(3, 7)),
                     lambda rgb: subtract_background(rgb, SETTINGS))
    video = video_evidence(door(0.5), front, SETTINGS)
    assert video is not None and video.second is None
    np.testing.assert_allclose(np.unique(video.flow[..., 0]), [3, 5])


def test_a_second_flow_has_its_own_evidence() -> None:
    front = FrontEnd(constant(3, 3), lambda rgb: subtract_background(rgb, SETTINGS),
                     bidirectional=True, second_flow=constant(3, 7))
    video = video_evidence(door(0.5), front, SETTINGS)
    assert video is not None and video.second is not None
    middle = video.flow.shape[2] // 2
    for each, right in ((video, 3), (video.second, 7)):
        assert each.flow_backward is not None
        for flow in (each.flow, each.flow_backward):
            np.testing.assert_allclose(flow[:, :, :middle, 0], 3)
            np.testing.assert_allclose(flow[:, :, middle:, 0], right)
    assert video.second.moving is video.moving


def test_weights_of_ones_own_are_in_the_name_of_the_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run").mkdir()
    shutil.copy(RAFT_WEIGHTS, tmp_path / "run/mine.safetensors")
    monkeypatch.chdir(tmp_path)
    for file in "run/mine.safetensors", str(tmp_path / "run/mine.safetensors"):
        assert FlowOnly(flow=f"raft:{file}").name == "gcpose-flow flow=raft:mine.safetensors"
    assert FlowOnly(flow="raft").name == "gcpose-flow flow=raft"
