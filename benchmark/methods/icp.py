"""ICP as the paper describes it, at its best: known axis directions, depth, parts, optical flow.

Flow and depth give 3D correspondences inside each part; one robust Kabsch, then trimmed
nearest-neighbour ICP from there, to the target's tangent planes. The angles are the twists about
the known axes that explain the rotations of all parts along the chain together, each weighted by
what the part's shape tells: a cylinder says nothing of a turn about itself, what hangs on it does.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import GcbenchError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array, apply, inverse, rotation_about, se3, transform
from ...robots.motion import ChainAxes, chain_rotations, fit_chain_angles
from .registry import load

MAX_DEPTH_CHANGE = 0.10
"""m between two frames; a pair with more is no correspondence."""
KEPT = 0.8
"""Share of the nearest pairs that trimmed ICP keeps."""
_TUKEY, _ROBUST_ROUNDS = 4.685, 10
_ICP_ROUNDS, _MAX_POINTS = 10, 1500
_MIN_PAIRS = 12
_DAMPING = 1e-3  # of ICP, as a share of the mean information; holds the start where shape is mute
_MAX_CORRECTION = np.radians(15.0)  # of the start; more is a wrong minimum
_SMOOTH = 7  # px, radius within which noisy depth is averaged inside a part
# How far flow and surfaces are to be believed when rotations are weighted: (m, independent pairs).
_FLOW_TRUST, _PLANE_TRUST = (0.004, 10.0), (0.002, 100.0)


@dataclass(frozen=True)
class Icp:
    """From frame to frame, accumulated."""

    name: str = "icp"
    version: str = "1"
    training: str = "none"
    inputs: tuple[Inputs, ...] = ("rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("axes",)
    segmenter: str = "gcpose"
    """The method, by name, that finds the parts where the observation does not give them."""
    to_first: bool = False
    """Align each frame with the first one, which does not drift."""

    def estimate(self, observation: Observation) -> Estimate:
        """Raises GcbenchError without depth or axis directions."""
        rgb, depth, axes = observation.rgb, observation.depth, observation.axis_direction
        if rgb is None or depth is None or axes is None:
            raise GcbenchError(f"{self.name} needs RGB, depth and the directions of the axes")
        part = observation.part
        if part is None:
            part = load(self.segmenter).estimate(observation).part
            if part is None:
                raise GcbenchError(f"{self.segmenter} found no parts")
        joints, k, parent = len(axes), observation.intrinsics, observation.parents
        smooth = _SMOOTH if observation.depth_noise > 0 else 0
        frames = [
            Frame(smoothed(z, p, joints, smooth), p, k) for z, p in zip(depth, part, strict=True)
        ]
        flows = observation.flow
        prismatic = np.array([kind == "prismatic" for kind in observation.joint_types])
        surfaces = [frame.surface(1 + max(1, smooth // 2), joints) for frame in frames]
        origin = np.stack([_middle(frames[0].points(j + 1)) for j in range(joints)])
        motion = np.tile(np.eye(4), (len(frames), joints + 1, 1, 1))  # frame t from frame 0
        angle = np.zeros((len(frames), joints))
        for t in range(1, len(frames)):
            flow = dis_flow(rgb[t - 1], rgb[t]) if flows is None else flows[t - 1]
            rotation, trust = np.tile(np.eye(3), (joints, 1, 1)), np.zeros((joints, 3, 3))
            for j in range(1, joints + 1):
                source, target = correspondences(frames[t - 1], frames[t], flow, j)
                step = np.eye(4)
                if len(source) >= _MIN_PAIRS:
                    step = robust_kabsch(source, target)
                    trust[j - 1] += rotation_information(source, None, *_FLOW_TRUST)
                first = 0 if self.to_first else t - 1
                start = step @ motion[t - 1, j] if self.to_first else step
                points = surfaces[first][j][0]
                pose, pairs = align_surfaces(points, *surfaces[t][j], start)
                if pairs is not None:
                    trust[j - 1] += rotation_information(*pairs, *_PLANE_TRUST)
                motion[t, j] = pose if self.to_first else pose @ motion[t - 1, j]
                rotation[j - 1] = pose[:3, :3]
            since = np.zeros(joints) if self.to_first else angle[t - 1]
            chain = ChainAxes(axes, prismatic, parent)
            angle[t] = fit_chain_angles(chain, rotation, trust, since, angle[t - 1])
            turned = chain_rotations(chain, angle[t])
            for j in range(joints):  # the next frame starts where the chain says
                motion[t, j + 1] = with_rotation(motion[t, j + 1], turned[j], origin[j])
        shifts = displacements(motion, axes, parent, origin)
        return Estimate(np.where(prismatic, shifts, angle), part=part)


@dataclass(frozen=True)
class IcpFirst(Icp):
    """From the first frame to each."""

    name: str = "icp-first"
    to_first: bool = True


@dataclass(frozen=True)
class Frame:
    """One instant. H x W pixels."""

    depth: NDArray[np.float32]
    """[H W] m, 0 = no surface"""
    part: NDArray[np.uint8]
    """[H W] 0 still, j what joint j is the last to move"""
    intrinsics: Array
    """[3 3]"""

    def points(self, j: int) -> Array:
        """[N 3] m, camera frame: the pixels of part j that have a depth."""
        v, u = np.nonzero((self.part == j) & (self.depth > 0))
        return lift(self.intrinsics, u, v, self.depth[v, u])

    def surface(self, step: int, joints: int) -> dict[int, tuple[Array, Array]]:
        """Points [N 3] m and unit normals [N 3] of each part, where its pixels `step` px away in
        all four directions are of it."""
        height, width = self.depth.shape
        v, u = np.mgrid[:height, :width]
        cloud = lift(self.intrinsics, u.ravel(), v.ravel(), self.depth.ravel())
        cloud = cloud.reshape(height, width, 3)
        own = np.where(self.depth > 0, self.part, 0)
        inside = np.zeros(own.shape, bool)
        middle = (slice(step, -step), slice(step, -step))
        across = cloud[step:-step, 2 * step :] - cloud[step:-step, : -2 * step]
        down = cloud[2 * step :, step:-step] - cloud[: -2 * step, step:-step]
        around = (
            own[step:-step, 2 * step :], own[step:-step, : -2 * step],
            own[2 * step :, step:-step], own[: -2 * step, step:-step],
        )  # fmt: skip
        inside[middle] = np.all([other == own[middle] for other in around], axis=0)
        normal = np.zeros_like(cloud)
        normal[middle] = np.cross(down, across)
        length = np.linalg.norm(normal, axis=2)
        inside &= (own > 0) & (length > 0)
        normal[inside] /= length[inside][:, None]
        return {
            j: (cloud[inside & (own == j)], normal[inside & (own == j)])
            for j in range(1, joints + 1)
        }


def smoothed(
    depth: NDArray[np.float32], part: NDArray[np.uint8], joints: int, radius: int
) -> NDArray[np.float32]:
    """Depth [H W] m averaged over a square inside each moving part; as it is for radius 0."""
    out = depth.copy()
    size = (2 * radius + 1, 2 * radius + 1)
    for j in range(1, joints + 1) if radius else ():
        mask = ((part == j) & (depth > 0)).astype(np.float32)
        total = cv2.boxFilter(depth * mask, -1, size, normalize=False)
        number = cv2.boxFilter(mask, -1, size, normalize=False)
        out = np.where(mask > 0, total / np.maximum(number, 1.0), out)
    return out.astype(np.float32)


def lift(
    intrinsics: Array, u: NDArray[np.generic], v: NDArray[np.generic], z: NDArray[np.generic]
) -> Array:
    """[N 3] m points in the camera frame of pixels (u, v) at depth z, each [N]."""
    pixel = np.stack([u, v, np.ones(len(z))], axis=1).astype(np.float64)
    return pixel @ np.linalg.inv(intrinsics).T * np.asarray(z, np.float64)[:, None]


def dis_flow(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """[H W 2] px from image a to b [H W 3], by OpenCV's DIS at its finest scale."""
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(0)
    gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (a, b)]
    return np.asarray(dis.calc(gray[0], gray[1], None), np.float32)  # pyright: ignore[reportCallIssue, reportArgumentType]


