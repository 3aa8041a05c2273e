"""The verifier passes what is right and, one by one, fails what is wrong."""

from __future__ import annotations

import json
import os
import shutil
import signal
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gcbench import GcbenchError, open_dataset
from gcbench.__main__ import main
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.verify import VerifyReport, verify_dataset
from gcbench.renderer.verify.checks import check, check_share, merge_checks
from gcbench.renderer.verify.driver import dataset_checks, verify_sequence
from gcbench.robots.geometry import transform
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ...support import analytic
from ...support.processes import children_of, command_of

MODEL = analytic.arm()


@pytest.fixture(scope="module")
def right():
    return analytic.render()


def state(sequence, **changes):
    """The sequence with arrays of its state changed by functions of them."""
    fields = {k: f(getattr(sequence.state, k).copy()) for k, f in changes.items()}
    return replace(sequence, state=replace(sequence.state, **fields))


def images(sequence, t=None, **changes):
    """The sequence with image stacks changed, in frame t or in all, by functions of an image."""
    stacks = {k: [f(x.copy()) if t in (None, i) else x for i, x in enumerate(getattr(sequence, k))]
              for k, f in changes.items()}
    return replace(sequence, **stacks)


def put(*where, value):
    """A function that adds a value at one place of an array."""
    def change(x):
        x[where] += value
        return x
    return change


def negate(*where):
    def change(x):
        x[where] *= -1
        return x
    return change


def ray_length(sequence):
    k = sequence.state.intrinsics
    v, u = np.mgrid[:sequence.meta.height, :sequence.meta.width]
    ray = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones(u.shape)], axis=-1)
    return (np.round(1e4 * np.linalg.norm(ray, axis=-1)) / 1e4).astype(np.float32)


def occluded_elsewhere(sequence):
    """Visibility as if what hides had been where it is one frame later."""
    return replace(sequence, visibility=[*sequence.visibility[1:], sequence.visibility[-1]])


def meta(sequence, **changes):
    return replace(sequence, meta=replace(sequence.meta, **changes))


def saying(sequence, joint, **changes):
    """Another word on the observability of a joint."""
    block = dict(sequence.meta.observability)
    block["joints"] = {**block["joints"], joint: {**block["joints"][joint], **changes}}
    return meta(sequence, observability=block)


def one_hole(sequence):
    depth = sequence.depth[1].copy()
    v, u = np.argwhere(sequence.part[1] == 0)[100]
    depth[v, u] = 0
    return replace(sequence, depth=[sequence.depth[0], depth, *sequence.depth[2:]])


