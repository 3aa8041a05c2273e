"""The estimator of GC-Pose for every kind of evidence: hypotheses, EM, bundle adjustment."""

from __future__ import annotations

from .em import Adjustment, Evidence, Residuals, Round, adjust, refine_in_stages, run_em, track
from .hypothesis import (
    BundleEquations,
    Hypothesis,
    LabeledPoints,
    align_displacements,
    calibrate_deviation,
    label_difference,
    select_distinct,
    spread_of_motions,
)

__all__ = [
    "Adjustment", "BundleEquations", "Evidence", "Hypothesis", "LabeledPoints", "Residuals",
    "Round", "adjust", "align_displacements", "calibrate_deviation", "label_difference",
    "refine_in_stages", "run_em", "select_distinct", "spread_of_motions", "track",
]
