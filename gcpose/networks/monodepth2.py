"""Monodepth2 (Godard et al., ICCV 2019): depth from one image.

Names and shapes of its parameters are those of the official checkpoint, which is licensed for
non-commercial use and not distributed with gcbench.
"""

# pyright: basic
from __future__ import annotations

from .resnet import ResNet18
from .torch_runtime import F, Tensor, nn, torch

IMAGE_WIDTH, IMAGE_HEIGHT = 640, 192
"""Size of the training images, px."""
_NEAR, _FAR = 0.1, 100.0  # range of depth, of unknown unit
_ENCODED = (64, 64, 128, 256, 512)
_DECODED = (16, 32, 64, 128, 256)


class DepthEncoder(nn.Module):
    """A ResNet-18 without its classifier (`encoder.pth`)."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ResNet18()

    def forward(self, image: Tensor) -> list[Tensor]:
        """Return features at 1/2, 1/4 .. 1/32 of an image [B 3 H W] in 0..1."""
        return self.encoder((image - 0.45) / 0.225)


class DepthDecoder(nn.Module):
    """Disparity from features (`depth.pth`)."""

    def __init__(self) -> None:
        super().__init__()
        blocks: list[nn.Module] = []
        channels = _ENCODED[-1]
        for level in (4, 3, 2, 1, 0):
            outputs = _DECODED[level]
            skip = _ENCODED[level - 1] if level else 0
            blocks += [_EluConv(channels, outputs), _EluConv(outputs + skip, outputs)]
            channels = outputs
        self.decoder = nn.ModuleList([*blocks, *(_ReflectConv(n, 1) for n in _DECODED[:4])])

    def forward(self, features: list[Tensor]) -> Tensor:
        """Return the disparity [B 1 H W] in 0..1, at the resolution of the image."""
        x = features[-1]
        for level in (4, 3, 2, 1, 0):
            first = 2 * (4 - level)
            x = F.interpolate(self.decoder[first](x), scale_factor=2, mode="nearest")
            x = torch.cat([x, features[level - 1]], 1) if level else x
            x = self.decoder[first + 1](x)
        return torch.sigmoid(self.decoder[10](x))


class _ReflectConv(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="reflect")

    def forward(self, x: Tensor) -> Tensor:
        return self.conv(x)


class _EluConv(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = _ReflectConv(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        return F.elu(self.conv(x))


def depth_from_disparity(disparity: Tensor) -> Tensor:
    """Return depth in 0.1..100, of unknown scale, from the decoder's disparity in 0..1."""
    return 1.0 / (1.0 / _FAR + (1.0 / _NEAR - 1.0 / _FAR) * disparity)
