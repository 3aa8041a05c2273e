"""`dataset.json`: what a dataset is made of, by what, and with which configuration."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args, get_origin, get_type_hints

from .. import GcbenchError, __version__
from .atomic import write_atomically
from .config import RenderConfig
from .metadata import MAX_JSON, dump_json, parse_json
from .sequence import FORMAT, Meta

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
    """sequences, frames, refused (draws by reason); None while the dataset grows."""


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
    sequences = frames = 0
    refused: dict[str, int] = {}
    for meta in metas:
        sequences += 1
        frames += meta.frames
        for reason, number in dict(meta.observability.get("refused", {})).items():
            refused[reason] = refused.get(reason, 0) + int(number)
    return {"sequences": sequences, "frames": frames, "refused": dict(sorted(refused.items()))}


def config_tree(config: RenderConfig) -> dict[str, Any]:
    """The config as JSON gives it back: dicts, lists, numbers and strings."""
    return json.loads(dump_json(dataclasses.asdict(config)))


def parse_config(tree: Mapping[str, Any], where: str) -> RenderConfig:
    """The config in a `dataset.json`; a field that is not there has its default.

    Raises GcbenchError, beginning with `where`, for an unknown field or a value of another type.
    """
    return _parse(RenderConfig, tree, f"{where}: config")


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """ "field: old -> new" of each leaf of two trees that differs."""
    a, b = _leaves(old), _leaves(new)
    return [
        f"{key}: {_show(a, key)} -> {_show(b, key)}"
        for key in [*a, *(k for k in b if k not in a)]
        if (key in a, a.get(key)) != (key in b, b.get(key))
    ]


def _show(leaves: dict[str, Any], key: str) -> str:
    return json.dumps(leaves[key]) if key in leaves else "nothing"


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves |= _leaves(cast("dict[str, Any]", value), f"{prefix}{key}.")
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def _parse(kind: Any, value: Any, where: str) -> Any:
    """`value` as a dataclass, tuple, Literal, number or string, as the annotation `kind` says."""
    if dataclasses.is_dataclass(kind) and isinstance(value, Mapping):
        fields = cast("Mapping[str, Any]", value)
        hints = get_type_hints(kind)
        if unknown := [name for name in fields if name not in hints]:
            raise GcbenchError(f"{where}: unknown field {unknown[0]!r}")
        parsed = {name: _parse(hints[name], v, f"{where}.{name}") for name, v in fields.items()}
        return cast("Any", kind)(**parsed)
    arguments = get_args(kind)
    if get_origin(kind) is Literal and value in arguments:
        return value
    if get_origin(kind) is tuple and isinstance(value, list):
        items = cast("list[Any]", value)
        kinds = [arguments[0]] * len(items) if arguments[-1] is Ellipsis else list(arguments)
        if len(kinds) == len(items):
            return tuple(_parse(k, v, where) for k, v in zip(kinds, items, strict=True))
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if kind in (int, bool, str) and type(value) is kind:
        return value
    raise GcbenchError(f"{where} is {value!r}, which is not a value for it")