CORRUPTIONS = {
    "flow scaled": (lambda s: images(s, flow=lambda f: f * np.float32(1.01)), "flow forward"),
    "flow axes swapped": (lambda s: images(s, flow=lambda f: f[..., ::-1]), "flow forward"),
    "flow sign": (lambda s: images(s, flow=lambda f: -f), "there and back"),
    "flow late by a frame": (lambda s: replace(s, flow=[*s.flow[1:], s.flow[0]]), "flow forward"),
    "flow unknown as zero": (lambda s: images(analytic.render(room=False), flow=np.nan_to_num),
                             "flow forward: known where it should be"),
    "flow lacks a pixel": (lambda s: images(s, 1, flow=put(75, 100, value=np.nan)),
                           "flow forward: known where it should be"),
    "flow lacks a component": (lambda s: images(s, 1, flow=put(75, 100, 0, value=np.nan)),
                               "flow forward: known where it should be"),
    "flow of one pixel": (lambda s: images(s, 2, flow=put(75, 100, 0, value=0.05)), "flow forward"),
    "flow truncated, not rounded": (
        lambda s: images(s, flow=lambda f: f - np.float32(1 / 64)), "flow forward"),
    "backward stored as forward": (lambda s: replace(s, flow_backward=s.flow), "flow backward"),
    "backward is negative forward": (
        lambda s: replace(s, flow_backward=[-f for f in s.flow]), "flow backward"),
    "backward shifted by a pixel": (
        lambda s: images(s, flow_backward=lambda f: np.roll(f, 1, axis=1)), "there and back"),
    "principal point half a pixel off": (
        lambda s: state(s, intrinsics=put(slice(2), 2, value=0.5)), "flow forward"),
    "focal length": (lambda s: state(s, intrinsics=put(0, 0, value=2.0)), "flow forward"),
    "no focal length": (lambda s: state(s, intrinsics=lambda k: k * 0), "intrinsics pinhole"),
    "no camera pose": (lambda s: state(s, cam_from_world=lambda x: x * 0), "camera poses rigid"),
    "no part pose": (lambda s: state(s, world_from_part=lambda x: x * 0), "part poses rigid"),
    "scored twice": (lambda s: meta(s, scored_joints=("lift", "lift")), "shapes"),
    "intrinsics of a mirror": (lambda s: state(s, intrinsics=negate(1, 1)), "intrinsics pinhole"),
    "depth is ray length": (
        lambda s: images(s, depth=lambda d: d * ray_length(s)), "flow forward"),
    "depth scaled": (lambda s: images(s, depth=lambda d: d * np.float32(1.02)), "flow forward"),
    "depth off in one frame": (
        lambda s: images(s, 1, depth=lambda d: d + np.float32(2e-3)), "depth where the flow leads"),
    "depth unit wrong": (lambda s: meta(s, depth_unit=1e-5), "depth in range"),
    "depth unit of no length": (lambda s: meta(s, depth_unit=0.0), "depth unit"),
    "depth infinite": (lambda s: images(s, depth=put(3, 4, value=np.inf)), "depth in range"),
    "a hole in the room": (one_hole, "surface where there is a part or room"),
    "a room in one frame only": (
        lambda s: images(s, 1, depth=lambda d: d * (s.part[1] > 0)),
        "background all surface or none"),
    "part numbers off by one": (lambda s: images(s, part=lambda p: p + (p > 0).astype(p.dtype)),
                                "part_pixels"),
    "part numbers off by one, counted so": (
        lambda s: images(state(s, part_pixels=lambda n: np.roll(n, 1, axis=1)),
                         part=lambda p: np.where(p > 0, p % 5 + 1, 0).astype(p.dtype)),
        "flow forward"),
    "part beyond the names": (lambda s: images(s, part=put(5, 5, value=9)),
                              "part numbers in range"),
    "part pixels": (lambda s: state(s, part_pixels=put(2, 1, value=1)), "part_pixels"),
    "image of another size": (lambda s: images(s, 1, rgb=lambda i: i[:-1]), "image shapes"),
    "flow of another size": (lambda s: images(s, 1, flow=lambda i: i[:-1]), "image shapes"),
    "a frame too few": (lambda s: replace(s, visibility=s.visibility[1:]), "shapes"),
    "pose off by 1 mm": (lambda s: state(s, world_from_part=put(1, 4, 0, 3, value=1e-3)),
                         "poses from the model: position"),
    "root pose off by 1 mm": (lambda s: state(s, world_from_part=put(1, 0, 0, 3, value=1e-3)),
                              "poses from the model: position"),
    "pose scaled": (lambda s: state(s, world_from_part=put(1, 2, 0, 0, value=1e-4)),
                    "part poses rigid"),
    "camera mirrored": (lambda s: state(s, cam_from_world=negate(slice(None), 1)),
                        "camera poses rigid"),
    "camera moves": (lambda s: state(s, cam_from_world=put(2, 0, 3, value=1e-3)), "flow forward"),
    "sign of a screw": (lambda s: state(s, joint_screw=negate(slice(None), 1)),
                        "joint moves its child: rotation"),
    "sign of a prismatic screw": (lambda s: state(s, joint_screw=negate(slice(None), 2)),
                                  "joint moves its child: position"),
    "sign of a moment": (
        lambda s: state(s, joint_screw=negate(slice(None), 0, slice(3, None))),
        "joint moves its child: position"),
    "screw of another frame": (lambda s: state(s, joint_screw=lambda x: np.roll(x, 1, axis=0)),
                               "screw fixed in its parts"),
    "screw not of unit length": (lambda s: state(s, joint_screw=lambda x: x * 1.001), "screw form"),
    "prismatic with a moment": (lambda s: state(s, joint_screw=put(1, 2, 4, value=0.1)),
                                "screw form"),
    "positions late by a frame": (
        lambda s: state(s, joint_positions=lambda q: np.roll(q, 1, axis=0)),
        "poses from the model: rotation"),
    "degrees": (lambda s: state(s, joint_positions=np.degrees), "joint limits"),
    "visibility late by a frame": (occluded_elsewhere, "visibility"),
    "visibility all": (lambda s: images(s, visibility=lambda v: (v > 0).astype(v.dtype)),
                       "visibility"),
    "visibility of background": (
        lambda s: images(s, visibility=lambda v: np.maximum(v, 1)), "visibility"),
    "visibility out of the image": (
        lambda s: images(s, visibility=lambda v: np.where(v == 3, 2, v)), "visibility"),
    "NaN in the state": (lambda s: state(s, world_from_part=put(1, 2, 0, 3, value=np.nan)),
                         "state finite"),
    "times stand still": (lambda s: state(s, times=lambda t: t * 0), "times increase"),
    "child numbers from 0": (lambda s: state(s, joint_child_part=lambda c: c - 2), "shapes"),
    "child part of another joint": (lambda s: state(s, joint_child_part=lambda c: c[::-1]),
                                    "joint moves its child: rotation"),
    "observability missing": (lambda s: meta(s, observability={}), "observability present"),
    "observability displacement": (lambda s: saying(s, "pan", displacement=0.5),
                                   "observability: displacement"),
    "observability pixels": (lambda s: saying(s, "lift", pixels=10_000), "observability: pixels"),
    "observability verdict": (lambda s: saying(s, "lift", share=0.1), "observability: verdict"),
}


