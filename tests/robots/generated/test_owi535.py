"""The OWI-535 against what is published of it, and fit for use."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.scene.sampling import Streams
from gcbench.robots.catalog import find_robot, load_robot
from gcbench.robots.geometry import apply, inverse
from gcbench.robots.model import ArticulatedModel, forward_kinematics, joint_screws
from gcbench.robots.motion.collision import CollisionChecker

MM = 1e-3
H1, L1, L2, L3 = 67.66 * MM, 89.68 * MM, 113.58 * MM, 75.0 * MM

CRAVES = """
-1 0.8 62.1 -12.2, -1 80.8 1.7 -67.7, -1 -79.2 -2.3 -67.2, -1 0.6 129.9 -6.2,
0 34.4 -26.1 -0.4, 0 55.4 -26.1 -0.5, 0 34.6 25.9 -0.1, 0 55.7 25.9 0.2,
1 -30.2 1.3 0.0, 1 28.3 1.3 17.1, 1 35.3 1.8 -16.9, 1 62.6 1.7 -0.6,
2 72.7 -1.7 13.0, 2 41.8 -1.4 25.7"""
"""The fourteen vertices of its skeleton.json, mm: parent (-1 base, relative to the shoulder; 0
shoulder, 1 elbow, 2 wrist) and offset. Frames are left-handed."""


@pytest.fixture(scope="module")
def model() -> ArticulatedModel:
    return load_robot("owi535")


def configurations(model: ArticulatedModel, n: int = 500) -> np.ndarray:
    return np.random.default_rng(0).uniform(*model.limits.T, (n, len(model.joint_names)))


def test_kinematics_are_the_published_closed_form(model: ArticulatedModel) -> None:
    q = configurations(model)
    poses = forward_kinematics(model, q)
    rot, b, e, w = q[:, :4].T
    r, z = np.zeros(len(q)), np.full(len(q), H1)
    for part, dr, dz in (("forearm", -L1 * np.sin(b), L1 * np.cos(b)),
                         ("hand", L2 * np.cos(b + e), L2 * np.sin(b + e)),
                         ("grasp", L3 * np.cos(b + e + w), L3 * np.sin(b + e + w))):
        r, z = r + dr, z + dz
        at = poses[:, model.part_names.index(part), :3, 3]
        expected = np.stack([r * np.cos(rot), r * np.sin(rot), z], axis=-1)
        assert np.abs(at - expected).max() < 1e-12


def test_joints_are_as_published(model: ArticulatedModel) -> None:
    assert model.joint_names == ("rotation", "base", "elbow", "wrist", "gripper")
    axes = joint_screws(model, forward_kinematics(model, np.zeros(5)))[:4, :3]
    np.testing.assert_allclose(axes, [[0, 0, 1], *[[0, -1, 0]] * 3], atol=1e-15)
    np.testing.assert_allclose(
        np.degrees(model.limits[:4]), [(-130, 130), (-90, 60), (-60, 90), (-45, 45)])
    assert find_robot("owi535").scored == ("rotation", "base", "elbow", "wrist")


def test_keypoints_are_craves(model: ArticulatedModel) -> None:
    """CRAVES' own reconstruction: an offset turned by yaw and by the pitch of its parent."""
    rows = np.array([[float(x) for x in row.split()] for row in CRAVES.split(",")])
    q = configurations(model, 20)
    q[:, 4] = 0.0
    poses = forward_kinematics(model, q)
    found = apply(poses[:, model.keypoint_part], model.keypoint[:, None])[:, :, 0]
    assert len(model.keypoint_names) == len(set(model.keypoint_names)) == 17
    joints = [model.part_names.index(p) for p in ("upper_arm", "forearm", "hand")]
    np.testing.assert_allclose(found[:, :3], poses[:, joints][..., :3, 3], atol=1e-15)
    for t, (rot, b, e, w, _) in enumerate(q):
        yaw = -rot - np.pi / 2  # left-handed, and its arm looks along -y at 0
        pitch = np.pi / 2 + b, b + e, b + e + w  # of the upper arm above the horizon, ...
        for k, (parent, *offset) in enumerate(rows):
            if parent < 0:
                x, y, z = np.array(offset) * MM + [0, 0, H1]
            else:
                c, s, p = np.cos(yaw), np.sin(yaw), pitch[int(parent)]
                turn = np.array([[np.cos(p) * c, -s, -np.sin(p) * c],
                                 [np.cos(p) * s, c, -np.sin(p) * s], [np.sin(p), 0, np.cos(p)]])
                start = found[t, int(parent)]
                x, y, z = turn @ np.array(offset) * MM + [-start[1], -start[0], start[2]]
            np.testing.assert_allclose(found[t, 3 + k], [-y, -x, z], atol=0.1 * MM)


