"""The network of the foreground (`gcpose.networks.foreground`) in NumPy: it needs no PyTorch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load

from ...errors import ConfigError
from ..numerics import Image, thread_map
from .foreground_input import FOREGROUND_CHANNELS

FOREGROUND_WEIGHTS = Path(__file__).parents[1] / "weights" / "foreground.safetensors"
"""The weights that gcbench has."""
_LEVELS = 4
_EPSILON = 1e-5  # of the batch normalization
_MAX_BYTES = 64_000_000
_MAX_CHANNELS = 1024


@dataclass(frozen=True)
class _Filter:
    """A convolution as a matrix."""

    matrix: NDArray[np.float32]
    """[side * side * inputs, outputs]"""
    bias: NDArray[np.float32]
    """[outputs]"""
    side: int

    @property
    def inputs(self) -> int:
        return len(self.matrix) // self.side**2

    @property
    def outputs(self) -> int:
        return self.matrix.shape[1]

    def __call__(self, x: Image, stride: int = 1, rectify: bool = True) -> Image:
        """Apply it to frames [T H W C]; a frame at a time, which bounds the memory."""
        frames = thread_map(lambda frame: self._of_frame(frame, stride), x)
        out = np.stack(frames)
        return np.maximum(out, 0, out=out) if rectify else out

    def _of_frame(self, x: Image, stride: int) -> Image:
        height, width = (n // stride for n in x.shape[:2])
        if self.side == 1:
            columns = x.reshape(-1, x.shape[2])
        else:
            edge = self.side // 2
            wide = np.pad(x, ((edge, edge), (edge, edge), (0, 0)))
            columns = np.concatenate([
                wide[v : v + stride * height : stride, u : u + stride * width : stride]
                for v in range(self.side) for u in range(self.side)
            ], axis=2).reshape(height * width, -1)
        return (columns @ self.matrix + self.bias).reshape(height, width, -1)


class ForegroundInference:
    """The network, ready to run."""

    def __init__(self, tensors: Mapping[str, NDArray[np.float32]], source: str) -> None:
        """`tensors` are those of the PyTorch network by name; `source` is named in messages.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        reader = _Reader(tensors, source)
        self._enter: list[_Filter] = []
        self._encode: list[_Filter] = []
        self._exchange: list[_Filter] = []
        channels = 4 * FOREGROUND_CHANNELS
        for k in range(_LEVELS):
            self._enter.append(reader.step(f"enter.{k}", channels, 3))
            channels = self._enter[-1].outputs
            self._encode.append(reader.step(f"encode.{k}", channels, 3, channels))
            if k:
                self._exchange.append(reader.step(f"exchange.{k - 1}", 3 * channels, 1, channels))
        self._bottom = reader.step("bottom", channels, 3, channels)
        widths = [f.outputs for f in self._enter]
        self._rise = [reader.step(f"rise.{k}", widths[k + 1], 1, widths[k])
                      for k in range(_LEVELS - 1)]
        self._decode = [reader.step(f"decode.{k}", widths[k], 3, widths[k])
                        for k in range(_LEVELS - 1)]
        self._out = reader.filter("out", widths[0], 3, 4)

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


def load_foreground(path: Path = FOREGROUND_WEIGHTS) -> ForegroundInference:
    """Load the network from a safetensors file.

    Raises:
        ConfigError: If the file is missing, damaged, or holds another network's weights.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"{path}: larger than any weights of the foreground")
        found = load(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise ConfigError(f"{path}: no safetensors file ({reason})") from None
    return ForegroundInference(found, str(path))


@dataclass(frozen=True)
class _Reader:
    """Reads the filters of a network and checks their shapes."""

    tensors: Mapping[str, NDArray[np.float32]]
    source: str

    def step(self, name: str, inputs: int, side: int, outputs: int = 0) -> _Filter:
        """Return a filter whose batch normalization is a part of it."""
        weight = self._weight(f"{name}.filter", inputs, side, outputs)
        count = len(weight)
        gain, bias, mean, variance = (
            self._tensor(f"{name}.norm.{key}", (count,))
            for key in ("weight", "bias", "running_mean", "running_var"))
        factor = (gain / np.sqrt(np.maximum(variance, 0) + _EPSILON)).astype(np.float32)
        scaled = weight * factor[:, None, None, None]
        return _matrix(scaled, np.subtract(bias, mean * factor, dtype=np.float32))

    def filter(self, name: str, inputs: int, side: int, outputs: int) -> _Filter:
        """Return a filter with its own bias."""
        weight = self._weight(name, inputs, side, outputs)
        return _matrix(weight, self._tensor(f"{name}.bias", (outputs,)))

    def _weight(self, name: str, inputs: int, side: int, outputs: int) -> NDArray[np.float32]:
        key = f"{name}.weight"
        if not outputs:
            found = self.tensors.get(key)
            outputs = 1 if found is None or found.ndim != 4 else len(found)
            if not 0 < outputs <= _MAX_CHANNELS:
                raise ConfigError(f"{self.source}: no weights of the foreground: {key} has "
                                  f"{outputs} outputs")
        return self._tensor(key, (outputs, inputs, side, side))

    def _tensor(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        found = self.tensors.get(key)
        if found is None or found.shape != shape:
            there = "missing" if found is None else f"{list(found.shape)}"
            raise ConfigError(f"{self.source}: no weights of the foreground: {key} is {there}, "
                              f"expected {list(shape)}")
        value = found.astype(np.float32)
        if not np.isfinite(value).all():
            raise ConfigError(f"{self.source}: {key} is not finite")
        return value


def _matrix(weight: NDArray[np.float32], bias: NDArray[np.float32]) -> _Filter:
    side = weight.shape[2]
    matrix = weight.transpose(2, 3, 1, 0).reshape(-1, len(weight))
    return _Filter(np.ascontiguousarray(matrix), bias, side)


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