MODEL_CORRUPTIONS = {
    "type of joint pan": lambda s: meta(s, joint_types=("revolute", "revolute", "prismatic")),
    "limits of joint slide": lambda s: meta(s, joint_limits=(None, (-2.0, 2.0), (-0.1, 9.0))),
    "limits of joint lift": lambda s: meta(s, joint_limits=(None, (-1.9, 2.0), (-0.1, 0.3))),
    "parent part of joint slide": lambda s: state(s, joint_parent_part=lambda p: np.minimum(p, 2)),
    "joint spin": lambda s: meta(s, joint_names=("spin", "lift", "slide"), scored_joints=()),
    "deforming part hand": lambda s: meta(s, deforming_parts=("hand",)),
}


@pytest.mark.parametrize("place", MODEL_CORRUPTIONS)
def test_joints_and_parts_are_those_of_the_model(right, place):
    report = verify_sequence(MODEL_CORRUPTIONS[place](right), MODEL)
    where = {c.name: c.where for c in report.checks if not c.ok}
    assert where["joints and parts of the model"] == place


def test_limits_of_earlier_versions_pass(right):
    """They did not know of a joint that follows another."""
    wider = meta(right, joint_limits=(None, (-2.5, 2.0), (-0.1, 0.3)))
    assert verify_sequence(wider, MODEL).ok


def test_right_sequence_passes(right):
    report = verify_sequence(right, MODEL)
    assert report.ok, report.table()
    samples = {c.name: c.samples for c in report.checks}
    assert samples["flow forward"] > 10_000 and samples["visibility"] > 10_000
    assert samples["there and back"] > 5_000
    assert {int(x) for x in np.unique(right.visibility[0])} == {0, 1, 2, 3}  # a scene with all


