"""Datasets without flow or visibility: what is stored is the same, the rest says what it lacks."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path

import gcbench as gb
import numpy as np
import pytest
from gcbench.__main__ import main
from gcbench.benchmark.protocol import observe
from gcbench.gcpose.training.pairs import read_pair
from gcbench.renderer.dataset import SEQUENCES_FOLDER
from gcbench.renderer.verify.driver import verify_sequence

pytestmark = pytest.mark.gl

SIZE = ["--robot", "owi535", "--n", "1", "--frames", "3", "--width", "96", "--height", "72",
        "--workers", "1", "--quiet", "--layers", "coordinates", "tracks"]
CASES = {
    "forward": (["--flow", "forward"], ("flow_backward",)),
    "none": (["--flow", "none"], ("flow", "flow_backward")),
    "unseen": (["--no-visibility"], ("visibility",)),
    "bare": (["--flow", "none", "--no-visibility"], ("flow", "flow_backward", "visibility")),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data")
    for name, options in {"all": [], **{k: options for k, (options, _) in CASES.items()}}.items():
        assert main(["render", *SIZE, *options, "--out", str(out / name)]) == 0
    return out


def members(dataset: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(dataset / SEQUENCES_FOLDER / "000000.zip") as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.ci
def test_only_what_is_omitted_is_missing(folder: Path, case: str) -> None:
    _, omitted = CASES[case]
    whole, own = members(folder / "all"), members(folder / case)
    assert {name.split("/")[0] for name in {*whole} - {*own}} == {*omitted}
    assert {name for name in own if own[name] != whole[name]} == {"meta.json"}
    assert b"omitted" not in whole["meta.json"]
    sequence = gb.open_dataset(folder / case)[0]
    assert sequence.meta.omitted == omitted
    for frame in sequence:
        assert all(getattr(frame, name) is None for name in omitted)
    for name in omitted:
        with pytest.raises(gb.DatasetError, match=r"owi535/0/000000 has no .*; render it with"):
            sequence.stack(name)


@pytest.mark.parametrize("case", CASES)
def test_a_sequence_in_memory_lacks_the_same(folder: Path, case: str) -> None:
    dataset = gb.open_dataset(folder / case)
    rendered, stored = gb.render_sequence(dataset.config), dataset[0]
    for name in ("rgb", "part", "flow", "flow_backward", "visibility"):
        mine, its = getattr(rendered, name), getattr(stored, name)
        assert (mine is None) == (its is None) == (name in CASES[case][1])
        if mine is not None and "flow" not in name:
            np.testing.assert_array_equal(mine, np.asarray(its))


@pytest.mark.parametrize("case", CASES)
def test_what_is_stored_is_verified(folder: Path, case: str) -> None:
    report = gb.verify_dataset(folder / case, progress=False)
    assert report.ok
    names = {check.name for check in report.checks}
    omitted = CASES[case][1]
    assert ("flow forward" in names) == ("flow" not in omitted)
    assert ("flow backward" in names) == ("flow_backward" not in omitted)
    assert ("visibility" in names) == ("visibility" not in omitted)
    assert "depth where the flow leads" in names


@pytest.mark.parametrize("case", CASES)
def test_a_depth_that_moved_is_still_found(folder: Path, case: str) -> None:
    """Where visibility is not stored, the verifier takes its own."""
    sequence = gb.open_dataset(folder / case)[0]
    for factor in (0.9, 1.1):
        depth = np.asarray(sequence.depth).copy()
        depth[1] *= np.float32(factor)
        broken = dataclasses.replace(sequence, depth=depth)
        wrong = {check.name for check in verify_sequence(broken).checks if not check.ok}
        assert "depth where the flow leads" in wrong


def test_pages_and_films_need_no_flow(folder: Path, tmp_path: Path) -> None:
    for case in CASES:
        out = tmp_path / f"{case}.html"
        assert main(["show", str(folder / case), "--index", "0", "--out", str(out)]) == 0
        assert out.stat().st_size > 10_000
        sheet = tmp_path / f"{case}.png"
        assert main(["show", str(folder / case), "--index", "0", "--out", str(sheet)]) == 0


def test_exports_leave_it_out_or_name_it(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import tarfile

    for case, (_, omitted) in CASES.items():
        out = tmp_path / case
        ask = ["export", str(folder / case), "--quiet", "--format"]
        assert main([*ask, "webdataset", "--out", str(out)]) == 0
        with tarfile.open(next(out.glob("*.tar"))) as shard:
            kinds = {name.partition(".")[2] for name in shard.getnames()}
        assert {f"{name}.npy.gz" for name in omitted}.isdisjoint(kinds)
        assert {"rgb.png", "depth.npy.gz", "coordinates.npy.gz"} <= kinds
        capsys.readouterr()
        kitti = main([*ask, "kitti", "--out", str(tmp_path / f"{case}-kitti")])
        said = capsys.readouterr().err
        assert (kitti == 0) == (case == "forward")
        assert kitti == 0 or (said.count("\n") == 1 and "; render it with" in said)


def test_users_of_flow_say_how_to_get_it(folder: Path) -> None:
    forward, bare = (gb.open_dataset(folder / case)[0] for case in ("forward", "bare"))
    assert read_pair(forward, 0).flow.shape == (72, 96, 2)
    with pytest.raises(gb.DatasetError, match="no backward flow; render it with --flow both"):
        read_pair(forward, 0, backward=True)
    with pytest.raises(gb.DatasetError, match="no backward flow; render it with --flow both"):
        observe(forward, "rgbd", "axes", oracles=("true-flow",))
    with pytest.raises(gb.DatasetError, match="no forward flow; render it with --flow forward"):
        observe(bare, "rgbd", "axes", oracles=("true-flow",))


def test_tensors_are_those_that_are_stored(folder: Path) -> None:
    pytest.importorskip("torch", reason="PyTorch is in the extra learn")
    from gcbench.renderer.dataset.torch import TorchDataset

    dataset = gb.open_dataset(folder / "forward")
    assert {"rgb", "flow", "visibility"} <= {*TorchDataset(dataset)[0]}
    assert "flow_backward" not in TorchDataset(dataset)[0]
    with pytest.raises(gb.ConfigError, match="no backward flow; render it with --flow both"):
        TorchDataset(dataset, images=("rgb", "flow_backward"))


def test_another_choice_does_not_continue_a_dataset(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["render", *SIZE, "--flow", "forward", "--out", str(folder / "all")]) == 2
    assert 'flow: nothing -> "forward"' in capsys.readouterr().err
