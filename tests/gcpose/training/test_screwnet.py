"""ScrewNet: labels are the true motion, the loss is least there, runs continue."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.benchmark.methods.registry import load_method, with_options
from gcbench.benchmark.protocol import observe
from gcbench.benchmark.run.driver import EvalConfig, evaluate
from gcbench.gcpose.training.config import ScrewNetTraining
from gcbench.renderer.dataset.reader import open_dataset
from gcbench.robots.geometry import inverse, se3

from ...support.one_joint import dataset, moved

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.learned.screwnet import motion_of_screws  # noqa: E402
from gcbench.gcpose.networks.abbatematteo import MixtureDensityNetwork  # noqa: E402
from gcbench.gcpose.networks.screwnet import ScrewNet  # noqa: E402
from gcbench.gcpose.networks.weights import read_notes, read_tensors, write_weights  # noqa: E402
from gcbench.gcpose.training import loop, screwnet_task  # noqa: E402
from gcbench.gcpose.training.screwnet_task import ScrewNetTask  # noqa: E402
from gcbench.gcpose.training.screws import (  # noqa: E402
    DepthVideos,
    ScrewSample,
    line_distance,
    relative_screws,
    rotations_about,
    screw_loss,
)
from gcbench.gcpose.training.video_features import VideoFeatures  # noqa: E402
from gcbench.robots.geometry.depth_images import fit_depth  # noqa: E402


def options(data: Path, out: Path, steps: int = 3) -> ScrewNetTraining:
    return ScrewNetTraining(
        data=(data,), out=out, held_out=(data,), steps=steps, batch=2, width=8, frames=4,
        device="cpu", threads=1, minutes=0.0)


# -- labels -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("joint", "displacement"), [
    ("pan", [0.3, 0.5, 0.1, -0.4, -2.0]), ("slide", [0.0, 0.05, -0.02, 0.01, 0.1]),
    ("pan", [0.0, 0.0, 4.0, -4.0, 3.0]),
])
@pytest.mark.parametrize("first", [0, 1])
def test_labels_are_the_motion_of_the_part(
    joint: str, displacement: list[float], first: int
) -> None:
    sequence = moved(joint, displacement)
    state, j = sequence.state, sequence.meta.joint_names.index(joint)
    rows = relative_screws(sequence, first, len(displacement) - 1)
    assert rows.shape == (len(displacement) - 1 - first, 8)
    assert (rows[:, 6:] >= 0).all() and (rows[:, 6] <= np.pi).all()
    cam_from_part = state.cam_from_world @ state.world_from_part[:, state.joint_child_part[j] - 1]
    # what moves the post are pan and lift, which stand still, and slide
    motion = cam_from_part @ inverse(cam_from_part[first])
    turned = se3.revolute_motion(rows[:, :6], rows[:, 6])
    slid = se3.prismatic_motion(rows[:, :6], rows[:, 7])
    assert np.allclose(motion[first + 1 :], slid @ turned, atol=1e-9)
    assert not (rows[:, 6] * rows[:, 7]).any()


def test_true_screws_give_the_true_displacement() -> None:
    for joint, q in (("pan", [0.0, -0.2, 0.3, 0.9]), ("slide", [0.0, -0.05, -0.1, 0.02])):
        sequence = moved(joint, q)
        found, screw = motion_of_screws(relative_screws(sequence, 0, 3), joint == "slide")
        sign = np.sign(found @ q)
        assert np.allclose(sign * found, q)
        j = sequence.meta.joint_names.index(joint)
        assert np.allclose(sign * screw, sequence.state.joint_screw[0, j])
    assert np.allclose(motion_of_screws(np.zeros((3, 8)), False)[0], 0)


def test_a_sample_is_a_window_with_the_same_pixels_dropped_in_each_frame(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d")
    videos = DepthVideos([data], 3, seed=1, dropped=0.25)
    assert len(videos) == 4
    sample, again = videos.sample(5), videos.sample(5)
    assert np.array_equal(sample.depth, again.depth) and sample.screw.shape == (2, 8)
    whole = DepthVideos([data], 3, seed=1, dropped=0.0).sample(5)
    seen = (whole.depth > 0).any(axis=0)
    dropped = (sample.depth == 0).all(axis=0) & seen
    assert dropped.sum() == pytest.approx(0.25 * seen.sum(), rel=0.15)
    assert np.array_equal(sample.depth[:, ~dropped], whole.depth[:, ~dropped])
    turns = [round(float(videos.sample(i).screw[0, 6]), 4) for i in range(8)]
    assert sorted(turns[:4]) == sorted(turns[4:]) == [0.1, 0.2, 0.3, 0.4]  # an epoch has each once
    with pytest.raises(GcbenchError, match="give --frames 4 or fewer"):
        DepthVideos([data], 5, 1, 0.0)
    with pytest.raises(GcbenchError, match="2 scored joints"):
        DepthVideos([dataset(tmp_path / "two", 1, ("pan", "lift"))], 4, 1, 0.0).sample(0)


def test_depth_is_seen_as_a_whole() -> None:
    depth = np.random.default_rng(0).uniform(1, 3, (2, 216, 288)).astype(np.float32)
    small = fit_depth(depth)
    assert small.shape == (2, 108, 192)
    assert not small[..., :24].any() and not small[..., 168:].any()  # 4:3 in 16:9
    assert np.array_equal(small[..., 24:168], depth[:, 1::2, 1::2] / np.float32(12))
    exact = np.ones((1, 108, 192), np.float32)
    assert np.array_equal(fit_depth(exact), exact / np.float32(12))


# -- network and loss -------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "millions"), [(64, 21.0), (16, 1.3)])
def test_the_network_has_the_size_of_the_paper(width: int, millions: float) -> None:
    network = ScrewNet(width).eval()
    count = sum(p.numel() for p in network.parameters()) / 1e6
    assert count == pytest.approx(millions, rel=0.1)
    with torch.no_grad():
        found = network(torch.zeros(2, 5, 108, 192))
    assert found.shape == (2, 4, 8)


def screws(seed: int, count: int = 6) -> Any:
    rng = np.random.default_rng(seed)
    l = rng.standard_normal((count, 3))
    l /= np.linalg.norm(l, axis=1)[:, None]
    m = np.cross(rng.standard_normal((count, 3)), l)
    return torch.from_numpy(np.concatenate([l, m, rng.uniform(0, 2, (count, 2))], axis=1))[None]


def test_the_loss_is_zero_at_the_truth_and_grows_with_each_error() -> None:
    true = screws(0)
    assert float(screw_loss(true, true)) == pytest.approx(0, abs=1e-4)
    for column in range(8):
        wrong = true.clone()
        wrong[..., column] += 0.1
        assert float(screw_loss(wrong, true)) > 0.004, column
    found = screws(1).requires_grad_()
    screw_loss(found, true).backward()
    assert torch.isfinite(found.grad).all() and (found.grad != 0).any(dim=1).all()
    zero = torch.zeros_like(true).requires_grad_()  # what an untrained network may return
    screw_loss(zero, true).backward()
    assert torch.isfinite(zero.grad).all()


def test_distances_and_rotations_are_those_of_the_geometry() -> None:
    a, b = screws(2), screws(3)
    (l, m), (k, n) = ((x[0, :, :3].numpy(), x[0, :, 3:6].numpy()) for x in (a, b))
    cross = np.cross(l, k)
    at, to = np.cross(l, m), np.cross(k, n)
    distance = np.abs(((to - at) * cross).sum(1)) / np.linalg.norm(cross, axis=1)
    assert np.allclose(line_distance(a[..., :3], a[..., 3:6], b[..., :3], b[..., 3:6])[0], distance)
    shifted = m + np.cross([0.3, -0.1, 0.2], l)
    gap = np.linalg.norm(np.cross(l, [0.3, -0.1, 0.2]), axis=1)
    for sign in (1, -1):
        there = torch.from_numpy(sign * np.concatenate([l, shifted], axis=1))[None]
        found = line_distance(a[..., :3], a[..., 3:6], there[..., :3], there[..., 3:])
        assert np.allclose(found[0], gap)
    turned = rotations_about(a[0, :, :3], a[0, :, 6]).numpy()
    assert np.allclose(turned, se3.so3_exp(l * a[0, :, 6:7].numpy()))


@dataclass(frozen=True)
class Doors:
    """Small videos of doors that open at random speeds."""

    frames: int = 5

    def __len__(self) -> int:
        return 1000

    def sample(self, number: int) -> ScrewSample:
        rng = np.random.default_rng(number)
        angle = np.linspace(0, rng.uniform(0.2, 1.2), self.frames)
        depth = np.full((self.frames, 27, 48), 0.25, np.float32)
        reach = np.arange(24, dtype=np.float32)
        for t, a in enumerate(angle):
            wide = max(1, int(24 * np.cos(a)))
            depth[t, 6:21, 12 : 12 + wide] = 0.2 - 0.004 * np.sin(a) * reach[:wide]
        row = np.tile(np.array([0, 1, 0, -2.4, 0, 0, 0, 0], np.float32), (self.frames - 1, 1))
        row[:, 6] = angle[1:]
        return ScrewSample(depth, row)


class DoorTask(ScrewNetTask):
    def plan_data(self) -> Iterator[Any]:
        return iter(())

    def open_samples(self, folders: list[Path], network: Any) -> Doors:
        return Doors()


def test_a_short_training_learns_and_a_shuffled_video_is_worse(tmp_path: Path) -> None:
    config = ScrewNetTraining(
        out=tmp_path / "out", steps=160, batch=8, width=8, frames=5, rate=1e-2, weight_decay=0.0,
        device="cpu", threads=1)
    loop.train(DoorTask(config))
    log = [json.loads(line) for line in (tmp_path / "out/log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log] == list(range(20, 161, 20))
    network = ScrewNet(8).eval()
    network.load_state_dict(read_tensors(tmp_path / "out/screwnet.safetensors"))
    some = [Doors().sample(10_000 + i) for i in range(24)]
    depth = torch.from_numpy(np.stack([s.depth for s in some]))
    angle = np.stack([s.screw[:, 6] for s in some])

    def error(order: list[int]) -> float:
        with torch.no_grad():
            return float(np.abs(network(depth[:, order])[..., 6].numpy() - angle).mean())

    # by seed: 0.1 to 0.35 of no motion, and 1.4 to 8.5 times as much for the shuffled video
    assert error([0, 1, 2, 3, 4]) < 0.6 * np.abs(angle).mean()
    assert error([4, 2, 3, 1, 0]) > 1.1 * error([0, 1, 2, 3, 4])


def test_errors_of_a_screw_do_not_depend_on_its_length_and_a_slide_has_no_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = screws(0)
    shifted = true.clone()
    shifted[..., 3:6] += torch.linalg.cross(true.new_tensor([0.3, -0.1, 0.2]).expand(1, 6, 3),
                                            true[..., :3])
    error = screwnet_task._errors(shifted, true, 0.0)
    longer = shifted.clone()
    longer[..., :6] *= 0.6
    assert error[3] > 0.1
    assert np.allclose(screwnet_task._errors(longer, true, 0.0), error, atol=1e-4)

    task = ScrewNetTask(options(dataset(tmp_path / "d", 2), tmp_path / "out"))
    network = ScrewNet(8).eval()
    assert {"angle", "slide", "direction", "line", "loss"} == set(
        task.measure(network, tmp_path / "d")["screwnet"])

    def slide(*_: Any) -> Any:
        return np.array([[0.0, 0, 1, 0, 0, 0, 0, 0.2]] * 3)

    monkeypatch.setattr("gcbench.gcpose.training.screws.relative_screws", slide)
    found = task.measure(network, tmp_path / "d")["screwnet"]
    assert set(found) == {"angle", "slide", "direction", "loss"}


# -- runs -------------------------------------------------------------------------------------


class Killed(BaseException):
    """The end of the process."""


def test_a_run_that_was_killed_goes_on_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = dataset(tmp_path / "d")
    loop.train(ScrewNetTask(options(data, tmp_path / "whole", 4)))
    whole = tmp_path / "whole"

    out, writes, write = tmp_path / "parts", [], loop.write_checkpoint

    def dies(*values: Any) -> None:
        writes.append(1)
        if len(writes) >= 3:
            raise Killed  # the weights are written, the checkpoint is not
        write(*values)

    with monkeypatch.context() as patch:
        patch.setattr(loop, "write_checkpoint", dies)
        with pytest.raises(Killed):
            loop.train(ScrewNetTask(options(data, out, 4)))
    with (out / "log.jsonl").open("a") as log:
        log.write('{"step": 40, "loss": 1}\n{"step": 3, "lo')
    loop.train(ScrewNetTask(options(data, out, 4)))
    ends = [read_tensors(p / "screwnet.safetensors") for p in (whole, out)]
    assert all(torch.equal(ends[0][key], ends[1][key]) for key in ends[0])
    logs = [[json.loads(x) for x in (p / "log.jsonl").read_text().splitlines()]
            for p in (whole, out)]
    for lines in logs:
        for line in lines:
            line.pop("seconds")
    assert logs[0] == logs[1] and logs[0][0]["step"] == 0 and logs[0][1]["loss"] > 0
    page = (out / "curves.html").read_text()
    assert page.count("<svg") == 6 and "hold-still" in page  # the loss, and 5 errors


@pytest.mark.ci
def test_the_command_trains_and_eval_takes_the_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = dataset(tmp_path / "d"), tmp_path / "out"
    line = (f"train screwnet --data {data} --held-out {data} --out {out} --steps 1 --batch 2 "
            "--width 8 --frames 4 --device cpu --threads 1")
    assert main(line.split()) == 0
    printed = capsys.readouterr()
    assert f"{data} is also learned from: its errors are not those of new data" in printed.err
    said = printed.out.splitlines()
    assert said[0] == f"{data}: deg, m" and said[-1] == str(out)
    rows = {row.split()[0]: row.split()[1:] for row in said[2:-1]}
    assert set(rows) == {"screwnet", "hold-still"}
    assert float(rows["hold-still"][0]) == pytest.approx(np.degrees(0.5), rel=0.01)
    weights = out / "screwnet.safetensors"
    assert read_notes(weights) == {"objects": "arm"}
    assert all(t.dtype != torch.float16 for t in read_tensors(weights).values())
    assert main(f"{line.replace('--steps 1', '--steps 2')} --half".split()) == 0
    kinds = {t.ndim > 1: t.dtype for t in read_tensors(weights).values() if t.is_floating_point()}
    assert kinds == {True: torch.float16, False: torch.float32}
    more = options(dataset(tmp_path / "e"), tmp_path / "more")
    write_weights(tmp_path / "before.safetensors", ScrewNet(8), {"objects": "oven, lamp"})
    started = replace(more, start_from=tmp_path / "before.safetensors")
    assert ScrewNetTask(started).notes() == {"objects": "arm, lamp, oven"}
    capsys.readouterr()

    method = load_method(with_options("screwnet", {"weights": str(weights)}))
    assert method.name.startswith("screwnet arm width=8 net=")
    assert method.training == "supervised: depth video of arm"
    seen = observe(open_dataset(data)[0], "rgbd", "free")
    estimate = method.estimate(seen)
    assert estimate.displacement.shape == (4, 1) and estimate.displacement[0, 0] == 0
    assert estimate.screw is not None and estimate.screw.shape == (1, 6)
    assert np.linalg.norm(estimate.screw[0, :3]) == pytest.approx(1)
    assert estimate.screw[0, :3] @ estimate.screw[0, 3:] == pytest.approx(0, abs=1e-9)
    with pytest.raises(GcbenchError, match="sees one joint; this object has 2"):
        method.estimate(replace(seen, n_joints=2))
    with pytest.raises(GcbenchError, match="needs depth"):
        method.estimate(replace(seen, depth=None))

    run = EvalConfig(method=("screwnet",), weights=(str(weights),), data=(data,),
                     results=tmp_path / "results")
    (scored,) = evaluate(run, progress=False).runs
    assert {r.status for r in scored.results()} == {"ok"}


def test_a_training_begins_with_the_features_of_an_abbatematteo_network(tmp_path: Path) -> None:
    other = MixtureDensityNetwork(8)
    start, once = tmp_path / "abbatematteo.safetensors", tmp_path / "once"
    write_weights(start, other, {"objects": "oven"})
    for first, out in (start, once), (once / "screwnet.safetensors", tmp_path / "twice"):
        config = ScrewNetTraining(out=out, start_from=first, width=8, steps=1, batch=2, frames=5,
                                  rate=0.0, device="cpu", threads=1)
        loop.train(DoorTask(config))
        tensors = read_tensors(out / "screwnet.safetensors")
        for name, tensor in other.state_dict().items():
            if name.endswith("weight") and name.startswith(("encoder.", "features.")):
                assert torch.equal(tensors[name], tensor)
        method = load_method(with_options("screwnet", {
            "weights": str(out / "screwnet.safetensors")}))
        assert method.training == ("supervised: depth video of microwave, oven, begun with "
                                   "features of abbatematteo")
    frozen = ScrewNetTraining(
        out=tmp_path / "frozen", start_from=start, width=8, steps=2, batch=2, frames=5, rate=0.01,
        freeze_features=1.0, device="cpu", threads=1)
    for share, same in ((1.0, True), (0.5, False)):
        config = replace(frozen, out=tmp_path / str(share), freeze_features=share)
        loop.train(DoorTask(config))
        tensors = read_tensors(config.out / "screwnet.safetensors")
        kept = [torch.equal(tensors[name], tensor) for name, tensor in other.state_dict().items()
                if name.startswith(("encoder.", "features."))]
        assert all(kept) if same else not any(kept[:2])
        again = replace(config, out=tmp_path / f"{share} again", steps=4)  # stopped while frozen
        loop.train(DoorTask(replace(again, steps=1)))
        loop.train(DoorTask(again))
        loop.train(DoorTask(replace(again, out=tmp_path / f"{share} at once")))
        parts, whole = (read_tensors(tmp_path / folder / "screwnet.safetensors")
                        for folder in (f"{share} again", f"{share} at once"))
        assert all(torch.equal(parts[name], whole[name]) for name in whole)
    with pytest.raises(GcbenchError, match="give weights with --start-from"):
        loop.train(DoorTask(replace(frozen, start_from=None)))
    with pytest.raises(GcbenchError, match="add --freeze-features 1"):
        loop.train(DoorTask(replace(frozen, freeze_features=0.5, feature_views=2)))
    wide = ScrewNetTraining(out=tmp_path / "wide", start_from=start, width=16, steps=1)
    with pytest.raises(GcbenchError, match=r"no weights of screwnet: .* expected \[16, 3, 7, 7\]"):
        loop.train(DoorTask(wide))


def test_features_that_are_computed_once_train_as_those_of_each_step(tmp_path: Path) -> None:
    data = dataset(tmp_path / "d")
    start = tmp_path / "start.safetensors"
    torch.manual_seed(3)
    write_weights(start, ScrewNet(8))
    each = replace(options(data, tmp_path / "each"), start_from=start, freeze_features=1.0,
                   precision="float32", rate=0.01)
    once = replace(each, out=tmp_path / "once", feature_views=2)
    network = ScrewNet(8).eval()
    network.load_state_dict(read_tensors(start))
    cached = VideoFeatures(DepthVideos([data], 4, 1), 2, network, once)
    assert len(cached) == 8
    videos = DepthVideos([data], 4, 1)
    whole = [videos.sample(n) for n in range(8)]
    with torch.no_grad():
        expected = [network.image_features(torch.from_numpy(s.depth)[None])[0] for s in whole]
    for number in range(8):  # an epoch has each of the first samples once
        found = cached.sample(number)
        place = next(k for k, s in enumerate(whole) if np.array_equal(s.screw, found.screw)
                     and np.allclose(expected[k], found.features, atol=2e-3))
        whole[place] = replace(whole[place], screw=np.zeros_like(found.screw))

    for config in (each, once):
        loop.train(ScrewNetTask(config))
    found = [read_tensors(c.out / "screwnet.safetensors") for c in (each, once)]
    for name, tensor in network.state_dict().items():
        same = [torch.equal(tensors[name], tensor) for tensors in found]
        assert same == [name.startswith(("encoder.", "features."))] * 2 or "num_batches" in name
    whole_run = (once.out / "screwnet.safetensors").read_bytes()
    again = replace(once, out=tmp_path / "again")
    loop.train(ScrewNetTask(replace(again, steps=2)))
    loop.train(ScrewNetTask(again))
    assert (again.out / "screwnet.safetensors").read_bytes() == whole_run


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    from gcbench.gcpose.images.raft_network import RAFT_WEIGHTS

    listed = "--weights dishwasher or microwave or oven, or your own: gcbench train screwnet"
    with pytest.raises(GcbenchError, match=listed):
        load_method("screwnet")
    none = tmp_path / "none.safetensors"
    for path, said in ((RAFT_WEIGHTS, "no weights of screwnet"), (none, "no file and no weights")):
        with pytest.raises(GcbenchError, match=said):
            load_method(with_options("screwnet", {"weights": str(path)}))
    broken = ScrewNet(8)
    torch.nn.init.constant_(broken.features.bias, float("nan"))
    write_weights(tmp_path / "nan.safetensors", broken)
    with pytest.raises(GcbenchError, match=r"features\.bias is not finite"):
        load_method(with_options("screwnet", {"weights": str(tmp_path / "nan.safetensors")}))


def test_weights_that_come_with_gcbench_have_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gcbench.gcpose.learned.trained.TRAINED", tmp_path)
    for name in ("screwnet-oven", "screwnet-all-classes", "abbatematteo-box"):
        write_weights(tmp_path / f"{name}.safetensors", ScrewNet(8), {"objects": name})
    for name in ("oven", "all-classes"):
        method = load_method(with_options("screwnet", {"weights": name}))
        assert method.name == f"screwnet screwnet-{name} width=8"
    listed = "screwnet needs weights: --weights all-classes or oven, or your own: gcbench train"
    with pytest.raises(GcbenchError, match=rf"^{listed}"):
        load_method("screwnet")
    with pytest.raises(GcbenchError, match=rf"^no file and no weights of gcbench: box; {listed}"):
        load_method(with_options("screwnet", {"weights": "box"}))


def test_the_recipe_is_of_the_train_stream_and_holds_objects_out() -> None:
    task = ScrewNetTask(ScrewNetTraining(classes=("dishwasher", "oven"), sequences=101))
    plan = list(task.plan_data())
    assert sum(p.sequences for p in plan if not p.held_out) == 101
    assert sum(p.sequences for p in plan if p.held_out) == 100
    assert len({p.config.seed for p in plan}) == len({p.name for p in plan}) == 4
    assert {p.config.stream for p in plan} == {"train"}
    rates = [task.rate(x) for x in (0.0, 0.29, 0.31, 0.61, 0.95)]
    assert np.allclose(rates, [1e-3, 1e-3, 1e-4, 1e-5, 1e-6])
    falling = ScrewNetTask(ScrewNetTraining(rate_decay=0.5))
    rates = [falling.rate(x) for x in (0.0, 0.5, 0.75, 1.0)]
    assert np.allclose(rates, [1e-3, 1e-3, 5e-4, 0.0])
    assert task.count_steps(range(4000)) == 10_000  # type: ignore[arg-type]


@pytest.mark.parametrize(("args", "said"), [
    ("--views.mirror 2", "from 0 to 1"), ("--views.turn 90", "from 0 to 30"),
    ("--views.scale 2 1", "smaller number first"), ("--width 20", "multiple of 8"),
    ("--classes fridge", "there are"), ("--classes oven oven", "give each class once"),
    ("--dropped 1", "from 0 to 0.99"),
    ("--rate-decay 1.5", "from 0 to 1"), ("--freeze-features 2", "from 0 to 1"),
    ("--feature-views 2", "add --freeze-features 1"),
    ("--frames 1", "--frames 1: give a number of 2 or more"),
    ("--epochs 0", "--epochs 0: give a number of 1"),
])
def test_wrong_options_are_refused(
    args: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", "screwnet", *args.split()]) == 2
    assert not list(tmp_path.iterdir())
    assert said in capsys.readouterr().err
