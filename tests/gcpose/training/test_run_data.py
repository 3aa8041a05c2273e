"""The data of a training run: what it has learned from stays what it says."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.gcpose.training.config import CONFIGS, AbbatematteoTraining, FlowTraining

from ...support.one_joint import dataset

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.networks.abbatematteo import CONFIGURATION  # noqa: E402
from gcbench.gcpose.networks.weights import read_notes, read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop  # noqa: E402
from gcbench.gcpose.training.abbatematteo_task import AbbatematteoTask  # noqa: E402
from gcbench.gcpose.training.data import PlannedDataset, warn_of_leaks  # noqa: E402
from gcbench.gcpose.training.tasks import task_of  # noqa: E402


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


@pytest.mark.parametrize("network", ["flow", "foreground", "screwnet", "abbatematteo"])
@pytest.mark.parametrize("option", ["--data", "--held-out"])
def test_a_dataset_without_sequences_is_refused_before_anything_is_written(
    network: str, option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {"--data": dataset(tmp_path / "d", 1), "--held-out": dataset(tmp_path / "e", 1)}
    shutil.rmtree(folders[option] / "sequences")
    out = tmp_path / "out"
    line = [f"{name}={folder}" for name, folder in folders.items()]
    assert main(["train", network, *line, f"--out={out}", "--device=cpu"]) == 2
    said = capsys.readouterr().err
    assert f"{folders[option]} has no sequences; render some" in said and said.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(("network", "said"), [
    ("screwnet", "has 2 scored joints; screwnet learns from objects with one"),
    ("dustnet", "has 2 scored joints; dustnet learns from objects with one"),
    ("abbatematteo", "has 2 scored joints; abbatematteo learns from objects with one"),
    ("craves", "has 0 keypoints, and craves learns 17; render with --robot owi535"),
])
def test_every_sequence_is_checked_before_the_first_step(
    network: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, held, out = tmp_path / "d", tmp_path / "e", tmp_path / "out"
    dataset(data, 2)
    dataset(held, 1, ("pan", "lift"))
    args = ["train", network, f"--data={data}", f"--out={out}", "--device=cpu"]
    assert main([*args, f"--held-out={held}"]) == 2
    first = data if network == "craves" else held
    error = capsys.readouterr().err
    assert f"{first}/sequences/000000.zip {said}" in error and error.count("\n") == 1
    (data / "sequences/000001.zip").write_bytes(b"PK no archive")
    if network != "craves":
        assert main(args) == 2
        assert f"{data}/sequences/000001.zip" in capsys.readouterr().err
    assert not out.exists()


def test_sequences_under_another_name_are_told_as_learned_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, copy, other = dataset(tmp_path / "d", 2), tmp_path / "copy", dataset(tmp_path / "e", 2)
    shutil.copytree(data, copy)
    change_config(other, seed=8)
    warn_of_leaks([copy, other], [data])
    assert capsys.readouterr().err.splitlines() == [
        f"gcbench: {copy} is also learned from: its errors are not those of new data"]
    (data / "sequences/000001.zip").unlink()
    warn_of_leaks([copy], [data])
    assert f"{copy}, 1 of 2 sequences, is also learned" in capsys.readouterr().err


def test_errors_are_measured_on_what_is_named_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No sequences are rendered that nobody uses, and a run without errors says so."""
    held = dataset(tmp_path / "held", 1)
    change_config(held, seed=8)
    planned: list[bool] = []

    def render(out: Path, plan: list[PlannedDataset], config: object) -> tuple[list[Path], ...]:
        planned.extend(p.held_out for p in plan)
        return [dataset(out / "d", 1)], []

    monkeypatch.setattr(loop, "render_datasets", render)
    begun = replace(options(held, tmp_path / "out"), data=(), held_out=(held,))
    loop.train(AbbatematteoTask(begun))
    assert planned == [False]
    assert "no errors" not in capsys.readouterr().err
    loop.train(AbbatematteoTask(options(held, tmp_path / "none")))
    assert capsys.readouterr().err.count("no errors will be measured: ") == 1


@pytest.mark.parametrize("workers", [0, 1])
def test_sigterm_saves_the_steps_that_are_made(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    data, out, step = dataset(tmp_path / "d", 1), tmp_path / "out", loop._train_step

    def terminate(run: Any, batch: Any, at: int, steps: int) -> float:
        if at == 2:
            os.kill(os.getpid(), signal.SIGTERM)
            for worker in multiprocessing.active_children():
                os.kill(worker.pid or 0, signal.SIGTERM)
        return step(run, batch, at, steps)

    line = (f"train abbatematteo --data {data} --held-out {data} --out {out} --steps 9 --batch 2 "
            f"--width 8 --device cpu --threads 1 --workers {workers}")
    with monkeypatch.context() as patch:
        patch.setattr(loop, "_train_step", terminate)
        assert main(line.split()) == 143
    assert "stopped; run the same command again" in capsys.readouterr().err
    assert read_tensors(out / "checkpoint.safetensors")["at"][0] == 3  # the step is whole
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    assert main(line.split()) == 0


def test_a_folder_with_a_run_of_another_network_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = dataset(tmp_path / "d", 1), tmp_path / "out"
    loop.train(AbbatematteoTask(options(data, out)))
    for steps in "0", "1":
        line = (f"train screwnet --data {data} --held-out {data} --out {out} --steps {steps} "
                "--width 8 --frames 4 --device cpu")
        capsys.readouterr()
        assert main(line.split()) == 2
        said = capsys.readouterr().err
        assert f"{out} holds a run of abbatematteo; name another --out for screwnet" in said


def test_a_training_starts_from_weights_of_gcbench_by_their_name(tmp_path: Path) -> None:
    def start(name: str) -> str | None:
        config = AbbatematteoTraining(start_from=Path(name), out=tmp_path)
        return str(task_of(config).config.start_from)

    found = start("microwave")
    assert found is not None and found.endswith("weights/abbatematteo-microwave.safetensors")
    assert start("own.safetensors") == "own.safetensors"
    flow = task_of(FlowTraining(start_from=Path("raft"))).config.start_from
    assert flow is not None and flow.name == "raft.safetensors"
    with pytest.raises(GcbenchError, match=r"no file and no weights of gcbench: fridge; .* oven"):
        start("fridge")


def test_curves_have_units(tmp_path: Path) -> None:
    data, out = dataset(tmp_path / "d", 1), tmp_path / "out"
    loop.train(AbbatematteoTask(replace(options(data, out), held_out=(data,))))
    page = (out / "curves.html").read_text()
    assert "<h2>axis (deg), d</h2>" in page and "<h2>loss, d</h2>" in page


def test_the_networks_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  train {name} " in said for name in CONFIGS) and "usage: gcbench train" in said
    for args in [], ["fridge"]:
        assert main(["train", *args]) == 2
        error = capsys.readouterr().err
        assert f"no command {' '.join(['train', *args])!r}; there are train flow, " in error
        assert "render" not in error and error.count("\n") == 1
