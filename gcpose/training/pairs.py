"""Pairs of images with true flow, read from datasets, cropped and changed at random."""

from __future__ import annotations

from collections.abc import Sequence as Row
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.dataset import Dataset, open_dataset
from ...renderer.runtime import address
from ...renderer.types import OCCLUDED, OUT_OF_IMAGE, Sequence
from .config import AugmentationConfig, FlowTraining, LossConfig

STATIC_MOTION = 0.05
"""Mean motion below which a part counts as background, px."""
MAX_PARTS = 64
"""Parts of an image that the loss distinguishes."""
_Index = slice | NDArray[np.int64]


class FramePair(NamedTuple):
    """Two images of a sequence and the truth about them."""

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

    def select(self, rows: _Index, columns: _Index, factor: Row[float] = (1.0, 1.0)) -> FramePair:
        """Return some rows and columns, with the flow (u, v) multiplied by a factor."""
        return FramePair(
            self.a[rows][:, columns], self.b[rows][:, columns],
            self.flow[rows][:, columns] * np.array(factor, np.float32),
            self.part[rows][:, columns], self.seen[rows][:, columns],
        )


@dataclass(frozen=True)
class Sample:
    """A crop of h x w pixels, as the network learns from it."""

    a: NDArray[np.float32]
    """[3 h w] 0..1"""
    b: NDArray[np.float32]
    """[3 h w]"""
    flow: NDArray[np.float32]
    """[2 h w] px"""
    part: NDArray[np.int64]
    """[h w] 0: static"""
    weight: NDArray[np.float32]
    """[h w] of sum 1; the weight of a part is by the root of its size"""


class Pairs:
    """All pairs of neighboring frames of datasets, in both directions.

    Sample i of a seed is always the same.
    """

    def __init__(self, folders: Row[Path], config: FlowTraining) -> None:
        """Open datasets; `config` has the seed, the crop, augmentation and weights.

        Raises:
            DatasetError: If there are no pairs of frames.
        """
        self.datasets = [open_dataset(folder) for folder in folders]
        self.config = config
        self._ends = np.cumsum([_steps(d) * len(d) * 2 for d in self.datasets], dtype=np.int64)
        if not self.datasets or not self._ends[-1]:
            where = address(folders[0]) if folders else "the datasets"
            raise DatasetError(f"there are no pairs of frames in {where}"
                               + " and the others" * (len(folders) > 1))

    def __len__(self) -> int:
        return int(self._ends[-1])

    def pair(self, index: int) -> FramePair:
        """Return pair `index` in 0 .. len - 1: frames t and t + 1, or t + 1 and t."""
        which = int(np.searchsorted(self._ends, index, side="right"))
        dataset = self.datasets[which]
        index = index - (int(self._ends[which - 1]) if which else 0)
        number, step = divmod(index, 2 * _steps(dataset))
        return read_pair(dataset[number], step // 2, backward=bool(step % 2))

    def sample(self, number: int) -> Sample:
        """Return the sample of any number."""
        rng = np.random.default_rng([self.config.seed, number])
        return draw_sample(self.pair(int(rng.integers(len(self)))), self.config, rng)


def _steps(dataset: Dataset) -> int:
    return dataset.config.frames - 1


def read_pair(sequence: Sequence, t: int, backward: bool = False) -> FramePair:
    """Return frames t and t + 1 with the flow between, or from t + 1 back to t."""
    if backward:
        flow, part = sequence.stack("flow_backward")[t], sequence.part[t + 1]
        u, v = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in part.shape[::-1]))
        there = cv2.remap(sequence.part[t], u + np.nan_to_num(flow[..., 0], nan=-1e4),
                          v + np.nan_to_num(flow[..., 1]), cv2.INTER_NEAREST, borderValue=65535)
        seen = np.asarray(there) == part
    else:
        flow, part = sequence.stack("flow")[t], sequence.part[t]
        seen = ~np.isin(sequence.stack("visibility")[t], (OCCLUDED, OUT_OF_IMAGE))
    # Flow is unknown without a surface (a backdrop), which is static, as the camera is.
    flow = np.where((part == 0)[..., None], np.nan_to_num(flow), flow)
    a, b = (sequence.rgb[i] for i in ((t + 1, t) if backward else (t, t + 1)))
    return FramePair(a, b, flow, part.astype(np.int64), seen)


