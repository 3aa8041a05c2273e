"""The data of a training run: what it has learned from stays what it says."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from gcbench import GcbenchError
from gcbench.gcpose.training.config import AbbatematteoTraining

from ...support.one_joint import dataset

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.networks.abbatematteo import CONFIGURATION  # noqa: E402
from gcbench.gcpose.networks.weights import read_notes, read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.abbatematteo_task import AbbatematteoTask  # noqa: E402


def options(data: Path, out: Path, steps: int = 1) -> AbbatematteoTraining:
    return AbbatematteoTraining(data=(data,), out=out, steps=steps, batch=2, width=8, device="cpu",
                                threads=1, rate=1e-3)


def bounds(out: Path) -> list[float]:
    return read_tensors(out / "abbatematteo.safetensors")["bounds"][:, CONFIGURATION].tolist()


def test_a_run_that_is_done_writes_nothing_when_it_is_called_again(tmp_path: Path) -> None:
    data, out = dataset(tmp_path / "d", 1), tmp_path / "out"
    begun = replace(options(data, out), held_out=(data,))
    loop.train(AbbatematteoTask(begun))
    names = "abbatematteo.safetensors", "checkpoint.safetensors", "options.json"
    before = [(out / name).stat() for name in names], (out / "log.jsonl").read_bytes()
    assert loop.train(AbbatematteoTask(begun)) == loop.train(AbbatematteoTask(begun))
    after = [(out / name).stat() for name in names], (out / "log.jsonl").read_bytes()
    assert after[1] == before[1]
    assert [x.st_ino for x in after[0]] == [x.st_ino for x in before[0]]
    loop.train(AbbatematteoTask(replace(begun, half=True)))
    assert (out / names[0]).stat().st_size < 0.6 * before[0][0].st_size
    more = dataset(tmp_path / "e", 2)
    loop.train(AbbatematteoTask(replace(begun, held_out=(data, more))))
    assert len((out / "log.jsonl").read_text().splitlines()) == 1 + before[1].count(b"\n")


def test_files_of_weights_are_the_same_to_the_bit_with_their_notes(tmp_path: Path) -> None:
    network, notes = torch.nn.Linear(3, 2), {str(k): "ä" * k for k in (3, 1, 5, 4, 2)}
    for k in range(6):
        write_weights(tmp_path / f"{k}.safetensors", network, notes)
    assert len({path.read_bytes() for path in tmp_path.iterdir()}) == 1
    assert read_notes(tmp_path / "0.safetensors") == notes
    assert torch.equal(read_tensors(tmp_path / "0.safetensors")["weight"], network.weight)


def change_config(folder: Path, **values: object) -> None:
    path = folder / "dataset.json"
    info = json.loads(path.read_text())
    info["config"].update(values)
    path.write_text(json.dumps(info))


def test_a_run_is_not_continued_with_other_data_at_the_same_path(tmp_path: Path) -> None:
    whole, out = tmp_path / "all", tmp_path / "out"
    data = dataset(whole / "d", 2)
    loop.train(AbbatematteoTask(options(whole, out)))
    before = (out / "abbatematteo.safetensors").read_bytes()

    def refused(said: str) -> None:
        with pytest.raises(GcbenchError, match=said) as error:
            loop.train(AbbatematteoTask(options(whole, out, 2)))
        assert "\n" not in str(error.value)
        assert (out / "abbatematteo.safetensors").read_bytes() == before

    more = dataset(whole / "e", 1)
    refused(f"{more} is new since the run in {out} began; .* --out")
    shutil.rmtree(more)
    kept = data.rename(tmp_path / "kept")
    dataset(whole / "d", 3)
    refused(f"{data} has another configuration or other sequences since")
    shutil.rmtree(data)
    shutil.copytree(kept, data)
    change_config(data, seed=8)
    refused(f"{data} has another configuration or other sequences since")
    change_config(data, seed=0)
    loop.train(AbbatematteoTask(options(whole, out, 2)))
    assert (out / "abbatematteo.safetensors").read_bytes() != before


def test_a_run_of_an_earlier_version_continues_and_keeps_the_ranges_of_its_data(
    tmp_path: Path,
) -> None:
    data, out = dataset(tmp_path / "d", 1), tmp_path / "out"
    loop.train(AbbatematteoTask(options(data, out)))
    path = out / "options.json"
    kept = json.loads(path.read_text())
    assert list(kept.pop("datasets")) == [str(data)]
    path.write_text(json.dumps(kept))
    before = bounds(out)
    shutil.rmtree(data)
    dataset(data, 4)  # with larger motions
    loop.train(AbbatematteoTask(options(data, out, 2)))
    assert bounds(out) == before
    loop.train(AbbatematteoTask(options(data, tmp_path / "new")))
    assert bounds(tmp_path / "new") != before
