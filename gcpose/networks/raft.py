"""A small recurrent network for optical flow, after RAFT (Teed and Deng, ECCV 2020).

Features are at a quarter of the resolution, with a window of correlations around each cell at two
scales (20 and 40 px to each side). Starting from zero flow, a gated unit looks up correlations
where the flow points and corrects it, several times; a convex combination upsamples it. Plain
surfaces have no texture inside: the context network is a U-Net, so that outlines reach far.
`gcpose.images.raft_network` computes the same without PyTorch.
"""

# pyright: basic
from __future__ import annotations

from typing import NamedTuple

from .torch_runtime import F, Tensor, nn, torch

CELL = 4
"""Side of a cell of features, px."""
RAFT_MULTIPLE = 16
"""Sides of the images must be multiples of this, px."""
REACH = 5
"""Cells from the center of a window of correlations to its edge."""
_DILATIONS = (1, 2)
_LOOK = 3  # cells around where the flow points
_HIDDEN, _FEATURES, _GROUPS = 64, 64, 8


class RaftOutput(NamedTuple):
    """Output of the network for a pair of images."""

    coarse: list[Tensor]
    """[B 2 H/4 W/4] after each iteration, in cells"""
    fine: Tensor
    """[B 2 H W] px, after the last"""
    correlation: Tensor
    """[B H/4 W/4 11 11] of each cell with the cells around it in the other image, rows first"""


class Raft(nn.Module):
    """The network, with about 1.2 million parameters."""

    def __init__(self) -> None:
        super().__init__()
        looked = len(_DILATIONS) * (2 * _LOOK + 1) ** 2
        self.features = FeatureEncoder(3, _FEATURES)
        self.context = ContextEncoder(9, 3, 2 * _HIDDEN)
        self.seen = nn.Conv2d(looked, 80, 1)
        self.moved = nn.Conv2d(2, 32, 3, padding=1)
        self.both = nn.Conv2d(112, 62, 3, padding=1)
        self.known = nn.Conv2d(_HIDDEN, 3 * _HIDDEN, 3, padding=1)
        self.gates = nn.Conv2d(64 + _HIDDEN, 2 * _HIDDEN, 3, padding=1)
        self.news = nn.Conv2d(64 + _HIDDEN, _HIDDEN, 3, padding=1)
        self.wide = nn.Conv2d(_HIDDEN, 64, 3, padding=1)
        self.near = nn.Conv2d(_HIDDEN, 64, 3, padding=1)
        self.step = nn.Conv2d(64, 2, 3, padding=1)
        self.mask = nn.Sequential(
            nn.Conv2d(_HIDDEN, 64, 3, padding=1), nn.ReLU(), nn.Conv2d(64, 9 * CELL**2, 1)
        )
        for parameter in self.step.parameters():  # an untrained network returns zero flow
            nn.init.zeros_(parameter)

    def forward(self, a: Tensor, b: Tensor, iterations: int = 6) -> RaftOutput:
        """Return the flow from images a to b [B 3 H W] in 0..1."""
        a, b = 2 * a - 1, 2 * b - 1
        changed = F.avg_pool2d((b - a).abs(), CELL)
        flow = torch.zeros_like(changed[:, :2])
        hidden, context = self.context(torch.cat([a, b, 2 * (b - a)], 1), changed).split(_HIDDEN, 1)
        hidden, known = torch.tanh(hidden), self.known(F.relu(context))
        fa, fb = _normalize(self.features(torch.cat([a, b]))).chunk(2)
        windows = [correlations(fa, _blur(fb) if d > 1 else fb, d) for d in _DILATIONS]
        coarse: list[Tensor] = []
        for _ in range(iterations):
            flow = flow.detach()
            seen = torch.cat(
                [sample_windows(w, flow / d) for w, d in zip(windows, _DILATIONS, strict=True)], 1)
            motion = torch.cat([F.relu(self.seen(seen)), F.relu(self.moved(flow))], 1)
            motion = torch.cat([F.relu(self.both(motion)), flow], 1)
            keep, use = torch.sigmoid(
                self.gates(torch.cat([hidden, motion], 1)) + known[:, : 2 * _HIDDEN]
            ).chunk(2, 1)
            news = self.news(torch.cat([use * hidden, motion], 1)) + known[:, 2 * _HIDDEN :]
            hidden = (1 - keep) * hidden + keep * torch.tanh(news)
            around = _enlarge(F.relu(self.wide(F.avg_pool2d(hidden, 2))), hidden)
            flow = flow + self.step(F.relu(self.near(hidden) + around)).float()
            coarse.append(flow)
        return RaftOutput(coarse, upsample_flow(flow, self.mask(hidden).float() / 4), windows[0])


class Residual(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1)
        self.norms = nn.ModuleList(nn.GroupNorm(_GROUPS, outputs) for _ in range(2))
        same = inputs == outputs and stride == 1
        self.around = nn.Identity() if same else nn.Conv2d(inputs, outputs, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.norms[0](self.first(x)))
        return F.relu(self.around(x) + self.norms[1](self.second(y)))


