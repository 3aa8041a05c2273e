"""`dataset.json`: what a dataset is made of, by what, and with which configuration."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypedDict

import msgspec

from ... import __version__
from ...errors import DatasetError
from ..runtime import address, dump_json, exists, read_record, store_file, to_record
from ..scene import RenderConfig, config_tree
from ..types import FORMAT, Meta

DATASET_FILE = "dataset.json"
_PACKAGES = (
    "numpy", "scipy", "opencv-python-headless", "opencv-python", "zlib-ng",
    "scikit-robot-pyrender", "PyOpenGL", "trimesh", "pycollada", "python-fcl", "yourdfpy",
)
"""Distributions that influence the images."""


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


def new_provenance(config: RenderConfig) -> Provenance:
    """Return the provenance of a dataset that this installation begins to render."""
    generator = {"name": "gcbench", "version": __version__}
    return Provenance(config_tree(config), generator, (environment(),))


def environment() -> dict[str, Any]:
    """Return the versions of this installation, and its platform without the machine's name."""
    from importlib.metadata import PackageNotFoundError, version

    dependencies: dict[str, str] = {"python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            dependencies[package] = version(package)
    here = {"system": platform.system(), "machine": platform.machine()}
    return {"dependencies": dependencies, "platform": here}


_Count = Annotated[int, msgspec.Meta(ge=0)]


class _Counts(TypedDict, total=False):
    """`counts` of `dataset.json`."""

    sequences: _Count
    frames: _Count
    unobservable: _Count
    refused: dict[str, _Count]


@dataclass(frozen=True)
class _File:
    """The fields of `dataset.json`."""

    config: dict[str, Any]
    generator: dict[str, str]
    assets: tuple[dict[str, Any], ...]
    counts: _Counts | None = None
    dependencies: dict[str, Any] | None = None
    platform: dict[str, Any] | None = None
    other_environments: tuple[dict[str, Any], ...] = ()


def read_provenance(dataset: Path) -> Provenance:
    """Return the dataset's own description.

    Raises:
        DatasetError: if the folder is not a dataset, or its `dataset.json` is damaged.
    """
    path = dataset / DATASET_FILE
    if not exists(path):
        raise DatasetError(f"{address(dataset)}: not a dataset (no {DATASET_FILE})")
    file = read_record(path, _File, FORMAT)
    first = {"dependencies": file.dependencies, "platform": file.platform}
    environments = (first, *file.other_environments)
    return Provenance(file.config, file.generator, environments, file.assets, file.counts)


def write_provenance(dataset: Path, provenance: Provenance, create: bool = False) -> bool:
    """Write or replace `dataset.json`; with `create`, return False if there is one."""
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
    return store_file(dataset / DATASET_FILE, dump_json(tree), create)


@dataclass(frozen=True)
class _Observability:
    """What the counts need of `Meta.observability`."""

    observable: bool | None = True
    refused: dict[str, int] = field(default_factory=dict[str, int])


def sequence_counts(metas: Iterable[Meta]) -> dict[str, Any]:
    """Return `Provenance.counts` of the sequences with these metas, in any order."""
    sequences = frames = unobservable = 0
    refused: Counter[str] = Counter()
    for meta in metas:
        seen = to_record(meta.observability, _Observability, f"{meta.name}: observability")
        sequences += 1
        frames += meta.frames
        unobservable += seen.observable is False
        refused.update(seen.refused)
    return {"sequences": sequences, "frames": frames, "unobservable": unobservable,
            "refused": dict(sorted(refused.items()))}
