"""Compare items that are rendered (`gb.stream`) with items that are read from disk.

One process does both in turns, sequence by sequence, so that other load on the machine slows both.
CPU time is that of all threads. The dataset was written just before: its pages are in memory.

    python tests/speed/stream_speed.py --robot ur5 --sequences 10
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gcbench as gb
from gcbench.renderer.dataset.torch import TorchDataset


@dataclass
class Turn:
    """The items of one sequence."""

    source: str
    items: int
    wall: float
    """s"""
    cpu: float
    """s, of all threads"""


def measure(source: str, items: Iterator[Any], n: int) -> Turn:
    """Take the next n items."""
    wall, cpu = time.perf_counter(), time.process_time()
    taken = sum(1 for _ in zip(range(n), items, strict=False))
    return Turn(source, taken, time.perf_counter() - wall, time.process_time() - cpu)


def compare(config: gb.RenderConfig, n: int, options: dict[str, Any]) -> list[Turn]:
    """Turns of both sources on sequences 1 .. n; 0 warms up."""
    with tempfile.TemporaryDirectory() as folder:
        gb.render_dataset(config, n + 1, folder, progress=False)
        stored = TorchDataset(gb.open_dataset(folder), **options)
        sources = {"streamed": iter(gb.stream(config, **options)),
                   "read": (stored[i] for i in range(len(stored)))}
        turns: list[Turn] = []
        for k in range(n + 1):
            turns += [measure(name, sources[name], stored.items.per_sequence)
                      for name in list(sources)[:: 1 if k % 2 else -1]]
    return turns[len(sources):]


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robot", default="ur5")
    parser.add_argument("--sequences", type=int, default=10, help="one more warms up")
    parser.add_argument("--frames", type=int, default=15, help="of a sequence")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    parser.add_argument("--images", nargs="+", default=["rgb", "depth", "part", "flow"])
    parser.add_argument("--json", type=Path, help="write all numbers to this file")
    options = parser.parse_args()
    config = gb.RenderConfig(robot=options.robot, frames=options.frames, width=options.width,
                             height=options.height)
    load = os.getloadavg()[0]
    turns = compare(config, options.sequences, {"images": tuple(options.images)})
    print(f"{options.robot}, {config.width} x {config.height}, {config.frames} frames a sequence, "
          f"pairs of {' '.join(options.images)}; load before {load:.2f}, "
          f"{len(os.sched_getaffinity(0))} cores")
    print(f"{'':10} items/s  CPU ms/item  (medians of {options.sequences} sequences)")
    for source in ("streamed", "read"):
        own = [t for t in turns if t.source == source]
        print(f"{source:10} {statistics.median(t.items / t.wall for t in own):7.1f}  "
              f"{1e3 * statistics.median(t.cpu / t.items for t in own):11.1f}")
    if options.json:
        options.json.write_text(json.dumps([asdict(t) for t in turns], indent=1))


if __name__ == "__main__":
    main()
