"""Inner loops as machine code: compiled on the first call, cached on disk, without the GIL.

The cache of a function is renewed when its file changes, but not when a file changes from which it
takes a function or a number. So compiled functions use only functions and numbers of their file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers to machine code (a decorator)."""
    compile_: Any = numba.njit
    options = {
        "nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "nsz", "contract"},
        # else a loop calls the copy of a function that its process loaded first: one that is
        # optimized alone where it was compiled, one from the cache of the loop elsewhere
        "forceinline": True,
    }
    try:
        return cast(F, compile_(cache=True, **options)(function))
    except RuntimeError:  # no folder for the cache: every process compiles it
        return cast(F, compile_(**options)(function))
