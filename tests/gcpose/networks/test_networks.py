"""Flow and depth networks: shapes, laws, and what a wrong file is told. Untrained, all of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.gcpose.images.depth import NetworkDepth, find_depth
from gcbench.gcpose.images.flow import dis_flow, find_flow, fine_dis_flow, for_cuts_of, training_of
from gcbench.gcpose.images.settings import FlowSettings

torch = pytest.importorskip("torch", reason="networks need PyTorch")

from gcbench.gcpose.images import raft_network  # noqa: E402
from gcbench.gcpose.images.network_flow import RaftFlow, load_tunable_raft  # noqa: E402
from gcbench.gcpose.networks import flownet2, monodepth2, raft  # noqa: E402
from gcbench.gcpose.networks.torch_runtime import warp_image  # noqa: E402


def picture(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    import cv2

    noise = rng.uniform(0, 255, (height // 8, width // 8, 3)).astype(np.float32)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(
        np.uint8)


@pytest.fixture(scope="module")
def network() -> raft.Raft:
    torch.manual_seed(0)
    return raft.Raft()


def test_raft_is_small(network: raft.Raft) -> None:
    assert 0.8e6 < sum(p.numel() for p in network.parameters()) < 1.3e6


def test_an_untrained_raft_sees_no_motion(network: raft.Raft) -> None:
    a, b = torch.rand(2, 1, 3, 48, 64)
    out = network(a, b, iterations=2)
    assert [tuple(c.shape) for c in out.coarse] == [(1, 2, 12, 16)] * 2
    torch.testing.assert_close(out.fine, torch.zeros(1, 2, 48, 64))


@pytest.mark.parametrize("dilation", [1, 2])
def test_correlations_are_products_of_neighbors(dilation: int) -> None:
    generator = torch.Generator().manual_seed(1)
    a, b = torch.randn(2, 2, 8, 10, 12, generator=generator)
    got = raft.correlations(a, b, dilation)
    for y, x, dv, du in ((3, 4, 2, -3), (9, 0, -4, 2), (5, 5, 1, 1), (2, 11, 3, -2), (0, 0, 0, 0)):
        v, u = y + dv * dilation, x + du * dilation
        inside = 0 <= v < 10 and 0 <= u < 12
        expected = (a[1, :, y, x] @ b[1, :, v, u]) / 8**0.5 if inside else torch.tensor(0.0)
        torch.testing.assert_close(got[1, y, x, dv + raft.REACH, du + raft.REACH], expected)


def test_look_interpolates_where_the_flow_points() -> None:
    """On windows that are linear in the displacement it reads that displacement off."""
    n = 2 * raft.REACH + 1
    line = torch.arange(n, dtype=torch.float32) - raft.REACH
    windows = (10 * line[:, None] + line).expand(1, 2, 3, n, n)
    flow = torch.tensor([0.25, -1.5])[None, :, None, None].expand(1, 2, 2, 3)
    seen = raft.sample_windows(windows, flow)
    middle = seen.shape[1] // 2
    torch.testing.assert_close(seen[0, middle], torch.full((2, 3), 10 * -1.5 + 0.25))
    torch.testing.assert_close(seen[0, middle + 1], torch.full((2, 3), 10 * -1.5 + 1.25))
    far = torch.full((1, 2, 2, 3), 50.0)
    assert not raft.sample_windows(windows, far).any()


def test_warping_undoes_a_shift() -> None:
    image = torch.rand(1, 2, 9, 11)
    flow = torch.tensor([2.0, -1.0])[None, :, None, None].expand(1, 2, 9, 11)
    there = warp_image(image, flow)
    torch.testing.assert_close(there[:, :, 1:, :-2], image[:, :, :-1, 2:], atol=1e-5, rtol=0)


@pytest.mark.parametrize("size", [(240, 320), (61, 83), (480, 640)])
def test_raft_takes_any_size(network: raft.Raft, size: tuple[int, int]) -> None:
    """Whatever it must reduce and pad; its flow is in pixels of the images that it was given."""
    rng = np.random.default_rng(0)
    a = picture(rng, *size)
    b = np.roll(a, (1, 3), (0, 1))
    flow = RaftFlow(network, FlowSettings(raft_iterations=1))(a, b)
    assert flow.shape == (*size, 2) and flow.dtype == np.float32 and not flow.any()
    biased = raft.Raft()
    with torch.no_grad():
        biased.step.bias += torch.tensor([0.25, -0.5])  # cells, once an iteration
    moved = RaftFlow(biased, FlowSettings(raft_iterations=2))(a, b)
    factor = max(1, min(size) / 320)
    expected = np.broadcast_to([2.0 * factor, -4.0 * factor], moved.shape)
    np.testing.assert_allclose(moved, expected, rtol=0.01)


def test_raft_sees_a_cut_as_small_as_the_whole() -> None:
    biased = raft.Raft()
    with torch.no_grad():
        biased.step.bias += torch.tensor([0.25, -0.5])  # cells of 4 px, once an iteration
    rng = np.random.default_rng(0)
    a, b = picture(rng, 96, 128), picture(rng, 96, 128)
    cut = for_cuts_of(RaftFlow(biased, FlowSettings(raft_iterations=2)), 480, 640)
    moved = cut(a, b)
    np.testing.assert_allclose(moved, np.broadcast_to([3.0, -6.0], moved.shape), rtol=0.01)
    assert for_cuts_of(fine_dis_flow, 480, 640) is fine_dis_flow


@pytest.mark.parametrize("flow", [dis_flow, fine_dis_flow])
def test_dis_finds_a_shift(flow: object) -> None:
    a = picture(np.random.default_rng(1), 96, 128)
    found = flow(a, np.roll(a, (-2, 4), (0, 1)))  # type: ignore[operator]
    np.testing.assert_allclose(np.median(found[16:-16, 16:-16], axis=(0, 1)), [4, -2], atol=0.1)


def test_raft_weights_round_trip(tmp_path: Path) -> None:
    from gcbench.gcpose.networks.weights import write_weights

    path = tmp_path / "raft.safetensors"
    torch.manual_seed(3)
    moved = raft.Raft()
    torch.nn.init.normal_(moved.step.weight, std=0.1)  # untrained, it sees no motion
    write_weights(path, moved)
    rng = np.random.default_rng(2)
    a, b = picture(rng, 64, 96), picture(rng, 64, 96)
    found = find_flow(f"raft:{path}")(a, b)
    assert np.ptp(found) > 0.1
    np.testing.assert_allclose(found, RaftFlow(moved)(a, b), atol=2e-3)


def test_numpy_computes_the_flow_that_pytorch_does() -> None:
    """Near the edge, too, where the flow leaves the image."""
    rng = np.random.default_rng(7)
    a = picture(rng, 150, 203)
    b = np.roll(a, (3, 20), (0, 1))
    found, expected = raft_network.load_raft()(a, b), load_tunable_raft(device="cpu")(a, b)
    assert np.ptp(expected) > 10
    np.testing.assert_allclose(found, expected, atol=5e-3)


def test_flownet2_is_the_official_one() -> None:
    with torch.device("meta"):
        network = flownet2.FlowNet2()
        out = network(torch.zeros(2, 3, 128, 192), torch.zeros(2, 3, 128, 192))
    assert tuple(out.shape) == (2, 2, 128, 192)
    assert sum(p.numel() for p in network.parameters()) == 162_518_834
    keys = network.state_dict()
    for key, shape in {
        "flownetc.conv1.0.weight": (64, 3, 7, 7),
        "flownetc.conv_redir.0.weight": (32, 256, 1, 1),
        "flownetc.conv3_1.0.weight": (256, 473, 3, 3),
        "flownetc.upsampled_flow6_to_5.bias": (2,),
        "flownets_1.conv1.0.weight": (64, 12, 7, 7),
        "flownets_2.deconv5.0.weight": (1024, 512, 4, 4),
        "flownets_2.predict_flow2.weight": (2, 194, 3, 3),
        "flownets_d.inter_conv5.0.weight": (512, 1026, 3, 3),
        "flownetfusion.predict_flow0.bias": (2,),
        "flownetfusion.upsampled_flow2_to_1.bias": (2,),
    }.items():
        assert tuple(keys[key].shape) == shape, key
    assert "flownets_1.upsampled_flow6_to_5.bias" not in keys


def test_flownet2_correlates_rows_first() -> None:
    generator = torch.Generator().manual_seed(3)
    a, b = torch.randn(2, 1, 4, 50, 60, generator=generator)
    got = flownet2.correlation(a, b)
    assert got.shape[1] == 441
    for dv, du in ((0, 0), (2, -4), (-20, 20)):
        channel = (dv + 20) // 2 * 21 + (du + 20) // 2
        expected = (a[0, :, 25, 30] * b[0, :, 25 + dv, 30 + du]).mean()
        torch.testing.assert_close(got[0, channel, 25, 30], expected)


def test_monodepth2_is_the_official_one(tmp_path: Path) -> None:
    torch.manual_seed(4)
    encoder, decoder = monodepth2.DepthEncoder(), monodepth2.DepthDecoder()
    assert sum(p.numel() for p in encoder.parameters()) == 11_176_512  # ResNet-18 without its head
    names = set(decoder.state_dict())
    assert {"decoder.0.conv.conv.weight", "decoder.9.conv.conv.bias", "decoder.10.conv.weight",
            "decoder.13.conv.bias"} <= names and len(names) == 28
    torch.save({**encoder.state_dict(), "height": 192, "width": 640, "use_stereo": False,
                "encoder.fc.bias": torch.zeros(1000)}, tmp_path / "encoder.pth")
    torch.save(decoder.state_dict(), tmp_path / "depth.pth")
    depth = find_depth(f"mono:{tmp_path}")
    assert isinstance(depth, NetworkDepth) and depth.training == "self-supervised: KITTI"
    out = depth(picture(np.random.default_rng(5), 96, 128))
    assert out.shape == (96, 128) and 0.1 <= out.min() < out.max() <= 100
    ends = monodepth2.depth_from_disparity(torch.tensor([0.0, 1.0]))
    torch.testing.assert_close(ends, torch.tensor([100.0, 0.1]))


@pytest.mark.parametrize(("make", "name", "package"), [
    (find_flow, "torchvision:raft_small", "torchvision"),
    (find_depth, "hf:some/model", "transformers"),
])
def test_a_missing_package_is_named_with_how_to_get_it(  # type: ignore[no-untyped-def]
    make, name: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(GcbenchError, match=f"needs {package}.*: pip install {package}$"):
        make(name)


@pytest.mark.parametrize("asked", [
    "images.network_flow.find_network_flow('raft')", "images.flow.find_flow('flownet2:x')",
    "images.depth.find_depth('mono:x')", "training.loop", "paper.pipeline.Epipolar()",
    "paper.fine_tune",
])
def test_without_pytorch_the_error_says_how_to_get_it(asked: str) -> None:
    package, module = asked.split(".")[:2]
    code = f"""import sys
