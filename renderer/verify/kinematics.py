"""Checks of `state.npz` and `meta.json`: shapes, kinematics, screws, limits.

Except for the times of an animation, nothing here calls the code that made the truth: motions are
matrix exponentials, and the forward kinematics is written a second time, once from the model's
arrays and once from the model's file (urdf_reader.py, gltf_reader.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ..dataset import image_times, state_shapes
from ..types import Sequence, State
from .animations import DrawnAnimation, drawn_animation
from .checks import CheckResult, check
from .frames import METRES
from .gltf_reader import GltfFrame, read_gltf_frames
from .meta_fields import check_model_fields
from .urdf_reader import UrdfJoint, read_urdf_tree

URDF_FILES, GLTF_FILES = (".urdf",), (".glb", ".gltf")
"""Suffixes of the files that have a second reader here."""
_RADIANS = 1e-6  # rad, bound of angles that only rounding may change


def verify_state(sequence: Sequence, model: ArticulatedModel | None = None,
                 file: Path | None = None, link_names: Mapping[str, str] | None = None,
                 scale: float = 1.0) -> list[CheckResult]:
    """Run all checks that need no image. Poses are compared with the model and its file, if given.

    A file of a format without a second reader is not read.

    `link_names` are the sequence's names of links of a URDF, where they differ; a joint has the
    name of the link that it moves. The lengths of the file are multiplied by `scale`.
    """
    checks = [_shapes(sequence)]
    if not checks[0].ok:
        return checks
    checks.append(_finite(sequence.state))
    if not checks[-1].ok:
        return checks
    checks += _rigid(sequence.state)
    if not all(c.ok for c in checks):
        return checks
    checks.append(_times(sequence.state))
    checks.append(_limits(sequence))
    checks += _screws(sequence)
    names, positions = sequence.meta.joint_names, sequence.state.joint_positions
    drawn = drawn_animation(sequence)
    if model is not None:
        checks.append(check_model_fields(sequence, model, scale))
    if drawn is not None:
        return checks + (_animated_poses(sequence, drawn, model) if model is not None else [])
    if model is not None:
        checks += _poses(sequence, poses_from_model(model, names, positions), "model")
    if file is not None and file.suffix.lower() in GLTF_FILES:
        checks += _poses_at_rest(sequence, file, scale)
    elif file is not None and file.suffix.lower() in URDF_FILES:
        found = poses_from_urdf(file, names, positions, link_names, scale)
        checks += _poses(sequence, found, "URDF")
    return checks


def _shapes(sequence: Sequence) -> CheckResult:
    """Every array of the state, and the length of every stack, against the meta data."""
    meta, s = sequence.meta, sequence.state
    j, p = len(meta.joint_names), len(meta.part_names)
    expected = state_shapes(meta)
    wrong = [k for k, shape in expected.items() if np.shape(getattr(s, k)) != shape]
    lengths = {name: len(times) for name, times in image_times(meta).items()}
    stacks = {k: getattr(sequence, k) for k in lengths}
    wrong += [k for k, n in lengths.items() if stacks[k] is None or len(stacks[k]) != n]
    if len(meta.joint_types) != j or len(meta.joint_limits) != j:
        wrong.append("joint_types, joint_limits")
    if not {*meta.scored_joints} <= {*meta.joint_names}:
        wrong.append("scored_joints")
    wrong += [f"{k} twice" for k in ("joint_names", "part_names", "scored_joints")
              if len({*getattr(meta, k)}) < len(getattr(meta, k))]
    child, parent = s.joint_child_part, s.joint_parent_part
    alien = np.any((child < 1) | (child > p)) or np.any((parent < 0) | (parent > p))
    if not wrong and alien:
        wrong.append("joint_child_part, joint_parent_part")
    return check("shapes", len(wrong), 0, "arrays", ", ".join(wrong),
                 samples=len(expected) + len(lengths) + 3)


def _finite(s: State) -> CheckResult:
    fields = ["times", "joint_positions", "intrinsics", "cam_from_world", "world_from_part",
              "joint_screw"]
    fields += [k for k in ("coordinate_box", "keypoint_world", "track_world")
               if getattr(s, k) is not None]
    bad = [int((~np.isfinite(getattr(s, k))).sum()) for k in fields]
    return check("state finite", bad, 0, "values", lambda i: fields[i],
                 samples=sum(np.size(getattr(s, k)) for k in fields))


def _rigid(s: State) -> list[CheckResult]:
    k = s.intrinsics
    pinhole = {(2, 0): k[2, 0], (2, 1): k[2, 1], (2, 2): k[2, 2] - 1, (1, 0): k[1, 0],
               (0, 0): k[0, 0] <= 0, (1, 1): k[1, 1] <= 0}
    checks = [check("intrinsics pinhole", [*pinhole.values()], 1e-12, "px",
                    lambda i: f"K{[*[*pinhole][i]]}")]
    for name, poses in (("camera", s.cam_from_world[:, None]), ("part", s.world_from_part)):
        r = poses[..., :3, :3]
        residual = np.stack([
            np.abs(np.swapaxes(r, -1, -2) @ r - np.eye(3)).max((-1, -2)),
            np.abs(np.linalg.det(r) - 1),
            np.abs(poses[..., 3, :] - [0, 0, 0, 1]).max(-1)], axis=-1)
        place = _frame_item("part", poses.shape[1])
        checks.append(check(f"{name} poses rigid", residual.max(-1), 1e-9, "", place))
    return checks


def _times(s: State) -> CheckResult:
    return check("times increase", np.diff(s.times) <= 0, 0, "steps", lambda i: f"frame {i + 1}")


def _limits(sequence: Sequence) -> CheckResult:
    q = sequence.state.joint_positions
    limits = np.array([(-np.inf, np.inf) if x is None else x for x in sequence.meta.joint_limits])
    low, high = limits.reshape(-1, 2).T
    over = np.maximum(0, np.maximum(low - q, q - high))
    return check("joint limits", over, 1e-6, "rad|m", _frame_item("joint", q.shape[1]))


def _screws(sequence: Sequence) -> list[CheckResult]:
    """Axes are screws, stand still in both parts they join, and the child moves about them."""
    s = sequence.state
    prismatic = np.array([t == "prismatic" for t in sequence.meta.joint_types], bool)
    direction, m = s.joint_screw[..., :3], s.joint_screw[..., 3:]
    joints = len(prismatic)
    place = _frame_item("joint", joints)
    form = np.abs(np.linalg.norm(direction, axis=-1) - 1) + np.abs(np.sum(direction * m, axis=-1))
    form += np.where(prismatic, np.linalg.norm(m, axis=-1), 0)
    checks = [replace(check("screw form", form, 1e-9, "", place),
                      note="unit direction, perpendicular moment, none if prismatic")]

    world = np.broadcast_to(np.eye(4), (len(s.times), 1, 4, 4))
    parts = np.concatenate([world, s.world_from_part], axis=1)  # part 0: the world
    cam_from_part = s.cam_from_world[:, None] @ parts
    twist = _twist(s.joint_screw, prismatic)
    cam_from_child = cam_from_part[:, s.joint_child_part]
    cam_from_parent = cam_from_part[:, s.joint_parent_part]
    moved = [np.linalg.inv(c) @ twist @ c for c in (cam_from_child, cam_from_parent)]
    fixed = np.max([np.abs(axis - axis[:1]).max((-1, -2)) for axis in moved], axis=0)
    checks.append(check("screw fixed in its parts", fixed, METRES, "rad|m", place))

    parent_from_child = np.linalg.inv(cam_from_parent) @ cam_from_child
    step = np.diff(s.joint_positions, axis=0)[..., None, None]
    predicted = _exp(moved[1][:-1] * step) @ parent_from_child[:-1]
    return checks + _pose_checks("joint moves its child", predicted, parent_from_child[1:], place)


def _poses(sequence: Sequence, expected: dict[str, Array], source: str) -> list[CheckResult]:
    """Stored poses against those of a forward kinematics, both relative to the root part.

    The root itself may stand anywhere; the parts that the other side does not know are counted.
    """
    names, actual = sequence.meta.part_names, sequence.state.world_from_part
    unknown = [n for n in names if n not in expected]
    checks = [check(f"parts known to the {source}", len(unknown), 0, "parts", ", ".join(unknown),
                    samples=len(names))]
    if unknown:
        return checks
    stack = np.stack([expected[n] for n in names], axis=1)
    relative = np.linalg.inv(stack[:, :1]) @ stack
    own = np.linalg.inv(actual[:, :1]) @ actual
    place = _frame_item("part", len(names))
    return checks + _pose_checks(f"poses from the {source}", relative, own, place)


def _animated_poses(
    sequence: Sequence, drawn: DrawnAnimation, model: ArticulatedModel
) -> list[CheckResult]:
    """Stored poses against the model's animation from the time on that was drawn."""
    found = drawn.find(model)
    checks = [check("animation known to the model", found is None, 0, "sequences",
                    f"{drawn.name!r}")]
    if found is None or set(sequence.meta.part_names) != set(model.part_names):
        return checks
    poses = drawn.state(found, sequence.state.times).world_from_part
    expected = {name: poses[:, p] for p, name in enumerate(model.part_names)}
    return checks + _poses(sequence, expected, "animation")


