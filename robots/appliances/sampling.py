"""Draws for generated objects, the same on every machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from .textures import Color

T = TypeVar("T")


class Dice:
    """Draws on grids of integers: the same on every machine."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def number(self, low: int, high: int) -> int:
        """Both ends included."""
        return int(self.rng.integers(low, high + 1))

    def length(self, low: float, high: float) -> float:
        """m, on a grid of a millimetre."""
        return self.number(round(low * 1000), round(high * 1000)) / 1000

    def angle(self, low: float, high: float) -> float:
        """rad, on a grid of a thousandth."""
        return self.length(low, high)

    def chance(self, percent: int) -> bool:
        return self.number(0, 99) < percent

    def pick(self, options: Sequence[T], weights: Sequence[int] | None = None) -> T:
        """One of the options; integer weights."""
        chances = weights or [1] * len(options)
        drawn = self.number(0, sum(chances) - 1)
        for option, weight in zip(options, chances, strict=True):
            drawn -= weight
            if drawn < 0:
                return option
        raise AssertionError("the weights are positive")

    def near(self, color: Color, spread: int) -> Color:
        """A colour that is up to `spread` lighter or darker, its channels almost alike."""
        shift, tint = self.number(-spread, spread), spread // 5
        r, g, b = (min(255, max(0, c + shift + self.number(-tint, tint))) for c in color)
        return r, g, b
