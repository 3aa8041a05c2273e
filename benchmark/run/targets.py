"""Targets: what predictions of a method that ran elsewhere must contain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...robots.geometry import Array
from ..protocol import truth_of
from .datasets import Data

_LEAST_DOUBTED, _MOST_WITHOUT_LIMITS = 3 * np.pi, 4 * np.pi  # rad


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


def describe_unscored(key: str, wanted: Mapping[str, Target]) -> str:
    """Return why a sequence of the datasets is not one of the targets; empty for another name."""
    datasets = {id(target.data): target.data for target in wanted.values()}.values()
    for data in datasets:
        before = f"{data.name}/" if len(datasets) > 1 else ""
        name = key[len(before):]
        if key.startswith(before) and name in data.dataset.names:
            meta = data.dataset[name].meta
            if not meta.scored_joints:
                return "it is not scored, because it has no scored joint; leave it out"
            if meta.observability.get("observable") is False:
                return ("it is not scored, because its motion cannot be observed; leave it out, or "
                        "score it with --keep-unobservable")
    return ""


def describe_degrees(displacement: Mapping[str, Array], wanted: Mapping[str, Target]) -> str:
    """Return a doubt whether displacements [T J] are in rad; empty if they may be.

    A joint that turns has moved by more than 1.5 turns and beyond its limits, or by 2 turns.
    """
    for key, target in wanted.items():
        largest = np.nan_to_num(np.abs(displacement[key])).max(axis=0, initial=0.0)
        if (largest <= _LEAST_DOUBTED).all():
            continue
        meta = target.data.dataset[target.sequence].meta
        for name, value in zip(target.names, largest, strict=True):
            j = meta.joint_names.index(name)
            limits = meta.joint_limits[j]
            span = limits[1] - limits[0] if limits else _MOST_WITHOUT_LIMITS
            if meta.joint_types[j] != "prismatic" and value > max(span, _LEAST_DOUBTED):
                return (f"sequence {key}: joint {name} moves by {value:.4g}; are these degrees? "
                        "displacements are in rad")
    return ""


def list_known(wanted: Mapping[str, Target]) -> str:
    """Say what names there are."""
    names = list(wanted)
    return f"there are {names[0]} to {names[-1]}" if len(names) > 1 else f"there is {names[0]}"