def correspondences(a: Frame, b: Frame, flow: NDArray[np.float32], j: int) -> tuple[Array, Array]:
    """Points [N 3] m of part j in frame a and where flow and depth see them in frame b.

    Left out: unknown flow, another part or no depth where it ends, |dZ| over 10 cm.
    """
    v, u = np.nonzero((a.part == j) & (a.depth > 0))
    du, dv = flow[v, u, 0], flow[v, u, 1]
    known = np.isfinite(du) & np.isfinite(dv)
    u, v, du, dv = u[known], v[known], du[known], dv[known]
    end = np.stack([u + du, v + dv], axis=1).astype(np.float64)
    column, row = np.round(end).astype(np.int64).T
    height, width = b.depth.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    u, v, end, column, row = u[inside], v[inside], end[inside], column[inside], row[inside]
    z = b.depth[row, column]
    start = a.depth[v, u]
    good = (z > 0) & (b.part[row, column] == j) & (np.abs(z - start) <= MAX_DEPTH_CHANGE)
    return (
        lift(a.intrinsics, u[good], v[good], start[good]),
        lift(b.intrinsics, end[good, 0], end[good, 1], z[good]),
    )


def kabsch(source: Array, target: Array, weight: Array | None = None) -> Array:
    """target_from_source [4 4] of least squares, from points [N 3] and weights [N]."""
    w = np.full(len(source), 1.0 / len(source)) if weight is None else weight / weight.sum()
    a, b = w @ source, w @ target
    u, _, vt = np.linalg.svd((source - a).T @ ((target - b) * w[:, None]))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ turn @ u.T
    return transform(rotation, b - rotation @ a)


