"""The network of optical flow (`gcpose.networks.raft`) in NumPy: it needs no PyTorch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..numerics import Image, compiled, thread_map
from .convolution import WeightReader, read_network
from .settings import FlowSettings

RAFT_WEIGHTS = Path(__file__).parents[1] / "weights" / "raft.safetensors"
"""The weights that gcbench has."""
RAFT_TRAINING = "supervised: flow of synthetic video"
_CELL, _MULTIPLE, _REACH, _LOOK = 4, 16, 5, 3  # as in `gcpose.networks.raft`
_DILATIONS = (1, 2)
_HIDDEN, _GROUPS = 64, 8
_DEFAULT = FlowSettings()


@dataclass(frozen=True)
class RaftInference:
    """The network, ready to run, and the size of the images that it sees: a `Flow`."""

    network: RaftNetwork
    settings: FlowSettings = _DEFAULT
    factor: float = 0
    """Reduction of the images; 0: as the settings say"""
    training: str = RAFT_TRAINING

    def for_cuts_of(self, height: int, width: int) -> RaftInference:
        """Return the same for crops of images of a size, reduced as whole images are."""
        factor = self.settings.raft_reduction(height, width)
        return RaftInference(self.network, self.settings, factor)

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the flow [H W 2] px."""
        height, width = rgb_a.shape[:2]
        factor = self.factor or self.settings.raft_reduction(height, width)
        small = (max(1, round(width / factor)), max(1, round(height / factor)))
        a, b = (_pad(np.divide(cv2.resize(image, small, interpolation=cv2.INTER_AREA), 255,
                               dtype=np.float32)) for image in (rgb_a, rgb_b))
        with threadpool_limits(1, "blas"):  # beside other processes its threads mostly wait
            flow = self.network(a, b, self.settings.raft_iterations)[: small[1], : small[0]]
        full = cv2.resize(flow, (width, height), interpolation=cv2.INTER_LINEAR)
        return full * np.array([width / small[0], height / small[1]], np.float32)


