"""The network of the foreground (`gcpose.networks.foreground`) in NumPy: it needs no PyTorch."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..numerics import Image
from .convolution import Filter, WeightReader, read_network
from .foreground_input import FOREGROUND_CHANNELS

FOREGROUND_WEIGHTS = Path(__file__).parents[1] / "weights" / "foreground.safetensors"
"""The weights that gcbench has."""
PEOPLE_WEIGHTS = FOREGROUND_WEIGHTS.with_name("people.safetensors")
"""Those of the same network for people."""
_LEVELS = 4


class ForegroundInference:
    """The network, ready to run."""

    def __init__(self, read: WeightReader) -> None:
        """Read the weights.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        self._enter: list[Filter] = []
        self._encode: list[Filter] = []
        self._exchange: list[Filter] = []
        channels = 4 * FOREGROUND_CHANNELS
        for k in range(_LEVELS):
            self._enter.append(read.normalized_filter(f"enter.{k}", channels, 3))
            channels = self._enter[-1].outputs
            self._encode.append(read.normalized_filter(f"encode.{k}", channels, 3, channels))
            if k:
                self._exchange.append(
                    read.normalized_filter(f"exchange.{k - 1}", 3 * channels, 1, channels))
        self._bottom = read.normalized_filter("bottom", channels, 3, channels)
        widths = [f.outputs for f in self._enter]
        self._rise = [read.normalized_filter(f"rise.{k}", widths[k + 1], 1, widths[k])
                      for k in range(_LEVELS - 1)]
        self._decode = [read.normalized_filter(f"decode.{k}", widths[k], 3, widths[k])
                        for k in range(_LEVELS - 1)]
        self._out = read.filter("out", widths[0], 3, 4)

    def __call__(self, frames: Image) -> Image:
        """Return logits [T S S] of frames [T C S S]; positive where something moves."""
        x = _unshuffle(frames)
        levels: list[Image] = []
        for k, (enter, encode) in enumerate(zip(self._enter, self._encode, strict=True)):
            x = encode(enter(x, stride=2 if k else 1))
            if k:
                shared = np.concatenate([x.mean(axis=0), x.max(axis=0)], axis=2)
                both = np.broadcast_to(shared, (len(x), *shared.shape))
                x = self._exchange[k - 1](np.concatenate([x, both], axis=3))
            levels.append(x)
        x = self._bottom(x)
        for k in reversed(range(_LEVELS - 1)):
            large = self._rise[k](x).repeat(2, axis=1).repeat(2, axis=2)
            x = self._decode[k](levels[k] + large)
        return _shuffle(self._out(x, rectify=False))


def load_foreground(
    path: Path = FOREGROUND_WEIGHTS, name: str = "the foreground"
) -> ForegroundInference:
    """Load the network from a safetensors file; `name` is what it finds.

    Raises:
        ConfigError: If the file is missing, damaged, or holds another network's weights.
    """
    return ForegroundInference(read_network(path, name))


def _unshuffle(frames: Image) -> Image:
    """Return [T S/2 S/2 4C] of [T C S S]: the four pixels of a cell become channels."""
    count, channels, height, width = frames.shape
    cells = frames.reshape(count, channels, height // 2, 2, width // 2, 2)
    return np.ascontiguousarray(cells.transpose(0, 2, 4, 1, 3, 5)).reshape(
        count, height // 2, width // 2, -1)


def _shuffle(x: Image) -> Image:
    """Return [T S S] of [T S/2 S/2 4]."""
    count, height, width, _ = x.shape
    cells = x.reshape(count, height, width, 2, 2).transpose(0, 1, 3, 2, 4)
    return np.ascontiguousarray(cells).reshape(count, 2 * height, 2 * width)
