"""Training: samples agree with their truth, losses measure what they say, runs continue."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.gcpose.training.config import FlowTraining, LossConfig
from gcbench.gcpose.training.curves import write_curves
from gcbench.gcpose.training.data import plan_datasets
from gcbench.gcpose.training.errors import flow_errors
from gcbench.gcpose.training.pairs import FramePair, Pairs, draw_sample, weigh_pixels
from gcbench.renderer.scene.config import resolve
from gcbench.robots.catalog import load_robot

from ...support.bench_data import make_dataset

CROPPED = FlowTraining(crop=(64, 48))


def to_learn_from(folder: Path, n: int = 3) -> Path:
    """A dataset of the stream "train"."""
    return make_dataset(folder, n, stream="train")


def shifted(shift: tuple[int, int] = (5, -3), size: tuple[int, int] = (96, 128)) -> FramePair:
    """Two parts on a still ground; part 2 moves by `shift` (u, v), part 1 does not."""
    rng = np.random.default_rng(0)
    coarse = rng.uniform(0, 255, (size[0] // 8, size[1] // 8, 3)).astype(np.float32)
    ground = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255)
    thing = cv2.resize(coarse[::-1], size[::-1], interpolation=cv2.INTER_CUBIC).clip(0, 255)
    part = np.zeros(size, np.int64)
    part[10:30, 10:40] = 1
    part[40:70, 50:90] = 2
    there = np.roll(part == 2, shift[::-1], (0, 1))
    a = np.where((part > 0)[..., None], thing, ground).astype(np.uint8)
    b = np.where((part == 1)[..., None], thing, ground)
    b = np.where(there[..., None], np.roll(thing, shift[::-1], (0, 1)), b).astype(np.uint8)
    flow = np.where((part == 2)[..., None], np.float32(shift), np.float32(0))
    return FramePair(a, b, flow, part, ~(there & (part != 2)))


def test_weights_are_of_what_moves_and_sum_to_one() -> None:
    part, weight = weigh_pixels(shifted(), LossConfig())
    assert set(np.unique(part)) == {0, 2}
    assert weight.sum() == pytest.approx(1, abs=1e-5)
    assert weight[part == 2].sum() == pytest.approx(0.8, abs=0.05)
    hidden = ~shifted().seen
    assert weight[hidden].mean() < 0.5 * weight[(part == 0) & ~hidden].mean()


def test_parts_count_by_the_root_of_their_size() -> None:
    flow = np.ones((64, 64, 2), np.float32)
    part = np.full((64, 64), 1)
    part[:8, :8] = 2
    image = np.zeros((64, 64, 3), np.uint8)
    _, weight = weigh_pixels(
        FramePair(image, image, flow, part, np.ones((64, 64), bool)), LossConfig())
    ratio = weight[part == 1].sum() / weight[part == 2].sum()
    assert ratio == pytest.approx(np.sqrt((64 * 64 - 64) / 64), rel=1e-4)


def test_unknown_flow_and_many_parts_weigh_nothing_more() -> None:
    pair = shifted()
    part, flow = pair.part.copy(), pair.flow.copy()
    part[:8, :8], part[-8:, -8:] = 200, 90
    flow[:8, :8], flow[-8:, -8:] = np.nan, 3.0
    numbers, weight = weigh_pixels(pair._replace(part=part, flow=flow), LossConfig())
    assert set(np.unique(numbers)) == {0, 2}  # as many as the loss can tell apart
    assert not weight[:8, :8].any() and weight.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("seed", range(12))
def test_a_sample_keeps_flow_and_images_together(seed: int) -> None:
    """Whatever is drawn, b at x + flow(x) looks as a at x does, but for tone and noise."""
    sample = draw_sample(shifted(), CROPPED, np.random.default_rng(seed))
    assert sample.a.shape == (3, 48, 64) and sample.weight.shape == (48, 64)
    u, v = np.meshgrid(np.arange(64, dtype=np.float32), np.arange(48, dtype=np.float32))
    gray = [cv2.GaussianBlur(x.mean(0), (0, 0), 1.5) for x in (sample.a, sample.b)]
    moving = cv2.erode((sample.part == 2).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    if moving.sum() < 60:
        pytest.skip("the crop shows too little of what moves")
    with_flow, without = (
        np.abs(cv2.remap(gray[1], u + k * sample.flow[0], v + k * sample.flow[1],
                         cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) - gray[0])[moving]
        for k in (1, 0)
    )
    assert np.median(with_flow) < 0.5 * np.median(without)


def test_a_sample_of_a_number_is_always_one(tmp_path: Path) -> None:
    folder = make_dataset(tmp_path / "d")
    first, second = (Pairs([folder, folder], FlowTraining(seed=3, crop=(48, 32))) for _ in range(2))
    assert len(first) == 2 * 3 * 3 * 2
    for number in (0, 5, 9):
        a, b = first.sample(number), second.sample(number)
        np.testing.assert_array_equal(a.a, b.a)
        np.testing.assert_array_equal(a.flow, b.flow)
    with pytest.raises(GcbenchError, match="no pairs"):
        Pairs([], FlowTraining())


def test_both_directions_are_each_others_inverse(tmp_path: Path) -> None:
    pairs = Pairs([make_dataset(tmp_path / "d", n=1)], FlowTraining())
    forward, backward = pairs.pair(0), pairs.pair(1)
    np.testing.assert_array_equal(forward.a, backward.b)
    seen = forward.seen & (forward.part > 0)
    v, u = np.nonzero(seen)
    there = np.rint(np.stack([u, v], 1) + forward.flow[seen]).astype(int)
    back = backward.flow[there[:, 1].clip(0, 35), there[:, 0].clip(0, 47)]
    assert np.nanmedian(np.linalg.norm(back + forward.flow[seen], axis=1)) < 0.1


def test_errors_of_known_flows() -> None:
    pair = shifted()
    noise = np.random.default_rng(1).normal(0, 1, (*pair.part.shape, 2)).astype(np.float32)
    errors = flow_errors({
        "true": lambda a, b: pair.flow,
        "off": lambda a, b: pair.flow + np.float32([0.3, 0.4]),
        "noisy": lambda a, b: pair.flow + noise,
        "none": lambda a, b: np.zeros_like(pair.flow),
    }, [pair])
    speed = float(np.hypot(5, 3))
    assert (errors["true"].epe, errors["true"].bias, errors["true"].parts) == (0, 0, 1)
    for value in (errors["off"].epe, errors["off"].bias, errors["off"].median):
        assert value == pytest.approx(0.5, rel=1e-5)
    assert errors["noisy"].epe > 1 > 10 * errors["noisy"].bias
    assert errors["none"].epe == errors["none"].speed == pytest.approx(speed)


def test_the_recipe_is_of_models_that_no_suite_holds() -> None:
    shoots = list(plan_datasets(9, seed=2))
    assert len({s.name for s in shoots}) == len({s.config.seed for s in shoots}) == 9
    for shoot in shoots:
        assert shoot.config.stream == "train"
        assert resolve(shoot.config).robot == shoot.config.robot  # or it refuses a range
        if shoot.config.robot.startswith("random:"):
            names = load_robot(shoot.config.robot).joint_names
            assert shoot.config.scored_joints and set(shoot.config.scored_joints) <= set(names)
    assert [s.config.robot for s in shoots if ":" not in s.config.robot] == ["microwave"]
    assert shoots == list(plan_datasets(9, seed=2))


def test_half_of_the_recipe_is_of_robots_that_are_given(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(
        '<robot name="arm"><link name="a"/><link name="b"/><joint name="turn" type="continuous">'
        '<parent link="a"/><child link="b"/></joint></robot>'
    )
    robots = ("microwave:3", str(file))
    shoots = list(plan_datasets(6, seed=2, robots=robots))
    assert [s.config.robot for s in shoots][::2] == [robots[0], robots[1], robots[0]]
    assert all(s.config.robot.startswith("random:") for s in shoots[1::2])
    assert shoots[2].name == f"{file.stem}-20002"


# -- with PyTorch -----------------------------------------------------------------------------


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason="training needs PyTorch")


def config(folder: Path, out: Path, steps: int) -> FlowTraining:
    return FlowTraining(
        data=(folder,), out=out, held_out=(folder,), steps=steps, batch=2, crop=(48, 48),
        threads=1, every=100, device="cpu", precision="float32",
    )


@pytest.mark.parametrize("instructions", [(), ("avx512_bf16",), ("amx_tile",)])
def test_precision_follows_the_instructions_of_the_cpu(
    torch, monkeypatch: pytest.MonkeyPatch, instructions: tuple[str, ...]
) -> None:
    from gcbench.gcpose.training.task import reduce_precision

    for name in ("avx512_bf16", "amx_tile"):
        monkeypatch.setattr(torch.cpu, f"_is_{name}_supported",
                            lambda name=name: name in instructions, raising=False)
    with reduce_precision(FlowTraining(), torch.device("cpu")):
        product = torch.ones(2, 2) @ torch.ones(2, 2)
    assert product.dtype == (torch.bfloat16 if instructions else torch.float32)


def test_the_loss_is_least_at_the_truth(torch) -> None:
    from gcbench.gcpose.networks.raft import REACH, RaftOutput
    from gcbench.gcpose.training.loss import coarse_flow, flow_loss, part_bias

    sample = draw_sample(shifted(), CROPPED, np.random.default_rng(2))
    flow, part, weight = (torch.from_numpy(x)[None] for x in
                          (sample.flow, sample.part, sample.weight))
    cells, share = coarse_flow(flow, weight)
    assert float(share.sum()) == pytest.approx(1, abs=1e-5)
    n = 2 * REACH + 1
    even = torch.zeros(1, 12, 16, n, n)

    def loss(offset: float) -> float:
        out = RaftOutput([cells + offset / 4], flow + offset, even)
        return float(flow_loss(out, flow, part, weight, 1.0, LossConfig()))

    assert loss(0.0) == pytest.approx(0, abs=1e-4)
    assert loss(1.0) > loss(0.5) > 0.1
    moving = float(weight[part > 0].sum())
    assert float(part_bias(torch.ones_like(flow), part, weight)) == pytest.approx(
        2**0.5 * moving, rel=1e-4)


def test_a_match_is_best_where_the_flow_points(torch) -> None:
    from gcbench.gcpose.networks.raft import REACH
    from gcbench.gcpose.training.loss import correlation_loss

    n = 2 * REACH + 1
    target = torch.tensor([2.0, -1.0])[None, :, None, None].expand(1, 2, 2, 2)
    share = torch.full((1, 2, 2), 0.25)
    right, wrong = torch.zeros(2, 1, 2, 2, n, n)
    right[..., REACH - 1, REACH + 2] = 20.0
    wrong[..., REACH + 2, REACH - 1] = 20.0
    assert float(correlation_loss(right, target, share)) == pytest.approx(0, abs=1e-5)
    assert float(correlation_loss(wrong, target, share)) == pytest.approx(20, abs=0.1)
    assert float(correlation_loss(wrong, 100 * target, share)) == 0


def test_a_run_that_was_stopped_goes_on_as_if_it_had_not_been(
    torch, tmp_path: Path
) -> None:
    from gcbench.gcpose.networks.weights import read_tensors
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    folder = to_learn_from(tmp_path / "d")
    errors = train(FlowTask(config(folder, tmp_path / "whole", 3)))
    assert {"dis", "dis-fine", "raft"} == set(errors[str(folder)])
    log = [json.loads(line) for line in (tmp_path / "whole/log.jsonl").read_text().splitlines()]
    assert log[-1]["step"] == 3 and log[-1]["raft"]["pairs"] > 0

    with pytest.raises(GcbenchError):
        stopped(config(folder, tmp_path / "parts", 3), at=2)
    assert (tmp_path / "parts/checkpoint.safetensors").exists()
    train(FlowTask(config(folder, tmp_path / "parts", 3)))
    whole, parts = (read_tensors(tmp_path / k / "raft.safetensors") for k in ("whole", "parts"))
    for key, value in whole.items():
        torch.testing.assert_close(parts[key], value, msg=key)
    assert not list(tmp_path.glob("*/.*.tmp"))

    (tmp_path / "parts/checkpoint.safetensors").write_bytes(b"\x08" * 64)
    with pytest.raises(GcbenchError, match=r"checkpoint\.safetensors: .*; remove the file to"):
        train(FlowTask(config(folder, tmp_path / "parts", 4)))


def test_weights_of_another_run_can_be_gone_on_from(torch, tmp_path: Path) -> None:
    from gcbench.gcpose.images.raft_network import RAFT_WEIGHTS
    from gcbench.gcpose.networks.weights import read_tensors
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    begun = replace(config(to_learn_from(tmp_path / "d"), tmp_path / "out", 1),
                    start_from=RAFT_WEIGHTS)
    train(FlowTask(begun))
    before, after = read_tensors(RAFT_WEIGHTS), read_tensors(tmp_path / "out/raft.safetensors")
    moved = [float((after[key] - before[key].float()).abs().max()) for key in before]
    assert 0 < max(moved) < 1e-3  # one step at the rate of a beginning
    train(FlowTask(begun))  # a run that is done stays as it is
    with pytest.raises(GcbenchError, match=r"none\.safetensors: there is no such file"):
        train(FlowTask(replace(begun, start_from=tmp_path / "none.safetensors")))


def test_a_run_is_not_continued_with_other_options(torch, tmp_path: Path) -> None:
    """Its weights would say of themselves what is true of the last options only."""
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    folder, other = to_learn_from(tmp_path / "d"), to_learn_from(tmp_path / "e")
    begun = config(folder, tmp_path / "out", 1)
    with pytest.raises(GcbenchError, match="the disk is gone"):
        stopped(replace(begun, seed=9), at=0)  # without a step, nothing is continued
    train(FlowTask(begun))
    weights = (tmp_path / "out/raft.safetensors").read_bytes()
    for changes, said in (({"data": (other,)}, "data: "), ({"seed": 2}, "seed: 1 -> 2"),
                          ({"rate": 0.5}, "rate: "), ({"crop": (64, 48)}, "crop: ")):
        with pytest.raises(GcbenchError, match=f"a run with other options .*{said}.* --out"):
            train(FlowTask(replace(begun, **changes)))
    assert (tmp_path / "out/raft.safetensors").read_bytes() == weights
    free = replace(begun, steps=2, every=7, threads=2, held_out=(other,))
    train(FlowTask(free))
    assert (tmp_path / "out/raft.safetensors").read_bytes() != weights


def test_what_is_also_learned_from_is_told(
    torch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    folder = to_learn_from(tmp_path / "d")
    train(FlowTask(config(folder, tmp_path / "out", 1)))
    assert f"{folder} is also learned from" in capsys.readouterr().err


def test_held_out_data_that_do_not_fit_end_a_run_before_its_first_step(
    torch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    def fails(*_: object) -> None:
        raise GcbenchError("does not fit")

    monkeypatch.setattr(FlowTask, "measure", fails)
    with pytest.raises(GcbenchError, match="does not fit"):
        train(FlowTask(config(to_learn_from(tmp_path / "d"), tmp_path / "out", 3)))
    assert not (tmp_path / "out/checkpoint.safetensors").exists()


def damage_state(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, b"no array" if name == "state.npz" else data)


def test_errors_of_processes_that_prepare_samples_are_one_line(torch, tmp_path: Path) -> None:
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    folder = to_learn_from(tmp_path / "d")
    damage_state(folder / "sequences/000001.zip")  # what is read first is whole
    begun = replace(config(folder, tmp_path / "out", 8), held_out=(), workers=1)
    with pytest.raises(GcbenchError) as error:
        train(FlowTask(begun))
    assert "000001" in str(error.value) and "\n" not in str(error.value)


def test_curves_of_folders_of_one_name_are_apart(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(record) + "\n" for record in (
        {"step": 20, "loss": None},
        *({"step": step, "held_out": f"{name}/held", "raft": {"epe": step + 1.0}}
          for step in (20, 40) for name in ("one", "two")))))
    write_curves(log, tmp_path / "curves.html", "flow")
    page = (tmp_path / "curves.html").read_text()
    assert "epe, one/held" in page and "epe, two/held" in page and page.count("<polyline") == 2


def test_the_command_measures_weights_without_a_step(
    torch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gcbench.gcpose.images.raft_network import RAFT_WEIGHTS

    held, out = to_learn_from(tmp_path / "held"), tmp_path / "out"
    args = (f"train flow --steps 0 --start-from {RAFT_WEIGHTS} --held-out {held} --out {out} "
            "--workers 1")
    assert main(args.split()) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(str(held)) and said[-1] == str(out)
    rows = {line.split()[0]: [float(x) for x in line.split()[1:]] for line in said[2:-1]}
    assert set(rows) == {"dis", "dis-fine", "raft"}
    assert all(len(row) == 7 and min(row) > 0 for row in rows.values())


def test_what_suites_score_on_is_not_learned_from(torch, tmp_path: Path) -> None:
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    with pytest.raises(GcbenchError, match="--stream train"):
        train(FlowTask(config(make_dataset(tmp_path / "d"), tmp_path / "out", 3)))
    assert not (tmp_path / "out").exists()


def stopped(options: FlowTraining, at: int) -> None:
    """Train until a step in which something fails."""
    from gcbench.gcpose.training.flow_task import FlowTask
    from gcbench.gcpose.training.loop import train

    before = Pairs.sample

    def fails(self: Pairs, number: int):
        if number >= at * options.batch:
            raise GcbenchError("the disk is gone")
        return before(self, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Pairs, "sample", fails)
        train(FlowTask(options))


def test_training_lowers_the_loss(torch, tmp_path: Path) -> None:
    """On one sample, learned by heart."""
    from gcbench.gcpose.networks.raft import Raft
    from gcbench.gcpose.training.loss import flow_loss

    torch.manual_seed(0)
    network, sample = Raft(), draw_sample(shifted(), CROPPED, np.random.default_rng(4))
    a, b, flow, part, weight = (torch.from_numpy(x)[None] for x in vars(sample).values())
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3)
    losses: list[float] = []
    for _ in range(25):
        loss = flow_loss(network(a, b, 2), flow, part, weight, 0.0, LossConfig())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.6 * losses[0]


@pytest.mark.parametrize(
    ("args", "said"),
    [
        ([], "train flow"),
        (["flow", "--crop", "100", "100"], "multiples of 16"),
        (["flow", "--data", "nowhere"], "there is no dataset"),
        (["flow", "--device", "abacus"], "cpu works everywhere"),
        (["flow", "--rate", "nan"], "--rate nan: give a number of 0 or more"),
        (["flow", "--max-gradient", "0"], "--max-gradient 0: give a number above 0"),
        (["flow", "--weight-decay", "-1"], "--weight-decay -1: give a number of 0"),
        (["flow", "--workers", "-1"], "--workers -1: give a number of 0 or more"),
        (["flow", "--seed", "-1"], "--seed -1: give a number of 0 or more"),
        (["flow", "--iterations", "0"], "--iterations 0: give a number from 1 to 100"),
        (["flow", "--held-out-pairs", "0"], "--held-out-pairs 0: give a number of 1 or more"),
        (["flow", "--warm-up", "2"], "--warm-up 2: give a number from 0 to 0.99"),
        (["flow", "--out", "s3://b/out"], "--out s3://b/out: only datasets can be in object"),
        (["flow", "--steps", "-1"], "--steps -1: give 0 or more"),
        (["flow", "--loss.bias", "inf"], "--loss.bias inf: give a number of 0 or more"),
        (["flow", "--recipe.texture-probability", "2"], "give a number from 0 to 1"),
        (["foreground", "--noise", "-3", "2"], "--noise -3 2: give a number from 0 to 255"),
        (["people", "--people-probability", "2"], "give a number from 0 to 1"),
        (["craves", "--rotation", "nan"], "--rotation nan: give a number from 0 to 180"),
        (["flow", "--steps", "0"], "name it with --held-out"),
        (["flow", "--steps", "0", "--held-out", "."], "raft has no run to measure"),
    ],
)
def test_wrong_options_are_told_in_one_line(
    torch, args: list[str], said: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *args]) == 2
    assert not list(tmp_path.iterdir())
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


def test_the_rate_goes_up_and_then_down_to_nothing(torch) -> None:
    from gcbench.gcpose.training.flow_task import one_cycle

    rates = [one_cycle(x, 0.05, 0.04) for x in np.linspace(0, 1, 101)]
    assert max(rates) == pytest.approx(1, abs=0.02) and rates[0] < 0.05 and rates[-1] == 0
    peak = int(np.argmax(rates))
    assert rates[: peak + 1] == sorted(rates[: peak + 1])
    assert rates[peak:] == sorted(rates[peak:], reverse=True)
