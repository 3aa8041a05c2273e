"""Exports are read back by readers that are not ours, and hold what the dataset holds."""

from __future__ import annotations

import csv
import dataclasses
import gc
import gzip
import hashlib
import importlib.util
import io
import json
import shutil
import signal
import subprocess
import sys
import tarfile
import tracemalloc
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from gcbench import GcbenchError, open_dataset
from gcbench.__main__ import main
from gcbench.errors import DatasetError, StorageError
from gcbench.renderer.dataset.reader import Dataset, select_sequences
from gcbench.renderer.export import kitti as export_kitti
from gcbench.renderer.export.bop_models import size_of
from gcbench.renderer.export.driver import WRITERS, export_dataset, write_export
from gcbench.renderer.export.webdataset import json_values
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.runtime.zip_archive import Archive, open_archive
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.files.lock import lock_folder
from gcbench.robots.geometry.depth_images import fit_depth

from ...support import analytic, bench_data, one_joint

SEQUENCES, FRAMES = 3, 4


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Three sequences of an arm before a room, exact to the pixel."""
    folder = tmp_path_factory.mktemp("data") / "arm"
    bench_data.make_dataset(folder, SEQUENCES)
    room = analytic.render(width=48, height=36, frames=FRAMES, room=True)
    (folder / "sequences" / "000002.zip").unlink()
    bench_data.save(room, folder, 2, 1.0, True)
    return open_dataset(folder)


@pytest.fixture(scope="module")
def doors(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two objects with one joint that turns there and back beyond half a turn, and one that
    slides, in 17 frames."""
    folder = one_joint.dataset(tmp_path_factory.mktemp("data") / "doors", 3)
    info = json.loads((folder / "dataset.json").read_text())
    info["config"]["frames"] = 17
    (folder / "dataset.json").write_text(json.dumps(info))
    for index, (joint, faster) in enumerate([("pan", 1.0), ("pan", -1.3), ("slide", 0.1)]):
        motion = [*np.linspace(0.0, 3.3, 9), *np.linspace(3.0, -0.6, 8)]
        moved = one_joint.moved(joint, [faster * x for x in motion])
        (folder / f"sequences/{index:06d}.zip").unlink()
        bench_data.save(moved, folder, index, 1.0, observable=True)
    return open_dataset(folder)


# -- what all formats share -------------------------------------------------------------------


def test_every_format_is_there() -> None:
    for entry in WRITERS.values():
        module, _, name = entry.partition(":")
        needed = {"rerun": "rerun", "screwnet": "h5py"}.get(module, "numpy")
        if importlib.util.find_spec(needed):
            kind = getattr(importlib.import_module(f"gcbench.renderer.export.{module}"), name)
            assert callable(kind.add) and callable(kind.finish)


