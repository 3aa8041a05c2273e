"""A dataset describes itself, and is read back as it was configured."""

from __future__ import annotations

import dataclasses
import importlib
import json
import pickle
import shutil
import sys
from pathlib import Path
from typing import Any

import gcbench
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.benchmark.protocol import observe
from gcbench.renderer.dataset.reader import Dataset
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.scene.config import CameraConfig, RandomizationConfig, RenderConfig
from gcbench.renderer.scene.config_files import config_tree, differences, parse_config, read_config

from ...support import bench_data

CONFIG = RenderConfig(
    robot="arm",
    seed=3,
    frames=4,
    width=32,
    height=24,
    scored_joints=("elbow",),
    randomization=RandomizationConfig(camera=CameraConfig(fov=(30, 40.5))),
)
N = 3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[2] / "support"))
        render_dataset(CONFIG, N, out, 1, progress=False, source="fake_source:FakeRenderer")
    return out


@pytest.fixture
def dataset(folder: Path) -> Dataset:
    return gcbench.open_dataset(folder)


def test_a_dataset_is_a_list_of_sequences(dataset: Dataset) -> None:
    assert dataset.names == ("000000", "000001", "000002")
    assert len(dataset) == len(list(dataset)) == N
    assert [s.meta.index for s in dataset] == [0, 1, 2]
    assert dataset[-1].meta.name == dataset["000002"].meta.name == "000002"
    assert np.array_equal(dataset[1].rgb[2], dataset["000001"].rgb[2])
    assert dataset[np.int64(1)].meta.index == 1
    assert "000001" in dataset and "1" not in dataset and 1 not in dataset
    with pytest.raises(IndexError):
        dataset[N]
    for wrong in (slice(2), 0.0, None):
        with pytest.raises(TypeError, match="integer"):
            dataset[wrong]
    with pytest.raises(GcbenchError, match="there are 000000 to 000002"):
        dataset["000009"]
    gaps = dataclasses.replace(dataset, names=("000005", "000007"))
    with pytest.raises(GcbenchError, match="there are 2 from 000005 to 000007"):
        gaps["000006"]
    assert len(pickle.loads(pickle.dumps(dataset))[0]) == 4


def test_frames_are_counted_from_both_ends(dataset: Dataset) -> None:
    sequence = dataset[0]
    for t in range(4):
        one, same = vars(sequence.frame(t)), vars(sequence.frame(t - 4))
        for name, image in one.items():
            assert (image is None) == (same[name] is None)
            assert image is None or np.array_equal(image, same[name], equal_nan=True), name
    for beyond in (4, -5):
        with pytest.raises(IndexError):
            sequence.frame(beyond)


def test_sequences_compare_by_identity(dataset: Dataset) -> None:
    """Their arrays have no truth value."""
    sequence = dataset[0]
    assert sequence == sequence and sequence != dataset[0]
    assert len({sequence, sequence.state, sequence.frame(0)}) == 3


def test_a_dataset_knows_its_config(dataset: Dataset) -> None:
    assert dataset.config == CONFIG


def test_a_dataset_knows_where_it_came_from(dataset: Dataset, folder: Path) -> None:
    info = dataset.info
    assert info.generator == {"name": "gcbench", "version": gcbench.__version__}
    assert info.counts == {
        "sequences": 3,
        "frames": 12,
        "unobservable": 1,
        "refused": {"collision": 0 + 1 + 2},
    }
    assert [a["licence"] for a in info.assets] == ["MIT"]
    tree = json.loads((folder / "dataset.json").read_text())
    assert (tree["format"], tree["seed"]) == ("gcbench/1", 3)
    assert tree["dependencies"]["numpy"] == np.__version__
    assert tree["platform"]["system"]


