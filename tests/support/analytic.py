"""A small exact renderer of boxes and spheres: an independent truth for tests of the verifier.

Rays are cut with the shapes in closed form; flow comes from the hit points in 3D; visibility from
its definition, pixel by pixel. Nothing of the package's renderer is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gcbench.renderer.types.camera import intrinsics_from_fov, look_at
from gcbench.renderer.types.sequence import Meta, Sequence, State
from gcbench.robots.geometry import inverse, rotation_from_rpy, transform
from gcbench.robots.model import ArticulatedModel, Joint, JointType, Link, Mimic, forward_kinematics


@dataclass(frozen=True)
class Shape:
    """A box with half sizes, or a sphere whose radius is the first of them, in a part's frame."""

    part: int
    center: tuple[float, float, float]
    half: tuple[float, float, float]
    sphere: bool = False


SHAPES = (
    Shape(0, (0, 0, 0.05), (0.25, 0.25, 0.05)),
    Shape(1, (0.15, 0, 0.12), (0.28, 0.09, 0.12)),
    Shape(2, (0.2, 0, 0), (0.25, 0.06, 0.06)),
    Shape(2, (0.35, 0.02, 0.1), (0.09, 0, 0), sphere=True),
    Shape(3, (0, 0, 0.1), (0.05, 0.05, 0.16)),
    Shape(4, (0, 0, 0.22), (0.08, 0.03, 0.05)),
)


def arm() -> ArticulatedModel:
    """A base, a turret, an upper arm, a sliding post and a mimic hand: every kind of joint."""
    def joint(name, joint_type, direction, point=(0, 0, 0), **others):
        return Joint(name, joint_type, direction / np.linalg.norm(direction), point, **others)

    at_zero = transform(
        rotation_from_rpy([[0, 0, 0], [0, 0, 0.3], [0.1, -0.4, 0], [0.2, 0.3, 0.1], [0, 0.1, 0]]),
        [[0, 0, 0], [0, 0, 0.1], [0.3, 0, 0.26], [0.42, 0, 0.02], [0, 0, 0.06]])
    joints = [
        Joint(),
        joint("pan", JointType.CONTINUOUS, [0, 0, 1], [0.02, 0.01, 0]),
        joint("lift", JointType.REVOLUTE, [0.1, 1, 0], [0, 0, 0.03], limits=(-2, 2)),
        joint("slide", JointType.PRISMATIC, [0, 0.2, 1], limits=(-0.1, 0.3)),
        joint("wave", JointType.REVOLUTE, [0, 0, 1], [0.01, 0, 0], mimic=Mimic("lift", -1.5, 0.2)),
    ]
    names = ("base", "turret", "upper", "post", "hand")
    return ArticulatedModel.from_links(
        "arm", [Link(*link) for link in zip(names, (None, *names), at_zero, joints, strict=False)])


def render(width=200, height=150, frames=4, room=True, quantise=True) -> Sequence:
    """The arm in motion. `room`: a sphere of 2 m around it, else no background surface."""
    model = arm()
    time = np.arange(frames)[:, None]
    q = np.array([0.4, -0.3, 0.02]) + time * np.array([0.1, -0.08, 0.02])
    poses = forward_kinematics(model, q)
    k = intrinsics_from_fov(width, height, np.radians(40))
    cam_from_world = inverse(look_at([1.2, 0.8, 0.8], [0.3, 0.1, 0.36], 0.1))
    unit = 1e-4
    depth, part, hits = zip(*(_cast(k, cam_from_world, p, width, height, room) for p in poses),
                            strict=True)
    flows, backs, seen = [], [], []
    for t in range(frames - 1):
        f, z = _flow(k, cam_from_world, hits[t], part[t], poses[t], poses[t + 1])
        flows.append(f)
        seen.append(_visible(f, z, part[t], depth[t + 1], part[t + 1], unit))
        backs.append(_flow(k, cam_from_world, hits[t + 1], part[t + 1], poses[t + 1], poses[t])[0])
    if quantise:
        depth = tuple(np.round(d / unit) * unit for d in depth)
        flows, backs = ([np.round(f * 64) / 64 for f in x] for x in (flows, backs))
    state = State(
        times=np.arange(frames) / 30, joint_positions=q, intrinsics=k,
        cam_from_world=np.broadcast_to(cam_from_world, (frames, 4, 4)).copy(),
        world_from_part=poses, joint_screw=_screws(model, cam_from_world @ poses),
        joint_parent_part=np.array([1, 2, 3]), joint_child_part=np.array([2, 3, 4]),
        part_pixels=np.stack([np.bincount(p.ravel(), minlength=6)[1:] for p in part]))
    meta = Meta(
        name="000000", asset={}, joint_names=model.joint_names, joint_types=model.joint_types,
        joint_limits=(None, (-2.0, 2.0), (-0.1, 0.3)), part_names=model.part_names,
        scored_joints=("pan", "lift"), width=width, height=height, frames=frames, seed=0, index=0,
        randomization={}, renderer={}, depth_unit=unit,
        observability=_observability(q, state.part_pixels))

    def images(found, dtype, *channels):
        return np.array(found, dtype).reshape(len(found), height, width, *channels)

    return Sequence(
        meta=meta, state=state, rgb=np.zeros((frames, height, width, 3), np.uint8),
        depth=images(depth, np.float32), part=images(part, np.uint16),
        flow=images(flows, np.float32, 2), flow_backward=images(backs, np.float32, 2),
        visibility=images(seen, np.uint8))


