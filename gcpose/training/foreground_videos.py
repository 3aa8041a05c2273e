"""Short videos with the true mask of what moves, cut to a square and changed at random."""

# pyright: basic
from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import open_dataset
from ...renderer.runtime import address
from ...renderer.types import Sequence
from ..images import ImageSettings, Square, changing_square, color_and_change, cut_square
from .config import ForegroundTraining
from .data import draw_place

_STILL = 1e-6  # of the entries of a pose


@dataclass(frozen=True)
class ForegroundSample:
    """Frames and what moves in them."""

    frames: NDArray[np.float32]
    """[T 10 S S] (see `color_and_change`)"""
    moving: NDArray[np.float32]
    """[T S S] share of a pixel that is to be found, 0..1"""


def true_foreground(sequence: Sequence, frames: slice) -> NDArray[np.bool_]:
    """Return where frames [T H W] of a sequence show a part that moves in any of its frames."""
    pose = sequence.state.world_from_part
    moves = np.append(False, np.ptp(pose, axis=0).max(axis=(1, 2)) > _STILL)
    return moves[np.asarray(sequence.part[frames]).astype(np.int64)]


class ForegroundVideos:
    """Sequences of datasets; each epoch has every sequence once, in another order."""

    any_way_up = True
    """Whether samples are also turned by right angles, and their color channels permuted."""

    def __init__(self, folders: Row[Path], config: ForegroundTraining) -> None:
        """Open datasets; `config` has the seed and the ranges of the changes.

        Raises:
            DatasetError: If a sequence has fewer frames than `config.frames`.
        """
        self.config, self._settings = config, ImageSettings()
        self._place = [(d, i) for d in map(open_dataset, folders) for i in range(len(d))]
        for dataset, _ in self._place:
            if dataset.config.frames < config.frames:
                raise DatasetError(f"{address(dataset.path)} has sequences of "
                                   f"{dataset.config.frames} frames; "
                                   f"lower --frames {config.frames}")

    def __len__(self) -> int:
        return len(self._place)

    def sample(self, number: int) -> ForegroundSample:
        """Return the sample of any number."""
        c = self.config
        rng, place = draw_place(c.seed, number, len(self))
        dataset, index = self._place[place]
        sequence = dataset[index]
        start = int(rng.integers(dataset.config.frames - c.frames + 1))
        rgb, wanted = self.read_frames(sequence, slice(start, start + c.frames), rng)
        square = self._draw_square(rgb, rng)
        rgb, mask = cut_square(rgb, square), cut_square(wanted[..., None], square)
        turn, mirror = int(rng.integers(4)) * self.any_way_up, bool(rng.integers(2))
        rgb, mask = (np.rot90(x, turn, (1, 2))[:, :: -1 if mirror else 1] for x in (rgb, mask))
        rgb = self._recolor(np.ascontiguousarray(rgb), rng)
        return ForegroundSample(color_and_change(rgb, self._settings),
                                np.multiply(mask, 1 / 255, dtype=np.float32))

    def read_frames(
        self, sequence: Sequence, frames: slice, rng: np.random.Generator
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return images [T H W 3], and the share of a pixel that is to be found [T H W], 0..255."""
        moving = true_foreground(sequence, frames).astype(np.uint8) * np.uint8(255)
        return np.asarray(sequence.rgb[frames]), moving

    def _draw_square(self, rgb: NDArray[np.uint8], rng: np.random.Generator) -> Square:
        """Return a square about the one in use; about the image where nothing changes."""
        height, width = rgb.shape[1:3]
        side = max(height, width)
        whole = Square((width - side) // 2, (height - side) // 2, side)
        found = changing_square(rgb, self._settings) or whole
        side = max(32, round(found.side * rng.uniform(*self.config.scale)))
        left, top = (int(start + (found.side - side) / 2 + rng.uniform(-0.1, 0.1) * side)
                     for start in (found.left, found.top))
        return replace(found, left=left, top=top, side=side)

    def _recolor(self, rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """Change the tones of all frames alike, and add noise; the channels may be permuted."""
        c = self.config
        tone = np.linspace(0, 1, 256)[:, None] ** rng.uniform(*c.gamma) * rng.uniform(*c.gain, 3)
        table = np.clip(255 * tone, 0, 255).astype(np.uint8)
        channels = rng.permutation(3) if self.any_way_up else np.arange(3)
        sigma = rng.uniform(*c.noise) if rng.random() < c.noise_probability else 0.0
        out = np.empty_like(rgb)
        for t, image in enumerate(rgb):
            changed = cv2.LUT(np.ascontiguousarray(image[..., channels]), table[None])
            if sigma:
                noise = sigma * rng.standard_normal(image.shape, np.float32)
                changed = np.clip(np.rint(changed + noise), 0, 255)
            out[t] = changed
        return out