@pytest.mark.parametrize("kind", [{"room": False}, {"quantise": False}])
def test_other_right_sequences_pass(kind):
    report = verify_sequence(analytic.render(**kind), MODEL)
    assert report.ok, report.table()


def test_unquantised_truth_has_no_residual():
    report = verify_sequence(analytic.render(quantise=False), MODEL)
    worst = {c.name: c.worst for c in report.checks}
    assert worst["flow forward"] < 1e-5 and worst["flow backward"] < 1e-5
    assert worst["visibility"] == 0
    assert worst["there and back"] < 1e-3


def test_one_frame_is_a_sequence():
    still = analytic.render(frames=1)
    block = {**still.meta.observability, "observable": False, "reason": "displacement"}
    report = verify_sequence(meta(still, observability=block), MODEL)
    assert report.ok, report.table()


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_corruption_fails_its_check(right, name):
    corrupt, expected = CORRUPTIONS[name]
    report = verify_sequence(corrupt(right), MODEL)
    assert expected in report.failures, report.table()


@pytest.mark.parametrize("name", [
    n for n, (_, expected) in CORRUPTIONS.items()
    if not expected.startswith(("poses from the model", "observability: pixels"))])
def test_corruption_fails_without_a_model(right, name):
    corrupt, expected = CORRUPTIONS[name]
    assert expected in verify_sequence(corrupt(right)).failures


def test_a_consistent_lie_about_depth_shows_where_the_flow_leads():
    """Ray lengths taken for depth by everyone agree with each other, but not over time."""
    s = analytic.render(quantise=False)
    s = images(s, depth=lambda d: d * ray_length(s))
    k = s.state.intrinsics
    v, u = np.mgrid[:s.meta.height, :s.meta.width]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(k).T
    cam_from_part = s.state.cam_from_world[:, None] @ s.state.world_from_part
    motion = cam_from_part[1:] @ np.linalg.inv(cam_from_part[:-1])
    flow = []
    for t, move in enumerate(motion):
        per_pixel = np.concatenate([np.eye(4)[None], move])[s.part[t]]
        points = rays * s.depth[t][..., None]
        points = np.einsum("hwij,hwj->hwi", per_pixel[..., :3, :3], points) + per_pixel[..., :3, 3]
        there = points @ k.T
        moved = there[..., :2] / there[..., 2:]
        flow.append((moved - np.stack([u, v], axis=-1)).astype(np.float32))
    report = verify_sequence(replace(s, flow=flow), MODEL)
    assert "flow forward" not in report.failures
    assert "depth where the flow leads" in report.failures, report.table()


def urdf_of(model):
    """The same chain as text; axes that pass beside a part turn a link of their own."""
    text = "".join(f'<link name="{n}"/><link name="{n}_axis"/>' for n in model.part_names)
    for c in range(1, len(model.parent)):
        name, parent = model.part_names[c], model.part_names[model.parent[c]]
        origin, (axis, moment) = model.parent_from_part_at_zero[c], np.split(model.screw[c], 2)
        foot = np.cross(axis, moment)
        to_axis = origin_of(origin @ transform(np.eye(3), foot))
        back = origin_of(transform(np.eye(3), -foot))
        joint, kind = model.joint_names[model.joint[c]], "revolute"
        mimic = (f'<mimic joint="{joint}" multiplier="{model.multiplier[c]}"'
                 f' offset="{model.offset[c]}"/>')
        if c in model.joint_child:
            mimic, kind = "", model.joint_types[model.joint[c]]
        else:
            joint = name
        text += (
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child '
            f'link="{name}_axis"/>{to_axis}<axis xyz="{words(axis)}"/>{mimic}'
            '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
            f'<joint name="{name}_fixed" type="fixed"><parent link="{name}_axis"/><child '
            f'link="{name}"/>{back}</joint>')
    return f'<robot name="arm">{text}</robot>'


