"""RAFT of torchvision behind `--flow torchvision:NAME`: pixels, sizes, weights, messages."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.gcpose.images.flow import find_flow

from ...support import analytic, bench_data

torch = pytest.importorskip("torch", reason="networks need PyTorch")
if find_spec("torchvision") is None:
    pytest.skip("networks of torchvision need torchvision", allow_module_level=True)

from gcbench.gcpose.networks.torchvision_raft import import_torchvision  # noqa: E402
from gcbench.gcpose.networks.weights import write_weights  # noqa: E402

MODELS = import_torchvision().models
OFFERED = MODELS.get_model_weights("raft_small")


def noise(*size: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (*size, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def network():  # type: ignore[no-untyped-def]
    torch.manual_seed(0)
    return MODELS.get_model("raft_small", weights=None).eval()


@pytest.fixture(scope="module")
def weights(network, tmp_path_factory: pytest.TempPathFactory) -> Path:  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("weights") / "mine.safetensors"
    write_weights(path, network)
    return path


@pytest.fixture
def cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file in which torchvision keeps its default weights, in a cache that is empty."""
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    for name in ("http_proxy", "https_proxy", "HTTPS_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")  # nothing listens there
    path = tmp_path / "torch/hub/checkpoints" / OFFERED.DEFAULT.url.rpartition("/")[2]
    path.parent.mkdir(parents=True)
    return path


def test_the_flow_is_that_of_the_network_on_images_that_it_takes(network, weights: Path) -> None:  # type: ignore[no-untyped-def]
    flow = find_flow(f"torchvision:raft_small:{weights}")
    a, b = noise(128, 136), noise(128, 136)[::-1].copy()
    for first, second in ((a, b), (b, a)):  # there and back
        tensors = (torch.from_numpy(x).permute(2, 0, 1)[None] for x in (first, second))
        with torch.no_grad():
            expected = network(*OFFERED.DEFAULT.transforms()(*tensors))[-1][0].permute(1, 2, 0)
        assert expected.abs().max() > 1
        np.testing.assert_allclose(flow(first, second), expected, atol=1e-3)


@pytest.mark.parametrize("size", [(41, 150), (130, 61), (136, 128)])
def test_the_flow_is_in_pixels_of_images_of_any_size(network, size, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """A network that corrects by the same number of cells (8 px) twelve times."""
    moving = MODELS.get_model("raft_small", weights=None)
    moving.load_state_dict(network.state_dict())
    last = moving.update_block.flow_head.conv2
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor([0.02, -0.01]))
    write_weights(tmp_path / "moving.safetensors", moving)
    found = find_flow(f"torchvision:raft_small:{tmp_path}/moving.safetensors")(
        noise(*size), noise(*size))
    assert found.shape == (*size, 2) and found.dtype == np.float32
    np.testing.assert_allclose(found, np.broadcast_to([1.92, -0.96], found.shape), atol=1e-3)


def test_weights_in_the_cache_of_torchvision_need_no_network(network, cached: Path) -> None:  # type: ignore[no-untyped-def]
    torch.save(network.state_dict(), cached)
    data = "supervised: FlyingChairs, FlyingThings3D (torchvision raft_small C_T_V2; licence"
    method = load_method(with_options("gcpose-flow", {"flow": "torchvision:raft_small"}))
    assert method.name == "gcpose-flow flow=torchvision:raft_small"
    assert method.training.startswith(data)
    named = load_method(with_options("gcpose-epipolar", {"flow": "torchvision:raft_small:C_T_V2"}))
    assert named.name == "gcpose-epipolar flow=torchvision:raft_small:C_T_V2"
    assert named.training.startswith(data) and named.training.endswith("on the video")


def test_a_cached_file_that_would_run_code_is_refused(cached: Path, tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, ...]:
            return os.mkdir, (str(tmp_path / "sprung"),)

    torch.save({"x": Trap()}, cached)
    with pytest.raises(GcbenchError, match="torchvision cannot load https://"):
        find_flow("torchvision:raft_small")
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(("name", "said"), [
    ("torchvision", "no optical flow ''; there are raft_large, raft_small"),
    ("torchvision:raft_larg", "perhaps you meant raft_large"),
    ("torchvision:resnet18", "no optical flow 'resnet18'"),
    ("torchvision:raft_small:C_T_V3", "perhaps you meant C_T_V"),
    ("torchvision:raft_small:none.pth", "no such file; there are C_T_V1, C_T_V2"),
    ("torchvision:raft_large:MINE", "no weights of raft_large"),
    ("torchvision:raft_small", "download it elsewhere and use --flow torchvision:raft_small:FILE"),
])
def test_a_wrong_name_is_told_what_there_is(  # type: ignore[no-untyped-def]
    name: str, said: str, weights: Path, cached: Path
) -> None:
    with pytest.raises(GcbenchError) as caught:
        find_flow(name.replace("MINE", str(weights)))
    assert said in str(caught.value) and "\n" not in str(caught.value)
    assert not list(cached.parent.iterdir())


@pytest.mark.slow
def test_eval_runs_it_and_the_row_names_it(weights: Path, tmp_path: Path) -> None:
    data = tmp_path / "d"
    data.mkdir()
    bench_data.make_dataset(data, 1)
    (data / "sequences/000000.zip").unlink()
    bench_data.save(analytic.render(width=96, height=72, frames=3, room=False), data, 0, 1.0, True)
    run = EvalConfig(method=("gcpose-flow",), flow=f"torchvision:raft_small:{weights}",
                     data=(data,), results=tmp_path / "results", workers=1)
    (scored,) = evaluate(run, progress=False).runs
    results = scored.results()
    assert {r.status for r in results} == {"ok"}
    (name,), (training,) = {r.method for r in results}, {r.training for r in results}
    assert name == "gcpose-flow flow=torchvision:raft_small:mine.safetensors"
    assert training == "unknown: the file mine.safetensors"
