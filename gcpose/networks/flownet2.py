"""FlowNet2 (Ilg et al., CVPR 2017), the flow network of the paper.

Names, shapes and order of its 162,518,834 parameters are those of the official PyTorch checkpoint,
which is licensed for research only and not distributed with gcbench.
"""

# pyright: basic
from __future__ import annotations

from collections.abc import Sequence

from .torch_runtime import F, Tensor, nn, torch, warp_image

FLOWNET2_MULTIPLE = 64
"""Sides of the images must be multiples of this, px."""
_SCALE = 20.0  # px, unit of the inner networks' flow
_STEPS, _STEP = 10, 2  # displacements to each side in the correlation; size of one, cells


class FlowNet2(nn.Module):
    """Five networks: one correlates features, two correct it, one sees small motion, one fuses."""

    def __init__(self) -> None:
        super().__init__()
        self.flownetc = _Correlating()
        self.flownets_1 = _Simple()
        self.flownets_2 = _Simple()
        self.flownets_d = _Small()
        self.flownetfusion = _Fusion()

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Return the flow [B 2 H W] px from images a to b [B 3 H W] in 0..1."""
        mean = torch.stack([a, b]).mean((0, 3, 4))[..., None, None]  # of each channel over the pair
        a, b = a - mean, b - mean
        pair = torch.cat([a, b], 1)
        flow = _bilinear(_SCALE * self.flownetc(a, b))
        flow = _bilinear(_SCALE * self.flownets_1(_with_residual(a, b, flow)))
        large = _nearest(_SCALE * self.flownets_2(_with_residual(a, b, flow)))
        small = _nearest(self.flownets_d(pair) / _SCALE)  # as in training
        residual = [_length(a - warp_image(b, f)) for f in (small, large)]
        return self.flownetfusion(
            torch.cat([a, small, large, _length(small), _length(large), *residual], 1)
        )


class _Decoding(nn.Module):
    """A decoder from coarse to fine: each level has skip features, those of the coarser level, and
    its flow."""

    def levels(self, sizes: Sequence[tuple[int, int, int, int]], top: tuple[int, int],
               between: bool, bias: bool = True) -> None:
        """Add modules for `sizes`: level, input, output and intermediate channels.

        `top` is the coarser level and its channels.
        """
        self._levels = [size[0] for size in sizes]
        level, channels = top
        self.add_module(f"predict_flow{level}", nn.Conv2d(channels, 2, 3, 1, 1))
        for level, inputs, outputs, middle in sizes:
            up = nn.ConvTranspose2d(2, 2, 4, 2, 1, bias=bias)
            self.add_module(f"upsampled_flow{level + 1}_to_{level}", up)
            self.add_module(f"deconv{level}", _deconvolution(channels, outputs))
            if between:
                self.add_module(f"inter_conv{level}",
                                nn.Sequential(nn.Conv2d(inputs, middle, 3, 1, 1)))
            self.add_module(f"predict_flow{level}",
                            nn.Conv2d(middle if between else inputs, 2, 3, 1, 1))
            channels = inputs

    def decode(self, top: Tensor, skips: Sequence[Tensor]) -> Tensor:
        """Return the finest flow from the coarsest features and the skip features of each level."""
        x, flow = top, self.get_submodule(f"predict_flow{self._levels[0] + 1}")(top)
        for level, skip in zip(self._levels, skips, strict=True):
            up = self.get_submodule(f"upsampled_flow{level + 1}_to_{level}")(flow)
            x = torch.cat([skip, self.get_submodule(f"deconv{level}")(x), up], 1)
            between = getattr(self, f"inter_conv{level}", None)
            flow = self.get_submodule(f"predict_flow{level}")(between(x) if between else x)
        return flow


_LEVELS = ((5, 1026, 512, 512), (4, 770, 256, 256), (3, 386, 128, 128), (2, 194, 64, 64))


class _Deep(_Decoding):
    """Levels 3 to 6, which three of the networks share."""

    def add_deep_levels(self, inputs: int, between: bool = False, bias: bool = True) -> None:
        self.conv3_1 = _convolution(inputs, 256)
        self.conv4, self.conv4_1 = _convolution(256, 512, 3, 2), _convolution(512, 512)
        self.conv5, self.conv5_1 = _convolution(512, 512, 3, 2), _convolution(512, 512)
        self.conv6, self.conv6_1 = _convolution(512, 1024, 3, 2), _convolution(1024, 1024)
        self.levels(_LEVELS, (6, 1024), between, bias)

    def run_deep_levels(self, second: Tensor, third: Tensor) -> Tensor:
        third = self.conv3_1(third)
        fourth = self.conv4_1(self.conv4(third))
        fifth = self.conv5_1(self.conv5(fourth))
        return self.decode(self.conv6_1(self.conv6(fifth)), [fifth, fourth, third, second])


class _Correlating(_Deep):
    def __init__(self) -> None:
        super().__init__()
        self.conv1, self.conv2 = _convolution(3, 64, 7, 2), _convolution(64, 128, 5, 2)
        self.conv3, self.conv_redir = _convolution(128, 256, 5, 2), _convolution(256, 32, 1)
        self.add_deep_levels(473)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        second = self.conv2(self.conv1(a))
        third, other = self.conv3(second), self.conv3(self.conv2(self.conv1(b)))
        matches = F.leaky_relu(correlation(third, other), 0.1)
        return self.run_deep_levels(second, torch.cat([self.conv_redir(third), matches], 1))


class _Simple(_Deep):
    def __init__(self) -> None:
        super().__init__()
        self.conv1, self.conv2 = _convolution(12, 64, 7, 2), _convolution(64, 128, 5, 2)
        self.conv3 = _convolution(128, 256, 5, 2)
        self.add_deep_levels(256, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        second = self.conv2(self.conv1(x))
        return self.run_deep_levels(second, self.conv3(second))


class _Small(_Deep):
    def __init__(self) -> None:
        super().__init__()
        self.conv0 = _convolution(6, 64)
        self.conv1, self.conv1_1 = _convolution(64, 64, 3, 2), _convolution(64, 128)
        self.conv2, self.conv2_1 = _convolution(128, 128, 3, 2), _convolution(128, 128)
        self.conv3 = _convolution(128, 256, 3, 2)
        self.add_deep_levels(256, between=True)

    def forward(self, x: Tensor) -> Tensor:
        second = self.conv2_1(self.conv2(self.conv1_1(self.conv1(self.conv0(x)))))
        return self.run_deep_levels(second, self.conv3(second))


class _Fusion(_Decoding):
    def __init__(self) -> None:
        super().__init__()
        self.conv0 = _convolution(11, 64)
        self.conv1, self.conv1_1 = _convolution(64, 64, 3, 2), _convolution(64, 128)
        self.conv2, self.conv2_1 = _convolution(128, 128, 3, 2), _convolution(128, 128)
        self.levels(((1, 162, 32, 32), (0, 82, 16, 16)), (2, 128), True)

    def forward(self, x: Tensor) -> Tensor:
        full = self.conv0(x)
        half = self.conv1_1(self.conv1(full))
        return self.decode(self.conv2_1(self.conv2(half)), [half, full])


def correlation(a: Tensor, b: Tensor) -> Tensor:
    """Return the channel means [B 441 h w] of a(x) b(x + d), d = -20, -18 .. 20, rows first."""
    _, _, h, w = a.shape
    edge = _STEPS * _STEP
    wide = F.pad(b, (edge, edge, edge, edge))
    shifts = range(0, 2 * edge + 1, _STEP)
    return torch.stack(
        [(a * wide[:, :, v : v + h, u : u + w]).mean(1) for v in shifts for u in shifts], 1
    )


def _with_residual(a: Tensor, b: Tensor, flow: Tensor) -> Tensor:
    """[B 12 H W] the pair, b warped by the flow, the flow, and the difference from a."""
    there = warp_image(b, flow)
    return torch.cat([a, b, there, flow / _SCALE, _length(a - there)], 1)


def _length(x: Tensor) -> Tensor:
    return x.square().sum(1, keepdim=True).sqrt()


def _bilinear(flow: Tensor) -> Tensor:
    return F.interpolate(flow, scale_factor=4, mode="bilinear", align_corners=False)


def _nearest(flow: Tensor) -> Tensor:
    return F.interpolate(flow, scale_factor=4, mode="nearest")


def _convolution(inputs: int, outputs: int, size: int = 3, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, (size - 1) // 2), nn.LeakyReLU(0.1)
    )


def _deconvolution(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.ConvTranspose2d(inputs, outputs, 4, 2, 1), nn.LeakyReLU(0.1))
