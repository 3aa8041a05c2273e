"""Training of the network that finds people."""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...renderer.dataset import open_dataset
from ..images import ImageSettings, find_people
from ..networks.torch_runtime import nn
from .config import PeopleTraining
from .foreground_task import ForegroundTask, worst_tenth
from .foreground_videos import true_foreground
from .people_drawing import draw_person
from .people_videos import PeopleVideos
from .task import Samples, Scores


@dataclass(frozen=True)
class PeopleTask(ForegroundTask):
    """Errors are measured on the held-out sequences with a person, and on the same without."""

    config: PeopleTraining
    name: str = "people"
    unit: str = ("%, means over the sequences; iou: overlap with a person; worst: that of the "
                 "worst tenth; lost: share of the object that is taken for a person; alone: the "
                 "same with no person in the images")
    units: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("iou", "worst", "lost", "alone"), "%")

    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        return PeopleVideos(folders, self.config)

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the overlap with the person, and what is lost of the object."""
        settings = ImageSettings()
        inference = self.inference(network)
        overlap, lost, alone = list[float](), list[float](), list[float]()
        for k, sequence in enumerate(open_dataset(folder)):
            rgb, cover = draw_person(sequence, slice(None), np.random.default_rng(k))
            person, found = cover > 127, find_people(rgb, inference, settings)
            moving = true_foreground(sequence, slice(None))
            seen = moving & ~person
            overlap.append(float((found & person).sum() / max(1, (found | person).sum())))
            lost.append(float((found & seen).sum() / max(1, seen.sum())))
            found = find_people(np.asarray(sequence.rgb[:]), inference, settings)
            alone.append(float((found & moving).sum() / max(1, moving.sum())))
        shares = {"iou": np.mean(overlap), "worst": worst_tenth(overlap), "lost": np.mean(lost),
                  "alone": np.mean(alone)}
        return {"network": {name: 100 * float(share) for name, share in shares.items()}}
