"""Features of the images of depth videos, computed once for a network that keeps them as they are.
"""

# pyright: basic
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..networks.depth_video import DepthVideoNetwork
from ..networks.torch_runtime import torch
from .config import TrainConfig
from .data import draw_place
from .screws import DepthVideos
from .task import reduce_precision

_VIDEOS = 16  # that go through the network together


@dataclass(frozen=True)
class FeatureSample:
    """What a network finds in the T images of a depth video, and the motion in it."""

    features: NDArray[np.float32]
    """[T F]"""
    screw: NDArray[np.float32]
    """[T-1 8] (see `screws.relative_screws`)"""


class VideoFeatures:
    """The first samples of depth videos, with features in place of images."""

    def __init__(
        self, videos: DepthVideos, views: int, network: DepthVideoNetwork, config: TrainConfig
    ) -> None:
        """Compute the features of `views` samples of each sequence."""
        from tqdm import tqdm

        self.seed = config.seed
        device = next(network.parameters()).device
        features: list[NDArray[np.float16]] = []
        screws: list[NDArray[np.float32]] = []
        numbers = range(views * len(videos))
        network.eval()
        for start in tqdm(numbers[::_VIDEOS], unit_scale=_VIDEOS, unit="video", desc="features",
                          dynamic_ncols=True):
            samples = [videos.sample(n) for n in numbers[start : start + _VIDEOS]]
            depth = torch.from_numpy(np.stack([s.depth for s in samples])).to(device)
            with torch.no_grad(), reduce_precision(config, device):
                found = network.image_features(depth)
            features.append(found.half().cpu().numpy())
            screws += [s.screw for s in samples]
        self._features = np.concatenate(features) if features else np.zeros((0, 0, 0), np.float16)
        self._screws = screws

    def __len__(self) -> int:
        return len(self._screws)

    def sample(self, number: int) -> FeatureSample:
        """Return the sample of any number."""
        _, place = draw_place(self.seed, number, len(self))
        return FeatureSample(self._features[place].astype(np.float32), self._screws[place])
