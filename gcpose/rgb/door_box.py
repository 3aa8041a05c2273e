"""A door as a flat box, and how its outline fits the seen one.

Where one of two faces that meet at an edge is seen and the other is not, the edge is on the
outline. So both faces of the box, which turn together, are compared with the outline of the
foreground in all frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares
from scipy.sparse import csr_array, eye_array, hstack, kron, vstack

from ...robots.geometry import Array, pinhole, se3
from ..images import VideoEvidence
from ..numerics import Image
from .settings import RgbSettings

NEAREST = 0.15  # of a place, in units of the distance
UNKNOWNS = 4
"""Of a box: the angles of the hinge and of the plane around the axis' direction, the thickness, and
the hinge's distance from the plane; the turns [T] since frame `first` follow."""
_FIXED = 1e5  # weight of an unknown that is known
_SIZES = (0.05, 0.1, 0.02, 0.02)  # typical changes of the unknowns
_TURN = 0.05  # the same of a turn
_FAR = 1e4  # px; no place counts as farther outside
_NEAR_ZERO = 1e-6


@dataclass(frozen=True)
class SeenOutline:
    """The outline of the foreground in T frames of h x w pixels, and a door's axis."""

    intrinsics: Array
    axis: Array
    """[3] direction"""
    first: int
    """The frame that shows most of the door"""
    pixel: Array
    """[N 2] in order around the foreground of that frame"""
    away: Image
    """[T h w] distance from the outline, px, negative inside; the image's border is no outline"""
    area: Array
    """[T] of the foreground, px^2"""
    meets_border: NDArray[np.bool_]
    """[T 4] whether the foreground is cut off on the left, right, top and bottom"""

    @cached_property
    def ray(self) -> Array:
        """[N 3] at depth 1."""
        return pinhole.pixel_rays(self.intrinsics, self.pixel)

    @cached_property
    def across(self) -> tuple[Array, Array]:
        """Two directions [3] at right angles to the axis, the first toward the door."""
        middle = self.ray.mean(axis=0)
        one = middle - self.axis * (self.axis @ middle)
        one = one / max(1e-9, float(np.linalg.norm(one)))
        return one, np.asarray(np.cross(self.axis, one), np.float64)

    @cached_property
    def length(self) -> float:
        """Of the outline in frame `first`, px."""
        return float(np.linalg.norm(self.pixel - np.roll(self.pixel, 1, axis=0), axis=1).sum())

    @cached_property
    def is_cut_in(self) -> NDArray[np.bool_]:
        """[T] whether a border cuts the foreground off."""
        return np.asarray(self.meets_border.any(axis=1))

    @cached_property
    def borders(self) -> NDArray[np.bool_]:
        """[4] which borders cut the foreground off in some frame."""
        return np.asarray(self.meets_border.any(axis=0))

    def direction(self, angle: float) -> Array:
        """Return a direction [3] at right angles to the axis."""
        one, other = self.across
        return np.asarray(np.cos(angle) * one + np.sin(angle) * other, np.float64)

    def angle(self, place: Array) -> Array:
        """Return the angles [...] of places [... 3] around the axis through the camera."""
        one, other = self.across
        return np.arctan2(place @ other, place @ one)

    def is_cut(self, u: Array, v: Array) -> NDArray[np.bool_]:
        """Return whether places are beyond a border that cuts the foreground off."""
        height, width = self.away.shape[1:]
        left, right, top, bottom = self.borders
        return ((u <= 0) & left) | ((u >= width - 1) & right) | (
            (v <= 0) & top) | ((v >= height - 1) & bottom)


def see_outline(
    video: VideoEvidence, axis: Array, settings: RgbSettings
) -> SeenOutline | None:
    """Return the outline that a video shows of a door about a direction [3]; None where hardly
    anything moves. The door is seen best where its foreground is largest and not cut off."""
    moving = video.moving.astype(np.uint8)
    area = video.moving.sum(axis=(1, 2)).astype(np.float64)
    border = np.stack([video.moving[:, :, 0].any(axis=1), video.moving[:, :, -1].any(axis=1),
                       video.moving[:, 0].any(axis=1), video.moving[:, -1].any(axis=1)], axis=1)
    whole = ~border.any(axis=1)
    first = int(np.where(whole | ~whole.any(), area, -1.0).argmax())
    contours, _ = cv2.findContours(moving[first], cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    line = max(contours, key=cv2.contourArea, default=np.zeros((0, 1, 2)))[:, 0].astype(np.float64)
    if len(line) < settings.min_points:
        return None
    line = np.concatenate([line, line[:1]])
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()])
    at = np.linspace(0, along[-1], settings.outline_points, endpoint=False)
    pixel = np.stack([np.interp(at, along, line[:, k]) for k in range(2)], axis=1)
    away = [np.where(image > 0, 0.5 - np.asarray(cv2.distanceTransform(image, cv2.DIST_L2, 5)),
                     np.asarray(cv2.distanceTransform(1 - image, cv2.DIST_L2, 5)) - 0.5)
            for image in moving]
    return SeenOutline(video.intrinsics, axis, first, pixel,
                        np.stack(away).astype(np.float32), area, border)


