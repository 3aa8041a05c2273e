"""The options that determine a training run, kept beside its checkpoint."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from ...errors import ConfigError
from ...renderer.runtime import address, dump_json, parse_json
from ...renderer.scene import differences
from ...robots.files import read_bounded, write_atomically
from .config import TrainConfig

_FILE, _FORMAT = "options.json", "gcbench-training/1"
_FREE = {"out", "held_out", "steps", "epochs", "device", "workers", "threads", "precision", "half",
         "every", "minutes", "held_out_sequences", "held_out_pairs", "held_out_images"}
"""Options that may change when a run continues."""
_MAX_BYTES = 2**20


def keep_options(config: TrainConfig, continues: bool) -> None:
    """Store the options of a run in its folder; `continues` says whether it has made steps.

    Raises ConfigError if it has done so with other options: its samples, its rates or its weights
    would be of two kinds.
    """
    path, mine = config.out / _FILE, _tree(config)
    if continues and path.exists():
        there = parse_json(read_bounded(path, _MAX_BYTES, ConfigError), str(path), _FORMAT)
        if changes := differences(there, mine):
            raise ConfigError(
                f"{config.out} holds a run with other options ({'; '.join(changes)}); give the "
                "same ones to continue it, or name another --out")
        return
    write_atomically(path, dump_json(mine))


def _tree(config: TrainConfig) -> dict[str, Any]:
    values = {f.name: _plain(getattr(config, f.name)) for f in fields(config)
              if f.name not in _FREE}
    return {"format": _FORMAT, **values}


def _plain(value: Any) -> Any:
    """Return a value as JSON has it; a path does not depend on the current folder."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Path):
        return address(value) if "://" in address(value) else str(value.resolve())
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