def _observability(q, pixels):
    moved = {"pan": [1, 2, 3, 4], "lift": [2, 3, 4]}
    joints = {n: {"displacement": float(q[-1, j] - q[0, j]), "share": 0.8, "motion": 2.0,
                  "pixels": int(pixels[:, moved[n]].sum(1).min())} for j, n in enumerate(moved)}
    return {"observable": True, "reason": "", "refused": {}, "joints": joints}


def _screws(model, cam_from_part):
    out = np.zeros((len(cam_from_part), len(model.joint_child), 6))
    for j, c in enumerate(model.joint_child):
        axis, moment = model.screw[c, :3], model.screw[c, 3:]
        for t, pose in enumerate(cam_from_part[:, c]):
            direction = pose[:3, :3] @ axis
            point = pose[:3, :3] @ np.cross(axis, moment) + pose[:3, 3]
            turning = not model.prismatic[c]
            out[t, j] = [*direction, *(np.cross(point, direction) * turning)]
    return out


def _cast(k, cam_from_world, poses, width, height, room):
    """Depth [H W], part [H W], hit points in the world [H W 3] of the rays of pixel centers."""
    v, u = np.mgrid[:height, :width].astype(float)
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], axis=-1)
    world_from_cam = np.linalg.inv(cam_from_world)
    d, o = rays @ world_from_cam[:3, :3].T, world_from_cam[:3, 3]  # z = 1: the parameter is depth
    depth, part = np.full(u.shape, np.inf), np.zeros(u.shape, int)
    if room:
        b, c = (d @ o), o @ o - 4.0
        a = (d * d).sum(-1)
        depth = (-b + np.sqrt(b * b - a * c)) / a
    for shape in SHAPES:
        inv = np.linalg.inv(poses[shape.part])
        po = inv[:3, :3] @ o + inv[:3, 3] - shape.center
        pd = d @ inv[:3, :3].T
        with np.errstate(all="ignore"):
            if shape.sphere:
                a, b, c = (pd * pd).sum(-1), pd @ po, po @ po - shape.half[0] ** 2
                hit = (-b - np.sqrt(b * b - a * c)) / a
            else:
                t0, t1 = (-np.array(shape.half) - po) / pd, (np.array(shape.half) - po) / pd
                near, far = np.minimum(t0, t1).max(-1), np.maximum(t0, t1).min(-1)
                hit = np.where(near < far, near, np.nan)
        first = hit < depth
        depth[first], part[first] = hit[first], shape.part + 1
    depth[np.isinf(depth)] = 0
    return depth, part, o + d * depth[..., None]


def _flow(k, cam_from_world, hits, part, poses, other):
    """Flow [H W 2] (NaN without a surface) and depth [H W] of the moved hit points."""
    moved = hits.copy()
    for p in range(len(poses)):
        on = part == p + 1
        in_part = (hits[on] - poses[p, :3, 3]) @ poses[p, :3, :3]
        moved[on] = in_part @ other[p, :3, :3].T + other[p, :3, 3]
    cam = moved @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    height, width = part.shape
    v, u = np.mgrid[:height, :width]
    with np.errstate(all="ignore"):
        flow = np.stack([k[0, 0] * cam[..., 0] / cam[..., 2] + k[0, 2] - u,
                         k[1, 1] * cam[..., 1] / cam[..., 2] + k[1, 2] - v], axis=-1)
    eye = np.linalg.inv(cam_from_world)[:3, 3]
    flow[np.linalg.norm(hits - eye, axis=-1) < 1e-9] = np.nan
    return flow, cam[..., 2]


def _visible(flow, z, part, depth_next, part_next, unit):
    height, width = part.shape
    out = np.zeros(part.shape, np.uint8)
    for v, u in np.argwhere(part > 0):
        x, y = u + flow[v, u, 0], v + flow[v, u, 1]
        if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
            out[v, u] = 3
            continue
        around = [(j, i) for j in (int(np.floor(y)), int(np.floor(y)) + 1)
                  for i in (int(np.floor(x)), int(np.floor(x)) + 1)
                  if 0 <= j < height and 0 <= i < width and part_next[j, i] == part[v, u]]
        depths = [depth_next[c] for c in around]
        tol = max(2 * unit, 0.002 * z[v, u])
        out[v, u] = 1 if depths and min(depths) - tol <= z[v, u] <= max(depths) + tol else 2
    return out