def test_keypoints_lie_on_the_surface(model: ArticulatedModel) -> None:
    """Where an annotator would see them; the joints' centers and the grip have none."""
    poses = forward_kinematics(model, np.zeros(5))
    for name, part, point in zip(
            model.keypoint_names[3:], model.keypoint_part[3:], model.keypoint[3:], strict=True):
        near = [v for v in model.visuals if v.part == part or
                (name == "grip" and "finger" in model.part_names[v.part])]
        at = apply(poses[part], point[None])
        distance = min(abs(float(trimesh.proximity.closest_point(
            trimesh.Trimesh(apply(poses[v.part], v.vertices), v.faces, process=False), at)[1][0]))
            for v in near)
        assert distance < 1.0 * MM, (name, distance)


def test_the_gripper_opens_from_0_to_45_mm(model: ArticulatedModel) -> None:
    q = np.zeros((30, 5))
    q[:, 4] = np.linspace(*model.limits[4], 30)
    poses = forward_kinematics(model, q)
    hand, left, right, inner = (model.part_names.index(p) for p in (
        "hand", "finger_left", "finger_right", "inner_crank_left"))
    np.testing.assert_allclose(poses[:, left, :3, :3], poses[:, hand, :3, :3], atol=1e-15)

    def tip(part: int, side: int) -> np.ndarray:
        """[T] y of the finger's inner face, which is parallel to x and z."""
        y = np.concatenate([v.vertices[:, 1] for v in model.visuals if v.part == part])
        return poses[:, part, 1, 3] + (y.min() if side > 0 else y.max())

    gap = tip(left, 1) - tip(right, -1)
    assert gap[0] == pytest.approx(0, abs=1e-9) and gap[-1] == pytest.approx(45 * MM)
    assert (np.diff(gap) > 0).all()
    end = model.parent_from_part_at_zero[left, :3, 3]  # of each crank, in its frame
    # the inner crank ends at one point of the finger: it is a parallelogram
    moved = inverse(poses[:, left]) @ poses[:, inner] @ np.array([*end, 1])
    np.testing.assert_allclose(moved, moved[:1].repeat(30, 0), atol=1e-15)


def test_it_has_the_products_size(model: ArticulatedModel) -> None:
    base = np.concatenate([v.vertices for v in model.visuals if v.part == 0])
    size = np.ptp(base, axis=0) / MM
    assert size[0] == pytest.approx(228.6, abs=2) and size[1] == pytest.approx(160, abs=3)
    assert base[:, 2].min() == pytest.approx(0, abs=1e-12)  # it stands on the table
    faces = sum(len(v.faces) for v in model.visuals)
    assert 5_000 < faces < 100_000


def test_it_does_not_touch_itself_where_it_is_used(model: ArticulatedModel) -> None:
    checker = CollisionChecker(model)
    assert checker.first_contact(forward_kinematics(model, np.zeros(5))[None], 0.0) is None
    poses = forward_kinematics(model, configurations(model, 200))
    assert checker.groups.ground_height(poses) == pytest.approx(0.0, abs=1e-12)
    free = [checker.first_contact(p[None], 0.0) is None for p in poses]
    assert 0.6 < np.mean(free) < 0.95
    down = forward_kinematics(model, np.radians([0, -90, -60, 0, 0]))
    contact = checker.first_contact(down[None], 0.0)
    assert contact is not None and contact.b == "the ground"


@pytest.mark.gl
def test_sequences_are_found_in_few_draws() -> None:
    renderer = SequenceRenderer(RenderConfig(robot="owi535", seed=11))
    try:
        draws = [renderer._sampler.draw(Streams(renderer.config, i)) for i in range(12)]
        refused = [sum(reasons.values()) for _, reasons in draws]
    finally:
        renderer.close()
    assert np.mean(refused) < 4 and max(refused) < 20