def test_what_is_no_sequence_is_ignored(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "sequences"
    copy.mkdir()
    (tmp_path / "dataset.json").write_bytes((folder / "dataset.json").read_bytes())
    (copy / "000001.zip").write_bytes((folder / "sequences/000001.zip").read_bytes())
    for stray in (".000002.zip.1.tmp", "notes.txt", "000003.zip.part", "12.zip", "000004"):
        (copy / stray).touch()
    dataset = gcbench.open_dataset(tmp_path)
    assert dataset.names == ("000001",)
    assert dataset[0].meta.index == 1


def test_what_is_no_dataset_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(GcbenchError, match="not a dataset"):
            gcbench.open_dataset(path)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "gcbench/9"},
        {"config": {"robbot": "ur5"}},
        {"config": {"frames": "many"}},
        {"config": {"randomization": {"camera": {"fov": [1, 2, 3]}}}},
        {"config": {"stream": "validation"}},
        {"config": None},
        {"assets": {}},
    ],
)
def test_a_broken_description_is_one_line(
    folder: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    tree = json.loads((folder / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps(tree | change))
    with pytest.raises(GcbenchError, match=r"dataset\.json") as caught:
        gcbench.open_dataset(tmp_path)
    assert "\n" not in str(caught.value)


def test_configs_come_back_from_json() -> None:
    for config in (RenderConfig(), CONFIG):
        assert parse_config(json.loads(json.dumps(config_tree(config))), "") == config
    assert parse_config({}, "") == RenderConfig(twin_of="")  # as in earlier versions


def test_configs_are_read_from_files(tmp_path: Path, folder: Path) -> None:
    toml = tmp_path / "config.toml"
    toml.write_text('robot = "arm"\nframes = 4\n[randomization.camera]\nfov = [30, 40.5]\n')
    mine = dataclasses.replace(CONFIG, robot="ur5", frames=9)
    assert read_config(toml, mine) == dataclasses.replace(CONFIG, twin_of="")
    assert read_config(folder / "dataset.json") == CONFIG
    for text in ("frames = ", "frames = true", "frame = 3", "randomization = 3", "\x00"):
        toml.write_text(text)
        with pytest.raises(GcbenchError, match=r"config\.toml") as caught:
            read_config(toml)
        assert "\n" not in str(caught.value)
    with pytest.raises(GcbenchError, match="No such file"):
        read_config(tmp_path / "nowhere.json")


def test_differences_name_the_field() -> None:
    other = dataclasses.replace(CONFIG, seed=0, randomization=RandomizationConfig())
    assert differences(config_tree(CONFIG), config_tree(CONFIG)) == []
    assert differences(config_tree(CONFIG), config_tree(other)) == [
        "seed: 3 -> 0",
        "randomization.camera.fov: [30, 40.5] -> [35.0, 55.0]",
    ]
    assert differences({"a": None}, {"b": 1}) == ["a: null -> nothing", "b: nothing -> 1"]


# -- tensors ----------------------------------------------------------------------------------


def test_tensors_name_the_extra_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "gcbench.renderer.dataset.torch", raising=False)
    with pytest.raises(GcbenchError, match=r"\.\[learn\]"):
        importlib.import_module("gcbench.renderer.dataset.torch")


def test_tensors_of_pairs_and_sequences(dataset: Dataset) -> None:
    torch = pytest.importorskip("torch")
    from gcbench.renderer.dataset.torch import TorchDataset

    arrays = ("intrinsics", "joint_positions")
    pairs = TorchDataset(dataset, state=arrays)
    assert len(pairs) == N * 3
    assert isinstance(pairs, torch.utils.data.Dataset)
    item, sequence = pairs[3 + 2], dataset[1]
    assert (item["sequence"], item["frame"]) == (1, 2)
    assert item["rgb"].shape == (2, 3, 24, 32)
    assert np.array_equal(item["rgb"][1].permute(1, 2, 0), sequence.rgb[3])
    assert np.array_equal(item["flow"][0].permute(1, 2, 0), sequence.flow[2], equal_nan=True)
    assert np.array_equal(item["depth"], sequence.depth[2:4])
    assert np.array_equal(item["part"], sequence.part[2:4])
    assert np.array_equal(item["joint_positions"], sequence.state.joint_positions[2:4])
    assert np.array_equal(item["intrinsics"], sequence.state.intrinsics)
    assert pairs[np.int64(-1)]["frame"] == 2
    with pytest.raises(IndexError):
        pairs[len(pairs)]
    with pytest.raises(TypeError, match="integer"):
        pairs[0:2]
    whole = TorchDataset(dataset, pairs=False, images=("rgb", "visibility"))
    assert len(whole) == N
    assert whole[-1]["visibility"].shape == (3, 24, 32)
    assert "depth" not in whole[0]
    batch = next(iter(torch.utils.data.DataLoader(whole, batch_size=3)))
    assert batch["rgb"].shape == (3, 4, 3, 24, 32)
    with pytest.raises(GcbenchError, match="no image 'normals'"):
        TorchDataset(dataset, images=("normals",))
    with pytest.raises(GcbenchError, match="no array 'joints'; there are times"):
        TorchDataset(dataset, state=("joints",))
    with pytest.raises(GcbenchError, match=r"'rgb' is one name; give a tuple of images: \('rgb',"):
        TorchDataset(dataset, images="rgb")
    with pytest.raises(GcbenchError, match="takes an open dataset"):
        TorchDataset("data/arm")
    still = dataclasses.replace(dataset, config=dataclasses.replace(CONFIG, frames=1))
    with pytest.raises(GcbenchError, match="pairs need 2 frames"):
        TorchDataset(still)
    assert len(TorchDataset(still, pairs=False)) == N


@pytest.fixture(scope="module")
def mix(tmp_path_factory: pytest.TempPathFactory, folder: Path) -> tuple[Dataset, Dataset]:
    """Two robots: with 2 joints and 3 parts, and with other numbers of both."""
    other = bench_data.make_dataset(tmp_path_factory.mktemp("other") / "arm", 2)
    return gcbench.open_dataset(folder), gcbench.open_dataset(other)


def test_several_robots_make_batches(
    mix: tuple[Dataset, Dataset], tmp_path: Path
) -> None:
    torch = pytest.importorskip("torch")
    from gcbench.renderer.dataset.torch import TorchDataset, pad_collate
    from torch.utils.data import ConcatDataset, DataLoader

    sizes = [data[0].state.joint_positions.shape[1] for data in mix]
    assert sizes[0] != sizes[1]

    def crop(item: dict[str, Any]) -> dict[str, Any]:
        return item | {"rgb": item["rgb"][..., :24, :32]}

    fixed = ConcatDataset([TorchDataset(data, images=("rgb",), transform=crop) for data in mix])
    (batch,) = DataLoader(fixed, batch_size=len(fixed))  # torch's own collate
    assert batch["rgb"].shape == (N * 3 + 2 * 3, 2, 3, 24, 32)
    assert batch["cam_from_world"].shape == (len(fixed), 2, 4, 4)

    chosen = [TorchDataset(data, images=(), state=("joint_positions", "times")) for data in mix]
    both = ConcatDataset(chosen)
    with pytest.raises(RuntimeError, match="equal size"):
        next(iter(DataLoader(both, batch_size=len(both))))
    (batch,) = DataLoader(both, batch_size=len(both), collate_fn=pad_collate, num_workers=2)
    positions, mask = batch["joint_positions"], batch["joint_positions_mask"]
    assert positions.shape == mask.shape == (len(both), 2, max(sizes))
    assert "times_mask" not in batch
    for i, item in enumerate(both):
        assert torch.equal(positions[i][mask[i]], item["joint_positions"].ravel())
        assert not positions[i][~mask[i]].any()
    (batch,) = DataLoader(chosen[0], batch_size=len(chosen[0]), collate_fn=pad_collate)
    assert batch["joint_positions_mask"].all()  # the same keys where nothing is padded


def test_tensors_are_ready_for_losses(dataset: Dataset) -> None:
    torch = pytest.importorskip("torch")
    from gcbench.renderer.dataset.torch import TorchDataset

    plain, masked = (TorchDataset(dataset, masks=masks)[4] for masks in (False, True))
    assert plain["flow"].isnan().any() and not masked["flow"].isnan().any()
    assert torch.equal(masked["flow_valid"], plain["flow"].isfinite().all(dim=1))
    assert torch.equal(masked["flow"], plain["flow"].nan_to_num() * masked["flow_valid"][:, None])
    assert masked["part"].dtype == masked["visibility"].dtype == torch.int64
    assert masked["rgb"].dtype == torch.uint8 and "depth_valid" not in masked
    torch.nn.functional.cross_entropy(torch.zeros(2, 4, 24, 32), masked["part"])


@pytest.mark.parametrize("change", [{"frames": 9}, {"width": 40}, {"layers": ["normal"]}])
def test_a_sequence_of_another_kind_is_refused(
    folder: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    """Where dataset.json says other things than its sequences."""
    pytest.importorskip("torch")
    from gcbench.renderer.dataset.torch import TorchDataset

    shutil.copytree(folder, tmp_path / "data")
    tree = json.loads((folder / "dataset.json").read_text())
    tree["config"] |= change
    (tmp_path / "data/dataset.json").write_text(json.dumps(tree))
    data = gcbench.open_dataset(tmp_path / "data")
    tensors = TorchDataset(data, images=("rgb", *data.config.layers))
    with pytest.raises(GcbenchError, match="sequence 000000 has") as caught:
        tensors[0]
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    (sequence,) = gcbench.open_dataset(bench_data.make_dataset(tmp_path / "arm", 1))
    frames = len(sequence)
    for number in (frames, -frames - 1):
        with pytest.raises(IndexError, match=f"^there is no frame {number}; .* from 0 to "):
            sequence.frame(number)
    with pytest.raises(gcbench.ConfigError, match=r"^there is no sequence -1; the first"):
        gcbench.render_sequence(CONFIG, -1)
    with pytest.raises(gcbench.ModelError, match=r"^'5' is no robot; give a name or the path"):
        gcbench.load_robot(5)  # type: ignore[arg-type]


def test_arrays_are_described_in_a_line_and_compared_by_identity(tmp_path: Path) -> None:
    dataset = gcbench.open_dataset(bench_data.make_dataset(tmp_path / "arm", 1))
    sequence, model = dataset[0], gcbench.load_robot("owi535")
    height, width = sequence.rgb.shape[1:3]
    assert repr(sequence.rgb) == f"LazyStack({len(sequence)} x {height} x {width} x 3 uint8)"
    assert repr(sequence.frame(-1)) == \
        f"Frame({width}x{height} px: rgb, depth, part, flow_backward)"
    parts, joints = len(model.part_names), len(model.joint_names)
    assert repr(model) == f"ArticulatedModel('owi535', {parts} parts, {joints} joints)"
    camera = gcbench.Camera(4, 3, np.eye(3), np.eye(4))
    estimate = gcbench.Estimate(np.zeros((2, 3)))
    observation = observe(sequence, "rgbd", "axes")
    for one, other in ((camera, gcbench.Camera(4, 3, np.eye(3), np.eye(4))),
                       (estimate, gcbench.Estimate(np.zeros((2, 3)))),
                       (observation, observe(sequence, "rgbd", "axes")),
                       (model, gcbench.load_robot("owi535")),
                       (gcbench.JointTrajectory(np.zeros(2), np.zeros((2, 1))),
                        gcbench.JointTrajectory(np.zeros(2), np.zeros((2, 1))))):
        assert one == one and one != other and len({one, other}) == 2