sys.modules["torch"] = None
from gcbench import GcbenchError
try:
    import gcbench.gcpose.{package}.{module}
    gcbench.gcpose.{asked}
except GcbenchError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "a network needs PyTorch: pip install '.[learn]'\n", done.stderr


def test_depth_none_is_none() -> None:
    assert find_depth("none") is None


def test_the_weights_that_come_with_it_are_small_and_see_how_a_plain_bar_moves() -> None:
    assert raft_network.RAFT_WEIGHTS.stat().st_size < 3_000_000
    rng = np.random.default_rng(2)
    plain = np.full((144, 176, 3), 90, np.uint8)  # a plain bar on a ground with texture
    ground = cv2.GaussianBlur(rng.uniform(0, 255, plain.shape), (0, 0), 3).astype(np.uint8)
    bar, shift = np.zeros(plain.shape[:2], bool), 6
    bar[40:100, 50:90] = True
    a = np.where(bar[..., None], plain, ground)
    b = np.where(np.roll(bar, shift, 1)[..., None], plain, ground)
    found, dis = (f(a, b)[bar].mean(axis=0) for f in (raft_network.load_raft(), fine_dis_flow))
    assert np.linalg.norm(found - (shift, 0)) < np.linalg.norm(dis - (shift, 0))


def test_a_row_says_what_its_networks_were_trained_on() -> None:
    source = "gcbench.gcpose.paper.pipeline:Epipolar"
    said = "supervised: flow of synthetic video; self-supervised on the video"
    assert load_method(source).training == said
    source = "gcbench.gcpose.paper.pipeline:FlowOnly"
    assert load_method(source).training == "none"
    assert load_method(with_options(source, {"flow": "dis"})).training == "none"
    assert load_method(with_options(source, {"flow": "raft"})).training in said
    networks = NetworkDepth(dis_flow, "x"), raft_network.load_raft(), dis_flow, None  # type: ignore[arg-type]
    assert training_of(*networks, then="y") == "x; supervised: flow of synthetic video; y"
    assert len(training_of(NetworkDepth(dis_flow, 300 * "x"))) == 200  # type: ignore[arg-type]


