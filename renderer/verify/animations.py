"""The animation that a sequence says it shows."""

from __future__ import annotations

from dataclasses import dataclass

from ...robots.geometry import Array
from ...robots.model import Animation, ArticulatedModel, ModelState
from ..runtime import to_record
from ..scene import animation_times
from ..types import Sequence


@dataclass(frozen=True)
class DrawnAnimation:
    """What `meta.json` says of the animation."""

    name: str
    start: float
    """s in the animation at the first frame"""

    def find(self, model: ArticulatedModel) -> Animation | None:
        """Return the animation of a model; None if it has none of this name."""
        return next((a for a in model.animations if a.name == self.name), None)

    def state(self, animation: Animation, times: Array) -> ModelState:
        """Return the state of the model at times [T] s of the sequence."""
        return animation.at(animation_times(times, self.start, animation.duration))


def drawn_animation(sequence: Sequence) -> DrawnAnimation | None:
    """Return the animation of a sequence; None if its joints move. Raises DatasetError."""
    said = sequence.meta.randomization
    if "animation" not in said:
        return None
    return to_record(said["animation"], DrawnAnimation, "meta.json: randomization.animation")
