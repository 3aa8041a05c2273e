"""What a method sees, what it must return, and how that is scored."""

from __future__ import annotations

from .metrics import PCP5, PCP_DEGREES, has_axis, is_covered, pcp_thresholds
from .observations import ORACLES, Allocate, are_compatible, observe
from .scoring import AXES_KNOWN, score_motion, score_sequence, shape_of
from .truth import Truth, truth_digest, truth_of

__all__ = [
    "AXES_KNOWN", "ORACLES", "PCP5", "PCP_DEGREES", "Allocate", "Truth", "are_compatible",
    "has_axis", "is_covered", "observe", "pcp_thresholds", "score_motion", "score_sequence",
    "shape_of", "truth_digest", "truth_of",
]
