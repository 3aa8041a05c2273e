"""ICP, the paper's baseline, with known axis directions, depth, parts and optical flow.

Flow and depth give 3D correspondences inside each part. A robust Kabsch alignment of these starts a
trimmed nearest-neighbor ICP to the target's tangent planes. The joint angles are those about the
known axes that best explain the rotations of all parts of the chain together, each weighted by the
information in the part's shape: a cylinder does not show a rotation about its own axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array, apply, inverse, pinhole, se3, transform
from ...robots.motion import ChainAxes, chain_rotations, fit_chain_angles

_MAX_DEPTH_CHANGE = 0.10  # m between two frames; a larger change is not a correspondence
_KEPT = 0.8  # share of the nearest pairs that trimmed ICP keeps
_TUKEY, _ROBUST_ROUNDS = 4.685, 10  # Tukey's constant: 95 % efficiency for Gaussian residuals
_ICP_ROUNDS, _MAX_POINTS = 10, 1500
_MIN_PAIRS = 12
_DAMPING = 1e-3  # of ICP, as a share of the mean information: keeps the start if unobservable
_MAX_CORRECTION = np.radians(15.0)  # of the start; a larger one is a wrong minimum
_SMOOTH = 7  # px, radius within which noisy depth is averaged inside a part
# Standard deviation (m) and number of independent pairs by which flow and surfaces are weighted.
_FLOW_TRUST, _PLANE_TRUST = (0.004, 10.0), (0.002, 100.0)


Segmenter = Callable[[Observation], NDArray[np.uint8] | None]
"""Returns the parts [T H W] of an observation: 0 static, j the link that joint j moves."""


@dataclass(frozen=True)
class Icp:
    """ICP from each frame to the next, accumulated."""

    name: str = "icp"
    version: str = "1"
    training: str = "none"
    inputs: tuple[Inputs, ...] = ("rgbd", "rgbd-noise")
    knowledge: tuple[Knowledge, ...] = ("axes",)
    segment: Segmenter | None = None
    """Finds the parts if the observation does not contain them."""
    to_first: bool = False
    """Align each frame with the first one, which does not drift."""

    def estimate(self, observation: Observation) -> Estimate:
        """Estimate the motion. Raises MethodError without depth, axis directions or parts."""
        if observation.rgb is None or observation.depth is None:
            raise MethodError(f"{self.name} needs RGB and depth")
        axes = observation.axis_direction
        if axes is None:
            raise MethodError(f"{self.name} needs the directions of the axes")
        part = observation.part
        if part is None and self.segment is not None:
            part = self.segment(observation)
        if part is None:
            raise MethodError(f"{self.name} needs the parts, and found none")
        joints, parent = len(axes), observation.parents
        smooth = _SMOOTH if observation.depth_noise > 0 else 0
        frames = [
            LabelledDepth(smooth_depth(z, p, joints, smooth), p, observation.intrinsics)
            for z, p in zip(observation.depth, part, strict=True)
        ]
        prismatic = np.array([kind == "prismatic" for kind in observation.joint_types])
        chain = ChainAxes(axes, prismatic, parent)
        surfaces = [frame.surface(1 + max(1, smooth // 2), joints) for frame in frames]
        origin = np.stack([_center(frames[0].points(j + 1)) for j in range(joints)])
        motion = np.tile(np.eye(4), (len(frames), joints + 1, 1, 1))  # frame t from frame 0
        angle = np.zeros((len(frames), joints))
        for t in range(1, len(frames)):
            flow = _flow(observation, t - 1)
            first = 0 if self.to_first else t - 1
            rotation, information = np.zeros((2, joints, 3, 3))
            for j in range(1, joints + 1):
                matches = correspondences(frames[t - 1], frames[t], flow, j)
                start = motion[t - 1, j] if self.to_first else np.eye(4)
                source, target = surfaces[first][j], surfaces[t][j]
                pose, information[j - 1] = _align(matches, source, target, start)
                motion[t, j] = pose if self.to_first else pose @ motion[t - 1, j]
                rotation[j - 1] = pose[:3, :3]
            since = np.zeros(joints) if self.to_first else angle[t - 1]
            angle[t] = fit_chain_angles(chain, rotation, information, since, angle[t - 1])
            turned = chain_rotations(chain, angle[t])
            for j in range(joints):  # the next frame starts at the rotations of the chain
                motion[t, j + 1] = with_rotation(motion[t, j + 1], turned[j], origin[j])
        shifts = displacements(motion, axes, parent, origin)
        return Estimate(np.where(prismatic, shifts, angle), part=part)


@dataclass(frozen=True)
class IcpFirst(Icp):
    """ICP from the first frame to each."""

    name: str = "icp-first"
    to_first: bool = True


@dataclass(frozen=True)
class LabelledDepth:
    """Depth and parts of one frame of H x W pixels."""

    depth: NDArray[np.float32]
    """[H W] m, 0 = no surface"""
    part: NDArray[np.uint8]
    """[H W] 0 static, j the link that joint j moves"""
    intrinsics: Array
    """[3 3] px"""

    def points(self, j: int) -> Array:
        """[N 3] m, camera frame: the pixels of part j with a depth."""
        v, u = np.nonzero((self.part == j) & (self.depth > 0))
        return pinhole.unproject(self.intrinsics, np.stack([u, v], axis=-1), self.depth[v, u])

    def surface(self, step: int, joints: int) -> dict[int, tuple[Array, Array]]:
        """Points [N 3] m and unit normals [N 3] of each part, where the four neighbors at a
        distance of `step` px belong to the same part."""
        grid = pinhole.pixel_grid(*self.depth.shape)
        cloud = pinhole.unproject(self.intrinsics, grid, self.depth)
        own = np.where(self.depth > 0, self.part, 0)
        inside = np.zeros(own.shape, bool)
        middle = (slice(step, -step), slice(step, -step))
        across = cloud[step:-step, 2 * step :] - cloud[step:-step, : -2 * step]
        down = cloud[2 * step :, step:-step] - cloud[: -2 * step, step:-step]
        around = (
            own[step:-step, 2 * step :], own[step:-step, : -2 * step],
            own[2 * step :, step:-step], own[: -2 * step, step:-step],
        )
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


def _flow(observation: Observation, t: int) -> NDArray[np.float32]:
    """[H W 2] px from frame t to the next: the given flow, or OpenCV's DIS at its finest scale."""
    if observation.flow is not None:
        return observation.flow[t]
    assert observation.rgb is not None
    dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    dis.setFinestScale(0)
    gray = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in observation.rgb[t : t + 2]]
    return np.asarray(dis.calc(gray[0], gray[1], None), np.float32)  # pyright: ignore[reportCallIssue, reportArgumentType]


