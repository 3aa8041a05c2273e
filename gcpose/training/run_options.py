"""The options and data that determine a training run, kept beside its checkpoint."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from ...errors import ConfigError
from ...renderer.dataset import open_dataset
from ...renderer.runtime import address, dump_json, parse_json
from ...renderer.scene import differences
from ...robots.files import read_bounded, write_atomically
from .config import TrainConfig

_FILE, _FORMAT = "options.json", "gcbench-training/1"
_FREE = {"out", "held_out", "steps", "epochs", "device", "workers", "threads", "precision", "half",
         "every", "minutes", "held_out_sequences", "held_out_pairs", "held_out_images"}
"""Options that may change when a run continues."""
_MAX_BYTES = 2**20


def keep_options(config: TrainConfig, data: list[Path], continues: bool) -> None:
    """Store the options of a run, and a hash of each dataset that is given to it, in its folder.

    `continues` says whether the run has made steps. Raises ConfigError if it has done so with other
    options or data: its samples, its rates or its weights would be of two kinds.
    """
    path, mine = config.out / _FILE, _tree(config)
    now = {str(_plain(folder)): _hash_dataset(folder) for folder in data}
    if continues and path.exists():
        there = parse_json(read_bounded(path, _MAX_BYTES, ConfigError), str(path), _FORMAT)
        then = there.pop("datasets", None)
        if changes := differences(there, mine):
            raise ConfigError(
                f"{config.out} holds a run with other options ({'; '.join(changes)}); give the "
                "same ones to continue it, or name another --out")
        if isinstance(then, dict):  # runs of earlier versions have none
            _refuse_other_data(config.out, then, now)
        return
    write_atomically(path, dump_json({**mine, "datasets": now}))


def refuse_other_network(out: Path, name: str) -> None:
    """Raise ConfigError if a folder holds a run of another network than `name`."""
    there = {path.stem for path in out.glob("*.safetensors")} - {"checkpoint"}
    if there and name not in there:
        raise ConfigError(f"{out} holds a run of {min(there)}; name another --out for {name}")


def _refuse_other_data(out: Path, then: dict[str, Any], now: dict[str, str]) -> None:
    for folder in dict.fromkeys([*then, *now]):
        if then.get(folder) != now.get(folder):
            change = ("is new" if folder not in then else "is gone" if folder not in now
                      else "has another configuration or other sequences")
            raise ConfigError(
                f"{folder} {change} since the run in {out} began; give the data of then to "
                "continue it, or name another --out (--start-from keeps its weights)")


def _hash_dataset(folder: Path) -> str:
    """Return a hash of what a dataset is made of, and of the names of its sequences."""
    dataset = open_dataset(folder)
    models = sorted(str(asset.get("sha256", "")) for asset in dataset.info.assets)
    whole = {"config": dataset.info.config, "models": models, "names": dataset.names}
    return hashlib.sha256(dump_json(whole)).hexdigest()


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
