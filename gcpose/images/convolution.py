"""Convolutions of small networks in NumPy, from the weights of PyTorch: they need no PyTorch."""

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

_EPSILON = 1e-5  # of the normalizations
_MAX_BYTES = 64_000_000
_MAX_CHANNELS = 1024
_BLOCK = 2**18  # numbers that a convolution gathers at once: they fit into the cache


@dataclass(frozen=True)
class Filter:
    """A convolution as a matrix."""

    matrix: NDArray[np.float32]
    """[side * side * inputs, outputs]"""
    bias: NDArray[np.float32]
    """[outputs]"""
    side: int

    @property
    def outputs(self) -> int:
        return self.matrix.shape[1]

    def __call__(self, x: Image, stride: int = 1, rectify: bool = True) -> Image:
        """Apply it to frames [T H W C]; a frame at a time, which bounds the memory."""
        frames = thread_map(lambda frame: self.of_frame(frame, stride, rectify=rectify), x)
        return np.stack(frames)

    def of_frame(self, x: Image, stride: int = 1, *, rectify: bool = True) -> Image:
        """Apply it to a frame [H W C], whose sides are multiples of `stride`."""
        height, width = (n // stride for n in x.shape[:2])
        out = np.empty((height, width, self.outputs), np.float32)
        edge, side = self.side // 2, self.side
        wide = np.pad(x, ((edge, edge), (edge, edge), (0, 0))) if edge else x
        rows = max(1, _BLOCK // (width * len(self.matrix)))
        for top in range(0, height, rows):
            end = min(top + rows, height)
            columns = np.concatenate([
                wide[v + stride * top : v + stride * end : stride,
                     u : u + stride * width : stride]
                for v in range(side) for u in range(side)
            ], axis=2).reshape(-1, len(self.matrix))
            np.matmul(columns, self.matrix, out=out[top:end].reshape(-1, self.outputs))
        out += self.bias
        return np.maximum(out, 0, out=out) if rectify else out


@dataclass(frozen=True)
class Normalization:
    """The normalization of groups of channels over the whole frame."""

    gain: NDArray[np.float32]
    """[C]"""
    bias: NDArray[np.float32]
    """[C]"""
    groups: int

    def __call__(self, x: Image) -> Image:
        """Normalize a frame [H W C]."""
        mean = x.mean(axis=(0, 1), dtype=np.float64).reshape(self.groups, -1).mean(axis=1)
        square = np.square(x).mean(axis=(0, 1), dtype=np.float64)
        variance = square.reshape(self.groups, -1).mean(axis=1) - mean**2
        size = x.shape[2] // self.groups
        factor = self.gain / np.sqrt(np.maximum(variance, 0) + _EPSILON).repeat(size)
        return x * factor.astype(np.float32) + (self.bias - mean.repeat(size) * factor).astype(
            np.float32)


@dataclass(frozen=True)
class WeightReader:
    """Reads the layers of a network and checks their shapes."""

    tensors: Mapping[str, NDArray[np.float32]]
    """Those of the PyTorch network by name"""
    network: str
    """Its name in messages"""
    source: str
    """What is named in messages as the place of the tensors"""

    def filter(self, name: str, inputs: int, side: int, outputs: int = 0) -> Filter:
        """Return the filter of a name with its bias; `outputs` 0: as many as its weights have.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        weight = self._weight(name, inputs, side, outputs)
        return _matrix(weight, self.tensor(f"{name}.bias", (len(weight),)))

    def normalized_filter(self, name: str, inputs: int, side: int, outputs: int = 0) -> Filter:
        """Return the filter NAME.filter, of which the batch normalization NAME.norm is a part.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        weight = self._weight(f"{name}.filter", inputs, side, outputs)
        count = len(weight)
        gain, bias, mean, variance = (
            self.tensor(f"{name}.norm.{key}", (count,))
            for key in ("weight", "bias", "running_mean", "running_var"))
        factor = (gain / np.sqrt(np.maximum(variance, 0) + _EPSILON)).astype(np.float32)
        scaled = weight * factor[:, None, None, None]
        return _matrix(scaled, np.subtract(bias, mean * factor, dtype=np.float32))

    def normalization(self, name: str, channels: int, groups: int) -> Normalization:
        """Return the normalization of a name.

        Raises:
            ConfigError: If a tensor is missing, has a wrong shape, or is not finite.
        """
        gain, bias = (self.tensor(f"{name}.{key}", (channels,)) for key in ("weight", "bias"))
        return Normalization(gain, bias, groups)

    def tensor(self, key: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return a tensor of a shape.

        Raises:
            ConfigError: If it is missing, has another shape, or is not finite.
        """
        found = self.tensors.get(key)
        if found is None or found.shape != shape:
            there = "missing" if found is None else f"{list(found.shape)}"
            raise ConfigError(f"{self.source}: no weights of {self.network}: {key} is {there}, "
                              f"expected {list(shape)}")
        value = found.astype(np.float32)
        if not np.isfinite(value).all():
            raise ConfigError(f"{self.source}: {key} is not finite")
        return value

    def _weight(self, name: str, inputs: int, side: int, outputs: int) -> NDArray[np.float32]:
        key = f"{name}.weight"
        if not outputs:
            found = self.tensors.get(key)
            outputs = 1 if found is None or found.ndim != 4 else len(found)
            if not 0 < outputs <= _MAX_CHANNELS:
                raise ConfigError(f"{self.source}: no weights of {self.network}: {key} has "
                                  f"{outputs} outputs")
        return self.tensor(key, (outputs, inputs, side, side))


def read_network(path: Path, network: str) -> WeightReader:
    """Read the weights of a network from a safetensors file.

    Raises:
        ConfigError: If the file is missing, too large or damaged.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ConfigError(f"{path}: larger than any weights of {network}")
        found = load(path.read_bytes())
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:120]
        raise ConfigError(f"{path}: no safetensors file ({reason})") from None
    return WeightReader(found, network, str(path))


def _matrix(weight: NDArray[np.float32], bias: NDArray[np.float32]) -> Filter:
    side = weight.shape[2]
    matrix = weight.transpose(2, 3, 1, 0).reshape(-1, len(weight))
    return Filter(np.ascontiguousarray(matrix), bias, side)