def test_the_command_line_exports(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    ask = ["export", str(dataset.path), "--format", "webdataset", "--sequences", "1-2"]
    assert main([*ask, "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}: 2 sequences, 8 frames\n"
    said = json.loads((out / "export.json").read_text())
    assert said["sequences"] == ["000001", "000002"] and said["format"] == "webdataset"
    assert said["assets"][0]["licence"] == "MIT"
    assert main(ask) == 0 and dataset.path.with_name("arm-webdataset").is_dir()
    assert main([*ask, "--out", str(out)]) == 2
    assert "is there already; choose another --out" in capsys.readouterr().err


def test_the_current_folder_is_exported_beside_it(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    copy = Path(shutil.copytree(dataset.path, tmp_path / "copy"))
    info = json.loads((copy / "dataset.json").read_text())
    (copy / "dataset.json").write_text(json.dumps(info | {"counts": None}))
    ask = ["--format", "webdataset", "--sequences", "0", "--quiet"]
    for here, given in ((copy, "."), (copy / "sequences", ".."), (copy, str(copy))):
        monkeypatch.chdir(here)
        assert main(["export", given, *ask]) == 0
        assert "copy is not finished" in capsys.readouterr().err.replace(given, "copy")
        shutil.rmtree(tmp_path / "copy-webdataset")
    assert sorted(p.name for p in copy.iterdir()) == ["dataset.json", "sequences"]


def test_texts_and_open_datasets_are_taken(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = export_dataset(dataset, "kitti", "one", "0", progress=False)
    again = export_dataset(str(dataset.path), "kitti", Path("two"), "0", progress=False)
    assert (done.folder, done.sequences) == (Path("one"), 1)
    assert [p.read_bytes() for p in sorted(Path("one").rglob("*.png"))] == [
        p.read_bytes() for p in sorted(again.folder.rglob("*.png"))]


def test_the_exporter_of_the_checklist_takes_any_joints(doors: Dataset, tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs/develop/add_an_exporter.md"
    code = page.read_text().partition("```python\n")[2].partition("```")[0]
    names = {"__package__": "gcbench.renderer.export", "__name__": "jointcsv"}
    exec(compile(code, str(page), "exec", dont_inherit=True), names)
    kind: Any = names["JointCsv"]
    out = write_export(kind, doors, [*doors.names], tmp_path / "out", {}, False).folder
    with (out / "joints.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["joint"] for row in rows} == {n for s in doors for n in s.meta.joint_names}
    for name, sequence in zip(doors.names, doors, strict=True):
        for j, joint in enumerate(sequence.meta.joint_names):
            found = [float(row["position"]) for row in rows
                     if (row["sequence"], row["joint"]) == (name, joint)]
            assert found == sequence.state.joint_positions[:, j].tolist()


def test_an_unknown_format_is_told_those_that_exist(
    dataset: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(dataset.path), "--format", "voc"]) == 2
    assert "choose one of kitti, bop" in (err := capsys.readouterr().err) and "observation" in err


def test_sequences_are_chosen_by_number(dataset: Dataset) -> None:
    assert select_sequences(dataset, "") == ["000000", "000001", "000002"]
    assert select_sequences(dataset, "2, 0-1,1") == ["000002", "000000", "000001"]
    assert select_sequences(dataset, "1-99999") == ["000001", "000002"]
    for wrong, why in (("x", "as in 0-9,15"), ("3", "no sequence 3; there are 000000 to 000002"),
                       ("0,7-9", "no sequence 7-9"), ("-1", "as in"), ("1-", "as in")):
        with pytest.raises(GcbenchError, match=why):
            select_sequences(dataset, wrong)


def test_what_fails_leaves_nothing_behind(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "deep" / "out"
    other = out.with_name(".other.part")
    other.mkdir(parents=True)
    with pytest.raises(GcbenchError, match="of one frame"):
        monkeypatch.setattr(
            "gcbench.renderer.export.driver.open_dataset", lambda *_: dataclasses.replace(
                dataset, config=dataclasses.replace(dataset.config, frames=1)))
        export_dataset(dataset.path, "kitti", out, progress=False)
    assert [p.name for p in out.parent.iterdir()] == [other.name]
    monkeypatch.undo()
    with pytest.raises(GcbenchError, match="not a dataset"):
        export_dataset(tmp_path, "kitti", out, progress=False)
    (tmp_path / "file").touch()
    with pytest.raises(GcbenchError, match="cannot write to"):
        export_dataset(dataset.path, "kitti", tmp_path / "file" / "out", progress=False)


def test_ctrl_c_leaves_nothing_behind(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(export_kitti.Kitti, "finish", interrupted)
    out = str(tmp_path / "out")
    assert main(["export", str(dataset.path), "--format", "kitti", "--out", out]) == 130
    assert "run the same command again to continue\n" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == [".out.part"]


@pytest.mark.parametrize("format", WRITERS)
def test_what_was_stopped_is_continued(
    format: str, dataset: Dataset, toy: Dataset, doors: Dataset, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """After any sequence, with the next one half written; the files are those of a clean run."""
    pytest.importorskip({"coco": "pycocotools", "screwnet": "h5py"}.get(format, format)
                        if format in ("rerun", "coco", "screwnet") else "numpy")
    data = {"bop": toy, "screwnet": doors}.get(format, dataset)
    monkeypatch.setattr("gcbench.renderer.export.webdataset.SHARD", 6)
    whole = export_dataset(data.path, format, tmp_path / "whole", progress=False).folder
    for stop in range(len(data.names)):
        out = tmp_path / str(stop)
        calls = interrupt(monkeypatch, format, data, stop)
        with pytest.raises(KeyboardInterrupt):
            export_dataset(data.path, format, out, progress=False)
        assert not out.exists() and out.with_name(f".{stop}.part").exists() == (stop > 0)
        monkeypatch.undo()
        monkeypatch.setattr("gcbench.renderer.export.webdataset.SHARD", 6)
        calls = interrupt(monkeypatch, format, data, None)
        done = export_dataset(data.path, format, out, progress=False)
        assert calls == list(data.names[stop:])
        assert (done.sequences, done.frames) == (len(data.names), sum(map(len, data)))
        names = sorted(p.relative_to(whole) for p in whole.rglob("*"))
        assert names == sorted(p.relative_to(out) for p in out.rglob("*"))
        for name in names:
            if (whole / name).is_file() and name.suffix != ".rrd":  # Rerun numbers at random
                assert (whole / name).read_bytes() == (out / name).read_bytes(), name
        monkeypatch.undo()
        monkeypatch.setattr("gcbench.renderer.export.webdataset.SHARD", 6)


def interrupt(
    monkeypatch: pytest.MonkeyPatch, format: str, data: Dataset, stop: int | None,
    error: type[BaseException] = KeyboardInterrupt,
) -> list[str]:
    """Names of the sequences that are written from now on; Ctrl-C comes after the work of number
    `stop`, before anybody knows that it is done; or another error."""
    module, _, name = WRITERS[format].partition(":")
    kind = getattr(importlib.import_module(f"gcbench.renderer.export.{module}"), name)
    before, calls = kind.add, list[str]()

    def add(self: object, sequence: Sequence, archive: Archive) -> object:
        calls.append(archive.path.stem)
        record = before(self, sequence, archive)
        if stop is not None and calls[-1] == data.names[stop]:
            raise error
        return record

    monkeypatch.setattr(kind, "add", add)
    return calls


@pytest.mark.parametrize(("error", "kept"), [(StorageError, True), (DatasetError, False)])
def test_what_a_storage_did_not_give_is_continued(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[Exception],
    kept: bool,
) -> None:
    interrupt(monkeypatch, "tapvid", dataset, 2, error)
    with pytest.raises(error):
        export_dataset(dataset.path, "tapvid", tmp_path / "out", progress=False)
    monkeypatch.undo()
    assert (tmp_path / ".out.part").exists() == kept
    calls = interrupt(monkeypatch, "tapvid", dataset, None)
    export_dataset(dataset.path, "tapvid", tmp_path / "out", progress=False)
    assert calls == list(dataset.names[2 if kept else 0:])


def test_a_kill_leaves_what_can_be_continued(dataset: Dataset, tmp_path: Path) -> None:
    """At the worst moment: while a line of the journal is written."""
    code = """
import os, signal, sys
from pathlib import Path
from gcbench.renderer.export import driver, journal
def half(self, line, before=journal.Journal._append):
    if b'"000001"' in line and b'"frames"' in line:
        before(self, line[:-5])
        os.kill(os.getpid(), signal.SIGKILL)
    before(self, line)
journal.Journal._append = half
driver.export_dataset(sys.argv[1], "webdataset", Path(sys.argv[2]), progress=False)
"""
    out, whole = tmp_path / "out", tmp_path / "whole"
    killed = subprocess.run([sys.executable, "-c", code, str(dataset.path), str(out)])
    assert killed.returncode == -signal.SIGKILL
    lines = (tmp_path / ".out.part" / "journal.jsonl").read_bytes().split(b"\n")
    assert len(lines) == 3 and lines[2]  # what it exports, a sequence, half of another
    export_dataset(dataset.path, "webdataset", out, progress=False)
    export_dataset(dataset.path, "webdataset", whole, progress=False)
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["out", "whole"]
    for path in whole.iterdir():
        assert path.read_bytes() == (out / path.name).read_bytes()


def test_another_export_is_not_continued(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt(monkeypatch, "tapvid", dataset, 2)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        export_dataset(dataset.path, "tapvid", out, progress=False)
    monkeypatch.undo()
    assert (tmp_path / ".out.part" / "000000.npz").exists()
    export_dataset(dataset.path, "kitti", out, sequences="1", progress=False)
    assert sorted(p.name for p in out.iterdir()) == ["export.json", "training"]
    part = tmp_path / ".new.part"
    part.mkdir()
    with lock_folder(part), pytest.raises(GcbenchError, match="another gcbench is writing to"):
        export_dataset(dataset.path, "kitti", tmp_path / "new", progress=False)
    assert part.exists()


def test_a_missing_package_is_named(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "gcbench.renderer.export.coco", raising=False)
    for name in [n for n in sys.modules if n.startswith("pycocotools")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    with pytest.raises(GcbenchError, match=r"coco needs pycocotools: pip install '\.\[export"):
        export_dataset(dataset.path, "coco", tmp_path / "out", progress=False)


# -- KITTI ------------------------------------------------------------------------------------


def read_kitti_flow(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """As the development kit reads it: (u, v) and whether they are valid."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    flow = (image[..., 2:0:-1].astype(np.float64) - 2**15) / 64.0
    return flow, image[..., 0] > 0


def test_kitti(dataset: Dataset, tmp_path: Path) -> None:
    out = export_dataset(dataset.path, "kitti", tmp_path / "k", progress=False).folder / "training"
    rows = list(csv.DictReader((out / "pairs.csv").read_text().splitlines()))
    assert len(rows) == SEQUENCES * (FRAMES - 1)
    for row in rows:
        sequence, t = dataset[row["sequence"]], int(row["first"])
        name = f"{int(row['pair']):06d}"
        for k, suffix in enumerate(("10", "11")):
            image = cv2.imread(str(out / "image_2" / f"{name}_{suffix}.png"))[..., ::-1]
            np.testing.assert_array_equal(image, sequence.rgb[t + k])
            depth = cv2.imread(str(out / "depth_2" / f"{name}_{suffix}.png"), cv2.IMREAD_UNCHANGED)
            assert np.abs(depth / 256.0 - sequence.depth[t + k]).max() <= 0.5 / 256 + 1e-6
            np.testing.assert_array_equal(depth > 0, sequence.depth[t + k] > 0)
        flow, valid = read_kitti_flow(out / "flow_occ" / f"{name}_10.png")
        np.testing.assert_array_equal(valid, np.isfinite(sequence.flow[t]).all(-1))
        np.testing.assert_array_equal(flow[valid], sequence.flow[t][valid])
        seen_flow, seen = read_kitti_flow(out / "flow_noc" / f"{name}_10.png")
        np.testing.assert_array_equal(seen_flow[seen], flow[seen])
        assert (seen <= valid).all()
        part = sequence.part[t]
        np.testing.assert_array_equal(seen[part > 0], sequence.visibility[t][part > 0] == 1)
        world = (part == 0) & valid  # it stands still: what is there now
        np.testing.assert_array_equal(seen[world], sequence.part[t + 1][world] == 0)
        parts = cv2.imread(str(out / "obj_map" / f"{name}_10.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(parts, part)
        lines = (out / "calib_cam_to_cam" / f"{name}.txt").read_text().splitlines()
        calib = dict(line.split(": ", 1) for line in lines)
        k = np.array(calib["P_rect_02"].split(), float).reshape(3, 4)
        np.testing.assert_allclose(k[:, :3], sequence.state.intrinsics, rtol=1e-12)
        assert np.array(calib["S_rect_02"].split(), float).tolist() == [48, 36]
    room = [row for row in rows if row["sequence"] == "000002"]
    hidden = [read_kitti_flow(out / kind / f"{int(room[0]['pair']):06d}_10.png")[1].sum()
              for kind in ("flow_occ", "flow_noc")]
    assert hidden[0] == 48 * 36 > hidden[1] > 0  # everything is known, not everything is seen


def test_kitti_refuses_a_scene_that_is_too_deep(dataset: Dataset, tmp_path: Path) -> None:
    sequence = dataset[0]
    far = dataclasses.replace(sequence, depth=np.full((FRAMES, 36, 48), 300.0, np.float32))
    (tmp_path / "k").mkdir()
    writer = export_kitti.Kitti(tmp_path / "k", dataset)
    with pytest.raises(GcbenchError, match="depth is up to 300 m, and a file of KITTI holds"):
        writer.add(far, open_archive(dataset.path / "sequences" / "000000.zip"))


def test_rerun_refuses_times_that_it_cannot_hold(dataset: Dataset, tmp_path: Path) -> None:
    export_rerun = pytest.importorskip("gcbench.renderer.export.rerun")
    sequence = dataset[0]
    late = dataclasses.replace(sequence.state, times=sequence.state.times + 1e10)
    with pytest.raises(GcbenchError, match="beyond the 292 years"):
        export_rerun.Rerun(tmp_path, dataset).add(
            dataclasses.replace(sequence, state=late),
            open_archive(dataset.path / "sequences" / "000000.zip"))


# -- COCO -------------------------------------------------------------------------------------


def mask_of(coco, annotation) -> np.ndarray:
    """[H W] as pycocotools decodes it, which is behind NumPy's times."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return coco.annToMask(annotation).astype(bool)


def test_coco(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coco = pytest.importorskip("pycocotools.coco")
    out = export_dataset(dataset.path, "coco", tmp_path / "c", progress=False).folder
    data = coco.COCO(str(out / "annotations" / "instances.json"))
    assert capsys.readouterr().out  # pycocotools talks
    assert len(data.imgs) == SEQUENCES * FRAMES
    names = {k: c["name"] for k, c in data.cats.items()}
    for image in data.imgs.values():
        sequence, t = dataset[image["sequence"]], image["frame"]
        pixels = cv2.imread(str(out / "images" / image["file_name"]))[..., ::-1]
        np.testing.assert_array_equal(pixels, sequence.rgb[t])
        part = sequence.part[t]
        found = data.loadAnns(data.getAnnIds(imgIds=image["id"]))
        assert len(found) == len(np.unique(part[part > 0]))
        for a in found:
            mask = mask_of(data, a)
            number = sequence.meta.part_names.index(names[a["category_id"]]) + 1
            np.testing.assert_array_equal(mask, part == number)
            rows, columns = np.nonzero(mask)
            assert a["bbox"] == [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
            assert a["area"] == mask.sum() and a["iscrowd"] == 0
    assert {c["supercategory"] for c in data.cats.values()} == {"arm"}


@pytest.mark.gl
def test_coco_keypoints(toy: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coco = pytest.importorskip("pycocotools.coco")
    out = export_dataset(toy.path, "coco", tmp_path / "c", progress=False).folder
    data = coco.COCO(str(out / "annotations" / "keypoints.json"))
    assert capsys.readouterr().out
    assert data.cats[1]["keypoints"] == list(toy[0].meta.keypoint_names)
    assert len(data.anns) == len(data.imgs) == 4
    for a in data.anns.values():
        image = data.imgs[a["image_id"]]
        sequence, t = toy[image["sequence"]], image["frame"]
        np.testing.assert_array_equal(mask_of(data, a), sequence.part[t] > 0)
        x, y, v = np.reshape(a["keypoints"], (-1, 3)).T
        np.testing.assert_array_equal(v == 2, sequence.state.keypoint_visible[t])
        assert a["num_keypoints"] == 17 == (v > 0).sum()  # the whole robot is in the image
        np.testing.assert_allclose(np.stack([x, y], -1), sequence.state.keypoint_image[t])


# -- WebDataset -------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_webdataset(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wds = pytest.importorskip("webdataset")
    monkeypatch.setattr("gcbench.renderer.export.webdataset.SHARD", 5)
    out = export_dataset(dataset.path, "webdataset", tmp_path / "w", progress=False).folder
    shards = sorted(str(path) for path in out.glob("*.tar"))
    assert [Path(s).name for s in shards] == [f"arm-{k:06d}.tar" for k in range(3)]
    samples = list(wds.WebDataset(shards, shardshuffle=False).decode("rgb8"))
    gc.collect()  # the reader leaves its last shard open
    assert len(samples) == SEQUENCES * FRAMES
    assert len({tuple(sample) for sample in samples}) == 1, "every sample has the same keys"
    for sample in samples:
        facts = sample["json"]
        sequence, t = dataset[facts["sequence"]], facts["frame"]
        assert sample["__key__"] == f"{facts['sequence']}_{t:06d}"
        np.testing.assert_array_equal(facts["joint_positions"], sequence.state.joint_positions[t])
        np.testing.assert_array_equal(facts["world_from_part"], sequence.state.world_from_part[t])
        np.testing.assert_array_equal(facts["intrinsics"], sequence.state.intrinsics)
        same_images({k.partition(".")[0]: v for k, v in sample.items()}, sequence, t)


def same_images(found: dict[str, np.ndarray], sequence: Sequence, t: int) -> None:
    """Every image of frame t, as it is in the dataset."""
    frame = sequence.frame(t)
    for kind in ("rgb", "depth", "part"):
        np.testing.assert_array_equal(found[kind], getattr(frame, kind))
    for kind in ("flow", "flow_backward"):
        flow = getattr(frame, kind)
        assert (flow is None) == (t == (FRAMES - 1 if kind == "flow" else 0))
        np.testing.assert_array_equal(found[kind], np.nan if flow is None else flow)
    np.testing.assert_array_equal(
        found["visibility"], 255 if frame.visibility is None else frame.visibility)


@pytest.mark.gl
def test_webdataset_has_the_layers(toy: Dataset, tmp_path: Path) -> None:
    out = export_dataset(toy.path, "webdataset", tmp_path / "w", progress=False).folder
    with tarfile.open(out / "toy-000000.tar") as shard:
        files = {m.name: shard.extractfile(m).read() for m in shard.getmembers()}
    for name in toy.names:
        sequence = toy[name]
        for t in range(2):
            facts = json.loads(files[f"{name}_{t:06d}.json"])
            assert tuple(facts["keypoint_names"]) == sequence.meta.keypoint_names
            for key in ("track_image", "keypoint_world", "keypoint_visible"):
                expected = getattr(sequence.state, key)[t]
                np.testing.assert_array_equal(np.array(facts[key], expected.dtype), expected)
            np.testing.assert_array_equal(facts["track_query"], sequence.state.track_query)
            packed = files[f"{name}_{t:06d}.normal.npy.gz"]
            normal = np.load(io.BytesIO(gzip.decompress(packed)))
            np.testing.assert_array_equal(normal, sequence.normal[t])
    gone = np.array([[np.nan, 1.0], [2.0, 3.0]])
    assert json_values(gone) == [[None, 1.0], [2.0, 3.0]] and json_values(np.float64(2)) == 2.0


# -- Hugging Face -----------------------------------------------------------------------------


@pytest.mark.parametrize("streaming", [False, True])
@pytest.mark.filterwarnings("ignore")
def test_hugging_face_loads_it(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, streaming: bool
) -> None:
    datasets = pytest.importorskip("datasets")
    monkeypatch.setattr("gcbench.renderer.export.webdataset.SHARD", 5)
    out = export_dataset(dataset.path, "hf", tmp_path / "hf", progress=False).folder
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()) == [
        "README.md", "croissant.json", *(f"data/test-{k:06d}.tar" for k in range(3)),
        "export.json"]
    data = datasets.load_dataset(
        str(out), split="test", streaming=streaming, cache_dir=str(tmp_path / "cache"))
    rows = list(data.with_format("numpy"))
    assert len(rows) == SEQUENCES * FRAMES
    for row, exact in zip(rows, data, strict=True):
        facts = exact["json"]
        sequence, t = dataset[facts["sequence"]], int(facts["frame"])
        np.testing.assert_array_equal(facts["joint_positions"], sequence.state.joint_positions[t])
        assert list(facts["part_names"]) == list(sequence.meta.part_names)
        same_images({k.partition(".")[0]: np.asarray(v) for k, v in row.items()}, sequence, t)


@pytest.mark.filterwarnings("ignore")
def test_croissant_describes_it(dataset: Dataset, tmp_path: Path) -> None:
    out = export_dataset(dataset.path, "hf", tmp_path / "hf", progress=False).folder
    tree = json.loads((out / "croissant.json").read_text())
    (shard,) = tree["distribution"]
    assert shard["sha256"] == hashlib.sha256((out / shard["contentUrl"]).read_bytes()).hexdigest()
    croissant = pytest.importorskip("mlcroissant")
    metadata = croissant.Dataset(str(out / "croissant.json")).metadata
    assert metadata.name == "arm" and not metadata.issues.errors


# -- BOP --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two sequences of a robot whose model is at hand everywhere."""
    folder = tmp_path_factory.mktemp("data") / "toy"
    config = RenderConfig(robot="owi535", frames=2, width=160, height=120, seed=3,
                          layers=("keypoints", "tracks", "normal", "coordinates"), track_points=20)
    render_dataset(config, 2, folder, workers=1, progress=False)
    return open_dataset(folder)


def silhouette(mesh: trimesh.Trimesh, k: np.ndarray, r: np.ndarray, t: np.ndarray,
               scale: int = 8) -> np.ndarray:
    """Share [3H 3W] of each pixel that a mesh in mm covers on BOP's large canvas, for 160 x 120."""
    p = (mesh.vertices @ r.T + t) @ k.T
    uv = p[:, :2] / p[:, 2:] + [160, 120] + 0.5
    canvas = np.zeros((360 * scale, 480 * scale), np.uint8)
    for face in np.round(uv * scale * 16 - 8).astype(np.int32)[mesh.faces]:
        cv2.fillConvexPoly(canvas, face, 1, shift=4)
    return cv2.resize(canvas.astype(np.float32), (480, 360), interpolation=cv2.INTER_AREA)


def test_the_diameter_of_many_points_needs_little_memory() -> None:
    half = np.random.default_rng(0).normal(size=(3000, 3))
    half *= 0.25 / np.linalg.norm(half, axis=1, keepdims=True)
    tracemalloc.start()
    found = size_of(np.concatenate([half, -half]))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found["diameter"] == pytest.approx(500.0) and peak < 100e6
    with_corners = size_of(np.array([[0, 0, 0], [0.3, 0, 0], [0.3, 0.4, 0]]))  # flat
    assert with_corners["diameter"] == pytest.approx(500.0)


@pytest.mark.gl
def test_bop(toy: Dataset, tmp_path: Path) -> None:
    out = export_dataset(toy.path, "bop", tmp_path / "b", progress=False).folder
    infos = json.loads((out / "models" / "models_info.json").read_text())
    meshes = {k: trimesh.load(out / "models" / f"obj_{int(k):06d}.ply", process=False)
              for k in infos}
    for k, info in infos.items():
        v = meshes[k].vertices
        assert toy[0].meta.part_names[int(k) - 1] == info["name"]
        np.testing.assert_allclose([info[f"min_{a}"] for a in "xyz"], v.min(0), atol=1e-3)
        np.testing.assert_allclose([info[f"size_{a}"] for a in "xyz"], np.ptp(v, axis=0), atol=1e-3)
        assert np.ptp(v, axis=0).max() <= info["diameter"] <= np.linalg.norm(np.ptp(v, axis=0))
    assert "grasp" not in {i["name"] for i in infos.values()}  # it has no surface
    assert {tuple(c[:3]) for c in meshes["3"].visual.vertex_colors.tolist()} >= {(250, 194, 15)}
    targets = json.loads((out / "test_targets_bop19.json").read_text())
    for sequence in toy:
        folder = out / "test" / f"{sequence.meta.index:06d}"
        camera, gt, gt_info = (json.loads((folder / f"scene_{name}.json").read_text())
                               for name in ("camera", "gt", "gt_info"))
        for t in range(len(sequence)):
            def image(kind: str, name: str, folder: Path = folder) -> np.ndarray:
                return cv2.imread(str(folder / kind / f"{name}.png"), cv2.IMREAD_UNCHANGED)

            depth = image("depth", f"{t:06d}") * camera[str(t)]["depth_scale"]
            np.testing.assert_allclose(depth, 1000 * sequence.depth[t], atol=1e-3)
            np.testing.assert_array_equal(image("rgb", f"{t:06d}")[..., ::-1], sequence.rgb[t])
            k = np.reshape(camera[str(t)]["cam_K"], (3, 3))
            np.testing.assert_allclose(k, sequence.state.intrinsics)
            part = sequence.part[t]
            assert len(gt[str(t)]) == len(gt_info[str(t)]) == len(infos)
            for n, (pose, info) in enumerate(zip(gt[str(t)], gt_info[str(t)], strict=True)):
                r, shift = np.reshape(pose["cam_R_m2c"], (3, 3)), np.array(pose["cam_t_m2c"])
                visible = image("mask_visib", f"{t:06d}_{n:06d}")
                np.testing.assert_array_equal(visible > 0, part == pose["obj_id"])
                mask = image("mask", f"{t:06d}_{n:06d}") > 0
                assert set(np.unique(visible)) <= {0, 255} and not (~mask & (visible > 0)).any()
                share = silhouette(meshes[str(pose["obj_id"])], k, r, shift)
                middle = share[120:240, 160:320]
                assert (~mask & (middle > 0.98)).sum() <= 1  # OpenCV fills the edges, too
                assert not mask[middle == 0].any()
                assert info["px_count_visib"] == (visible > 0).sum()
                assert info["px_count_valid"] == (mask & (depth > 0)).sum()
                edge = ((share > 0) & (share < 0.99)).sum()
                assert abs(info["px_count_all"] - share.sum()) <= edge
                fraction = (visible > 0).sum() / max(info["px_count_all"], 1)
                assert info["visib_fract"] == pytest.approx(fraction)
                if visible.any():
                    for kind, shown in (("bbox_visib", visible > 0), ("bbox_obj", mask)):
                        rows, columns = np.nonzero(shown)
                        box = [columns.min(), rows.min(), np.ptp(columns), np.ptp(rows)]
                        if info["px_count_all"] == mask.sum():  # nothing beyond the image
                            assert info[kind] == box
                    # the surface that is seen is where the pose and the mesh say
                    rows, columns = np.nonzero(visible)
                    rays = np.stack([columns, rows, np.ones(len(rows))], -1) @ np.linalg.inv(k).T
                    seen = rays * depth[rows, columns, None]
                    local = (seen - shift) @ r
                    _, distance, _ = trimesh.proximity.closest_point(
                        meshes[str(pose["obj_id"])], local[:: len(local) // 20 + 1])
                    assert distance.max() < 0.2
                else:
                    assert info["bbox_obj"] == info["bbox_visib"] == [-1] * 4
                listed = {"scene_id": sequence.meta.index, "im_id": t, "obj_id": pose["obj_id"],
                          "inst_count": 1} in targets
                assert listed == (info["visib_fract"] >= 0.1)


@pytest.mark.gl
def test_bop_counts_the_parts_of_each_instance(tmp_path: Path) -> None:
    config = RenderConfig(robot="microwave", frames=2, width=160, height=120)
    render_dataset(config, 2, tmp_path / "data", workers=1, progress=False)
    out = export_dataset(tmp_path / "data", "bop", tmp_path / "b", progress=False).folder
    infos = json.loads((out / "models" / "models_info.json").read_text())
    used: list[set[int]] = []
    for sequence in open_dataset(tmp_path / "data"):
        folder = out / "test" / f"{sequence.meta.index:06d}"
        poses = json.loads((folder / "scene_gt.json").read_text())["1"]
        used.append({pose["obj_id"] for pose in poses})
        names = [infos[str(k)]["name"] for k in sorted(used[-1])]
        seen = np.unique(sequence.part[1])
        assert {sequence.meta.part_names[n - 1] for n in seen[seen > 0]} <= set(names)
        assert set(names) <= set(sequence.meta.part_names)
    assert not used[0] & used[1] and {str(k) for k in used[0] | used[1]} == set(infos)
    assert len(list((out / "models").glob("obj_*.ply"))) == len(infos)


def test_bop_needs_the_model(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="no robot 'arm'"):
        export_dataset(dataset.path, "bop", tmp_path / "b", progress=False)


# -- Rerun ------------------------------------------------------------------------------------


HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def columns_of(recording: Path) -> dict[str, dict[str, list]]:
    """Values by entity and column, as Rerun's own reader gives them; static ones have no frame."""
    from rerun.chunk import RrdReader

    out: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(str(recording)).stream():
        for column, values in chunk.to_record_batch().to_pydict().items():
            out.setdefault(chunk.entity_path, {}).setdefault(column, []).extend(values)
    return out


def test_rerun(dataset: Dataset, toy: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    for data in (dataset, toy):
        out = export_dataset(data.path, "rerun", tmp_path / data.path.name, progress=False).folder
        assert sorted(p.stem for p in out.glob("*.rrd")) == list(data.names)
        for sequence in data:
            check_recording(columns_of(out / f"{sequence.meta.index:06d}.rrd"), sequence)


def check_recording(found: dict[str, dict[str, list]], sequence: Sequence) -> None:
    meta, s = sequence.meta, sequence.state
    image = found["/world/camera/image"]
    k = np.reshape(image["Pinhole:image_from_camera"][0], (3, 3)).T  # column by column
    np.testing.assert_allclose(k, s.intrinsics + HALF, rtol=1e-6)
    assert image["Pinhole:resolution"][0][0] == [meta.width, meta.height]
    for j, name in enumerate(meta.joint_names):
        joint = found[f"/joints/{name}"]
        assert joint["frame"] == list(range(meta.frames))
        np.testing.assert_array_equal(
            np.ravel(joint["Scalars:scalars"]), s.joint_positions[:, j])
        seconds = [time.total_seconds() for time in joint["time"]]
        np.testing.assert_allclose(seconds, s.times, atol=1e-6)
    poses = [("/world/camera", np.linalg.inv(s.cam_from_world))]
    poses += [(f"/world/parts/{name}", s.world_from_part[:, p])
              for p, name in enumerate(meta.part_names)]
    for path, expected in poses:
        at = np.reshape(found[path]["Transform3D:translation"], (-1, 3))
        turned = np.reshape(found[path]["Transform3D:mat3x3"], (-1, 3, 3)).swapaxes(1, 2)
        np.testing.assert_allclose(at, expected[:, :3, 3], atol=1e-6)
        np.testing.assert_allclose(turned, expected[:, :3, :3], atol=1e-6)
    for t in range(meta.frames):
        rgb, depth = (cv2.imdecode(np.array(found[f"/world/camera/image/{name}"][column][t][0],
                                            np.uint8), cv2.IMREAD_UNCHANGED)
                      for name, column in (("rgb", "EncodedImage:blob"),
                                           ("depth", "EncodedDepthImage:blob")))
        np.testing.assert_array_equal(rgb[..., ::-1], sequence.rgb[t])
        meter = found["/world/camera/image/depth"]["EncodedDepthImage:meter"][t][0]
        np.testing.assert_allclose(depth / meter, sequence.depth[t], atol=1e-6)
        part = found["/world/camera/image/part"]["SegmentationImage:buffer"][t][0]
        number = np.frombuffer(np.array(part, np.uint8).tobytes(), np.uint16)
        np.testing.assert_array_equal(number.reshape(meta.height, meta.width), sequence.part[t])
    assert ("/world/tracks" in found) == ("tracks" in meta.layers)
    if s.track_world is not None:
        places = [found["/world/tracks"]["Points3D:positions"][t] for t in range(meta.frames)]
        np.testing.assert_allclose(places, s.track_world, atol=1e-6)


# -- TAP-Vid ----------------------------------------------------------------------------------


@pytest.mark.gl
def test_tapvid_has_the_tracks_of_the_dataset(toy: Dataset, tmp_path: Path) -> None:
    out = export_dataset(toy.path, "tapvid", tmp_path / "t", progress=False).folder
    for name in toy.names:
        sequence = toy[name]
        with np.load(out / f"{name}.npz", allow_pickle=False) as video:
            assert {k: video[k].dtype.name for k in video} == {
                "video": "uint8", "points": "float32", "occluded": "bool"}
            np.testing.assert_array_equal(video["video"], sequence.rgb[:])
            pixels = video["points"].swapaxes(0, 1) * [160, 120] - 0.5
            np.testing.assert_allclose(pixels, sequence.state.track_image, atol=1e-4)
            np.testing.assert_array_equal(~video["occluded"].T, sequence.state.track_visible)


def test_tapvid_follows_parts(dataset: Dataset, tmp_path: Path) -> None:
    """A point's next place is where the flow of its pixel leads; what is seen shows its part."""
    out = export_dataset(dataset.path, "tapvid", tmp_path / "t", progress=False).folder
    followed = 0
    for name in dataset.names:
        sequence = dataset[name]
        with np.load(out / f"{name}.npz", allow_pickle=False) as video:
            points, occluded = video["points"], video["occluded"]
        assert points.shape == (256, FRAMES, 2) and occluded.shape == (256, FRAMES)
        pixels = points * [48, 36] - 0.5
        assert (np.abs(pixels - np.rint(pixels)).max(-1) < 1e-4).any(1).all()  # in its own frame
        assert occluded[(pixels < -0.5).any(-1) | (pixels > [47.5, 35.5]).any(-1)].all()
        for t in range(FRAMES - 1):
            at = np.rint(pixels[:, t]).astype(int)
            exact = (np.abs(pixels[:, t] - at).max(-1) < 1e-4) & ~occluded[:, t]
            for n in np.flatnonzero(exact):
                u, v = at[n]
                if sequence.part[t][v, u]:
                    expected = at[n] + sequence.flow[t][v, u]
                    np.testing.assert_allclose(pixels[n, t + 1], expected, atol=0.03)
                    hidden = sequence.visibility[t][v, u] != 1
                    followed += 1
                    assert hidden == occluded[n, t + 1]
    assert followed > 100


# -- ScrewNet ---------------------------------------------------------------------------------


def pose(values: np.ndarray) -> np.ndarray:
    """[4 4] of x y z, qw qx qy qz."""
    return trimesh.transformations.translation_matrix(values[:3]) @ (
        trimesh.transformations.quaternion_matrix(values[3:]))


def test_screwnet_images_are_those_that_our_networks_see(doors: Dataset, tmp_path: Path) -> None:
    """Also where a pixel's centre is between two of the large image."""
    h5py = pytest.importorskip("h5py")
    from gcbench.renderer.export.screwnet import ScrewNetData

    depth = np.random.default_rng(0).uniform(1, 3, (17, 288, 384)).astype(np.float32)
    archive = SimpleNamespace(path=Path("000000.zip"))
    sequence = dataclasses.replace(doors[0], depth=depth)
    ScrewNetData(tmp_path, doors).add(sequence, archive)  # type: ignore[arg-type]
    with h5py.File(tmp_path / "objects/000000.hdf5", "r") as file:
        np.testing.assert_array_equal(file["depth_imgs"], fit_depth(depth[:16]))


def test_screwnet(doors: Dataset, tmp_path: Path) -> None:
    """Read as the published loaders do: the labels follow from the poses."""
    h5py = pytest.importorskip("h5py")
    folder = export_dataset(doors.path, "screwnet", tmp_path / "s", progress=False).folder
    assert sorted(p.name for p in folder.iterdir()) == ["complete_data.hdf5", "export.json"]
    with h5py.File(folder / "complete_data.hdf5", "r") as file:
        assert list(file) == ["obj_000000", "obj_000001", "obj_000002"]
        for k, sequence in enumerate(doors):
            found, s = file[f"obj_{k:06d}"], sequence.state
            j = sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
            assert found.attrs["joint_type"] == sequence.meta.joint_types[j]
            assert found.attrs["sequence"] == doors.names[k]
            assert found["depth_imgs"].dtype == np.float32
            np.testing.assert_array_equal(found["depth_imgs"], fit_depth(sequence.depth[:16]))
            moving = [pose(values) for values in found["moving_frame_in_world"]]
            body = pose(found["embedding_and_params"][-7:])
            labels = np.array(found["global_labels"])
            assert (len(moving), labels.shape) == (16, (15, 8))
            parts = [int(s.joint_parent_part[j]) - 1, int(s.joint_child_part[j]) - 1]
            between = [np.linalg.inv(placed[parts[0]]) @ placed[parts[1]]
                       for placed in s.world_from_part[:16]]
            np.testing.assert_allclose(np.linalg.inv(body) @ moving, between, atol=1e-9)
            for t, (l, m, (theta, d)) in enumerate(
                zip(labels[:, :3], labels[:, 3:6], labels[:, 6:], strict=True), 1
            ):
                assert 0 <= theta <= np.pi and d >= 0 and np.linalg.norm(l) == pytest.approx(1)
                screw = trimesh.transformations.rotation_matrix(theta, l, np.cross(l, m))
                screw[:3, 3] += d * l
                np.testing.assert_allclose(screw, moving[t] @ np.linalg.inv(moving[0]), atol=1e-9)
    assert (labels[:, 7] > 0.005).all() and not labels[:, 3:7].any()  # of the sliding one


def test_screwnet_needs_one_joint_and_16_frames(dataset: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    with pytest.raises(GcbenchError, match="here are 4 frames, 2 scored joints; render an appli"):
        export_dataset(dataset.path, "screwnet", tmp_path / "s", progress=False)
    assert not list(tmp_path.iterdir())