def _poses_at_rest(sequence: Sequence, gltf: Path, scale: float) -> list[CheckResult]:
    """Stored poses, with the joints turned back to zero, against the nodes of a glTF file.

    The file has no joints, so that the motion itself is taken from the stored screws.
    """
    frames, s = read_gltf_frames(gltf), sequence.state
    names = sequence.meta.part_names
    # part 0 is the scene; a part whose name the first reader changed is no node's by its name
    number = {name: p for p, name in enumerate(names) if p and name in frames}
    above = {name: frames[name].parent for name in number}
    pairs = [(p, number.get(above[name], 0)) for name, p in number.items()
             if not above[name] or above[name] in number]
    if not pairs:
        return []
    child, parent = np.array(pairs).T
    parent_from_child = np.linalg.inv(s.world_from_part[:, parent]) @ s.world_from_part[:, child]
    row = {int(p) - 1: i for i, p in enumerate(s.joint_child_part)}
    moved = [(k, row[int(p)]) for k, p in enumerate(child) if int(p) in row]
    for k, j in moved:
        cam_from_parent = s.cam_from_world @ s.world_from_part[:, parent[k]]
        twist = _twist(s.joint_screw[:, j], sequence.meta.joint_types[j] == "prismatic")
        twist = np.linalg.inv(cam_from_parent) @ twist @ cam_from_parent
        back = _exp(-twist * s.joint_positions[:, j, None, None])
        parent_from_child[:, k] = back @ parent_from_child[:, k]
    root = GltfFrame("", np.zeros(3), np.eye(3))
    first = [frames[names[p]] for p in child]
    bases = [frames.get(frame.parent, root) for frame in first]
    expected = np.tile(np.eye(4), (len(pairs), 1, 1))
    back_turn = np.stack([f.rotation.T for f in bases])
    expected[:, :3, :3] = back_turn @ np.stack([f.rotation for f in first])
    apart = np.stack([f.position for f in first]) - np.stack([f.position for f in bases])
    expected[:, :3, 3] = (back_turn @ apart[..., None])[..., 0]
    expected[:, :3, 3] *= _unit(expected[:, :3, 3], parent_from_child[0, :, :3, 3], scale)
    return _pose_checks("rest poses from the glTF file",
                        np.broadcast_to(expected, parent_from_child.shape), parent_from_child,
                        lambda i: f"frame {i // len(pairs)} part {child[i % len(pairs)] + 1}")


