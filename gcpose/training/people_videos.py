"""Short videos of objects with a person drawn over them, and the mask of the person."""

# pyright: basic
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Sequence
from .config import PeopleTraining
from .foreground_videos import ForegroundVideos
from .people_drawing import draw_person


class PeopleVideos(ForegroundVideos):
    """Sequences of datasets, most of them with a person."""

    any_way_up = False
    config: PeopleTraining

    def read_frames(
        self, sequence: Sequence, frames: slice, rng: np.random.Generator
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return images [T H W 3], and the share of a pixel that shows a person [T H W], 0..255."""
        if rng.random() < self.config.people_probability:
            return draw_person(sequence, frames, rng)
        rgb = np.asarray(sequence.rgb[frames])
        return rgb, np.zeros(rgb.shape[:3], np.uint8)