def robust_sum(residuals: Array, settings: RgbSettings) -> float:
    """Half the sum of the robust squares that `fit_box` minimizes, px^2."""
    scale = settings.outline_scale
    return scale**2 * float((np.sqrt(1 + (residuals / scale) ** 2) - 1).sum())


def door_box(seen: SeenOutline, unknown: Array) -> tuple[Array, Array, Array, Array, float]:
    """The foot [3] of the axis, the normal [3] from the near face to the other in frame `first`,
    the outline [N 3] of the near face, its outward normals [N 3], and the thickness."""
    hinge, tilt, thickness, apart = unknown[:UNKNOWNS]
    foot, normal = seen.direction(hinge), seen.direction(tilt)
    if normal @ seen.ray.mean(axis=0) < 0:
        normal = -normal
    offset, along = _away_from_zero(normal @ foot - apart), _away_from_zero(seen.ray @ normal)
    near = seen.ray * (offset / along)[:, None]
    outward = np.cross(np.roll(near, -2, axis=0) - np.roll(near, 2, axis=0), normal)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    outward *= np.sign(((near - near.mean(axis=0)) * outward).sum())
    far = seen.ray * ((offset + thickness) / along)[:, None] - thickness * normal
    near = np.where(np.einsum("na,na->n", outward, near)[:, None] < 0, far, near)
    scale = float(np.median(along / offset))
    return foot * scale, normal, near * scale, outward, thickness * scale


def _away_from_zero(values: Array) -> Array:
    return np.where(np.abs(values) < _NEAR_ZERO, _NEAR_ZERO, values)


def outline_residuals(seen: SeenOutline, unknown: Array) -> Array:
    """Distances [T N 2] of the outlines of both faces from the seen one, px; 0 where an outline is
    hidden by the box or outside of the image."""
    foot, normal, near, outward, thickness = door_box(seen, unknown)
    turned = se3.so3_exp(unknown[UNKNOWNS:, None] * seen.axis)
    across, outward = turned @ normal, np.einsum("tab,nb->tna", turned, outward)
    faces = [np.einsum("tab,nb->tna", turned, face - foot) + foot
             for face in (near, near + thickness * normal)]
    shows_side = np.einsum("tna,tna->tn", faces[0], outward) < 0
    height, width = seen.away.shape[1:]
    frame = np.broadcast_to(np.arange(len(turned))[:, None], shows_side.shape)
    still_cut = seen.is_cut(*seen.pixel.T)
    out: list[Array] = []
    for face, sign in zip(faces, (1, -1), strict=True):
        shows_face = sign * np.einsum("tna,ta->tn", face, across) > 0
        at = face / np.maximum(face[..., 2:], NEAREST) @ seen.intrinsics.T
        u, v = at[..., 0].clip(-_FAR, _FAR), at[..., 1].clip(-_FAR, _FAR)
        x, y = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
        away = map_coordinates(seen.away, [frame, y, x], order=1) + np.abs(u - x) + np.abs(v - y)
        visible = (shows_face ^ shows_side) & ~seen.is_cut(u, v) & ~still_cut
        out.append(np.where(visible, away, 0.0))
    return np.stack(out, axis=2)


def fit_box(
    seen: SeenOutline, start: Array, settings: RgbSettings, *,
    hinge: float | None = None, turn: Array | None = None,
) -> tuple[float, Array]:
    """The cost and the unknowns [4+T] of the box that fits the outline, from a start; or the first
    4 of them, where the turns [T] are known. `hinge` is the angle of the hinge, if it is known."""
    s, frames = settings, len(seen.away)
    prior, each = s.outline_prior / s.door_thickness, 2 * len(seen.ray)
    unknowns = len(start)
    depends = csr_array(np.ones((frames * each + frames + 2, UNKNOWNS)))
    if turn is None:  # the residuals of a frame depend on its turn alone
        own = csr_array(eye_array(frames))
        depends = hstack([depends, vstack([
            kron(own, np.ones((each, 1))), own[:-2] + own[1:-1] + own[2:],
            *[own[[seen.first]]] * 4])], format="csr")

    def residuals(unknown: Array) -> Array:
        box = unknown if turn is None else np.concatenate([unknown, turn])
        known = [0.0 if hinge is None else box[0] - hinge, box[UNKNOWNS + seen.first]]
        return np.concatenate([
            outline_residuals(seen, box).ravel(), s.outline_jerk * np.diff(box[UNKNOWNS:], 2),
            prior * (box[2:UNKNOWNS] - [s.door_thickness, 0.0]), _FIXED * np.array(known)])

    least = np.full(unknowns, -np.inf)
    least[2] = 0.0
    size = np.concatenate([_SIZES, np.full(unknowns - UNKNOWNS, _TURN)])
    found = least_squares(
        residuals, start, jac_sparsity=depends, loss="soft_l1",
        f_scale=s.outline_scale, max_nfev=s.outline_iterations, diff_step=1e-4,
        bounds=(least, np.inf), x_scale=size)
    return float(found.cost), found.x
