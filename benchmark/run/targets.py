"""Targets: what predictions of a method that ran elsewhere must contain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..protocol import truth_of
from .datasets import Data


@dataclass(frozen=True)
class Target:
    """The required predictions of a sequence: their dataset and shape."""

    data: Data
    sequence: str
    frames: int
    names: tuple[str, ...]
    """Of the scored joints, from the base outward."""

    @property
    def joints(self) -> int:
        return len(self.names)


def list_targets(data: Sequence[Data]) -> dict[str, Target]:
    """Return the targets by name of the sequence, or by DATASET/NAME for several datasets."""
    out: dict[str, Target] = {}
    for d in data:
        for name in d.sequences:
            sequence = d.dataset[name]
            key = name if len(data) == 1 else f"{d.name}/{name}"
            out[key] = Target(d, name, len(sequence), truth_of(sequence).joint_names)
    return out
