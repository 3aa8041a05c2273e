"""Settings of the adjustment to noisy depth and images at once."""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics import DEGREE, Count, NonNegative, Positive


@dataclass(frozen=True)
class FusionSettings:
    """Settings of where it starts, how both kinds of evidence count, and what is reported."""

    image_starts: Count = 4  # Motions by images from which it starts, beside that by depth.
    rounds: Count = 5  # Rounds of EM from each of them.
    image_weight: Positive = 0.05
    """Weight of images against depth: the errors of patches are correlated."""
    depth_scale: Positive = 0.33  # Robust scale of depth, by that of the images.
    score_depth: NonNegative = 10.0  # Weight of the cost of depth against the score by images.

    # reported standard deviations
    factor: Positive = 3.0  # Reported by formal ones.
    floor: NonNegative = 0.5 * DEGREE  # Least one, rad or m.
    excess: Positive = 0.2  # Score above the best at which another motion weighs 1/e.
    spread: NonNegative = 1.0  # Reported by the standard deviation of other motions.
    sigma_unknown: Positive = 1.0  # Largest one, rad or m.
