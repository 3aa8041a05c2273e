"""Training of `ScrewNet`, and what other networks for depth videos share with it."""

# pyright: basic
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, cast

import numpy as np

from ...errors import ConfigError
from ...renderer.dataset import open_dataset
from ..networks.abbatematteo import mixture_width
from ..networks.depth_video import DepthVideoNetwork
from ..networks.screwnet import ScrewNet
from ..networks.torch_runtime import Tensor, nn, torch
from ..networks.weights import read_notes, read_tensors, read_weights
from .config import ScrewNetTraining
from .object_task import ObjectTask
from .screws import DepthVideos, line_distance, screw_loss
from .task import Samples, Scores, reduce_precision
from .video_features import VideoFeatures


@dataclass(frozen=True)
class ScrewNetTask(ObjectTask):
    """Errors are measured beside those of no motion at all."""

    config: ScrewNetTraining
    name: str = "screwnet"
    units: ClassVar[Mapping[str, str]] = {
        "angle": "deg", "slide": "m", "direction": "deg", "line": "m"}

    def check_options(self) -> None:
        super().check_options()
        frozen = self.config.freeze_features
        if frozen and self.config.start_from is None:
            raise ConfigError("--freeze-features: give weights with --start-from")
        if self.config.feature_views and frozen < 1:
            raise ConfigError("--feature-views: features that are computed once cannot learn; add "
                              "--freeze-features 1")

    def make_network(self) -> DepthVideoNetwork:
        return ScrewNet(self.config.width)

    def criterion(self, network: DepthVideoNetwork, output: Tensor, true: Tensor) -> Tensor:
        """Return the loss of the network's output for videos of these screws [B K 8]."""
        return screw_loss(output, true)

    def screws(self, network: DepthVideoNetwork, output: Tensor) -> Tensor:
        """Return the screws [B K 8] that the network's output stands for."""
        return output

    def notes(self) -> Mapping[str, str]:
        """Return what the network has learned from, and whose features it began with."""
        start = self.config.start_from
        if start is None or start.suffix != ".safetensors":
            return super().notes()
        features = "abbatematteo" if mixture_width(read_tensors(start)) else \
            read_notes(start).get("features", "")
        return {**super().notes(), **({"features": features} if features else {})}

    def load_start(self, network: nn.Module, path: Path) -> None:
        """Load weights of this network, or an `abbatematteo` network's features of an image."""
        if not mixture_width(read_tensors(path)):
            super().load_start(network, path)
            return
        features = {name: tensor for name, tensor in network.state_dict().items()
                    if name.startswith(("encoder.", "features."))}
        network.load_state_dict(read_weights(path, features, self.name), strict=False)

    def open_samples(self, folders: list[Path], network: nn.Module) -> Samples:
        c = self.config
        videos = DepthVideos(folders, c.frames, c.seed, c.dropped, c.views)
        if not c.feature_views:
            return videos
        return VideoFeatures(videos, c.feature_views, cast("DepthVideoNetwork", network), c)

    def rate(self, progress: float) -> float:
        """Return the learning rate: by default a tenth after each 30 % of the steps."""
        if self.config.rate_decay:
            return super().rate(progress)
        return self.config.rate * 0.1 ** int(progress / 0.3)

    def loss(self, network: nn.Module, batch: list[Tensor], progress: float) -> Tensor:
        seen, screw = batch
        videos = cast("DepthVideoNetwork", network)
        videos.freeze_features(progress < self.config.freeze_features)
        with reduce_precision(self.config, seen.device):
            output = videos.motion(seen) if self.config.feature_views else videos(seen)
        return self.criterion(videos, output.float(), screw)

    def frames_of(self, folder: Path) -> int:
        """Return how many frames of the videos of a held-out dataset the network sees."""
        return min(self.config.frames, open_dataset(folder).config.frames)

    def measure(self, network: nn.Module, folder: Path) -> Scores:
        """Return the mean errors, and the mean motion: the error of an estimate of none.

        The error of the line is a mean over the joints that turn; without one, it is left out.
        """
        frames = self.frames_of(folder)
        videos = DepthVideos([folder], frames, self.config.seed)
        finder = cast("DepthVideoNetwork", network)
        device = next(network.parameters()).device
        rows: list[np.ndarray] = []
        with torch.no_grad():
            for number in range(len(videos)):
                sample = videos.sample(number)
                depth, true = (torch.from_numpy(x)[None].to(device) for x in vars(sample).values())
                output = finder(depth)
                loss = float(self.criterion(finder, output, true))
                rows.append(_errors(self.screws(finder, output), true, loss))
        names = "angle", "slide", "direction", "line", "loss", "true angle", "true slide"
        columns = {name: column[~np.isnan(column)] if name == "line" else column
                   for name, column in zip(names, np.transpose(rows), strict=True)}
        mean = {name: float(np.mean(column)) for name, column in columns.items() if len(column)}
        still = {"angle": mean.pop("true angle"), "slide": mean.pop("true slide")}
        return {self.name: mean, "hold-still": still}


def _errors(found: Tensor, true: Tensor, loss: float) -> np.ndarray:
    """The means over frames of screws [1 K 8]: deg, m, deg, m (NaN of a slide), the loss, deg, m.
    """
    length = found[..., :3].norm(dim=-1, keepdim=True).clamp(min=1e-6)
    l, m = found[..., :3] / length, found[..., 3:6] / length
    angle = (found[..., 6] - true[..., 6]).abs().rad2deg()
    direction = (l * true[..., :3]).sum(-1).clamp(-1, 1).acos().rad2deg()
    line = line_distance(l, m, true[..., :3], true[..., 3:6])
    if not true[..., 3:6].any():  # a slide has no line
        line = torch.full_like(line, torch.nan)
    slide = (found[..., 7] - true[..., 7]).abs()
    values = [angle, slide, direction, line]
    return np.array([*(float(v.mean()) for v in values), loss,
                     float(true[..., 6].mean().rad2deg()), float(true[..., 7].mean())])
