"""A map over two threads, for work that NumPy and compiled loops do outside the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def thread_map(work: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """Return [work(i) for i in items], computed by two threads.

    There is one thread where the environment variable OMP_NUM_THREADS is 1, by which `gcbench eval`
    tells the libraries of a worker how many threads it has.
    """
    if os.environ.get("OMP_NUM_THREADS") == "1":
        return [work(i) for i in items]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(work, items))