def origin_of(pose):
    rpy = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    return f'<origin xyz="{words(pose[:3, 3])}" rpy="{words(rpy)}"/>'


def words(numbers):
    return " ".join(map(str, numbers))


def test_poses_of_another_urdf_or_model_are_not_these(right, tmp_path):
    def found(model):
        urdf = tmp_path / "arm.urdf"
        urdf.write_text(urdf_of(model))
        return verify_sequence(right, file=urdf).failures

    def changed(change):
        return replace(MODEL, parent_from_part_at_zero=change(
            MODEL.parent_from_part_at_zero.copy()))

    other = replace(MODEL, part_names=("base", "turret", "upper", "post", "claw"))
    turned = Rotation.from_rotvec([0, 0, 1e-3]).as_matrix()
    assert not found(MODEL)
    assert "poses from the URDF: position" in found(changed(put(3, 0, 3, value=1e-4)))
    assert "poses from the URDF: rotation" in found(
        changed(lambda x: np.stack([*x[:4], x[4] @ transform(turned, np.zeros(3))])))
    assert "parts known to the URDF" in found(other)
    assert "parts known to the model" in verify_sequence(right, other).failures


@pytest.fixture
def dataset(right, tmp_path):
    """Two sequences on disk."""
    write_provenance(tmp_path, new_provenance(
        RenderConfig(robot="gone.urdf", seed=3, frames=4, width=200, height=150)))
    for index in (0, 1):
        write(tmp_path, right, index)
    return tmp_path


def write(folder, sequence, index, **changes):
    with SequenceWriter(folder, index, sequence.meta.depth_unit) as writer:
        for frame in sequence:
            writer.add(frame)
        changes = {"seed": 3, "index": index, **changes}
        return writer.finish(replace(sequence.meta, **changes), sequence.state)


def test_dataset_on_disk_passes(dataset):
    report = verify_dataset(dataset, progress=False)
    assert report.ok, report.table()
    unfinished, reference = report.warnings
    assert "is not finished (its run has not ended)" in unfinished and "own screws" in reference
    (flow,) = (c for c in report.checks if c.name == "flow forward")
    assert flow.where.startswith("00000") and "frame" in flow.where


def test_an_open_dataset_is_verified_as_its_folder(dataset):
    found = verify_dataset(open_dataset(dataset), progress=False)
    assert found.ok and found == verify_dataset(dataset, progress=False)


def test_one_sequence_alone_or_in_its_dataset(dataset, tmp_path):
    file = dataset / "sequences" / "000001.zip"
    report = verify_dataset(file)
    assert report.ok and "own screws only" in report.warnings[0]
    alone = tmp_path / "elsewhere.zip"
    alone.write_bytes(file.read_bytes())
    report = verify_dataset(alone)
    assert report.ok and report.warnings
    with zipfile.ZipFile(file) as archive:
        archive.extractall(tmp_path / "unpacked")
    assert verify_dataset(tmp_path / "unpacked").ok


def test_some_sequences_of_a_dataset(dataset, right):
    write(dataset, images(right, flow=lambda f: f * np.float32(1.01)), 3)
    assert verify_dataset(dataset, progress=False, sequences="0-1").ok, "2 is missing, 3 is wrong"
    assert "flow forward" in verify_dataset(dataset, progress=False, sequences="3").failures
    one = dataset / "sequences/000000.zip"
    for absent, where in (("2", dataset), ("7-9", dataset), ("0", one)):
        with pytest.raises(GcbenchError, match=r"no sequence|one sequence"):
            verify_dataset(where, progress=False, sequences=absent)


def test_chosen_sequences_are_a_dataset(dataset, right):
    """As `render --sequences` writes it: with gaps, and with its number of sequences."""
    write(dataset, right, 3)
    file = dataset / "dataset.json"
    tree = json.loads(file.read_text())
    for said, ok in ((3, True), (4, False)):
        file.write_text(json.dumps(tree | {"counts": {"sequences": said}}))
        report = verify_dataset(dataset, progress=False)
        assert report.ok == ok == ("no sequence missing" not in report.failures)


