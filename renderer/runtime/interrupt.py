"""Ctrl-C at a moment that can bear it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def defer_interrupts() -> Generator[None]:
    """Defer Ctrl-C until the end of the block. Processes that are started in it ignore Ctrl-C.

    A process that is interrupted while Python starts, or whose parent is while it hands over the
    task, would print a traceback. The mask is for the child, which inherits it; the parent needs a
    handler too, because a thread of NumPy's may receive the signal in the place of this one.
    """
    waiting: list[int] = []
    in_main = threading.current_thread() is threading.main_thread()  # only it may have handlers
    handler = signal.getsignal(signal.SIGINT)
    if in_main:
        signal.signal(signal.SIGINT, lambda number, _: waiting.append(number))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if in_main:
            signal.signal(signal.SIGINT, handler)
    if waiting:
        signal.raise_signal(signal.SIGINT)
