"""Inner loops as machine code: compiled when first called, kept on disk, free of the lock.

What is kept is made again when the file of a function changes, not when a file changes that it
takes a function or a number from: so compiled functions call those of their own file only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """The same function, of arrays and numbers, as machine code."""
    compile_: Any = numba.njit
    options = {"nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"}}
    try:
        return cast(F, compile_(cache=True, **options)(function))
    except RuntimeError:  # nowhere to keep it: compiled again by every process
        return cast(F, compile_(**options)(function))
