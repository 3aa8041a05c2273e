"""A map over two threads, for work that NumPy and compiled loops do outside the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def thread_map(work: Callable[[A], B], items: Iterable[A], threads: int | None = None) -> list[B]:
    """Return [work(i) for i in items], computed by some threads.

    Args:
        work: Any function that may run in several threads.
        items: Its arguments.
        threads: Default: 2, but 1 where the environment variable OMP_NUM_THREADS is 1, by which
            `gcbench eval` tells the libraries of a worker how many threads it has.
    """
    if threads is None:
        threads = 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2
    if threads == 1:
        return [work(i) for i in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))
