"""What the networks for depth videos of one joint share: features of each image by a ResNet-18."""

# pyright: basic
from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from .resnet import ResNet18
from .torch_runtime import Tensor, nn


class DepthVideoNetwork(nn.Module):
    """Features of each depth image; a subclass finds the motion in those of all images."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.feature_count = 1000 * width // 64
        self.encoder = ResNet18(width)
        self.features = nn.Linear(8 * width, self.feature_count)

    def forward(self, depth: Tensor) -> Tensor:
        """Return the output for depth videos [B T H W] (see `depth_images.fit_depth`)."""
        return self.motion(self.image_features(depth))

    def image_features(self, depth: Tensor) -> Tensor:
        """Return the features [B T F] of each image of depth videos [B T H W]."""
        images = depth.flatten(0, 1)[:, None].expand(-1, 3, -1, -1)
        return self.features(self.encoder(images)[-1].mean((2, 3))).unflatten(0, depth.shape[:2])

    @abstractmethod
    def motion(self, features: Tensor) -> Tensor:
        """Return the output for videos with these features [B T F] of their images."""

    def freeze_features(self, frozen: bool) -> None:
        """Keep the features of an image as they are, statistics too; or learn them."""
        for part in (self.encoder, self.features):
            part.requires_grad_(not frozen).train(self.training and not frozen)


def encoder_width(tensors: Mapping[str, Tensor]) -> int:
    """Return the width of the network for depth images that has these tensors; 0 if it is none."""
    first = tensors.get("encoder.conv1.weight")
    return 0 if first is None or first.ndim != 4 else int(first.shape[0])