def _unit(file: Array, actual: Array, scale: float) -> float:
    """The factor of lengths [N 3]: `scale`, and the power of ten by which a tiny or huge model is
    brought to a usual size."""
    length = float(np.linalg.norm(file) * scale)
    if length < 1e-30:
        return scale
    return scale * 10.0 ** round(np.log10(max(float(np.linalg.norm(actual)), 1e-30) / length))


def poses_from_model(model: ArticulatedModel, joint_names: ArrayLike, positions: Array
                     ) -> dict[str, Array]:
    """root_from_part [T 4 4] of each part name, by matrix exponentials of the model's arrays."""
    column = {str(n): i for i, n in enumerate(np.asarray(joint_names))}
    poses: list[Array] = []
    for p, parent in enumerate(model.parent):
        pose = np.broadcast_to(model.parent_from_part_at_zero[p], (len(positions), 4, 4))
        if model.joint[p] >= 0:
            i = column.get(model.joint_names[model.joint[p]])
            q = positions[:, i] if i is not None else np.zeros(len(positions))
            twist = _twist(model.screw[p], bool(model.prismatic[p]))
            pose = pose @ _exp(twist * (model.multiplier[p] * q + model.offset[p])[:, None, None])
        poses.append(pose if parent < 0 else poses[parent] @ pose)
    return dict(zip(model.part_names, poses, strict=True))