def test_leftovers_only_warn(dataset):
    (dataset / "sequences" / ".000002.17.tmp").write_bytes(b"half")
    report = verify_dataset(dataset, progress=False)
    assert report.ok and any(".000002.17.tmp" in w for w in report.warnings)


def test_dataset_failures_are_named(dataset, right, capsys):
    folder = dataset / "sequences"
    write(dataset, images(right, flow=lambda f: f * np.float32(1.01)), 3)
    write(dataset, right, 4, seed=4)
    data = (folder / "000001.zip").read_bytes()
    (folder / "000001.zip").write_bytes(data[: len(data) // 2])
    report = verify_dataset(dataset, progress=False)
    where = {c.name: c.where for c in report.checks if not c.ok}
    assert set(where) >= {"readable", "no sequence missing", "flow forward", "seed and index"}
    assert where["readable"].startswith("000001") and where["flow forward"].startswith("000003")
    assert "000002" in where["no sequence missing"] and where["seed and index"].startswith("000004")
    assert main(["verify", str(dataset), "--workers", "1"]) == 1
    assert "FAIL" in capsys.readouterr().out


@pytest.mark.parametrize("said", [5, None, [], {}, {"name": 3, "start": 0.0}, {"name": "walk"},
                                  {"name": "walk", "start": [1]}])
def test_a_malformed_animation_is_a_failed_check(dataset, right, said):
    meta = replace(right.meta, randomization={**right.meta.randomization, "animation": said})
    write(dataset, replace(right, meta=meta), 1)
    report = verify_dataset(dataset, progress=False)
    assert report.failures == ("readable",)
    where = {c.name: c.where for c in report.checks}["readable"]
    assert where.startswith("000001") and "randomization.animation" in where


def test_a_number_of_many_digits_needs_no_memory():
    names = (("0", "1"), ("0", "3"), ("2", "99999999999"), ("9" * 400,), ())
    for name, missing, first in zip(names, (0, 2, 99999999998, 2**53, 1), "-1000", strict=True):
        found = {c.name: c for c in dataset_checks([Path(f"{n}.zip") for n in name], None)}
        check = found["no sequence missing"]
        assert check.worst == missing
        assert check.where == (f"first: 00000{first}" if missing else "")


def test_sequences_are_counted(dataset):
    said = json.loads((dataset / "dataset.json").read_text())
    said["counts"] = {"sequences": 3}
    (dataset / "dataset.json").write_text(json.dumps(said))
    assert set(verify_dataset(dataset, progress=False).failures) == {"sequences counted"}
    with zipfile.ZipFile(dataset / "sequences/000001.zip") as archive:
        archive.extractall(dataset / "sequences/000001")
    assert "no sequence twice" in verify_dataset(dataset, progress=False).failures
    shutil.rmtree(dataset / "sequences")
    (dataset / "sequences").mkdir()
    assert "sequences present" in verify_dataset(dataset, progress=False).failures


@pytest.mark.parametrize(("field", "change"), [
    ("width", {"width": 64}), ("height", {"height": 48}), ("frames", {"frames": 9}),
    ("layers", {"layers": ["normal"]}), ("omitted", {"flow": "forward"}),
    ("times at 60 fps", {"randomization": {"motion": {"fps": 60}}})])
def test_sequences_are_compared_with_the_configuration(dataset, field, change):
    said = json.loads((dataset / "dataset.json").read_text())
    motion = {**said["config"]["randomization"], **change.get("randomization", {})}
    said["config"] |= {**change, "randomization": motion}
    (dataset / "dataset.json").write_text(json.dumps(said))
    report = verify_dataset(dataset, progress=False)
    where = {c.name: c.where for c in report.checks if not c.ok}
    assert where == {"as dataset.json says": f"000000 {field}"}


def test_counts_are_those_of_the_sequences(dataset):
    file = dataset / "dataset.json"
    said = json.loads(file.read_text())
    right = {"sequences": 2, "frames": 8, "unobservable": 0, "refused": {}}
    wrong = {"frames": 9, "unobservable": 1, "refused": {"collision": 2}}
    for changes in ({}, *({name: value} for name, value in wrong.items())):
        file.write_text(json.dumps(said | {"counts": right | changes}))
        report = verify_dataset(dataset, progress=False)
        where = {c.name: c.where for c in report.checks if not c.ok}
        assert [*where] == ["counts of dataset.json"] * bool(changes)
        assert all(where["counts of dataset.json"].startswith(f"{name}, ") for name in changes)
        assert not any("not finished" in warning for warning in report.warnings)


def test_several_processes_find_the_same(dataset, right):
    for index in range(2, 6):
        write(dataset, right, index)
    alone = verify_dataset(dataset, 1, progress=False)
    assert verify_dataset(dataset, 2, progress=False) == alone
    assert verify_dataset(dataset, 0, progress=False) == alone  # one for each core


def test_a_killed_process_is_one_line(dataset, right):
    for index in range(2, 6):
        write(dataset, right, index)
    with ThreadPoolExecutor(1) as pool:
        report = pool.submit(verify_dataset, dataset, 2, False)
        while not (workers := [p for p in children_of(os.getpid())
                               if b"spawn_main" in command_of(p)]):
            assert not report.done()
        os.kill(workers[0], signal.SIGKILL)
        with pytest.raises(GcbenchError, match="a process that verifies died") as caught:
            report.result()
    assert "\n" not in str(caught.value)


def test_no_dataset_is_an_error_of_the_user(tmp_path):
    with pytest.raises(GcbenchError):
        verify_dataset(tmp_path)


def test_worst_and_mean_survive_merging():
    one = check("x", [1.0, 3.0], 2.0, "px", lambda i: f"one {i}")
    two = check("x", [0.0, 0.0], 2.0, "px", lambda i: f"two {i}")
    (both,) = merge_checks([one, two])
    assert (both.worst, both.mean, both.samples, both.where) == (3.0, 1.0, 4, "one 1")
    assert not both.ok and not VerifyReport((both,)).ok
    assert not check("nan", [np.nan], 1e9, "px").ok
    assert check("nothing", [], 0, "px").ok
    assert check_share("s", [True], 0.5, lambda i: "", samples=4).ok
    table = VerifyReport((both,), ("odd",)).table()
    assert "FAIL" in table and "warning: odd" in table
    assert VerifyReport((both, check("y", 1.0, 2.0, "m"))).worst == both
    assert VerifyReport(()).worst is None


@given(st.data())
def test_a_report_does_not_depend_on_the_order_of_sequences(data):
    """Right or wrong: the same checks fail, at the same worst values and places."""
    found = [[check(name, residual, 1.0, "px", lambda i, k=k: f"sequence {k}")
              for name, residual in sequence]
             for k, sequence in enumerate(data.draw(st.lists(st.lists(
                 st.tuples(st.sampled_from("abc"), st.floats(0, 2) | st.just(np.nan)), max_size=4),
                 max_size=4)))]
    first = VerifyReport(merge_checks(c for s in found for c in s))
    other = VerifyReport(merge_checks(c for s in data.draw(st.permutations(found)) for c in s))
    assert first.ok == other.ok and set(first.failures) == set(other.failures)
    one, two = ({c.name: c for c in report.checks} for report in (first, other))
    assert one.keys() == two.keys()
    for name, result in one.items():
        assert (result.worst, result.samples) == (two[name].worst, two[name].samples)
        assert result.mean == pytest.approx(two[name].mean)
