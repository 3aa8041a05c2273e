"""Ground truth in closed form: flow, visibility, layers, tracks, observability."""

from __future__ import annotations

from .ground_truth import SequenceTruth, needs_faces, room_normal
from .rejection import Draw, DrawSampler
from .tracks import projected, surface_visible

__all__ = [
    "Draw", "DrawSampler", "SequenceTruth", "needs_faces", "projected", "room_normal",
    "surface_visible",
]