def draw_sample(pair: FramePair, config: FlowTraining, rng: np.random.Generator) -> Sample:
    """Return a crop around something that moves, resized, mirrored and with other colors."""
    augmentation = config.augmentation
    pair = _mirror(_crop(pair, config.crop, augmentation, rng), augmentation, rng)
    a, b = _recolor(pair.a, pair.b, augmentation, rng)
    part, weight = weigh_pixels(pair, config.loss)
    first, second = (_channels(np.multiply(x, 1 / 255, dtype=np.float32)) for x in (a, b))
    flow = np.nan_to_num(pair.flow)
    return Sample(first, second, _channels(flow), part, weight)


def _channels(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """[C H W] of [H W C]."""
    return np.ascontiguousarray(np.moveaxis(image, 2, 0))


def weigh_pixels(
    pair: FramePair, config: LossConfig
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return part numbers [H W], 0 where static, and weights [H W] of sum 1."""
    known = np.isfinite(pair.flow).all(axis=2)
    speed = np.linalg.norm(np.nan_to_num(pair.flow), axis=2)
    numbers = max(MAX_PARTS, int(pair.part.max()) + 1)
    counts = np.bincount(pair.part[known], minlength=numbers)
    total = np.bincount(pair.part[known], speed[known], minlength=numbers)
    moving = (total > STATIC_MOTION * np.maximum(counts, 1)) & (np.arange(len(counts)) < MAX_PARTS)
    moving[0] = False
    part = np.where(moving[pair.part], pair.part, 0)
    counts = np.bincount(part[known], minlength=numbers)
    share = np.sqrt(counts) * (np.arange(len(counts)) > 0)
    share *= config.moving / max(float(share.sum()), 1e-9)
    share[0] = 1.0 - config.moving
    weight = (share / np.maximum(counts, 1))[part] * known
    weight = weight * np.where(pair.seen, 1.0, config.hidden)
    weight /= 1.0 + config.speed_discount * speed
    return part, (weight / max(float(weight.sum()), 1e-9)).astype(np.float32)


def _crop(
    pair: FramePair, crop: tuple[int, int], config: AugmentationConfig, rng: np.random.Generator
) -> FramePair:
    """A window around a moving pixel, sometimes resized."""
    height, width = pair.part.shape
    scale = 1.0
    if rng.random() < config.resize_probability:
        scale = float(np.exp(rng.uniform(*np.log(config.resize))))
    scale = max(scale, crop[0] / width, crop[1] / height)
    w, h = (min(round(c / scale), n) for c, n in zip(crop, (width, height), strict=True))
    motion = np.nan_to_num(np.abs(pair.flow)).sum(axis=2)[::4, ::4]
    moving = np.flatnonzero(motion > 2 * STATIC_MOTION)
    v, u = height // 2, width // 2
    if len(moving):
        v, u = (4 * int(x) for x in np.divmod(rng.choice(moving), -(-width // 4)))
    left = int(np.clip(u - w // 2 + rng.integers(-w // 3, w // 3 + 1), 0, width - w))
    top = int(np.clip(v - h // 2 + rng.integers(-h // 3, h // 3 + 1), 0, height - h))
    window = pair.select(slice(top, top + h), slice(left, left + w))
    if (w, h) == crop:
        return window
    smooth = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    a, b = (np.asarray(cv2.resize(x, crop, interpolation=smooth), np.uint8)
            for x in (window.a, window.b))
    rows, columns = (np.minimum((np.arange(n) + 0.5) * size / n, size - 1).astype(np.int64)
                     for n, size in ((crop[1], h), (crop[0], w)))
    return window.select(rows, columns, (crop[0] / w, crop[1] / h))._replace(a=a, b=b)


def _mirror(
    pair: FramePair, config: AugmentationConfig, rng: np.random.Generator
) -> FramePair:
    """Mirror along each axis at random."""
    forward, back = slice(None), slice(None, None, -1)
    if rng.random() < config.mirror_probability:
        pair = pair.select(forward, back, (-1.0, 1.0))
    if rng.random() < config.mirror_probability:
        pair = pair.select(back, forward, (1.0, -1.0))
    return pair


def _recolor(
    a: NDArray[np.uint8], b: NDArray[np.uint8], config: AugmentationConfig,
    rng: np.random.Generator,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Permute channels and change tones of both images, then exposure, noise and blur of each."""
    channels = rng.permutation(3)
    gamma, offset = rng.uniform(*config.gamma), rng.uniform(*config.offset)
    gain = np.ones(3)
    if rng.random() < config.gain_probability:
        gain = rng.uniform(*config.gain) * rng.uniform(*config.channel_gain, 3)
    apart = rng.uniform(*config.exposure) if rng.random() < config.exposure_probability else 1.0
    tone = np.arange(256) / 255.0
    sigma = rng.uniform(*config.noise) if rng.random() < config.noise_probability else 0.0
    blur = rng.uniform(*config.blur) if rng.random() < config.blur_probability else 0.0
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
