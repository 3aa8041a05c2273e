"""Inner loops as machine code: compiled on the first call, cached on disk, without the GIL.

The cache of a function is renewed when its file changes, but not when a file changes from which it
takes a function or a number. So compiled functions use only functions and numbers of their file.
"""

from __future__ import annotations

import hashlib
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
        out = compile_(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache: every process compiles it
        return cast(F, compile_(**options)(function))
    _name_code_by_types(out._cache._cache_file)
    return cast(F, out)


def _name_code_by_types(cache: Any) -> None:
    """Have the cache of a function keep the code for each set of argument types under a name of
    its own, written before the index that names it.

    Numba numbers the files in the order in which a process saves them, and writes the index first.
    So processes that compile at once may overwrite each other's code, and run the code for another
    memory layout.
    """

    def save(key: object, data: object) -> None:
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        name = cache._index_name.removesuffix(".nbi") + f".{digest}.nbc"
        cache._save_data(name, data)
        cache._save_index({**cache._load_index(), key: name})

    cache.save = save