def poses_from_urdf(
    urdf: Path, joint_names: ArrayLike, positions: Array,
    link_names: Mapping[str, str] | None = None, scale: float = 1.0,
) -> dict[str, Array]:
    """Return root_from_link [T 4 4] of each link of a URDF, read by `urdf_reader`.

    Args:
        urdf: The file.
        joint_names: Names of the columns of `positions`. Other movable joints stand at zero.
        positions: [T J] rad or m.
        link_names: The sequence's names of links that it does not call by their own; a joint is
            called like the link that it moves.
        scale: Factor of the lengths of the URDF.
    """
    tree, names = read_urdf_tree(urdf), dict(link_names or {})
    column = {str(n): i for i, n in enumerate(np.asarray(joint_names))}
    poses: dict[str, Array] = {}
    for link in tree.links:
        joint = tree.joint_of_link.get(link)
        if joint is None:
            poses[link] = np.broadcast_to(np.eye(4), (len(positions), 4, 4))
            continue
        leader, multiplier, offset = tree.leader_of(joint)
        i = column.get(names.get(leader.child, leader.name))
        value = positions[:, i] if i is not None else np.zeros(len(positions))
        value = value / scale if leader.kind == "prismatic" else value
        motion = _urdf_motion(joint, multiplier * value + offset)
        poses[link] = poses[joint.parent] @ joint.parent_from_child_at_zero @ motion
    lengths = np.where(np.arange(4) < 3, scale, 1.0)[:, None] ** (np.arange(4) == 3)
    return {names.get(link, link): pose * lengths for link, pose in poses.items()}


def _urdf_motion(joint: UrdfJoint, value: Array) -> Array:
    """[T 4 4] of a joint at values [T] rad or m."""
    from scipy.spatial.transform import Rotation

    out = np.broadcast_to(np.eye(4), (len(value), 4, 4)).copy()
    along = joint.axis * value[:, None]
    if joint.kind in ("revolute", "continuous"):
        out[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
    elif joint.kind == "prismatic":
        out[:, :3, 3] = along
    return out


def _twist(screw: Array, prismatic: Any) -> Array:
    """Velocity matrix [... 4 4] of a screw [... 6]; the exponential of its multiples is motion."""
    straight = np.asarray(prismatic)[..., None]
    w = np.where(straight, 0.0, screw[..., :3])
    v = np.where(straight, screw[..., :3], screw[..., 3:])
    out = np.zeros((*screw.shape[:-1], 4, 4))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., :3, :3] -= np.swapaxes(out[..., :3, :3], -1, -2).copy()
    out[..., :3, 3] = v
    return out


def _exp(twists: Array) -> Array:
    """Matrix exponential [... 4 4]: its series for a 256th of the twist, squared eight times."""
    power = term = np.broadcast_to(np.eye(4), twists.shape)
    for k in range(1, 11):
        term = term @ (twists / 256) / k
        power = power + term
    for _ in range(8):
        power = power @ power
    return power


def _pose_checks(name: str, expected: Array, actual: Array, place: Callable[[int], str]
                 ) -> list[CheckResult]:
    """Distance of positions, and the angle between rotations (exact for small ones)."""
    shift = np.linalg.norm(expected[..., :3, 3] - actual[..., :3, 3], axis=-1)
    turn = np.linalg.norm(expected[..., :3, :3] - actual[..., :3, :3], axis=(-1, -2)) / np.sqrt(2)
    return [check(f"{name}: position", shift, METRES, "m", place),
            check(f"{name}: rotation", turn, _RADIANS, "rad", place)]


def _frame_item(item: str, n: int) -> Callable[[int], str]:
    """The place of a flat index into [T n]; parts count from 1, as in the masks."""
    first = 1 if item == "part" else 0
    return lambda i: f"frame {i // n} {item} {i % n + first}"