class FeatureEncoder(nn.Module):
    """Features at a quarter of the resolution."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(inputs, 32, 7, 2, 3)
        self.norm = nn.GroupNorm(_GROUPS, 32)
        self.body = nn.Sequential(Residual(32, 32), Residual(32, 64, 2), Residual(64, 64))
        self.out = nn.Conv2d(64, outputs, 1)

    def forward(self, x: Tensor) -> Tensor:
        return self.out(self.body(F.relu(self.norm(self.stem(x)))))


class ContextEncoder(nn.Module):
    """The same with further inputs at that resolution, as a U-Net of three levels."""

    def __init__(self, inputs: int, coarse: int, outputs: int) -> None:
        super().__init__()
        self.encoder = FeatureEncoder(inputs, 64)
        self.coarse = nn.Conv2d(coarse, 64, 3, padding=1)
        self.down = nn.ModuleList([Residual(64, 64, 2), Residual(64, 80, 2)])
        self.up = nn.ModuleList([nn.Conv2d(64, 64, 1), nn.Conv2d(80, 64, 1)])
        self.mix = nn.ModuleList(Residual(64, 64) for _ in range(2))
        self.out = nn.Conv2d(64, outputs, 1)

    def forward(self, images: Tensor, coarse: Tensor) -> Tensor:
        quarter = F.relu(self.encoder(images) + self.coarse(coarse))
        eighth = self.down[0](quarter)
        sixteenth = self.down[1](eighth)
        eighth = self.mix[1](eighth + _enlarge(self.up[1](sixteenth), eighth))
        return self.out(self.mix[0](quarter + _enlarge(self.up[0](eighth), quarter)))


def correlations(fa: Tensor, fb: Tensor, dilation: int) -> Tensor:
    """Return products [B h w n n] of features [B C h w] of each cell of a with those of b near it.

    n = 2 REACH + 1 steps of `dilation` cells, rows first; zero outside of the image.
    """
    batch, channels, h, w = fa.shape
    n, edge = 2 * REACH + 1, REACH * dilation
    here = fa.permute(0, 2, 3, 1).reshape(batch * h, w, channels)
    there = F.pad(fb, (edge, edge, edge, edge)).permute(0, 2, 1, 3)  # B h' C w'
    columns = torch.arange(w, device=fa.device)[:, None]
    columns = (columns + dilation * torch.arange(n, device=fa.device)).expand(batch * h, w, n)
    rows: list[Tensor] = []
    for i in range(n):
        row = there[:, i * dilation : i * dilation + h].reshape(batch * h, channels, w + 2 * edge)
        rows.append(torch.gather(torch.bmm(here, row), 2, columns))
    return torch.stack(rows, 2).reshape(batch, h, w, n, n) / channels**0.5


def sample_windows(windows: Tensor, flow: Tensor) -> Tensor:
    """Return correlations [B m*m h w] around where the flow [B 2 h w] points, m = 2 _LOOK + 1.

    `windows` [B h w n n] are those of `correlations`, the flow is in their steps; bilinear, zero
    outside.
    """
    batch, h, w, n, _ = windows.shape
    size = 2 * _LOOK + 2
    at = (flow.permute(0, 2, 3, 1).reshape(-1, 2) + REACH).clamp(-20, n + 20)
    first = at.floor()
    share = (at - first).to(windows.dtype)
    grid = first.long()[:, :, None] - _LOOK + torch.arange(size, device=flow.device)  # N 2 size
    inside = ((grid >= 0) & (grid < n)).to(windows.dtype)
    grid = grid.clamp(0, n - 1)
    index = (grid[:, 1, :, None] * n + grid[:, 0, None, :]).reshape(-1, size * size)
    found = torch.gather(windows.reshape(-1, n * n), 1, index).reshape(-1, size, size)
    found = found * inside[:, 1, :, None] * inside[:, 0, None, :]
    u, v = share[:, 0, None, None], share[:, 1, None, None]
    found = found[:, :, :-1] * (1 - u) + found[:, :, 1:] * u
    found = found[:, :-1] * (1 - v) + found[:, 1:] * v
    return found.reshape(batch, h, w, -1).permute(0, 3, 1, 2)


def upsample_flow(flow: Tensor, mask: Tensor) -> Tensor:
    """Return the flow [B 2 H W] px, at each pixel a convex combination of nine cells around it.

    flow [B 2 h w] in cells, mask [B 9*16 h w] logits.
    """
    batch, _, h, w = flow.shape
    share = mask.reshape(batch, 1, 9, CELL, CELL, h, w).softmax(2)
    cells = F.unfold(F.pad(CELL * flow, (1, 1, 1, 1), mode="replicate"), 3)
    out = (share * cells.reshape(batch, 2, 9, 1, 1, h, w)).sum(2)
    return out.permute(0, 1, 4, 2, 5, 3).reshape(batch, 2, CELL * h, CELL * w)


def _normalize(features: Tensor) -> Tensor:
    """Center each channel and scale it to unit variance; training starts much sooner with it."""
    features = features.float()
    a, b = features.chunk(2)
    both = torch.stack([a, b])
    mean = both.mean((0, 3, 4), keepdim=True)
    scale = (both.var((0, 3, 4), keepdim=True, correction=0) + 1e-4).sqrt()
    return ((both - mean) / scale).flatten(0, 1)


def _blur(x: Tensor) -> Tensor:
    return F.avg_pool2d(x, 3, 1, 1, count_include_pad=False)


def _enlarge(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, size=like.shape[-2:], mode="bilinear", align_corners=False)
