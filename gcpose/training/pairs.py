"""Pairs of images to learn flow from: read from datasets, cropped and changed at random."""

from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from ...renderer.dataset import Dataset, open_dataset
from ...renderer.types import OCCLUDED, OUT_OF_IMAGE, Sequence

STILL = 0.05  # px; parts that move less count as background
_MOVING = 0.8  # weight of all moving parts together
_HIDDEN = 0.2  # weight of a pixel that the other image does not show
MOST_PARTS = 64


_Index = slice | NDArray[np.int64]


class Pair(NamedTuple):
    """Two images and what is true of them."""

    a: NDArray[np.uint8]
    """[H W 3]"""
    b: NDArray[np.uint8]
    """[H W 3]"""
    flow: NDArray[np.float32]
    """[H W 2] px, a to b"""
    part: NDArray[np.int64]
    """[H W] of a"""
    seen: NDArray[np.bool_]
    """[H W] whether b shows the pixel"""

    def viewed(self, rows: _Index, columns: _Index, factor: Row[float] = (1.0, 1.0)) -> Pair:
        """Those rows and columns, the flow (u, v) multiplied."""
        return Pair(
            self.a[rows][:, columns], self.b[rows][:, columns],
            self.flow[rows][:, columns] * np.array(factor, np.float32),
            self.part[rows][:, columns], self.seen[rows][:, columns],
        )  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """A crop as the network learns from it; h x w pixels."""

    a: NDArray[np.float32]
    """[3 h w] 0..1"""
    b: NDArray[np.float32]
    """[3 h w]"""
    flow: NDArray[np.float32]
    """[2 h w] px, the truth"""
    part: NDArray[np.int64]
    """[h w] 0: what does not move"""
    weight: NDArray[np.float32]
    """[h w] sums to 1; parts count by the root of their size"""


class Pairs:
    """All pairs of neighbouring frames of datasets, both ways: sample i of a seed is always one."""

    def __init__(self, folders: Row[Path], seed: int, crop: tuple[int, int] = (176, 144)) -> None:
        """`crop` is width and height. Raises GcbenchError if there are no frames to pair."""
        self.datasets = [open_dataset(folder) for folder in folders]
        self.seed, self.crop = seed, crop
        self._ends = np.cumsum([_steps(d) * len(d) * 2 for d in self.datasets], dtype=np.int64)
        if not self.datasets or not self._ends[-1]:
            raise GcbenchError("there are no pairs of frames in the datasets to learn from")

    def __len__(self) -> int:
        return int(self._ends[-1])

    def pair(self, index: int) -> Pair:
        """Pair `index` in 0 .. len - 1: frames t and t + 1, or t + 1 and t."""
        which = int(np.searchsorted(self._ends, index, side="right"))
        dataset = self.datasets[which]
        index = index - (int(self._ends[which - 1]) if which else 0)
        number, step = divmod(index, 2 * _steps(dataset))
        return pair_of(dataset[number], step // 2, backward=bool(step % 2))

    def sample(self, number: int) -> Sample:
        """The sample of a number, without end."""
        rng = np.random.default_rng([self.seed, number])
        return drawn(self.pair(int(rng.integers(len(self)))), self.crop, rng)


def _steps(dataset: Dataset) -> int:
    return dataset.config.frames - 1


def pair_of(sequence: Sequence, t: int, backward: bool = False) -> Pair:
    """Frames t and t + 1 with the flow between, or from t + 1 back to t."""
    if backward:
        flow, part = sequence.flow_backward[t], sequence.part[t + 1]
        u, v = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in part.shape[::-1]))
        there = cv2.remap(sequence.part[t], u + np.nan_to_num(flow[..., 0], nan=-1e4),
                          v + np.nan_to_num(flow[..., 1]), cv2.INTER_NEAREST, borderValue=65535)
        seen = np.asarray(there) == part
    else:
        flow, part = sequence.flow[t], sequence.part[t]
        seen = ~np.isin(sequence.visibility[t], (OCCLUDED, OUT_OF_IMAGE))
    # Without a surface the flow is unknown (a backdrop): the camera is still, and so is that.
    flow = np.where((part == 0)[..., None], np.nan_to_num(flow), flow)
    a, b = (sequence.rgb[i] for i in ((t + 1, t) if backward else (t, t + 1)))
    return Pair(a, b, flow, part.astype(np.int64), seen)


def drawn(pair: Pair, crop: tuple[int, int], rng: np.random.Generator) -> Sample:
    """A crop about something that moves: scaled, mirrored, its colours changed."""
    pair = _mirrored(_cropped(pair, crop, rng), rng)
    a, b = _colored(pair.a, pair.b, rng)
    part, weight = weighted(pair)
    first, second = (_channels(np.multiply(x, 1 / 255, dtype=np.float32)) for x in (a, b))
    flow = np.nan_to_num(pair.flow)
    return Sample(first, second, _channels(flow), part, weight)


