"""Targets: what predictions of a method that ran elsewhere must contain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


def list_known(wanted: Mapping[str, Target]) -> str:
    """Say what names there are."""
    names = list(wanted)
    return f"there are {names[0]} to {names[-1]}" if len(names) > 1 else f"there is {names[0]}"
