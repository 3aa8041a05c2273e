"""Least squares, robust weights, settings records, compiled loops and threads."""

from __future__ import annotations

from .arrays import Image
from .compilation import compiled
from .least_squares import Solver, gauss_newton
from .robust import cauchy_weight, geman_mcclure_cost, truncated_cost
from .settings import DEGREE, Count, NonNegative, Positive, Scales, SettingsRecord, Share, Whole
from .threads import thread_map

__all__ = [
    "DEGREE", "Count", "Image", "NonNegative", "Positive", "Scales", "SettingsRecord", "Share",
    "Solver", "Whole", "cauchy_weight", "compiled", "gauss_newton", "geman_mcclure_cost",
    "thread_map", "truncated_cost",
]