def _align(
    matches: tuple[Array, Array],
    source: tuple[Array, Array],
    target: tuple[Array, Array],
    start: Array,
) -> tuple[Array, Array]:
    """Return target_from_source [4 4] of a part and the information [3 3] 1/rad^2 on its rotation,
    from correspondences since the frame of `start` and from surfaces (points and normals)."""
    information = np.zeros((3, 3))
    if len(matches[0]) >= _MIN_PAIRS:
        start = robust_kabsch(*matches) @ start
        information += rotation_information(matches[0], None, *_FLOW_TRUST)
    pose, pairs = align_surfaces(source[0], *target, start)
    if pairs is not None:
        information += rotation_information(*pairs, *_PLANE_TRUST)
    return pose, information


def smooth_depth(
    depth: NDArray[np.float32], part: NDArray[np.uint8], joints: int, radius: int
) -> NDArray[np.float32]:
    """Average depth [H W] m over a square inside each moving part; not at all for radius 0."""
    out = depth.copy()
    size = (2 * radius + 1, 2 * radius + 1)
    for j in range(1, joints + 1) if radius else ():
        mask = ((part == j) & (depth > 0)).astype(np.float32)
        total = cv2.boxFilter(depth * mask, -1, size, normalize=False)
        number = cv2.boxFilter(mask, -1, size, normalize=False)
        out = np.where(mask > 0, total / np.maximum(number, 1.0), out)
    return out.astype(np.float32)


