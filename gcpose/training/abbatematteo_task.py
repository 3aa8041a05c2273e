"""Training of the network of Abbatematteo et al."""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, cast

import numpy as np

from ...renderer.dataset import open_dataset
from ...robots.geometry import Array, fit_depth, rotation_from_quaternion
from ..networks.abbatematteo import AXIS, CONFIGURATION, MixtureDensityNetwork
from ..networks.torch_runtime import Tensor, nn, torch
from .config import AbbatematteoTraining
from .joint_images import JointImages, joint_numbers
from .object_task import ObjectTask
from .task import Samples, Scores, reduce_precision


@dataclass(frozen=True)
class AbbatematteoTask(ObjectTask):
    """Errors are measured beside those of no motion at all."""

    config: AbbatematteoTraining
    name: str = "abbatematteo"
    units: ClassVar[Mapping[str, str]] = {
        "displacement": "deg or m", "position": "deg or m", "axis": "deg"}
    layers: tuple[str, ...] = ("coordinates",)

    def make_network(self) -> nn.Module:
        return MixtureDensityNetwork(self.config.width, self.config.dropout)

    def open_samples(self, folders: list[Path], network: nn.Module) -> JointImages:
        c = self.config
        return JointImages(folders, c.seed, c.dropped, c.views)

    def take_ranges(self, network: nn.Module, samples: Samples) -> None:
        if isinstance(samples, JointImages):
            bounds = cast("MixtureDensityNetwork", network).bounds
            bounds.copy_(torch.from_numpy(samples.bounds()))

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        depth, numbers = batch
        mixture = cast("MixtureDensityNetwork", network)
        with reduce_precision(self.config, depth.device):
            return mixture.loss(depth, numbers, self.config.gate_gain)

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the mean errors of displacements, of positions, of axes (deg), and the loss."""
        mixture = cast("MixtureDensityNetwork", network)
        device, rows, still = mixture.bounds.device, [], []
        for sequence in open_dataset(folder):
            true = torch.from_numpy(joint_numbers(sequence).astype(np.float32)).to(device)
            depth = torch.from_numpy(fit_depth(sequence.depth[0 : len(sequence)])).to(device)
            with torch.no_grad():
                loss = float(mixture.loss(depth, true))
                numbers = mixture.likeliest(depth).cpu().numpy()
            found, q = numbers[:, CONFIGURATION], true[:, CONFIGURATION].cpu().numpy()
            cosine = (_direction(numbers) * _direction(true.cpu().numpy())).sum(-1)
            moved = q[1:] - q[0]
            scale = 1.0 if sequence.meta.joint_types[
                sequence.meta.joint_names.index(sequence.meta.scored_joints[0])
            ] == "prismatic" else 180 / np.pi
            rows.append([scale * np.abs(found[1:] - found[0] - moved).mean(),
                         scale * np.abs(found - q).mean(),
                         np.degrees(np.arccos(cosine.clip(-1, 1))).mean(), loss])
            still.append([scale * np.abs(moved).mean()])
        names = "displacement", "position", "axis", "loss"
        return {"abbatematteo": dict(zip(names, np.mean(rows, axis=0).tolist(), strict=True)),
                "hold-still": {"displacement": float(np.mean(still))}}


def _direction(numbers: Array) -> Array:
    """Return the directions [N 3] of the axes, in the body's frame, of numbers [N 22]."""
    quaternion = numbers[:, AXIS][:, 3:]
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    return rotation_from_quaternion(quaternion / length.clip(1e-9))[..., 0]