class RaftNetwork:
    """The network alone."""

    def __init__(self, read: WeightReader) -> None:
        """Read the weights.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        looked, hidden = len(_DILATIONS) * (2 * _LOOK + 1) ** 2, _HIDDEN
        self._features = _FeatureEncoder(read, "features", 3)
        self._context = _ContextEncoder(read, "context")
        self._seen = read.filter("seen", looked, 1, 80)
        self._moved = read.filter("moved", 2, 3, 32)
        self._both = read.filter("both", 112, 3, 62)
        self._known = read.filter("known", hidden, 3, 3 * hidden)
        self._gates = read.filter("gates", 64 + hidden, 3, 2 * hidden)
        self._news = read.filter("news", 64 + hidden, 3, hidden)
        self._wide = read.filter("wide", hidden, 3, 64)
        self._near = read.filter("near", hidden, 3, 64)
        self._step = read.filter("step", 64, 3, 2)
        self._mask = (read.filter("mask.0", hidden, 3, 64),
                      read.filter("mask.2", 64, 1, 9 * _CELL**2))

    def __call__(self, a: Image, b: Image, iterations: int) -> Image:
        """Return the flow [H W 2] px from images a to b [H W 3] in 0..1, whose sides are multiples
        of 16 px."""
        a, b = 2 * a - 1, 2 * b - 1
        fa, fb = _normalize(thread_map(self._features, (a, b)))
        state = self._context(np.concatenate([a, b, 2 * (b - a)], axis=2), _pool(abs(b - a), _CELL))
        hidden = np.tanh(state[..., :_HIDDEN])
        known = self._known.of_frame(np.maximum(state[..., _HIDDEN:], 0), rectify=False)
        windows = [_correlations(fa, _blur(fb) if d > 1 else fb, d) for d in _DILATIONS]
        flow = np.zeros((*fa.shape[:2], 2), np.float32)
        for _ in range(iterations):
            motion = self._motion(windows, flow)
            gates = _sigmoid(self._gates.of_frame(
                np.concatenate([hidden, motion], axis=2), rectify=False)
                + known[..., : 2 * _HIDDEN])
            keep, use = gates[..., :_HIDDEN], gates[..., _HIDDEN:]
            news = np.tanh(self._news.of_frame(
                np.concatenate([use * hidden, motion], axis=2), rectify=False)
                + known[..., 2 * _HIDDEN :])
            hidden = (1 - keep) * hidden + keep * news
            around = _enlarge(self._wide.of_frame(_pool(hidden, 2)))
            near = self._near.of_frame(hidden, rectify=False)
            flow = flow + self._step.of_frame(np.maximum(near + around, 0), rectify=False)
        mask = self._mask[1].of_frame(self._mask[0].of_frame(hidden), rectify=False)
        return _upsample(flow, np.divide(mask, 4, dtype=np.float32))

    def _motion(self, windows: list[Image], flow: Image) -> Image:
        """Return what is known of the motion [h w 64] where the flow points."""
        seen = np.concatenate([_sample(window, np.divide(flow, d, dtype=np.float32))
                               for window, d in zip(windows, _DILATIONS, strict=True)], axis=2)
        both = [self._seen.of_frame(seen), self._moved.of_frame(flow)]
        return np.concatenate([self._both.of_frame(np.concatenate(both, axis=2)), flow], axis=2)


def load_raft(path: Path = RAFT_WEIGHTS, settings: FlowSettings = _DEFAULT) -> RaftInference:
    """Load the flow from a safetensors file.

    Raises:
        ConfigError: If the file is missing, damaged, or holds another network's weights.
    """
    return RaftInference(RaftNetwork(read_network(path, "raft")), settings)


class _Residual:
    """Two convolutions with a skip connection."""

    def __init__(self, read: WeightReader, name: str, inputs: int, outputs: int, stride: int = 1):
        self._first = read.filter(f"{name}.first", inputs, 3, outputs)
        self._second = read.filter(f"{name}.second", outputs, 3, outputs)
        self._norms = [read.normalization(f"{name}.norms.{k}", outputs, _GROUPS) for k in range(2)]
        same = inputs == outputs and stride == 1
        self._around = None if same else read.filter(f"{name}.around", inputs, 1, outputs)
        self._stride = stride

    def __call__(self, x: Image) -> Image:
        y = np.maximum(self._norms[0](self._first.of_frame(x, self._stride, rectify=False)), 0)
        y = self._norms[1](self._second.of_frame(y, rectify=False))
        around = x if self._around is None else self._around.of_frame(
            x, self._stride, rectify=False)
        return np.maximum(around + y, 0)


class _FeatureEncoder:
    """Features [H/4 W/4 64] of a frame."""

    def __init__(self, read: WeightReader, name: str, inputs: int) -> None:
        self._stem = read.filter(f"{name}.stem", inputs, 7, 32)
        self._norm = read.normalization(f"{name}.norm", 32, _GROUPS)
        self._body = [_Residual(read, f"{name}.body.0", 32, 32),
                      _Residual(read, f"{name}.body.1", 32, 64, 2),
                      _Residual(read, f"{name}.body.2", 64, 64)]
        self._out = read.filter(f"{name}.out", 64, 1, 64)

    def __call__(self, x: Image) -> Image:
        x = np.maximum(self._norm(self._stem.of_frame(x, 2, rectify=False)), 0)
        for layer in self._body:
            x = layer(x)
        return self._out.of_frame(x, rectify=False)


class _ContextEncoder:
    """Features [H/4 W/4 128] of two frames and their difference, as a U-Net of three levels."""

    def __init__(self, read: WeightReader, name: str) -> None:
        self._encoder = _FeatureEncoder(read, f"{name}.encoder", 9)
        self._coarse = read.filter(f"{name}.coarse", 3, 3, 64)
        self._down = [_Residual(read, f"{name}.down.0", 64, 64, 2),
                      _Residual(read, f"{name}.down.1", 64, 80, 2)]
        self._up = [read.filter(f"{name}.up.0", 64, 1, 64), read.filter(f"{name}.up.1", 80, 1, 64)]
        self._mix = [_Residual(read, f"{name}.mix.{k}", 64, 64) for k in range(2)]
        self._out = read.filter(f"{name}.out", 64, 1, 2 * _HIDDEN)

    def __call__(self, images: Image, coarse: Image) -> Image:
        quarter = np.maximum(
            self._encoder(images) + self._coarse.of_frame(coarse, rectify=False), 0)
        eighth = self._down[0](quarter)
        below = self._up[1].of_frame(self._down[1](eighth), rectify=False)
        eighth = self._mix[1](eighth + _enlarge(below))
        below = self._up[0].of_frame(eighth, rectify=False)
        return self._out.of_frame(self._mix[0](quarter + _enlarge(below)), rectify=False)


@compiled
def _correlations(fa: Image, fb: Image, dilation: int) -> Image:
    """Return products [h w n n] of the features [h w C] of each cell with those around it, as
    `gcpose.networks.raft.correlations`."""
    h, w, channels = fa.shape
    n = 2 * _REACH + 1
    out = np.zeros((h, w, n, n), np.float32)
    scale = np.float32(1 / np.sqrt(channels))
    for y in range(h):
        for i in range(n):
            v = y + (i - _REACH) * dilation
            if v < 0 or v >= h:
                continue
            for x in range(w):
                for j in range(n):
                    u = x + (j - _REACH) * dilation
                    if 0 <= u < w:
                        total = np.float32(0)
                        for c in range(channels):
                            total += fa[y, x, c] * fb[v, u, c]
                        out[y, x, i, j] = total * scale
    return out


@compiled
def _sample(windows: Image, flow: Image) -> Image:
    """Return correlations [h w m*m] around where the flow [h w 2] points, as
    `gcpose.networks.raft.sample_windows`."""
    h, w, n, _ = windows.shape
    m = 2 * _LOOK + 1
    out = np.zeros((h, w, m * m), np.float32)
    for y in range(h):
        for x in range(w):
            at_u = min(max(flow[y, x, 0] + np.float32(_REACH), np.float32(-20)), np.float32(n + 20))
            at_v = min(max(flow[y, x, 1] + np.float32(_REACH), np.float32(-20)), np.float32(n + 20))
            first_u, first_v = int(np.floor(at_u)), int(np.floor(at_v))
            share_u, share_v = at_u - np.float32(first_u), at_v - np.float32(first_v)
            for i in range(m + 1):
                v = first_v - _LOOK + i
                if v < 0 or v >= n:
                    continue
                for j in range(m + 1):
                    u = first_u - _LOOK + j
                    if u < 0 or u >= n:
                        continue
                    value = windows[y, x, v, u]
                    for k in range(max(i - 1, 0), min(i, m - 1) + 1):
                        by_v = share_v if k == i - 1 else 1 - share_v
                        for o in range(max(j - 1, 0), min(j, m - 1) + 1):
                            by_u = share_u if o == j - 1 else 1 - share_u
                            out[y, x, k * m + o] += value * by_v * by_u
    return out


def _upsample(flow: Image, mask: Image) -> Image:
    """Return the flow [H W 2] px of a flow [h w 2] in cells, at each pixel a convex combination of
    nine cells by the logits [h w 9*16] of `mask`."""
    h, w, _ = flow.shape
    share = mask.reshape(h, w, 9, _CELL**2)
    share = np.exp(share - share.max(axis=2, keepdims=True))
    share /= share.sum(axis=2, keepdims=True)
    wide = np.pad(_CELL * flow, ((1, 1), (1, 1), (0, 0)), mode="edge")
    cells = np.stack([wide[v : v + h, u : u + w] for v in range(3) for u in range(3)], axis=2)
    out = np.einsum("hwnp,hwnc->hwpc", share, cells)
    out = out.reshape(h, w, _CELL, _CELL, 2).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(out).reshape(_CELL * h, _CELL * w, 2)


def _normalize(features: list[Image]) -> tuple[Image, Image]:
    """Center each channel of both frames and scale it to unit variance."""
    both = np.stack(features)
    mean = both.mean(axis=(0, 1, 2))
    scale = np.sqrt(both.var(axis=(0, 1, 2)) + np.float32(1e-4))
    both = (both - mean) / scale
    return both[0], both[1]


def _pad(image: Image) -> Image:
    """Return an image whose edge is repeated to multiples of the sides that the network needs."""
    below, right = (-side % _MULTIPLE for side in image.shape[:2])
    return np.pad(image, ((0, below), (0, right), (0, 0)), mode="edge")


def _pool(x: Image, size: int) -> Image:
    h, w, c = x.shape
    return x.reshape(h // size, size, w // size, size, c).mean(axis=(1, 3), dtype=np.float32)


def _blur(x: Image) -> Image:
    """Return the mean of 3 x 3 cells, at the edge of those that there are."""
    total, count = (cv2.boxFilter(y, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
                    for y in (x, np.ones(x.shape[:2], np.float32)))
    return np.divide(total, count[..., None], dtype=np.float32)


def _enlarge(x: Image) -> Image:
    """Return [2h 2w C] of [h w C], bilinear; a pixel's place is its center."""
    for axis in range(2):
        one = np.take(x, range(-1, x.shape[axis] - 1), axis, mode="clip")
        two = np.take(x, range(1, x.shape[axis] + 1), axis, mode="clip")
        both = np.stack([0.75 * x + 0.25 * one, 0.75 * x + 0.25 * two], axis + 1, dtype=np.float32)
        x = both.reshape(*(n * (2 if k == axis else 1) for k, n in enumerate(x.shape)))
    return x


def _sigmoid(x: Image) -> Image:
    with np.errstate(over="ignore"):  # then it is zero
        return np.reciprocal(1 + np.exp(-x), dtype=np.float32)