def correspondences(
    a: LabelledDepth, b: LabelledDepth, flow: NDArray[np.float32], j: int
) -> tuple[Array, Array]:
    """Return points [N 3] m of part j in frame a, and in frame b by flow and depth.

    Excludes pixels whose flow is unknown, ends in another part or without depth, or changes the
    depth by more than 10 cm.
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
    good = (z > 0) & (b.part[row, column] == j) & (np.abs(z - start) <= _MAX_DEPTH_CHANGE)
    return (
        pinhole.unproject(a.intrinsics, np.stack([u, v], axis=-1)[good], start[good]),
        pinhole.unproject(b.intrinsics, end[good], z[good]),
    )


def kabsch(source: Array, target: Array, weight: Array | None = None) -> Array:
    """Fit target_from_source [4 4] to points [N 3] with weights [N] by least squares.

    W. Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    w = np.full(len(source), 1.0 / len(source)) if weight is None else weight / weight.sum()
    a, b = w @ source, w @ target
    u, _, vt = np.linalg.svd((source - a).T @ ((target - b) * w[:, None]))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    rotation = vt.T @ turn @ u.T
    return transform(rotation, b - rotation @ a)


def robust_kabsch(source: Array, target: Array) -> Array:
    """Fit target_from_source [4 4] with Tukey's biweight, starting at the median translation."""
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
    """Fit target_from_source [4 4] by trimmed nearest-neighbor ICP of points [N 3] from `start`.

    The distance is to the target's tangent plane (unit normals [M 3]): a direction that the shape
    does not determine stays at the start. Returns the pose, and the points and normals that were
    kept last; `start` and None if there are too few points or the correction is too large.
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
        kept = distance <= np.quantile(distance, _KEPT)
        points, normals = moved[kept], normal[np.asarray(nearest)[kept]]
        gap = ((target[np.asarray(nearest)[kept]] - points) * normals).sum(1)
        center = points.mean(0)
        radius = max(float(np.linalg.norm(points - center, axis=1).mean()), 1e-6)
        rows = np.hstack([np.cross((points - center) / radius, normals), normals])
        hessian = rows.T @ rows
        hessian += _DAMPING * np.trace(hessian) / 6.0 * np.eye(6)
        turn, shift = np.split(np.linalg.solve(hessian, rows.T @ gap), 2)
        turn = turn / radius
        rotation = se3.so3_exp(turn)
        pose = transform(rotation, center + shift - rotation @ center) @ pose
        if np.linalg.norm(turn) < 1e-6 and np.linalg.norm(shift) < 1e-7:
            break
    correction = np.linalg.norm(se3.so3_log(pose[:3, :3] @ start[:3, :3].T))
    return (pose, (points, normals)) if correction <= _MAX_CORRECTION else (start, None)


def rotation_information(points: Array, normals: Array | None, sigma: float, pairs: float) -> Array:
    """Return the information [3 3] 1/rad^2 of points [N 3] m on a rotation, translation unknown.

    Each point is known along its normal [N 3] (None: in all directions) with a standard deviation
    of `sigma` m; together they count as `pairs` independent ones.
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
    """Replace the rotation [3 3] of a motion [4 4] that takes `point` [3] to the same place."""
    return transform(rotation, apply(motion, point[None])[0] - rotation @ point)


def displacements(motion: Array, axes: Array, parent: NDArray[np.int64], origin: Array) -> Array:
    """Return the shift [T J] m of each part along its axis, relative to its parent part.

    motion [T J+1 4 4] is that of each part in the camera frame, frame t from frame 0 (part 0 is
    static); axes [J 3] are unit directions and origin [J 3] m points of the parts at frame 0.
    """
    relative = inverse(motion[:, parent + 1]) @ motion[:, 1:]
    moved = np.einsum("tjab,jb->tja", relative[..., :3, :3], origin) + relative[..., :3, 3]
    return ((moved - origin) * axes).sum(-1)


def _center(points: Array) -> Array:
    return points.mean(0) if len(points) else np.zeros(3)
