"""`dataset.json`: what a dataset is made of, by what, and with which configuration."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from ... import __version__
from ...errors import GcbenchError
from ...robots.files import write_atomically
from ..runtime import MAX_JSON, dump_json, parse_json
from ..scene import RenderConfig, config_tree
from ..scene import read_config as read_config
from ..types import FORMAT, Meta

FILE = "dataset.json"
_PACKAGES = (
    "numpy",
    "scipy",
    "opencv-python-headless",
    "opencv-python",
    "scikit-robot-pyrender",
    "PyOpenGL",
    "trimesh",
    "pycollada",
    "pygltflib",
    "python-fcl",
    "yourdfpy",
)
"""Distributions that have a say in what is drawn."""


@dataclass(frozen=True)
class Provenance:
    """`dataset.json`."""

    config: Mapping[str, Any]
    """The full RenderConfig as JSON."""
    generator: Mapping[str, str]
    """name, version"""
    environments: tuple[Mapping[str, Any], ...]
    """dependencies and platform of each machine or installation that rendered a part, in order."""
    assets: tuple[Mapping[str, Any], ...] = ()
    """name, source, licence, sha256, notes of each model; empty until it has been loaded."""
    counts: Mapping[str, Any] | None = None
    """sequences, frames, unobservable (of the sequences), refused (draws, by reason); None while
    the dataset grows."""


def describe(config: RenderConfig) -> Provenance:
    """What a dataset of this config, rendered here and now, says about itself."""
    generator = {"name": "gcbench", "version": __version__}
    return Provenance(config_tree(config), generator, (environment(),))


def environment() -> dict[str, Any]:
    """Versions of this installation and machine, without its name."""
    from importlib.metadata import PackageNotFoundError, version

    dependencies: dict[str, str] = {"python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            dependencies[package] = version(package)
    here = {"system": platform.system(), "machine": platform.machine()}
    return {"dependencies": dependencies, "platform": here}


def read_provenance(dataset: Path) -> Provenance:
    """The dataset's own description. Raises GcbenchError if there is none that can be read."""
    path = dataset / FILE
    try:
        with path.open("rb") as file:
            data = file.read(MAX_JSON)
    except FileNotFoundError as error:
        raise GcbenchError(f"{dataset}: not a dataset (no {FILE})") from error
    except OSError as error:
        raise GcbenchError(f"{path}: {error.strerror}") from error
    tree = parse_json(data, str(path))
    if tree.get("format") != FORMAT:
        raise GcbenchError(f"{path}: format {tree.get('format')!r}, this version reads {FORMAT!r}")
    for key, kind in (("config", dict), ("generator", dict), ("assets", list), ("counts", dict)):
        if not isinstance(tree.get(key), kind) and not (key == "counts" and tree.get(key) is None):
            raise GcbenchError(f"{path}: {key} is missing or not what it must be")
    others = tree.get("other_environments", [])
    environments = [{key: tree.get(key) for key in ("dependencies", "platform")}]
    if not isinstance(others, list):
        raise GcbenchError(f"{path}: other_environments is not a list")
    return Provenance(
        config=tree["config"],
        generator=tree["generator"],
        environments=(*environments, *cast("list[Any]", others)),
        assets=tuple(tree["assets"]),
        counts=tree["counts"],
    )


def write_provenance(dataset: Path, provenance: Provenance) -> None:
    """Write or replace `dataset.json`."""
    first, *others = provenance.environments
    tree = {
        "format": FORMAT,
        "generator": provenance.generator,
        "seed": provenance.config["seed"],
        "config": provenance.config,
        "assets": provenance.assets,
        "counts": provenance.counts,
        **first,
        "other_environments": others,
    }
    write_atomically(dataset / FILE, dump_json(tree))


def count_sequences(metas: Iterable[Meta]) -> dict[str, Any]:
    """The counts of the sequences that are there: the same for every way to get there."""
    sequences = frames = unobservable = 0
    refused: dict[str, int] = {}
    for meta in metas:
        sequences += 1
        frames += meta.frames
        unobservable += meta.observability.get("observable") is False
        for reason, number in dict(meta.observability.get("refused", {})).items():
            refused[reason] = refused.get(reason, 0) + int(number)
    return {
        "sequences": sequences,
        "frames": frames,
        "unobservable": unobservable,
        "refused": dict(sorted(refused.items())),
    }
