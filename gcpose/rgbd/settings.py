"""Settings of the estimator with depth.

A footprint is the size of a pixel on the surface at the point's depth. Fields that end in `_noisy`
take the place of the field without the ending where the depth has noise.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics import DEGREE, Count, NonNegative, Positive, Scales


@dataclass(frozen=True)
class RgbdSettings:
    """Settings of the estimator with depth."""

    candidates: Count = 1500
    """Sampled points of a frame."""
    candidates_noisy: Count = 900
    min_moving_pixels: Count = 30
    """If fewer pixels of frame 0 may move, all joints are reported as static."""
    final_scales: Scales = (0.25, 0.12, 0.12)
    """Robust scale of each iteration of the last bundle adjustment, footprints."""
    final_scales_noisy: Scales = (1.0, 0.6, 0.4, 0.4)
    sigma_factor_known_lines: Positive = 2.7
    """Reported over formal standard deviation, where the axes' lines are known."""
    sigma_factor_known_directions: Positive = 2.9
    sigma_factor_free: Positive = 2.5
    sigma_factor_noisy: Positive = 8.2
    sigma_floor_noisy: NonNegative = 0.1 * DEGREE
    """Least reported standard deviation where depth has noise, rad or m."""
    sigma_unreliable: NonNegative = 10.0 * DEGREE
    """Least reported standard deviation of an unreliable estimate, rad or m."""
    sigma_static: Positive = 1.0
    """Largest reported standard deviation, also where nothing was seen to move, rad or m."""
