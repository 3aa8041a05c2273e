"""Angles of an arm and the camera from keypoints in one image, by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ...robots.geometry import Array, apply, pinhole, se3, transform
from ...robots.model import ArticulatedModel, forward_kinematics, joint_screws

_STARTS = 10
_SEED = 4
_UNIT = 1 / 64  # of the residuals: this share of the keypoints' extent
_GOOD = 1.0  # root mean square of residuals that ends the search
_REFINEMENTS = 2  # fits in which keypoints that are far away count less
_LIMIT = 20.0  # residual of an angle 1 rad beyond its limit
_NEAREST = 0.02  # m before the camera
_UPRIGHT = 10.0  # residual of a camera that rolls, or looks up, by 1 rad


@dataclass(frozen=True)
class ArmPose:
    """What is estimated of one image."""

    angles: Array
    """[A] rad, of the joints that move keypoints"""
    cam_from_world: Array
    """[4 4]"""
    residual: float
    """Root mean square of the weighted residuals, in shares 1/64 of the keypoints' extent"""


class ArmFit:
    """Fits a model to its keypoints in images; unknown are its angles and the camera."""

    def __init__(self, model: ArticulatedModel) -> None:
        """`model` has keypoints; other joints than those that move them are at zero."""
        self.model = model
        moves = np.array([model.subtree(int(c))[model.keypoint_part] for c in model.joint_child])
        fixed = ~moves.any(axis=0)
        self.joints: NDArray[np.int64] = np.flatnonzero(moves.any(axis=1))
        """[A] index of each joint that moves keypoints"""
        self._moves = moves[self.joints]
        limits = model.limits[self.joints]
        self._limits = np.where(np.isfinite(limits), limits, [-np.pi, np.pi])
        center = fixed | np.all(np.abs(self.points(np.zeros(len(self.joints)))
                                       - self.points(self._limits.mean(axis=1) + 0.3)) < 1e-9, 1)
        self._rigid: NDArray[np.int64] = np.flatnonzero(center)

    def points(self, angles: Array) -> Array:
        """Return the keypoints [K 3] m in the world."""
        return self._place(angles)[1]

    def screws(self, pose: ArmPose) -> Array:
        """Return the axes [A 6] in the camera frame."""
        return se3.move_screw(pose.cam_from_world, self._place(pose.angles)[0])

    def solve(
        self, pixels: Array, weight: Array, intrinsics: Array, before: ArmPose | None = None,
        camera: Array | None = None,
    ) -> ArmPose:
        """Fit positions [K 2] px with weights [K], first from the pose of the image before.

        `camera` [4 4] is a cam_from_world to start from; it is estimated nonetheless. The best of
        several starts is refined; after a pose before, a good one ends the search.
        """
        used = np.flatnonzero(weight > 0)
        unit = _UNIT * max(float(np.ptp(pixels[used], axis=0).max()), 1.0)
        problem = _Problem(self, pixels[used], np.sqrt(weight[used]), intrinsics, unit, used)
        best: ArmPose | None = None
        cameras = [] if camera is None else [_numbers(camera)]
        cameras += self._static_camera(pixels, weight, intrinsics)
        for start in self._starts(pixels[used], intrinsics, before, cameras):
            x, cost = problem.minimize(start)
            rms = float(np.sqrt(2 * cost / max(float(weight.sum()), 1e-9)))
            if np.isfinite(rms) and (best is None or rms < best.residual):
                best = ArmPose(x[6:], _camera(x), rms)
            if before is not None and best is not None and best.residual < _GOOD:
                break
        assert best is not None
        x = np.concatenate([_numbers(best.cam_from_world), best.angles])
        for _ in range(_REFINEMENTS):
            x, _ = replace(problem, weight=problem.reweight(x)).minimize(x)
        return ArmPose(x[6:], _camera(x), best.residual)

    def _starts(
        self, pixels: Array, intrinsics: Array, before: ArmPose | None, cameras: list[Array]
    ) -> Iterator[Array]:
        """Yield camera and angles [6 + A]: those before, then cameras with random angles."""
        if before is not None:
            yield np.concatenate([_numbers(before.cam_from_world), before.angles])
        rng = np.random.default_rng(_SEED)
        for k in range(_STARTS - (before is not None)):
            angles = rng.uniform(*self._limits.T) if k else np.clip(0.0, *self._limits.T)
            choice = k % (len(cameras) + 1)
            camera = cameras[choice] if choice < len(cameras) else self._random_camera(
                pixels, intrinsics, rng)
            yield np.concatenate([camera, angles])

    def _static_camera(self, pixels: Array, weight: Array, intrinsics: Array) -> list[Array]:
        """The camera [6] from keypoints that no angle moves; none without four of them."""
        used = self._rigid[weight[self._rigid] > 0]
        if len(used) < 4:
            return []
        points = self.points(np.zeros(len(self.joints)))[used]
        found, turn, shift = cv2.solvePnP(points, pixels[used].astype(np.float64), intrinsics, None,
                                          flags=cv2.SOLVEPNP_SQPNP)
        ahead = found and float(shift[2, 0]) > _NEAREST
        return [np.concatenate([turn[:, 0], shift[:, 0]]).astype(np.float64)] if ahead else []

    def _random_camera(self, pixels: Array, intrinsics: Array, rng: np.random.Generator) -> Array:
        """A camera [6] that looks at the arm from above, at the distance that its size tells."""
        azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 1.0)
        ahead = -np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
                           np.sin(elevation)])
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        points = self.points(np.zeros(len(self.joints)))
        size = float(np.ptp(points, axis=0).max())
        distance = intrinsics[0, 0] * size / max(float(np.ptp(pixels, axis=0).max()), 1.0)
        ray = pinhole.pixel_rays(intrinsics, pixels.mean(axis=0))
        return _numbers(transform(rotation, distance * ray - rotation @ points.mean(axis=0)))

    def _place(self, angles: Array) -> tuple[Array, Array]:
        """Axes [A 6] and keypoints [K 3] in the world."""
        q = np.zeros(len(self.model.joint_names))
        q[self.joints] = angles
        parts = forward_kinematics(self.model, q)
        poses = parts[self.model.keypoint_part]
        points = np.einsum("kij,kj->ki", poses[:, :3, :3], self.model.keypoint) + poses[:, :3, 3]
        return joint_screws(self.model, parts)[self.joints], points

    def linearize(self, angles: Array, used: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return keypoints [N 3] in the world and their derivatives [N 3 A]."""
        axes, points = self._place(angles)
        points = points[used]
        speed = np.cross(axes[:, None, :3], points[None]) + axes[:, None, 3:]
        return points, np.moveaxis(speed * self._moves[:, used, None], 0, 2)


@dataclass(frozen=True)
class _Problem:
    """Residuals of camera and angles x [6 + A]: robust ones of N keypoints, and of limits."""

    fit: ArmFit
    pixels: Array
    weight: Array
    intrinsics: Array
    unit: float
    used: NDArray[np.int64]

    def minimize(self, start: Array) -> tuple[Array, float]:
        """Return the unknowns and half of the sum of the squared residuals."""
        found = least_squares(
            self.residuals, start, self.jacobian,  # pyright: ignore[reportArgumentType]
            method="lm", max_nfev=60)
        return found.x, float(found.cost)

    def reweight(self, x: Array) -> Array:
        """Return the weights [N], less where a keypoint is far away (Cauchy's)."""
        points, _ = self.fit.linearize(x[6:], self.used)
        there = replace(self, weight=np.ones(len(self.used)))
        error, _, _ = there._errors(apply(_camera(x), points))
        return self.weight / np.sqrt(1.0 + (error.reshape(-1, 2) ** 2).sum(axis=1))

    def residuals(self, x: Array) -> Array:
        points, _ = self.fit.linearize(x[6:], self.used)
        error, _, _ = self._errors(apply(_camera(x), points))
        return np.concatenate([_soften(error)[0], _LIMIT * self._beyond(x), _lean(x)[0]])

    def jacobian(self, x: Array) -> Array:
        points, moved = self.fit.linearize(x[6:], self.used)
        camera = _camera(x)
        turned = points @ camera[:3, :3].T
        error, slope, free = self._errors(turned + camera[:3, 3])
        by_turn = -se3.hat(turned) @ se3.left_jacobian(x[:3])
        by_shift = np.broadcast_to(np.eye(3), (len(points), 3, 3))
        inner = np.concatenate([by_turn, by_shift, camera[:3, :3] @ moved], axis=2)
        inner[~free, 2] = 0.0
        rows = (slope @ inner).reshape(-1, len(x)) * _soften(error)[1][:, None]
        limits = np.zeros((len(x) - 6, len(x)))
        limits[:, 6:] = np.diag(_LIMIT * (self._beyond(x) != 0))
        lean = np.zeros((2, len(x)))
        lean[:, :3] = _lean(x)[1]
        return np.concatenate([rows, limits, lean])

    def _errors(self, points: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Weighted residuals [2N], derivatives by the points [N 2 3], and whether depth is free."""
        z = np.maximum(points[:, 2], _NEAREST)
        k = self.intrinsics[:2, :2]
        there = points[:, :2] @ k.T / z[:, None]
        scale = self.weight[:, None] / self.unit
        error = scale * (there + self.intrinsics[:2, 2] - self.pixels)
        slope = np.concatenate([np.broadcast_to(k, (len(z), 2, 2)), -there[:, :, None]], axis=2)
        return error.ravel(), slope * (scale / z[:, None])[..., None], points[:, 2] > _NEAREST

    def _beyond(self, x: Array) -> Array:
        """By how much each angle [A] is beyond its limits, rad."""
        low, high = self.fit._limits.T  # pyright: ignore[reportPrivateUsage]
        return np.maximum(x[6:] - high, 0.0) + np.minimum(x[6:] - low, 0.0)


def _soften(error: Array) -> tuple[Array, Array]:
    """Residuals whose squares are 2 (sqrt(1 + e^2) - 1), and their derivatives: far points pull
    less."""
    root = np.sqrt(1.0 + error**2)
    soft = np.sign(error) * np.sqrt(2.0 * error**2 / (1.0 + root))
    return soft, np.sqrt((1.0 + root) / 2.0) / root


def _lean(x: Array) -> tuple[Array, Array]:
    """Robust residuals [2] of a camera that rolls or looks up, and their derivatives [2 3] by its
    rotation vector: among poses that explain the keypoints alike, an upright camera is likelier."""
    up = se3.so3_exp(x[:3])[:, 2]
    slope = -se3.hat(up) @ se3.left_jacobian(x[:3])
    looks_up = up[2] > 0
    lean, by_lean = _soften(_UPRIGHT * np.array([up[0], up[2] * looks_up]))
    return lean, (_UPRIGHT * by_lean)[:, None] * np.stack([slope[0], slope[2] * looks_up])


def _camera(x: Array) -> Array:
    """cam_from_world [4 4] of the first six numbers: rotation vector and position."""
    return transform(se3.so3_exp(x[:3]), x[3:6])


def _numbers(cam_from_world: Array) -> Array:
    """The six numbers of a pose [4 4]."""
    rotation, _ = cv2.Rodrigues(cam_from_world[:3, :3])
    return np.concatenate([rotation[:, 0], cam_from_world[:3, 3]]).astype(np.float64)
