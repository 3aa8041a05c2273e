"""Verify a dataset by many processes: each writes what it finds, and the files are merged.

A file of a shard is a line of JSON that names the dataset, and one more for each sequence. A line
is written when its sequence is verified, so a killed shard continues.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping
from collections.abc import Sequence as Stack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import msgspec

from ... import __version__
from ...errors import DatasetError, GcbenchError, StorageError
from ...robots.files import remove_leftovers, write_atomically
from ..dataset import Dataset, default_output, open_dataset
from ..runtime import address, count_workers, dump_json, open_archive, parse_shard, require_local
from ..scene import config_tree
from .checks import CheckResult, VerifyReport, merge_checks
from .driver import dataset_checks, sequence_files, shared_reference, verify_files

_FORMAT = "gcbench-verify/1"
_SUFFIX = ".jsonl"
_MAX_LINE = 2**20  # bytes
_Record = TypeVar("_Record")
_Number = float | None
"""None is infinite, which JSON cannot express."""


@dataclass(frozen=True)
class _Head:
    """The first line."""

    format: str
    gcbench: str
    dataset: str
    """Hash of its configuration."""
    shard: int
    count: int
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Line:
    """What was found in a sequence."""

    sequence: str
    digest: str
    checks: tuple[tuple[str, _Number, _Number, float, str, int, str, str], ...]
    """The fields of each `CheckResult`."""


def verify_shard(
    path: str | Path | Dataset, shard: str, reports: str | Path | None = None, workers: int = 1,
    progress: bool = True, allow_model: bool = False,
) -> VerifyReport:
    """Run all checks of a share of the sequences of a dataset, and write what they find to a file.

    Any number of processes may verify shards at the same time. Sequences that the file has and
    that did not change are not verified again, so the same call continues one that was killed.
    `merge_verification` makes one report of the files of all shards.

    Args:
        path: The folder of a dataset, or its address in object storage; or an open dataset.
        shard: The share, such as "3/64": of the sequences that are there, those at the places 3,
            67, 131, ... (from 0); or auto, see `gcbench verify --help`.
        reports: Folder of the files. Default: `<dataset>-verify` in the current folder.
        workers: Number of processes. 0: one for each core.
        progress: Whether to show a progress bar.
        allow_model: Whether to read the model from a path that the dataset names.

    Returns:
        The report of the shard.

    Raises:
        DatasetError: there is no readable dataset at `path`.
        ConfigError: there is no such shard, or a negative number of workers.

    Example:
        >>> gb.verify_shard("data/ur5", "0/2", progress=False).ok
        True
    """
    workers = count_workers(workers)
    dataset = _open(path)
    allow_model |= dataset.allow_model
    files, _ = sequence_files(dataset.path)
    mine = parse_shard(shard, max(1, len(files)))
    files = files[mine.index::mine.count]
    reference, notes = shared_reference(dataset.config, allow_model)
    head = _Head(_FORMAT, __version__, _identity(dataset), mine.index, mine.count, tuple(notes))
    folder = _folder(dataset, reports)
    digests = {file.stem: _digest(file) for file in files}
    with _ShardFile(folder / f"{mine.index}-of-{mine.count}{_SUFFIX}", head, digests) as found:
        todo = [file for file in files if file.stem not in found.checks]
        jobs = [(file, reference, dataset.config) for file in todo]
        for file, checks in zip(todo, verify_files(jobs, workers, progress), strict=True):
            found.add(file.stem, checks)
    checks = [check for file in files for check in found.checks[file.stem]]
    return VerifyReport(merge_checks(checks), (*dataset.warnings, *notes))


def _open(path: str | Path | Dataset) -> Dataset:
    """The dataset as it is now."""
    if isinstance(path, Dataset):
        return open_dataset(path.path, path.allow_model)
    return open_dataset(path)


def merge_verification(
    path: str | Path | Dataset, reports: str | Path | None = None
) -> VerifyReport:
    """Make the report of a dataset of the files that its shards wrote.

    It is equal to that of `verify_dataset`.

    Args:
        path: The folder of the dataset, or its address in object storage; or an open dataset.
        reports: Folder of the files. Default: `<dataset>-verify` in the current folder.

    Returns:
        The report.

    Raises:
        DatasetError: a shard is missing or has not ended, or the dataset is another one or has
            changed.

    Example:
        >>> shards = [gb.verify_shard("data/ur5", f"{k}/2", progress=False) for k in range(2)]
        >>> gb.merge_verification("data/ur5").ok
        True
    """
    dataset = _open(path)
    files, warnings = sequence_files(dataset.path)
    folder, identity = _folder(dataset, reports), _identity(dataset)
    found: dict[str, _Line] = {}
    counts: set[int] = set()
    for file in sorted(folder.glob(f"*{_SUFFIX}")):
        head, lines = _read(file)
        if head is None or (head.dataset, head.gcbench) != (identity, __version__):
            raise DatasetError(f"{file} is of another dataset or version of gcbench; delete it, "
                               "and run its shard again")
        warnings += [warning for warning in head.warnings if warning not in warnings]
        counts.add(head.count)
        found |= {line.sequence: line for line in lines}
    missing = [k for k, file in enumerate(files)
               if file.stem not in found or found[file.stem].digest != _digest(file)]
    if missing:
        raise DatasetError(_describe_missing(dataset, folder, files, missing, counts))
    checks = dataset_checks(files, dataset.info.counts)
    for file in files:
        checks += _checks(found[file.stem])
    return VerifyReport(merge_checks(checks), (*dataset.warnings, *warnings))


def _describe_missing(
    dataset: Dataset, folder: Path, files: Stack[Path], missing: Stack[int], counts: set[int]
) -> str:
    command = f"gcbench verify {address(dataset.path)} --shard "
    shards = "K/N of each shard"
    if len(counts) == 1:
        (count,) = counts
        left = sorted({k % count for k in missing})
        shards = f"{left[0]}/{count}" + f" (and {len(left) - 1} more shards)" * (len(left) > 1)
    return (f"{folder}: {len(missing)} of {len(files)} sequences are not verified, or changed "
            f"since (first: {files[missing[0]].stem}); run {command}{shards}")


class _ShardFile:
    """The file of a shard, to which sequences are added."""

    def __init__(self, path: Path, head: _Head, digests: Mapping[str, str]) -> None:
        """Keep what the file has of these sequences, if they did not change since."""
        self._path, self._digests = path, digests
        path.parent.mkdir(parents=True, exist_ok=True)
        lines: Stack[_Line] = ()
        if path.is_file():
            old, lines = _read(path)
            lines = [line for line in lines
                     if old == head and digests.get(line.sequence) == line.digest]
        self.checks = {line.sequence: _checks(line) for line in lines}
        remove_leftovers(path.parent, {path.name})
        # written anew, because a kill may have cut off the last line
        write_atomically(path, b"".join(map(_encode, (head, *lines))))
        self._file = path.open("ab")

    def __enter__(self) -> _ShardFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, sequence: str, checks: Stack[CheckResult]) -> None:
        """Append what was found in a sequence."""
        line = _Line(sequence, self._digests[sequence], tuple(
            (c.name, _number(c.worst), _number(c.mean), float(c.bound), c.unit, int(c.samples),
             c.where, c.note) for c in checks))
        self._file.write(_encode(line))
        self._file.flush()
        os.fsync(self._file.fileno())
        self.checks[sequence] = _checks(line)


def _read(path: Path) -> tuple[_Head | None, list[_Line]]:
    """Read the file of a shard; lines that a kill cut off are left out."""
    head, lines = None, list[_Line]()
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), b"")):
                if number == 0:
                    head = _decode(line, _Head)
                elif found := _decode(line, _Line):
                    lines.append(found)
    except OSError as error:
        raise DatasetError(f"{path}: {error.strerror or error}") from error
    return (head if head and head.format == _FORMAT else None), lines


def _encode(record: object) -> bytes:
    return msgspec.json.encode(record) + b"\n"


def _decode(line: bytes, kind: type[_Record]) -> _Record | None:
    try:
        return msgspec.json.decode(line, type=kind) if line.endswith(b"\n") else None
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None


def _checks(line: _Line) -> list[CheckResult]:
    return [CheckResult(name, math.inf if worst is None else worst,
                        math.inf if mean is None else mean, bound, unit, samples, where, note)
            for name, worst, mean, bound, unit, samples, where, note in line.checks]


def _number(value: float) -> _Number:
    return float(value) if math.isfinite(value) else None


def _identity(dataset: Dataset) -> str:
    return hashlib.sha256(dump_json(config_tree(dataset.config))).hexdigest()


def _digest(file: Path) -> str:
    """Hash of a sequence by the checksums of its members; empty if it cannot be read."""
    try:
        return open_archive(file).digest()
    except StorageError:
        raise
    except (GcbenchError, OSError):
        return ""


def _folder(dataset: Dataset, reports: str | Path | None) -> Path:
    if reports:
        require_local(Path(reports), "--reports")
    return Path(reports) if reports else default_output(dataset.path, "-verify")
