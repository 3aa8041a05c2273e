"""Images of a stored sequence that are decoded when they are indexed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..runtime import Archive

Item = TypeVar("Item", bound=np.generic)
Decoder = Callable[..., NDArray[Item]]


@dataclass(frozen=True)
class LazyStack(Generic[Item]):
    """Images of one kind: an int gives one image, a slice a stacked array. Nothing is cached.

    `np.asarray(stack)` decodes them all.
    """

    archive: Archive
    members: list[str]
    decode: Decoder[Item]
    """(bytes, where=...) -> image"""
    item_shape: tuple[int, ...]
    """[H W] or [H W C]"""
    dtype: np.dtype[Item]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stacked array."""
        return (len(self.members), *self.item_shape)

    def __len__(self) -> int:
        return len(self.members)

    def __iter__(self) -> Iterator[NDArray[Item]]:
        return map(self._load, self.members)

    def __getitem__(self, index: int | slice, /) -> NDArray[Item]:
        """Raises IndexError, or DatasetError if an image is damaged."""
        if not isinstance(index, slice):
            return self._load(self.members[index])
        members = self.members[index]
        stacked = np.empty((len(members), *self.item_shape), self.dtype)
        for i, member in enumerate(members):
            stacked[i] = self._load(member)
        return stacked

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("decoding a lazy stack creates a new array; copy=False is impossible")
        return self[:].astype(self.dtype if dtype is None else dtype, copy=False)

    def _load(self, member: str) -> NDArray[Item]:
        return self.decode(self.archive.read(member), where=self.archive.where(member))


@dataclass(frozen=True)
class CombinedStack(Generic[Item]):
    """Images that are computed from the images of two stacks of equal length."""

    first: LazyStack[Any]
    second: LazyStack[Any]
    combine: Callable[[NDArray[Any], NDArray[Any]], NDArray[Item]]
    """(image, image) -> image of the first's shape"""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stacked array."""
        return self.first.shape

    def __len__(self) -> int:
        return len(self.first)

    def __iter__(self) -> Iterator[NDArray[Item]]:
        return (self[t] for t in range(len(self)))

    def __getitem__(self, index: int | slice, /) -> NDArray[Item]:
        """Raises IndexError, or DatasetError if an image is damaged."""
        if not isinstance(index, slice):
            return self.combine(self.first[index], self.second[index])
        chosen = range(*index.indices(len(self)))
        stacked = [self[t] for t in chosen]
        return np.stack(stacked) if stacked else np.empty((0, *self.shape[1:]), self.first.dtype)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("decoding a lazy stack creates a new array; copy=False is impossible")
        return self[:].astype(self.first.dtype if dtype is None else dtype, copy=False)
