"""Rows of learned baselines: each network has its own, and those of gcbench keep their names."""

from __future__ import annotations

from pathlib import Path

import pytest
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.benchmark.run.driver import EvalConfig, evaluate

from ...support.one_joint import dataset

torch = pytest.importorskip("torch", reason="the networks need PyTorch")

from gcbench.gcpose.learned.trained import TRAINED  # noqa: E402
from gcbench.gcpose.networks.screwnet import ScrewNet  # noqa: E402
from gcbench.gcpose.networks.weights import write_weights  # noqa: E402


def own_network(path: Path, seed: int) -> str:
    """The file of an untrained network that says that it has learned from microwaves."""
    path.parent.mkdir(exist_ok=True)
    torch.manual_seed(seed)
    write_weights(path, ScrewNet(16), {"objects": "microwave"})
    return str(path)


def test_networks_of_one_class_and_width_stand_in_one_leaderboard(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d", 1)
    one, two = (own_network(tmp_path / k / "screwnet.safetensors", seed)
                for seed, k in enumerate(("one", "two")))

    def rows() -> set[str]:
        run = EvalConfig(method=("screwnet", "hold-still"), data=(data,), workers=1,
                         weights=(f"screwnet={one}", f"screwnet={two}", "screwnet=microwave"),
                         results=tmp_path / "results")
        found = {r.run.row.method for r in evaluate(run, progress=False).runs}
        assert len(found) == 4 and {"screwnet microwave width=16", "hold-still"} < found
        return found

    first = rows()
    own_network(Path(two), 7)  # trained further: another network, another row
    assert len(first - rows()) == 1


def test_a_name_is_of_the_tensors_and_those_of_gcbench_have_none(tmp_path: Path) -> None:
    def name(weights: object) -> str:
        return load_method(with_options("screwnet", {"weights": str(weights)})).name

    file = Path(own_network(tmp_path / "a.safetensors", 1))
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(file.read_bytes())
    assert name(file) == name(copy) != name(own_network(tmp_path / "b.safetensors", 2))
    shipped = "screwnet microwave width=16"
    assert name(file).startswith(f"{shipped} net=")
    assert name("microwave") == name(TRAINED / "screwnet-microwave.safetensors") == shipped