def test_flows_have_names_and_settings() -> None:
    rng = np.random.default_rng(5)
    a, b = picture(rng, 64, 96), picture(rng, 64, 96)
    assert find_flow("dis") is dis_flow
    fine = find_flow("dis-fine")(a, b)
    np.testing.assert_array_equal(fine, fine_dis_flow(a, b))
    fewer = FlowSettings(fine_iterations=1, raft_iterations=1)
    assert (find_flow("dis-fine", fewer)(a, b) != fine).any()
    assert (find_flow("raft", fewer)(a, b) != find_flow("raft")(a, b)).any()
    method = load_method(with_options("gcpose", {"set": "images.flow.fine_iterations=1"}))
    found = method.front_end.flow(a, b)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(found, find_flow("dis-fine", fewer)(a, b))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda _: find_flow("raft2"), "perhaps you meant raft); there are dis, dis-fine, raft"),
        (lambda _: find_flow("flownet2"), "needs its checkpoint"),
        (lambda _: find_depth("mono"), "not distributed with gcbench"),
        (lambda _: find_depth("deep"), "no depth 'deep'"),
        (lambda p: find_flow(f"raft:{p}/none.safetensors"), "there is no such file"),
        (lambda p: find_depth(f"mono:{p}"), "encoder.pth: there is no such file"),
    ],
)
def test_a_wrong_name_is_told_what_there_is(make, said: str, tmp_path: Path) -> None:
    with pytest.raises(GcbenchError) as caught:
        make(tmp_path)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_wrong_file_is_told_in_one_line(network: raft.Raft, tmp_path: Path) -> None:
    from safetensors.torch import save_file

    weights = dict(network.state_dict())
    cases: dict[str, str] = {}

    def case(name: str, said: str) -> Path:
        cases[name] = said
        return tmp_path / name

    case("noise.safetensors", "holds no tensors").write_bytes(b"\x08" * 100)
    case("noise.pth", "holds no tensors").write_bytes(b"no checkpoint")
    save_file({"x": torch.zeros(1)}, case("other.safetensors", "there is no tensor"))
    save_file({**weights, "step.bias": torch.zeros(3)}, case("size.safetensors", "expected [2]"))
    save_file({**weights, "step.bias": torch.full((2,), torch.nan)},
              case("nan.safetensors", "not finite"))
    torch.save([1, 2], case("list.pth", "no tensors by name"))
    for name, said in cases.items():
        with pytest.raises(GcbenchError) as caught:
            load_tunable_raft(tmp_path / name)
        assert said in str(caught.value) and "\n" not in str(caught.value), name
        told = r"no safetensors file|expected \[|not finite"
        with pytest.raises(GcbenchError, match=rf"{name}: .*({told})"):
            raft_network.load_raft(tmp_path / name)


def test_a_checkpoint_runs_nothing(tmp_path: Path) -> None:
    """A pickle that would make a file is refused, and makes none."""
    import os

    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    torch.save({"state_dict": Trap()}, tmp_path / "trap.pth")
    with pytest.raises(GcbenchError, match="holds no tensors that can be read safely"):
        find_flow(f"flownet2:{tmp_path / 'trap.pth'}")
    assert not (tmp_path / "sprung").exists()
