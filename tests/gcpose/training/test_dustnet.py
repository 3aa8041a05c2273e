"""DUST-net: the normalizing constant is exact, the loss is least at the truth, estimates follow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.benchmark.protocol import observe
from gcbench.gcpose.training.config import DustNetTraining
from gcbench.renderer.dataset.reader import open_dataset

from ...support.one_joint import dataset

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.learned.dustnet import divide_frames  # noqa: E402
from gcbench.gcpose.networks.dustnet import DustNet, ScrewDistribution, log_normalizer  # noqa: E402
from gcbench.gcpose.networks.weights import read_notes, read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.dustnet_task import DustNetTask, distribution_loss  # noqa: E402
from gcbench.gcpose.training.screws import ScrewSample  # noqa: E402

PARAMETERS = [np.zeros((3, 2)), np.array([[3.0, 0.0], [0.0, 0.0], [0.0, 0.0]]),
              np.array([[2.0, 0.5], [-1.0, 1.5], [0.3, 0.0]]), np.eye(3, 2)]


def frames_of_directions(count: int) -> np.ndarray:
    """Matrices [N 3 2] of orthonormal columns, uniform."""
    q, r = np.linalg.qr(np.random.default_rng(0).standard_normal((count, 3, 2)))
    return q * np.sign(np.diagonal(r, axis1=1, axis2=2))[:, None]


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_the_normalizer_and_its_slope_are_those_of_samples(parameter: np.ndarray) -> None:
    x = frames_of_directions(400_000)
    likelihood = np.exp((x * parameter).sum((1, 2)))
    f = torch.from_numpy(parameter).requires_grad_()
    value = log_normalizer(f)
    value.backward()
    assert value.item() == pytest.approx(np.log(likelihood.mean()), abs=0.01)
    mean = np.einsum("n,nij->ij", likelihood, x) / likelihood.sum()
    assert np.allclose(f.grad, mean, atol=0.01)


def test_the_normalizer_is_exact_where_it_has_a_closed_form() -> None:
    k = torch.tensor([0.1, 2.0, 20.0, 300.0], dtype=torch.float64)
    f = torch.zeros(4, 3, 2, dtype=torch.float64)
    f[:, 1, 0] = k  # von Mises-Fisher on the sphere
    assert torch.allclose(log_normalizer(f), k + ((1 - (-2 * k).exp()) / (2 * k)).log(), atol=1e-6)
    sharp = 200.0 * torch.eye(3, 2, dtype=torch.float64)  # a normal distribution of small turns
    about = np.log((2 * np.pi) ** 1.5 / (8 * np.pi**2 * np.sqrt(2 * 200.0**3)))
    assert float(log_normalizer(sharp)) - 400 == pytest.approx(about, abs=0.02)
    assert torch.isfinite(log_normalizer(sharp.float()))


def truth(slides: bool) -> Any:
    rng = np.random.default_rng(1)
    l = rng.standard_normal((2, 3))
    l /= np.linalg.norm(l, axis=1)[:, None]
    m = 0 * l if slides else np.cross(rng.standard_normal((2, 3)), l)
    row = np.tile(np.concatenate([l, m, np.zeros((2, 2))], 1)[:, None], (1, 4, 1))
    row[..., 7 if slides else 6] = rng.uniform(0.1, 1, (2, 4))
    return torch.from_numpy(row)


def sure(true: Any, precision: float = 30.0) -> ScrewDistribution:
    """A distribution about true screws."""
    l, m = true[:, 0, :3], true[:, 0, 3:6]
    length = m.norm(dim=-1)
    f = torch.stack([l, m / length.clamp(min=1e-6)[:, None]], -1)
    every = torch.full_like(length, precision)
    return ScrewDistribution(
        20 * f, length, every, true[..., 6], every, true[..., 7], every)


def test_the_loss_is_least_at_the_truth() -> None:
    for slides in (False, True):
        true = truth(slides)
        right = sure(true)
        least = float(distribution_loss(right, true))
        turned = torch.tensor([[1, 0, 0], [0, 0.98, -0.199], [0, 0.199, 0.98]],
                              dtype=torch.float64)
        wrong = [replace(right, parameter=turned @ right.parameter)]
        wrong += [replace(right, **{name: getattr(right, name) + 0.1})
                  for name in ("moment", "turn", "slide")]
        wrong += [replace(right, turn_precision=right.turn_precision / 2)]
        for other in wrong:
            assert float(distribution_loss(other, true)) > least + 0.02
    turns = truth(False)
    assert torch.allclose(sure(turns).screws(), turns, atol=1e-6)


def test_the_network_has_the_size_of_the_paper() -> None:
    network = DustNet().eval()
    with torch.no_grad():
        numbers = network(torch.zeros(1, 16, 108, 192))
    assert numbers.shape == (1, 40)
    found = network.distribution(numbers)
    assert found.turn.shape == found.slide.shape == (1, 15)
    assert network.head[0].out_features == 1024


class Doors:
    """Small videos of doors that open to random angles."""

    def __len__(self) -> int:
        return 1000

    def sample(self, number: int) -> ScrewSample:
        rng = np.random.default_rng(number)
        angle = np.linspace(0, rng.uniform(0.2, 1.2), 5)
        depth = np.full((5, 27, 48), 0.25, np.float32)
        reach = np.arange(24, dtype=np.float32)
        for t, a in enumerate(angle):
            wide = max(1, int(24 * np.cos(a)))
            depth[t, 6:21, 12 : 12 + wide] = 0.2 - 0.004 * np.sin(a) * reach[:wide]
        row = np.tile(np.array([0, 1, 0, -2.4, 0, 0, 0, 0], np.float32), (4, 1))
        row[:, 6] = angle[1:]
        return ScrewSample(depth, row)


class DoorTask(DustNetTask):
    def plan_data(self) -> Iterator[Any]:
        return iter(())

    def open_samples(self, folders: list[Path], network: Any) -> Doors:
        return Doors()


@pytest.mark.ci
def test_a_short_training_learns_motions_and_how_sure_they_are(tmp_path: Path) -> None:
    config = DustNetTraining(out=tmp_path / "out", steps=240, batch=8, width=8, frames=5,
                             rate=0.003, rate_decay=0.5, weight_decay=0.0, device="cpu", threads=1)
    loop.train(DoorTask(config))
    network = DustNet(8, 5).eval()
    network.load_state_dict(read_tensors(tmp_path / "out/dustnet.safetensors"))
    some = [Doors().sample(10_000 + i) for i in range(24)]
    depth = torch.from_numpy(np.stack([s.depth for s in some]))
    true = np.stack([s.screw for s in some])

    def errors(order: list[int]) -> Any:
        with torch.no_grad():
            found = network.distribution(network(depth[:, order]))
        screws = found.screws().numpy()
        cosine = (screws[:, 0, :3] * true[:, 0, :3]).sum(-1)
        return (np.abs(screws[..., 6] - true[..., 6]).mean(), cosine.min(),
                float((1 / found.turn_precision).mean()))

    angle, cosine, deviation = errors([0, 1, 2, 3, 4])
    assert angle < 0.6 * true[..., 6].mean() and cosine > 0.9
    assert 0.3 < angle / deviation < 3
    assert errors([4, 2, 3, 1, 0])[0] > 1.1 * angle


def test_videos_of_any_length_are_divided() -> None:
    assert divide_frames(5, 5).tolist() == [[0, 1, 2, 3, 4]]
    assert divide_frames(3, 5).tolist() == [[0, 1, 2, 2, 2]]
    assert divide_frames(8, 5).tolist() == [[0, 1, 3, 5, 7], [0, 2, 4, 6, 6]]
    for count in range(2, 40):
        videos = divide_frames(count, 5)
        assert set(videos[:, 1:].ravel()) == set(range(1, count)) and not videos[:, 0].any()


def test_the_command_trains_and_the_method_returns_deviations(tmp_path: Path) -> None:
    data, out = dataset(tmp_path / "d"), tmp_path / "out"
    line = (f"train dustnet --data {data} --held-out {data} --out {out} --steps 2 --batch 2 "
            "--width 8 --frames 3 --device cpu --threads 1 --half")
    assert main(line.split()) == 0
    weights = out / "dustnet.safetensors"
    assert read_notes(weights) == {"objects": "arm"}
    method = load_method(with_options("dustnet", {"weights": str(weights)}))
    assert method.name.startswith("dustnet arm width=8 net=")
    seen = observe(open_dataset(data)[0], "rgbd", "free")
    estimate = method.estimate(seen)  # 4 frames by a network for 3
    assert estimate.displacement.shape == (4, 1) and estimate.displacement[0, 0] == 0
    assert estimate.sigma is not None and (estimate.sigma[1:] > 0).all()
    assert estimate.screw is not None
    assert np.linalg.norm(estimate.screw[0, :3]) == pytest.approx(1)
    assert estimate.screw[0, :3] @ estimate.screw[0, 3:] == pytest.approx(0, abs=1e-6)
    with pytest.raises(GcbenchError, match="needs depth"):
        method.estimate(replace(seen, depth=None))
    other = tmp_path / "other.safetensors"
    greedy = DustNet(8, 3)  # names more frames than it has weights for
    greedy.head[0].weight = torch.nn.Parameter(torch.zeros(2, 2**18))
    greedy.head[2].bias = torch.nn.Parameter(torch.zeros(2**20))
    for network in (torch.nn.Linear(2, 2), greedy):
        write_weights(other, network)
        with pytest.raises(GcbenchError, match="no weights of dustnet"):
            load_method(with_options("dustnet", {"weights": str(other)}))