def robust_kabsch(source: Array, target: Array) -> Array:
    """target_from_source [4 4] with Tukey's weights, from a median start; outliers have none."""
    pose = transform(None, np.median(target - source, axis=0))
    for _ in range(_ROBUST_ROUNDS):
        residual = np.linalg.norm(apply(pose, source) - target, axis=1)
        scale = _TUKEY * max(1.4826 * float(np.median(residual)), 1e-6)
        weight = np.clip(1.0 - (residual / scale) ** 2, 0.0, None) ** 2
        if np.count_nonzero(weight) < _MIN_PAIRS:
            break
        pose = kabsch(source, target, weight)
    return pose


def align_surfaces(
    source: Array, target: Array, normal: Array, start: Array
) -> tuple[Array, tuple[Array, Array] | None]:
    """target_from_source [4 4] by trimmed nearest-neighbour ICP of points [N 3] from `start`.

    The distance is to the target's tangent plane (unit normals [M 3]): surfaces slide along each
    other, and where the shape does not tell, the start stays. Also the points and normals that
    were kept in the end, None if there are too few or it went astray, so that the start stays.
    """
    if min(len(source), len(target)) < _MIN_PAIRS:
        return start, None
    if len(source) > _MAX_POINTS:
        source = source[np.linspace(0, len(source) - 1, _MAX_POINTS).astype(np.int64)]
    tree, pose = KDTree(target), start
    points, normals = target[:0], normal[:0]
    for _ in range(_ICP_ROUNDS):
        moved = apply(pose, source)
        distance, nearest = tree.query(moved)
        kept = distance <= np.quantile(distance, KEPT)
        points, normals = moved[kept], normal[np.asarray(nearest)[kept]]
        gap = ((target[np.asarray(nearest)[kept]] - points) * normals).sum(1)
        center = points.mean(0)
        radius = max(float(np.linalg.norm(points - center, axis=1).mean()), 1e-6)
        rows = np.hstack([np.cross((points - center) / radius, normals), normals])
        hessian = rows.T @ rows
        hessian += _DAMPING * np.trace(hessian) / 6.0 * np.eye(6)
        turn, shift = np.split(np.linalg.solve(hessian, rows.T @ gap), 2)
        turn = turn / radius
        rotation = exponential(turn)
        pose = transform(rotation, center + shift - rotation @ center) @ pose
        if np.linalg.norm(turn) < 1e-6 and np.linalg.norm(shift) < 1e-7:
            break
    correction = np.linalg.norm(se3.so3_log(pose[:3, :3] @ start[:3, :3].T))
    return (pose, (points, normals)) if correction <= _MAX_CORRECTION else (start, None)


def rotation_information(points: Array, normals: Array | None, sigma: float, pairs: float) -> Array:
    """[3 3] 1/rad^2: what points [N 3] m say of a rotation, the shift being unknown.

    Each says where it is along its normal [N 3] (None: in all directions) to `sigma` m; all
    together they are worth so many independent ones.
    """
    p = points - points.mean(0)
    if normals is None:
        information = (p * p).sum() * np.eye(3) - p.T @ p
    else:
        lever = np.cross(p, normals)
        both = lever.T @ normals
        information = lever.T @ lever - both @ np.linalg.pinv(normals.T @ normals, 1e-6) @ both.T
    return information * (pairs / len(points) / sigma**2)


def with_rotation(motion: Array, rotation: Array, point: Array) -> Array:
    """[4 4] the motion with another rotation [3 3], that takes `point` [3] to the same place."""
    return transform(rotation, apply(motion, point[None])[0] - rotation @ point)


def displacements(
    motion: Array, axes: Array, parent: NDArray[np.int64], origin: Array
) -> Array:
    """[T J] m: shift of each part along its axis, relative to the part that carries it.

    motion [T J+1 4 4] in the camera frame, frame t from frame 0, of each part (0 is still); axes
    [J 3] unit directions and origin [J 3] m a point of each part, at frame 0.
    """
    relative = inverse(motion[:, parent + 1]) @ motion[:, 1:]
    moved = np.einsum("tjab,jb->tja", relative[..., :3, :3], origin) + relative[..., :3, 3]
    return ((moved - origin) * axes).sum(-1)


def exponential(turn: Array) -> Array:
    """Rotation [3 3] of a rotation vector [3] rad."""
    angle = float(np.linalg.norm(turn))
    return rotation_about(turn / angle, angle) if angle > 1e-12 else np.eye(3)


def _middle(points: Array) -> Array:
    return points.mean(0) if len(points) else np.zeros(3)
