"""Ground truth in closed form: flow, visibility, layers, tracks, observability."""

from __future__ import annotations

from .ground_truth import SequenceTruth, needs_faces, room_normal
from .rejection import Draw, DrawSampler
from .tracks import TruthImages, track_paths

__all__ = [
    "Draw", "DrawSampler", "SequenceTruth", "TruthImages", "needs_faces", "room_normal",
    "track_paths",
]
