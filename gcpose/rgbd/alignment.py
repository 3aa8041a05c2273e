"""What images say of a motion: residuals of moved points, summed into normal equations.

Every residual's derivative is taken to the twist (w, v) of the point's part, T <- exp(twist) T: six
numbers a with dr = -a . twist. So the images enter the estimate only through a 6x6 matrix per part
and frame, whatever the unknowns are: rigid motions, joint angles, axes.

All of them move points by motion [T J+1 4 4] into frames 0..T-1, but for the frame that the points
are from, and add up over each part: matrix [T J+1 6 6], vector [T J+1 6], with Geman-McClure's
weights. Part 0 stands still and says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..images import Surfaces
from ..numerics import Image
from .kernels import add_flow, add_surface, camera_of, columns, fill_views
from .settings import BundleSettings

Equations = tuple[Array, Array]


@dataclass(frozen=True)
class Elements:
    """TriangleSurface elements sorted by part."""

    column: Image
    """[7 N] point, normal, sigma of the distance in m"""
    start: NDArray[np.int64]
    """[J+2] where each part begins."""

    def scaled(self, scale: float) -> Elements:
        """The same with sigma times `scale`."""
        column = self.column.copy()
        column[6] *= np.float32(scale)
        return Elements(column, self.start)


def elements(
    point: Array, normal: Array, sigma: Array, label: NDArray[np.int64], parts: int
) -> Elements:
    """Of points and normals [N 3], sigma and label [N] on as many parts."""
    order = np.argsort(label, kind="stable")
    start = np.searchsorted(label[order], np.arange(parts + 1))
    return Elements(columns(point, normal, sigma)[:, order], start)


def sparse(these: Elements, stride: int) -> Elements:
    """Every so manieth of them."""
    return Elements(np.ascontiguousarray(these.column[:, ::stride]), -(-these.start // stride))


def surface_equations(
    surfaces: Surfaces, frame: int, motion: Array, these: Elements, settings: BundleSettings
) -> Equations:
    """Point-to-plane distance of the measured surface; projective association.

    A point that has turned to the back of a part meets the front, a part's thickness away: the
    normals tell.
    """
    out = empty(motion.shape)
    add_surface(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
                frame, motion.astype(np.float32), these.column, these.start,
                np.float32(settings.min_normal_cosine), *out)
    return out


def accumulated_equations(
    surfaces: Surfaces, motion: Array, these: Elements, settings: BundleSettings
) -> tuple[Array, Array, Array]:
    """Distance of the measured surfaces from points that are where all frames together put them.

    A noisy point errs in every frame alike, and where it is looked for depends on its error: with
    both, joints seem to move less than they do. So each point may be displaced along its normal,
    which is eliminated by a Schur complement. That couples the frames: from matrix [T J+1 6 6]
    `coupling` [J+1 6T 6T] is to be taken. The points' own frame is one of them.
    """
    frames, parts = motion.shape[:2]
    n = these.column.shape[1]
    row, residual = np.zeros((frames, 6, n), np.float32), np.zeros((frames, n), np.float32)
    weight = np.zeros((frames, n), np.float32)
    fill_views(surfaces.depth, surfaces.normal, camera_of(surfaces.intrinsics, surfaces.depth),
               motion.astype(np.float32), these.column, these.start,
               np.float32(settings.min_normal_cosine), row, residual, weight)
    many = np.maximum(weight.sum(axis=0), np.float32(1e-12))
    residual -= (weight * residual).sum(axis=0) / many
    matrix, vector = empty(motion.shape)
    coupling = np.zeros((parts, 6 * frames, 6 * frames))
    for j in range(1, parts):
        mine = slice(these.start[j], these.start[j + 1])
        a = row[:, :, mine]
        weighed = a * weight[:, None, mine]
        matrix[:, j] = weighed @ a.transpose(0, 2, 1)
        vector[:, j] = np.einsum("tan,tn->ta", weighed, residual[:, mine])
        pull = weighed.reshape(6 * frames, -1)
        coupling[j] = (pull / many[mine]) @ pull.T
    return matrix, vector, coupling


def flow_equations(
    surfaces: Surfaces, motion: Array, these: Elements, settings: BundleSettings
) -> Equations:
    """Flow from frame t to t + 1 against the motion between (Sec. 3.4, L_w), for t = 0..T-2.

    Twists are of the steps. One in `settings.flow_stride` of the surfels is compared.
    """
    assert surfaces.flow is not None
    these = sparse(these, settings.flow_stride)
    out = empty(motion[1:].shape)
    add_flow(surfaces.depth, surfaces.normal, surfaces.flow,
             camera_of(surfaces.intrinsics, surfaces.depth), motion.astype(np.float32),
             these.column, these.start, np.float32(settings.flow_depth_noise * surfaces.noise),
             np.float32(settings.flow_sigma),
             np.float32(settings.flow_share * settings.flow_stride), *out)
    return out


def empty(shape: tuple[int, ...]) -> Equations:
    """Sums over nothing yet, for motion of that shape."""
    return np.zeros((*shape[:2], 6, 6)), np.zeros((*shape[:2], 6))
