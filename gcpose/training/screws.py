"""Depth videos with the screw of their motion, and ScrewNet's loss."""

# pyright: basic
from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import open_dataset
from ...renderer.runtime import address
from ...renderer.types import Sequence
from ...robots.geometry import Array, fit_depth
from ..networks.torch_runtime import Tensor, torch
from .config import ViewConfig
from .data import draw_place
from .depth_views import (
    SAME_VIEW,
    draw_view,
    fitted_intrinsics,
    joint_slides,
    view_depth,
    view_screws,
)

_PARALLEL = 1e-4  # sine of the angle below which lines count as parallel


@dataclass(frozen=True)
class ScrewSample:
    """A depth video of T frames as `ScrewNet` sees it, and the motion in it."""

    depth: NDArray[np.float32]
    """[T 108 192] in units of 12 m"""
    screw: NDArray[np.float32]
    """[T-1 8] (see `relative_screws`)"""


def relative_screws(sequence: Sequence, first: int, last: int) -> Array:
    """Return the screws [last-first 8] of the motion from frame `first` to each later one.

    Rows are l, m = p x l (camera frame at `first`), theta and d. theta in [0, pi] rad and d (m) are
    never negative: the axis carries the sign. m is zero where the joint slides.

    Raises:
        DatasetError: If the sequence has not one scored joint.
    """
    meta, state = sequence.meta, sequence.state
    if len(meta.scored_joints) != 1:
        raise DatasetError(f"sequence {meta.name} has {len(meta.scored_joints)} scored joints; "
                           "screwnet learns from objects with one")
    j = meta.joint_names.index(meta.scored_joints[0])
    moved = state.joint_positions[first + 1 : last + 1, j] - state.joint_positions[first, j]
    slides = joint_slides(sequence)
    if not slides:
        moved = np.pi - np.mod(np.pi - moved, 2 * np.pi)
    sign = np.where(moved < 0, -1.0, 1.0)[:, None]
    size = np.stack([np.abs(moved) * (not slides), np.abs(moved) * slides], axis=1)
    return np.concatenate([sign * state.joint_screw[first, j], size], axis=1)


class DepthVideos:
    """Windows of frames of datasets; each epoch has every sequence once, in another order."""

    def __init__(
        self, folders: Row[Path], frames: int, seed: int, dropped: float = 0.0,
        views: ViewConfig = SAME_VIEW,
    ) -> None:
        """Open datasets; `dropped` is the share of the pixels that are set to zero.

        Raises:
            DatasetError: If a dataset has too few frames.
        """
        self.datasets = [open_dataset(folder) for folder in folders]
        self.frames, self.seed, self.dropped, self.views = frames, seed, dropped, views
        for folder, dataset in zip(folders, self.datasets, strict=True):
            if dataset.config.frames < frames:
                raise DatasetError(f"{address(folder)} has {dataset.config.frames} frames in a "
                                   f"sequence; give --frames {dataset.config.frames} or fewer")
        self._place = [(dataset, i) for dataset in self.datasets for i in range(len(dataset))]

    def __len__(self) -> int:
        return len(self._place)

    def sample(self, number: int) -> ScrewSample:
        """Return the sample of any number."""
        rng, place = draw_place(self.seed, number, len(self))
        dataset, index = self._place[place]
        sequence = dataset[index]
        first = int(rng.integers(len(sequence) - self.frames + 1))
        depth = fit_depth(sequence.depth[first : first + self.frames])
        kept = rng.random(depth.shape[1:]) >= self.dropped  # the same pixels in all frames
        screw = relative_screws(sequence, first, first + self.frames - 1)
        if self.views != SAME_VIEW:
            view = draw_view(rng, self.views)
            depth = view_depth(depth, fitted_intrinsics(sequence), view)
            screw = view_screws(screw, view, joint_slides(sequence))
        return ScrewSample(depth * kept, screw.astype(np.float32))


def screw_loss(found: Tensor, true: Tensor) -> Tensor:
    """Return ScrewNet's loss of screws [B K 8] (Jain et al., 2021), the mean over all K frames.

    The angle between the directions, twice the distance of the lines, the difference of the
    rotations and of the slides, all squared; and how far the output is from a screw: |l| - 1
    squared, and |l . m|.
    """
    l, m, theta, d = found[..., :3], found[..., 3:6], found[..., 6], found[..., 7]
    true_l, true_theta, true_d = true[..., :3], true[..., 6], true[..., 7]
    length = l.norm(dim=-1)
    unit = l / length.clamp(min=1e-6)[..., None]
    direction = (true_l * l).sum(-1).clamp(-1 + 1e-6, 1 - 1e-6).acos()
    moment = m / length.clamp(min=1e-6)[..., None]
    distance = line_distance(unit, moment, true_l, true[..., 3:6])
    turn = torch.eye(3, device=l.device) - rotations_about(true_l, true_theta) @ rotations_about(
        unit, theta).transpose(-1, -2)
    slide = true_d[..., None] * true_l - d[..., None] * l
    return (direction**2 + 2 * distance**2 + turn.square().sum((-1, -2)) + slide.square().sum(-1)
            + (length - 1) ** 2 + (l * m).sum(-1).abs()).mean()


def line_distance(l: Tensor, m: Tensor, other_l: Tensor, other_m: Tensor) -> Tensor:
    """Return the distance [...] between lines of unit directions and moments [... 3]."""
    across = torch.linalg.cross(l, other_l)
    sine = across.square().sum(-1).clamp(min=_PARALLEL**2).sqrt()
    skew = ((l * other_m).sum(-1) + (other_l * m).sum(-1)).abs() / sine
    sign = torch.where((l * other_l).sum(-1, keepdim=True) < 0, -1.0, 1.0)
    gap = torch.linalg.cross(l, m - sign * other_m)
    parallel = gap.square().sum(-1).clamp(min=1e-16).sqrt()
    return torch.where(across.square().sum(-1) > _PARALLEL**2, skew, parallel)


def rotations_about(axis: Tensor, angle: Tensor) -> Tensor:
    """Return rotations [... 3 3] about unit axes [... 3] by angles [...] rad."""
    x, y, z = axis.unbind(-1)
    zero = torch.zeros_like(x)
    hat = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    sine, versine = angle.sin()[..., None, None], (1 - angle.cos())[..., None, None]
    return torch.eye(3, device=axis.device) + sine * hat + versine * (hat @ hat)
