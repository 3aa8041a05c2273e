"""The estimator of GC-Pose, for every kind of evidence: hypotheses, adjustment, uncertainty."""

from __future__ import annotations

from .equations import BundleEquations
from .hypothesis import (
    Hypothesis,
    LabeledPoints,
    align_displacements,
    label_difference,
    select_distinct,
)
from .uncertainty import calibrate_deviation

__all__ = [
    "BundleEquations", "Hypothesis", "LabeledPoints", "align_displacements", "calibrate_deviation",
    "label_difference", "select_distinct",
]
