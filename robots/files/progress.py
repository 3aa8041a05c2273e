"""Progress of slow readers, shown on a terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Collection, Iterable
from multiprocessing import parent_process
from typing import TypeVar

_Item = TypeVar("_Item")


def show_progress(items: Collection[_Item], what: str) -> Iterable[_Item]:
    """Return the items; a bar on the terminal counts them if they take more than two seconds."""
    if parent_process() or not sys.stderr.isatty():
        return items
    from tqdm import tqdm

    tqdm.set_lock(threading.RLock())  # tqdm's own is a semaphore, which outlives a kill
    return tqdm(items, what, delay=2.0, leave=False)
