"""Suites: named lists of dataset configurations, for reproducible benchmark data.

The TOML format:

    name = "mine"
    version = 2            # optional: from 2 on, a part of the suite's name in results
    [defaults]             # optional: fields of RenderConfig for all datasets
    seed = 5
    twin_of = "own"        # without this, all robots share the draws of earlier versions
    [[dataset]]            # repeated: name, number of sequences, fields of RenderConfig
    name = "ur5-studio"
    n = 20
    robot = "ur5"
    [dataset.randomization.background]
    room = 0.0
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import msgspec

from ...errors import ConfigError, GcbenchError, suggestion
from ...renderer.runtime import parse_toml, to_record
from ...renderer.scene import RenderConfig, parse_config, resolve
from ...robots.files import read_bounded

_FOLDER = Path(__file__).parents[1] / "suites"
_MAX_TOML = 2**20
_Name = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][\w.+-]{0,63}\Z")]


@dataclass(frozen=True)
class _SuiteFile:
    name: _Name
    dataset: Annotated[tuple[dict[str, Any], ...], msgspec.Meta(min_length=1)]
    about: str = ""
    version: Annotated[int, msgspec.Meta(ge=1, le=9999)] = 1
    defaults: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class _Entry:
    """The fields of a [[dataset]] that do not belong to RenderConfig."""

    name: _Name
    n: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]


@dataclass(frozen=True)
class SuiteDataset:
    """One dataset of a suite: sequences 0 .. n-1 of a configuration."""

    name: str
    n: int
    config: RenderConfig


@dataclass(frozen=True)
class Suite:
    """A named list of datasets."""

    name: str
    about: str
    version: int
    datasets: tuple[SuiteDataset, ...]

    @property
    def title(self) -> str:
        """Name in folders and results, such as "mini-2": versions are different suites there."""
        return self.name if self.version == 1 else f"{self.name}-{self.version}"

    def choose(self, names: Sequence[str]) -> Suite:
        """Return the suite with the datasets of these names only; with all, if no name is given.

        Raises ConfigError for a name that no dataset has.
        """
        known = [dataset.name for dataset in self.datasets]
        for name in names:
            if name not in known:
                raise ConfigError(f"suite {self.name} has no dataset {name!r}"
                                  f"{suggestion(name, known)}; there are {', '.join(known)}")
        chosen = tuple(d for d in self.datasets if not names or d.name in names)
        return replace(self, datasets=chosen)


def builtin_suites() -> tuple[str, ...]:
    """Return the names of the built-in suites."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def builtin_datasets() -> dict[str, SuiteDataset]:
    """Return the datasets of the built-in suites by their names in results, SUITE/NAME."""
    return {f"{suite.title}/{dataset.name}": dataset
            for suite in map(read_suite, builtin_suites()) for dataset in suite.datasets}


def list_suites() -> list[dict[str, object]]:
    """List the suites that come with gcbench.

    Returns:
        For each suite its name, version, numbers of datasets and sequences, and what it is for.

    Examples:
        >>> [record["suite"] for record in gb.list_suites()]
        ['mini', 'paper', 'standard']
    """
    return [{"suite": suite.name, "version": suite.version, "datasets": len(suite.datasets),
             "sequences": sum(dataset.n for dataset in suite.datasets), "about": suite.about}
            for suite in map(read_suite, builtin_suites())]


def read_suite(name_or_file: str | Path) -> Suite:
    """Read a built-in suite or a TOML file. Raises ConfigError with the invalid field."""
    text = str(name_or_file)
    if text in builtin_suites():
        return parse_suite((_FOLDER / f"{text}.toml").read_bytes(), text)
    path = Path(text).expanduser()
    if path.suffix != ".toml":
        known = builtin_suites()
        raise ConfigError(f"no suite {text!r}{suggestion(text, known)}; there are "
                          f"{', '.join(known)}, and any path to a .toml file")
    return parse_suite(read_bounded(path, _MAX_TOML, ConfigError), text)


def parse_suite(data: bytes, where: str) -> Suite:
    """Parse a suite from TOML. Raises ConfigError whose message starts with `where`."""
    file = to_record(parse_toml(data, where), _SuiteFile, where, True, ConfigError)
    base = parse_config(file.defaults, where)
    datasets = tuple(_dataset(entry, base, where) for entry in file.dataset)
    names = [dataset.name for dataset in datasets]
    if twice := {n for n in names if names.count(n) > 1}:
        raise ConfigError(f"{where}: two datasets have the name {min(twice)!r}")
    return Suite(file.name, file.about, file.version, datasets)


def _dataset(fields: dict[str, Any], base: RenderConfig, where: str) -> SuiteDataset:
    entry = to_record(fields, _Entry, f"{where}: dataset", error=ConfigError)
    where = f"{where}: {entry.name}"
    rest = {key: value for key, value in fields.items() if key not in ("name", "n")}
    try:
        config = resolve(parse_config(rest, where, base))
    except GcbenchError as error:
        raise ConfigError(f"{where}: {str(error).removeprefix(f'{where}: ')}") from error
    if config.stream != "test":
        raise ConfigError(f"{where}: stream is 'train'; a suite contains sequences of 'test' only")
    if config.keep_unobservable:
        raise ConfigError(
            f"{where}: keep_unobservable is set; a suite contains observable sequences only"
        )
    return SuiteDataset(entry.name, entry.n, config)
