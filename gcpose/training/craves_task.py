"""Training of the keypoint network of CRAVES."""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...errors import ConfigError
from ...renderer.runtime import plural
from ...renderer.scene import CameraConfig, ImageConfig, RandomizationConfig, RenderConfig
from ...renderer.types import Meta
from ..networks.hourglass import KEYPOINTS, StackedHourglass
from ..networks.keypoint_crops import (
    cut_crop,
    find_peaks,
    frame_keypoints,
    keypoint_errors,
    network_input,
    place_crop,
    to_image,
)
from ..networks.torch_runtime import F, Tensor, nn, torch
from .config import CravesTraining
from .data import PlannedDataset
from .keypoint_images import KeypointImages
from .task import Samples, Scores, TrainingTask, reduce_precision

_WIDTH, _HEIGHT = 384, 288  # px: crops of such images are enlarged by less than 2


@dataclass(frozen=True)
class CravesTask(TrainingTask):
    """Errors are measured in crops about the true keypoints."""

    config: CravesTraining
    name: str = "craves"
    unit: str = "pck: share of errors within 0.2 of the keypoints' box; errors in px of the image"
    units: ClassVar[Mapping[str, str]] = {"pck": "%", "pixels": "px", "median": "px"}

    def check_options(self) -> None:
        super().check_options()
        c = self.config
        if not 16 <= c.width <= 256 or c.width % 16:
            raise ConfigError(f"--width {c.width}: give a multiple of 16 from 16 to 256")

    def notes(self) -> Mapping[str, str]:
        return {"objects": "owi535"}

    def make_network(self) -> nn.Module:
        return StackedHourglass(self.config.width)

    def make_optimizer(self, network: nn.Module) -> torch.optim.Optimizer:
        return torch.optim.RMSprop(network.parameters(), self.config.rate,
                                   weight_decay=self.config.weight_decay)

    def plan_data(self) -> Iterator[PlannedDataset]:
        """Yield a dataset of single images, and one to measure errors on."""
        c = self.config
        ranges = RandomizationConfig(
            camera=CameraConfig(elevation=(5.0, 60.0), fov=(35.0, 75.0)),
            image=ImageConfig(noise=(0.0, 2.0), blur=(0.0, 0.5)))
        for held_out, count in ((False, c.images), (True, c.held_out_images)):
            seed = 1000 * c.seed + held_out
            render = RenderConfig(robot="owi535", seed=seed, stream="train", frames=1,
                                  width=_WIDTH, height=_HEIGHT, keep_unobservable=True,
                                  layers=("keypoints",), randomization=ranges)
            yield PlannedDataset(f"owi535-{seed}", render, count, held_out)

    def describe_misfit(self, meta: Meta) -> str:
        """Return that a sequence does not have the keypoints, or ""."""
        if len(meta.keypoint_names) == KEYPOINTS:
            return ""
        return (f"has {plural(len(meta.keypoint_names), 'keypoint')}, and craves learns "
                f"{KEYPOINTS}; render with --robot owi535 --layers keypoints")

    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        return KeypointImages(folders, self.config)

    def rate(self, progress: float) -> float:
        """Return the learning rate: a tenth in the last third of the steps."""
        return self.config.rate * (1.0 if progress < 2 / 3 else 0.1)

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        image, maps = batch
        image = image.contiguous(memory_format=torch.channels_last)
        with reduce_precision(self.config, image.device):
            found = network(image)
        return torch.stack([F.mse_loss(x.float(), maps) for x in found]).sum()

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the share of keypoints that are found, and their errors in the image."""
        images, rows = KeypointImages([folder], self.config), list[np.ndarray]()
        device = next(network.parameters()).device
        for index in range(len(images)):
            image, pixels = images.image(index)
            image_from_crop = place_crop(*frame_keypoints(pixels))
            crop = torch.from_numpy(network_input(cut_crop(image, image_from_crop)))
            with torch.no_grad():
                maps = network(crop.to(device))[-1]
            found = to_image(image_from_crop, find_peaks(maps[0].cpu().numpy())[0])
            errors = keypoint_errors(found, pixels)
            rows.append(np.stack(errors)[:, np.isfinite(errors[0])])
        error, close = np.concatenate(rows, axis=1)
        return {"craves": {"pck": float(100 * close.mean()), "pixels": float(error.mean()),
                           "median": float(np.median(error))}}
