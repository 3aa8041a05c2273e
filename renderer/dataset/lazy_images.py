"""Images of a stored sequence that are decoded when they are indexed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Item = TypeVar("Item", bound=np.generic)


@dataclass(frozen=True, eq=False)
class LazyStack(Generic[Item]):
    """Images of one kind: an int gives one image, a slice a stacked array. Nothing is cached.

    `np.asarray(stack)` decodes them all.
    """

    decode: Callable[[int], NDArray[Item]]
    """Decodes the image of a number."""
    shape: tuple[int, ...]
    """Shape of the stacked array: [N H W] or [N H W C]."""
    dtype: np.dtype[Item]

    def __repr__(self) -> str:
        return f"LazyStack({' x '.join(map(str, self.shape))} {self.dtype})"

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[NDArray[Item]]:
        return map(self.decode, range(len(self)))

    def __getitem__(self, index: int | slice, /) -> NDArray[Item]:
        """Raises IndexError, or DatasetError if an image is damaged."""
        chosen = range(len(self))[index]
        if isinstance(chosen, int):
            return self.decode(chosen)
        stacked = np.empty((len(chosen), *self.shape[1:]), self.dtype)
        for i, number in enumerate(chosen):
            stacked[i] = self.decode(number)
        return stacked

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("decoding a lazy stack creates a new array; copy=False is impossible")
        return self[:].astype(self.dtype if dtype is None else dtype, copy=False)
