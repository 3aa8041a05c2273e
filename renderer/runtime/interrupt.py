"""Ctrl-C at a moment that can bear it, and SIGTERM as Ctrl-C."""

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


class TerminationError(KeyboardInterrupt):
    """A Ctrl-C that was a SIGTERM."""


@contextmanager
def interrupt_on_sigterm() -> Generator[None]:
    """Treat the first SIGTERM in the block as Ctrl-C, and ignore further ones.

    Schedulers and containers send it some time before they kill a process.

    Raises:
        TerminationError: In place of a KeyboardInterrupt, at the end of the block.
    """
    if threading.current_thread() is not threading.main_thread():  # only it may have handlers
        yield
        return
    received: list[int] = []

    def interrupt(number: int, _: object) -> None:
        received.append(number)
        if len(received) == 1:
            signal.raise_signal(signal.SIGINT)  # which `defer_interrupts` defers

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        if received:
            raise TerminationError from None
        raise
    finally:
        signal.signal(signal.SIGTERM, before)
