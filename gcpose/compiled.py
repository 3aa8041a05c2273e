"""Inner loops as machine code: compiled when first called, kept on disk, free of the lock.

Loops over points are written without branches, on plain numbers in single precision and one array
for each coordinate, so that the compiler does sixteen points at once. That is what makes them some
twenty times as fast as the same in NumPy; a `continue`, or a look-up beside a store, undoes it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
Number = float | np.floating[Any]
"""In compiled code always single precision."""


def compiled(function: F) -> F:
    """The same function, of arrays and numbers, as machine code."""
    compile_: Any = numba.njit
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}
    try:
        return cast(F, compile_(cache=True, **options)(function))
    except RuntimeError:  # nowhere to keep it: compiled again by every process
        return cast(F, compile_(**options)(function))
