"""Crops of images with keypoints, changed at random, and their heat maps."""

# pyright: basic
from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import open_dataset
from ...robots.geometry import Array
from ..networks.hourglass import KEYPOINTS
from ..networks.keypoint_crops import cut_crop, draw_maps, frame_keypoints, place_crop, to_crop
from .config import CravesTraining
from .data import draw_place

_SHIFT = 0.1  # of a crop against its box, in sides of the crop


@dataclass(frozen=True)
class KeypointSample:
    """A crop and its heat maps."""

    image: NDArray[np.float32]
    """[3 256 256] 0..1"""
    maps: NDArray[np.float32]
    """[17 64 64]"""


class KeypointImages:
    """Images of datasets; each epoch has every image once, in another order."""

    def __init__(self, folders: Row[Path], config: CravesTraining) -> None:
        """Open datasets; `config` has the seed and the ranges of the changes.

        Raises:
            DatasetError: If a dataset has no keypoints, or another number of them.
        """
        self.config = config
        self._place = [(d, i, t) for d in map(open_dataset, folders) for i in range(len(d))
                       for t in range(d.config.frames)]

    def __len__(self) -> int:
        return len(self._place)

    def image(self, index: int) -> tuple[NDArray[np.uint8], Array]:
        """Return image `index` [H W 3] and its keypoints [17 2] px, NaN behind the camera."""
        dataset, i, t = self._place[index]
        sequence = dataset[i]
        pixels = sequence.state.keypoint_image
        if pixels is None or pixels.shape[1] != KEYPOINTS or not np.isfinite(pixels[t]).any():
            raise DatasetError(f"sequence {sequence.meta.name} has not {KEYPOINTS} keypoints; "
                               "render with --robot owi535 --layers keypoints")
        return sequence.rgb[t], pixels[t]

    def sample(self, number: int) -> KeypointSample:
        """Return the sample of any number."""
        c = self.config
        rng, place = draw_place(c.seed, number, len(self))
        image, pixels = self.image(place)
        center, side = frame_keypoints(pixels)
        side *= rng.uniform(*c.scale)
        shift = rng.uniform(-_SHIFT, _SHIFT, 2) * side
        turn = np.radians(rng.uniform(-c.rotation, c.rotation))
        image_from_crop = place_crop(center + shift, side, turn)
        gain = rng.uniform(*c.color, 3)
        crop = np.minimum(cut_crop(image, image_from_crop) * (gain / 255), 1.0)
        channels = np.ascontiguousarray(np.moveaxis(crop.astype(np.float32), 2, 0))
        return KeypointSample(channels, draw_maps(to_crop(image_from_crop, pixels)))
