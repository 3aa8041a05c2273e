"""Suites: named lists of datasets as recipes, so that anyone renders the same ones.

A TOML file:

    name = "mine"
    [defaults]             # fields of RenderConfig that all datasets share; may be left out
    seed = 5
    [[dataset]]            # one or more: a name, a number of sequences, fields of RenderConfig
    name = "ur5-studio"
    n = 20
    robot = "ur5"
    [dataset.randomization.background]
    room = 0.0
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from ...errors import ConfigError, GcbenchError
from ...renderer.scene import RenderConfig, parse_config, resolved
from ...robots.files import read_bounded

if sys.version_info >= (3, 11):
    from importlib.resources.abc import Traversable

    import tomllib
else:
    from importlib.abc import Traversable

    import tomli as tomllib  # pyright: ignore[reportMissingImports]

_MAX_TOML = 2**20
_MAX_SEQUENCES = 1_000_000


@dataclass(frozen=True)
class SuiteDataset:
    """One dataset of a suite: sequences 0 .. n-1 of a config."""

    name: str
    n: int
    config: RenderConfig


@dataclass(frozen=True)
class Suite:
    """A named list of datasets."""

    name: str
    about: str
    datasets: tuple[SuiteDataset, ...]


def shipped() -> tuple[str, ...]:
    """Names of the suites that come with gcbench."""
    names = (item.name for item in _folder().iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def read_suite(name_or_file: str | Path) -> Suite:
    """A suite by its name, or in a TOML file. Raises GcbenchError that names what is wrong."""
    text = str(name_or_file)
    if text in shipped():
        return parse_suite(
            (_folder() / f"{text}.toml").read_bytes(), text
        )
    path = Path(text).expanduser()
    if path.suffix != ".toml":
        raise GcbenchError(
            f"no suite {text!r}; there are {', '.join(shipped())}, and any path to a .toml file"
        )
    return parse_suite(read_bounded(path, _MAX_TOML, ConfigError), text)


def parse_suite(data: bytes, where: str) -> Suite:
    """A suite from TOML. Raises GcbenchError that begins with `where`."""
    try:
        tree = tomllib.loads(data.decode())
    except ValueError as error:
        raise GcbenchError(f"{where}: not TOML ({error})") from error
    if unknown := set(tree) - {"name", "about", "defaults", "dataset"}:
        raise GcbenchError(
            f"{where}: unknown field {min(unknown)!r}; there are name, about, defaults, dataset"
        )
    name, about = _name(tree.get("name"), where), tree.get("about", "")
    if not isinstance(about, str):
        raise GcbenchError(f"{where}: about is not text")
    base = parse_config(_mapping(tree.get("defaults", {}), f"{where}: defaults"), where)
    entries = tree.get("dataset")
    if not isinstance(entries, list) or not entries:
        raise GcbenchError(f"{where}: no [[dataset]]")
    datasets = [_dataset(entry, base, where) for entry in cast("list[Any]", entries)]
    names = [dataset.name for dataset in datasets]
    if twice := {n for n in names if names.count(n) > 1}:
        raise GcbenchError(f"{where}: dataset {min(twice)!r} is there twice")
    return Suite(name, about, tuple(datasets))


def _folder() -> Traversable:
    return files(__name__.removesuffix(".run.suite")) / "suites"


def _dataset(entry: Any, base: RenderConfig, where: str) -> SuiteDataset:
    fields = dict(_mapping(entry, f"{where}: dataset"))
    name, n = _name(fields.pop("name", None), f"{where}: dataset"), fields.pop("n", None)
    where = f"{where}: {name}"
    if isinstance(n, bool) or not isinstance(n, int) or not 1 <= n <= _MAX_SEQUENCES:
        raise GcbenchError(f"{where}: n is {n!r}, expected 1 to {_MAX_SEQUENCES} sequences")
    try:
        config = resolved(parse_config(fields, where, base))
    except GcbenchError as error:
        raise GcbenchError(f"{where}: {str(error).removeprefix(f'{where}: ')}") from error
    if config.stream != "test":
        raise GcbenchError(f"{where}: stream is 'train'; a suite holds sequences of 'test' only")
    if config.keep_unobservable:
        raise GcbenchError(f"{where}: keep_unobservable; a suite holds observable sequences only")
    return SuiteDataset(name, n, config)


def _name(value: Any, where: str) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9][\w.+-]{0,63}", value):
        raise GcbenchError(
            f"{where}: name is {value!r}, expected letters, digits, dots, dashes or underscores"
        )
    return value


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise GcbenchError(f"{where} is {value!r}, expected fields")
    return cast("Mapping[str, Any]", value)
