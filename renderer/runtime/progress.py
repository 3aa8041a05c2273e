"""A progress bar that counts frames, on stderr."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING, Any, NoReturn

from tqdm import tqdm

from ...errors import printable
from .interrupt import defer_interrupts

_Tqdm = tqdm[NoReturn] if TYPE_CHECKING else tqdm


class Bar(_Tqdm):
    """A bar for one thread. tqdm's own lock is a semaphore of the system, which outlives a kill."""

    monitor_interval = 0

    def refresh(self, *args: Any, **options: Any) -> Any:
        """Draw the bar; `close` then ends its line, which tqdm forgets before the first frame."""
        if hasattr(self, "start_t"):
            self.last_print_t = max(self.last_print_t, self.start_t + self.delay)
        return super().refresh(*args, **options)


Bar.set_lock(threading.RLock())


def say(text: str) -> None:
    """Print a message of gcbench to stderr, above the bars; names in it are made printable."""
    Bar.write(printable(f"gcbench: {text}"), file=sys.stderr)


def plural(n: int, word: str) -> str:
    """Return a number with its noun, such as "1 frame" or "2 frames"."""
    return f"{n} {word}{'' if n == 1 else 's'}"


def frame_bar(total: int, done: int, visible: bool, what: str = "render") -> Bar:
    """A bar of `total` frames, of which `done` were there before: the rate is without them.

    It appears with the first frame, so that a model that cannot be loaded is told in one line.
    """
    with defer_interrupts():  # tqdm prints errors if its constructor is interrupted
        return Bar(
            total=total,
            initial=done,
            unit="frame",
            desc=what,
            smoothing=0.1,
            disable=not visible,
            file=sys.stderr,
            dynamic_ncols=True,
            delay=0.01,
            mininterval=0.1 if sys.stderr.isatty() else 10.0,
        )


def shard_bar(total: int, visible: bool) -> Bar:
    """A bar of `total` shards, which other machines work on."""
    with defer_interrupts():
        return Bar(
            total=total, unit="shard", desc="shards", disable=not visible, file=sys.stderr,
            bar_format="{desc}: {n_fmt}/{total_fmt} [{elapsed}{postfix}]", dynamic_ncols=True,
            mininterval=0.1 if sys.stderr.isatty() else 60.0,
        )
