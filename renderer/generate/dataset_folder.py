"""The folder of a dataset while it is rendered: its lock, its `dataset.json`, what kills left.

Runs that render shards write to a folder at the same time. The first that has loaded the model
creates `dataset.json`; the others compare theirs with it. In object storage there are no locks:
there, every run behaves as one that renders a shard.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...errors import ConfigError, DatasetError
from ...robots.files import (
    LOCK,
    cache_folder,
    lock_briefly,
    lock_folder,
    remove_leftovers,
    scratch_folder,
)
from ..dataset import (
    DATASET_FILE,
    SEQUENCES_FOLDER,
    Provenance,
    count_sequences,
    new_provenance,
    read_provenance,
    sequence_name,
    sequence_paths,
    write_provenance,
)
from ..runtime import Shard, address, dump_json, exists, is_remote, refuse_other_addresses, say
from ..scene import RenderConfig, config_tree, differences, draws_of, parse_config


@contextmanager
def open_folder(out: Path, config: RenderConfig, shard: Shard | None) -> Generator[DatasetFolder]:
    """Create and lock the folder of a dataset; leave none behind if it gets no sequence.

    Raises:
        ConfigError: If the folder holds another dataset, or another run writes to it.
    """
    refuse_other_addresses(out)
    if is_remote(out):
        with scratch_folder(cache_folder() / "scratch") as work:
            yield DatasetFolder(out, config, shard, lambda: True, work)
        return
    created = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    try:
        with lock_folder(out, shared=shard is not None) as is_alone:
            try:
                yield DatasetFolder(out, config, shard, is_alone, out.absolute())
            finally:
                if shard is None or is_alone():
                    _remove_without_sequences(out, created)
    except OSError:  # also when the lock cannot be written
        if shard is None:
            _remove_without_sequences(out, created)
        raise


def _remove_without_sequences(out: Path, created: list[Path]) -> None:
    """Remove a dataset's folder, and its parents, that were created and have no sequence."""
    if created and not sequence_paths(out):
        for file in (out / DATASET_FILE, out / LOCK):
            file.unlink(missing_ok=True)
        for folder in (out / SEQUENCES_FOLDER, *created):
            with suppress(OSError):  # something else is in it
                folder.rmdir()


