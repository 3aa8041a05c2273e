"""Options of `gcbench train flow`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class TrainConfig:
    """Options of a training run."""

    data: tuple[Path, ...] = ()
    """Datasets (`gcbench render --stream train`), or folders of them; default: random objects
    and appliances, rendered into OUT/data first."""
    out: Path = Path("raft")
    """Folder of the weights (raft.safetensors), the checkpoint and the log (log.jsonl); a run
    that was stopped continues from there."""
    start_from: Path | None = None
    """Weights to begin a run with (one that is in OUT goes on from its own); default: drawn at
    random."""
    held_out: tuple[Path, ...] = ()
    """Datasets on which the errors are measured, against DIS."""
    steps: int = 60_000
    """0 measures what is there."""
    batch: int = 4
    rate: float = 8e-4
    """Highest learning rate of the cycle."""
    crop: tuple[int, int] = (176, 144)
    """Width and height of what is learned from at a time, px; multiples of 16."""
    iterations: int = 4
    """Corrections that the network makes; in use it makes six, tuned to a video three."""
    models: int = 300
    """Objects to render if no data are given."""
    robots: tuple[str, ...] = ()
    """Robots (names or files) that half of them are; the others are random."""
    seed: int = 1
    device: str = "auto"
    precision: Literal["bfloat16", "float32"] = "bfloat16"
    """Of the arithmetic while training; weights are float32."""
    workers: int = 0
    """Processes that prepare samples beside the one that trains (a GPU waits for 8 and more), and
    that render; 0: none, and one for each core."""
    threads: int = 0
    """Of the arithmetic on a CPU; default: all cores."""
    every: int = 1000
    """Steps between two checks on the held-out data."""
    minutes: float = 3.0
    """Between two checkpoints."""