def _channels(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """[C H W] of [H W C]."""
    return np.ascontiguousarray(np.moveaxis(image, 2, 0))


def weighted(pair: Pair) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Part numbers [H W] with 0 for all that is still, and weights [H W] that sum to 1."""
    known = np.isfinite(pair.flow).all(axis=2)
    speed = np.linalg.norm(np.nan_to_num(pair.flow), axis=2)
    numbers = max(MOST_PARTS, int(pair.part.max()) + 1)
    counts = np.bincount(pair.part[known], minlength=numbers)
    total = np.bincount(pair.part[known], speed[known], minlength=numbers)
    moving = (total > STILL * np.maximum(counts, 1)) & (np.arange(len(counts)) < MOST_PARTS)
    moving[0] = False
    part = np.where(moving[pair.part], pair.part, 0)
    counts = np.bincount(part[known], minlength=numbers)
    share = np.sqrt(counts) * (np.arange(len(counts)) > 0)
    share *= _MOVING / max(float(share.sum()), 1e-9)
    share[0] = 1.0 - _MOVING
    weight = (share / np.maximum(counts, 1))[part] * known * np.where(pair.seen, 1.0, _HIDDEN)
    weight /= 1.0 + 0.05 * speed
    return part, (weight / max(float(weight.sum()), 1e-9)).astype(np.float32)


def _cropped(pair: Pair, crop: tuple[int, int], rng: np.random.Generator) -> Pair:
    """A window around a moving pixel, at another scale half of the time."""
    height, width = pair.part.shape
    scale = float(np.exp(rng.uniform(np.log(0.75), np.log(1.6)))) if rng.random() < 0.5 else 1.0
    scale = max(scale, crop[0] / width, crop[1] / height)
    w, h = (min(round(c / scale), n) for c, n in zip(crop, (width, height), strict=True))
    moving = np.flatnonzero(np.nan_to_num(np.abs(pair.flow)).sum(axis=2)[::4, ::4] > 2 * STILL)
    v, u = height // 2, width // 2
    if len(moving):
        v, u = (4 * int(x) for x in np.divmod(rng.choice(moving), -(-width // 4)))
    left = int(np.clip(u - w // 2 + rng.integers(-w // 3, w // 3 + 1), 0, width - w))
    top = int(np.clip(v - h // 2 + rng.integers(-h // 3, h // 3 + 1), 0, height - h))
    window = pair.viewed(slice(top, top + h), slice(left, left + w))
    if (w, h) == crop:
        return window
    smooth = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    a, b = (np.asarray(cv2.resize(x, crop, interpolation=smooth), np.uint8)
            for x in (window.a, window.b))
    rows, columns = (np.minimum((np.arange(n) + 0.5) * size / n, size - 1).astype(np.int64)
                     for n, size in ((crop[1], h), (crop[0], w)))
    return window.viewed(rows, columns, (crop[0] / w, crop[1] / h))._replace(a=a, b=b)


def _mirrored(pair: Pair, rng: np.random.Generator) -> Pair:
    """Along either axis, or none."""
    forward, back = slice(None), slice(None, None, -1)
    if rng.random() < 0.5:
        pair = pair.viewed(forward, back, (-1.0, 1.0))
    if rng.random() < 0.5:
        pair = pair.viewed(back, forward, (1.0, -1.0))
    return pair


def _colored(
    a: NDArray[np.uint8], b: NDArray[np.uint8], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Channels swapped, tones bent alike in both images, exposure a little apart, noise, blur."""
    channels = rng.permutation(3)
    gamma, offset = rng.uniform(0.7, 1.4), rng.uniform(-0.1, 0.1)
    gain = rng.uniform(0.7, 1.2) * rng.uniform(0.85, 1.15, 3) if rng.random() < 0.7 else np.ones(3)
    apart = rng.uniform(0.97, 1.03) if rng.random() < 0.25 else 1.0
    tone = np.arange(256) / 255.0
    sigma = rng.uniform(0.0, 4.0) if rng.random() < 0.4 else 0.0
    blur = rng.uniform(0.3, 0.9) if rng.random() < 0.2 else 0.0
    out: list[NDArray[np.uint8]] = []
    for image, factor in ((a, 1.0), (b, apart)):
        table = np.clip(255 * (tone[:, None] ** gamma * gain * factor + offset), 0, 255)
        image = cv2.LUT(np.ascontiguousarray(image[..., channels]),
                        table.astype(np.uint8)[None])
        if blur:
            image = cv2.GaussianBlur(image, (0, 0), blur)
        if sigma:
            noise = sigma * rng.standard_normal(image.shape, np.float32)
            image = np.clip(np.rint(image + noise), 0, 255)
        out.append(np.asarray(image, np.uint8))
    return out[0], out[1]