class DatasetFolder:
    """A dataset that a run writes to."""

    def __init__(
        self, out: Path, config: RenderConfig, shard: Shard | None, is_alone: Callable[[], bool],
        work: Path,
    ) -> None:
        """Remove what killed processes have left, and read `dataset.json`.

        Raises:
            ConfigError: If the folder holds another dataset.
        """
        self.out, self._shard, self._is_alone = out, shard, is_alone
        self.work = work
        """Folder that sequences are written to"""
        self.target = out if is_remote(out) else None
        """Address that they are moved to"""
        self._is_shared = shard is not None or is_remote(out)
        self.remove_leftovers()
        self.config = _with_old_draws(out, config)
        """The configuration; for an older dataset, with its draws"""
        self._provenance = self._read()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader noted about the model."""
        return tuple(str(x) for asset in self._provenance.assets for x in asset.get("notes", ()))

    def remove_leftovers(self) -> None:
        """Remove what killed processes have left; of other shards, nothing."""
        if self.target:
            return
        names = None if self._shard is None else {
            f"{sequence_name(i)}.zip" for i in self._shard}
        if names is None:
            remove_leftovers(self.out)
        remove_leftovers(self.out / SEQUENCES_FOLDER, names)

    def add_model(
        self, asset: Mapping[str, Any], environment: Mapping[str, Any] | None = None
    ) -> None:
        """Compare a model with that of the dataset; record it before the first sequence is there.

        `environment` is that of the machine that has loaded it, if not this one.

        Raises:
            ConfigError: If it is another one.
        """
        now = json.loads(dump_json(asset))
        with nullcontext() if self.target else lock_briefly(self.out):
            if self._is_shared:  # another run may have created it, or have added its environment
                self._provenance = self._read()
            _compare_model(self.out, self._provenance, now)
            provenance = _with_environment(self._provenance, environment)
            assets = provenance.assets or (now,)
            written = self._write(replace(provenance, assets=assets, counts=None))
        if not written:
            self.add_model(asset, environment)

    def finish(self) -> dict[str, Any]:
        """Return the counts of what is on disk; `dataset.json` says so from now on.

        A run with a shard counts its own. The last one of a whole dataset counts it.
        """
        paths = sequence_paths(self.out)
        known = self._provenance.counts
        if self._shard is None and known and len(known) == 4 and known["sequences"] == len(paths):
            return {**known}  # nothing was rendered: no file of many needs to be read
        own = None if self._shard is None else {sequence_name(i) for i in self._shard}
        counts = _count(path for name, path in paths.items() if own is None or name in own)
        if self._shard is None:
            self._write(replace(self._provenance, counts=counts))
        elif len(paths) >= self._shard.n and self._is_alone():
            self._write(replace(self._read(), counts=_count(paths.values())))
        return counts

    def _write(self, provenance: Provenance) -> bool:
        """Create or replace `dataset.json`, if it says anything else.

        Return False if another run has created it in this moment.
        """
        self._provenance = provenance
        there = exists(self.out / DATASET_FILE)
        return (there and read_provenance(self.out) == provenance) or write_provenance(
            self.out, provenance, create=self._is_shared and not there)

    def _read(self) -> Provenance:
        """What the dataset is, or will be. Raises ConfigError if it is another one."""
        out, here = self.out, new_provenance(self.config)
        started = sequence_paths(out) or (self._is_shared and exists(out / DATASET_FILE))
        if not started:  # a run that failed before its first sequence decides nothing
            return here
        if not exists(out / DATASET_FILE):
            raise ConfigError(f"{address(out)} holds sequences but no {DATASET_FILE}; "
                              "choose another --out folder")
        there = read_provenance(out)
        _compare_config(out, there, here)
        return _with_environment(there, here.environments[0])


def compare_dataset(out: Path, config: RenderConfig, asset: Mapping[str, Any]) -> None:
    """Raise ConfigError if the dataset in `out` has another configuration, or another model."""
    there = read_provenance(out)
    _compare_config(out, there, new_provenance(config))
    _compare_model(out, there, asset)


def _compare_config(out: Path, there: Provenance, here: Provenance) -> None:
    # A field that is newer than the dataset has its default there.
    old = parse_config(there.config, str(out / DATASET_FILE))
    # The folder that meshes are read from does not count: an old dataset has none.
    changed = differences({**config_tree(old), "root": here.config["root"]}, here.config)
    changed += differences({"generator": there.generator}, {"generator": here.generator})
    if changed:
        raise ConfigError(
            f"{address(out)} holds a dataset of another configuration ({'; '.join(changed)}); "
            "choose another --out folder, or delete this one"
        )


def _compare_model(out: Path, dataset: Provenance, asset: Mapping[str, Any]) -> None:
    now = json.loads(dump_json(asset))
    there = dataset.assets[0] if dataset.assets else now
    # Notes are words. Datasets of the first edition have no hashes of meshes and textures.
    names = {*there, *now} - {"notes"} - ({"files"} - {*there})
    if changed := differences(*({k: v for k, v in asset.items() if k in names}
                                for asset in (there, now))):
        files = [change.partition(":")[0].removeprefix("files.") for change in changed]
        raise ConfigError(f"{address(out)} was rendered with other model files "
                          f"({', '.join(files)} changed); choose another --out folder")


def _with_environment(dataset: Provenance, one: Mapping[str, Any] | None) -> Provenance:
    if one is None or one in dataset.environments:
        return dataset
    return replace(dataset, environments=(*dataset.environments, one))


def _count(paths: Iterable[Path]) -> dict[str, Any]:
    try:
        return count_sequences(paths)
    except DatasetError as error:
        raise DatasetError(f"{error}; delete it, and the same command renders it again") from error


def _with_old_draws(out: Path, config: RenderConfig) -> RenderConfig:
    """The config; for a dataset in `out` that is older than `twin_of`, with its draws."""
    if (sequence_paths(out) and exists(out / DATASET_FILE)
            and "twin_of" not in read_provenance(out).config
            and config.twin_of == draws_of(config.robot)):
        say(f"{address(out)} continues with the draws of the version that began it")
        return replace(config, twin_of="")
    return config
