"""Two threads for what NumPy does without the interpreter: hypotheses, blocks of points."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def together(work: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """[work(i) for i in items]: the same results in the same order, sooner.

    Not where a process is to have one thread, as `gcbench eval --workers` says by the variable that
    NumPy's libraries read.
    """
    if os.environ.get("OMP_NUM_THREADS") == "1":
        return [work(i) for i in items]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(work, items))
