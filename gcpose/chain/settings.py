"""Settings of chains: priors, hinges, beam search, and fits to part motions."""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics import DEGREE, Count, NonNegative, Positive, Scales, Share


@dataclass(frozen=True)
class ChainSettings:
    """Settings of chains."""

    # hypotheses
    slide_arm: Positive = 0.2  # Slide that counts as much as a turn by 1 rad, m.
    distinct_labels: Share = 0.02  # Share of the labels that makes hypotheses distinct.

    # priors
    step_sigma: Positive = 5.0 * DEGREE  # Standard deviation of a step, rad or m.
    acceleration_sigma: Positive = 0.6 * DEGREE  # The same of its change.
    max_axis_offset: Positive = 0.5  # Largest distance of an axis from its hinge, by its depth.

    # hinges
    hinge_points: Count = 120  # Points of each part that are compared to find its hinge.
    hinge_divisor: Count = 12  # One in this number of them, the nearest, is averaged.
    extent_margin: Share = 0.04  # Share of the points that is left out at either end of an extent.

    # beam search
    beam_values: Count = 7  # Values of a joint's step.
    beam_directions: Count = 8  # Directions across the axis before, where directions are not known.
    beam_tilts: Scales = (10.0 * DEGREE, 22.0 * DEGREE, 35.0 * DEGREE, 48.0 * DEGREE)
    """Pitch of the camera: angles of an upright first axis from the image's vertical, rad."""
    beam_divisor: Count = 5  # One in this number is extended where directions are unknown.

    # fits of chains to part motions
    fit_held_iterations: Count = 8  # Iterations with the axes fixed.
    fit_held_damping: NonNegative = 1e-3  # Share of the diagonal's mean that is added.
    fit_iterations: Count = 20  # Iterations with the axes free.
    fit_damping: NonNegative = 1e-4  # Share of the diagonal that is added to it in these.
    fit_max_step: Positive = 0.2  # Largest change of an unknown in an iteration, rad or m.
    fit_robust_scale: Positive = 4.0  # Square of the robust scale, by the median squared residual.
