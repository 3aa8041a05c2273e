"""Jobs: a row on a dataset, its results folder, and what is missing in it."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ... import __version__
from ...errors import DatasetError, GcbenchError, MethodError, StorageError
from ...renderer.dataset import environment
from ...renderer.runtime import address, cpu_count, dump_json, parse_shard, say
from ...renderer.scene import differences
from ...robots.files import lock_briefly, remove_leftovers, write_atomically
from ..methods import Declaration, fingerprint_options, method_identity
from ..protocol import score_sequence, shape_of, truth_digest
from ..results import (
    ESTIMATES,
    RUN,
    SCORES,
    Attribution,
    Result,
    Row,
    Run,
    RunFolder,
    Status,
    Stored,
    dump_stored,
    read_run,
    read_stored,
    run_folder,
    write_run,
    write_scores,
)
from .datasets import Data


def check_owners(rows: Iterable[tuple[str, Row]]) -> None:
    """Raise MethodError if two methods would store their estimates in one folder."""
    owner: dict[str, str] = {}
    for source, row in rows:
        if (other := owner.setdefault(row.folder, source)) != source:
            raise MethodError(f"{other} and {source} both make the row {row.title}; give one of "
                              "them another name, or evaluate them into two --results folders")


@dataclass(frozen=True, eq=False)
class Job:
    """A row on a dataset, and the names of the sequences without an estimate."""

    folder: RunFolder
    data: Data
    share: tuple[str, ...]
    """The sequences that this process estimates; with --shard, a part of them."""
    todo: tuple[str, ...] = ()
    """Those of `share` without an estimate."""
    is_shared: bool = False
    """Whether other processes estimate the rest."""

    @property
    def row(self) -> Row:
        """The row."""
        return self.folder.run.row

    def read(self, sequence: str) -> Stored:
        """Read a stored estimate. Raises DatasetError if it is missing or damaged."""
        shape = shape_of(self.data.dataset[sequence])
        return read_stored(self.folder.estimate_path(sequence), shape)

    def write(self, sequence: str, estimate: bytes) -> Stored:
        """Store and read an estimate; bytes that are no estimate become a failure."""
        path = self.folder.estimate_path(sequence)
        with name_unwritable(path.parent):
            write_atomically(path, estimate)
        try:
            return self.read(sequence)
        except StorageError:
            raise
        except DatasetError as error:
            stored = Stored("invalid", f"the method's process sent no estimate: {error}")
            with name_unwritable(path.parent):
                write_atomically(path, dump_stored(stored))
            return stored

    def finish(self) -> None:
        """Score the run; of several shards, the last one does so.

        Estimates that another shard replaces meanwhile are scored again.
        """
        if not self.is_shared:
            self.score()
            return
        names = {self.folder.estimate_path(name).name for name in self.folder.run.sequences}
        while names <= (before := self._estimates()).keys():
            if read_run(self.folder.path / RUN).sequences != self.folder.run.sequences:
                return  # other shards work on more sequences, or fewer
            try:
                self.score()
            except DatasetError:
                if self._estimates() == before:
                    raise
            if self._estimates() == before:
                return

    def _estimates(self) -> dict[str, tuple[int, int]]:
        """What tells the files in the folder of estimates from those that replace them, by name."""
        found: dict[str, tuple[int, int]] = {}
        with os.scandir(self.folder.path / ESTIMATES) as entries:
            for entry in entries:
                with suppress(FileNotFoundError):  # another shard has just removed it
                    found[entry.name] = (entry.stat().st_ino, entry.stat().st_mtime_ns)
        return found

    def describe_rest(self) -> str:
        """Return in one line how many estimates of the run are there."""
        run, there = self.folder.run, self._estimates()
        done = sum(self.folder.estimate_path(name).name in there for name in run.sequences)
        return (f"{self.row.title} on {run.dataset}: {done} of {len(run.sequences)} sequences are "
                "estimated")

    def score(self) -> list[Result]:
        """Score every stored estimate, write the table and return its lines.

        Raises DatasetError if an estimate is missing or damaged, or if a sequence is not the one
        that was estimated.
        """
        out: list[Result] = []
        for name in self.folder.run.sequences:
            sequence = self.data.dataset[name]
            known = self.folder.run.digests.get(name)
            if known not in (None, truth_digest(sequence)):
                raise DatasetError(
                    f"{self.data.dataset.path}: sequence {name} changed after it was estimated; "
                    f"restore it, or delete {self.folder.path}")
            cluster = self.data.cluster(name)
            out += score_sequence(sequence, self.read(name), self.folder.run, name, cluster)
        with name_unwritable(self.folder.path):
            write_scores(self.folder.path / SCORES, out)
        return out

    def failures(self) -> Iterator[str]:
        """Yield a line for each sequence whose estimate failed."""
        for name in self.share:
            if line := self.describe_failure(name, self.read(name)):
                yield line

    def describe_failure(self, sequence: str, stored: Stored) -> str:
        """Return what went wrong in one line; empty if nothing did."""
        if stored.status == "ok":
            return ""
        where = f"{self.folder.run.dataset}/{sequence}"
        return f"{self.row.title} on {where}: {stored.status}: {shorten_reason(stored.reason)}"


def shorten_reason(reason: str) -> str:
    """Return a reason in one line: its first, and the last of what the method printed.

    Of a segmentation fault, the place in the method's code is the first that names a file.
    """
    first, *rest = reason.splitlines() or [""]
    said = [line.strip() for line in rest if not line.startswith("Extension modules:")]
    places = [line for line in said if line.startswith("File ")]
    is_fault = any(line.startswith("Fatal Python error:") for line in said)
    told = places[:1] if is_fault and places else said[-1:]
    return " ".join([first, *told]) if first.endswith("it said:") else first


def prepare_job(new: Run, data: Data, results: Path, retry: Sequence[Status] = (),
                shard: str = "") -> Job:
    """Create or reopen the folder of a run, and find the sequences without an estimate.

    With a shard ("3/64"), other processes may do so at the same time: only the estimates of the
    shard are touched.

    Raises DatasetError if the folder has estimates of another method version or dataset, or cannot
    be written.
    """
    new = with_free_name(new, results)
    path = run_folder(results, new.row, new.dataset)
    estimates = path / ESTIMATES
    with name_unwritable(path):
        estimates.mkdir(parents=True, exist_ok=True)
        with lock_briefly(path) if shard else nullcontext():
            new = _write_run(path, new, retry, bool(shard))
        share = new.sequences
        if shard:
            share = tuple(share[k] for k in parse_shard(shard, len(share)))
        else:
            remove_leftovers(path)
        remove_leftovers(estimates, {f"{name}.zip" for name in share} if shard else None)
        job = Job(RunFolder(path, new), data, share, is_shared=bool(shard))
        todo = tuple(name for name in share if not _is_done(job, name, retry))
        if shard:  # a run with shards is complete when all files are there
            for name in todo:
                job.folder.estimate_path(name).unlink(missing_ok=True)
        if todo:
            (path / SCORES).unlink(missing_ok=True)  # outdated by the new estimates
    return replace(job, todo=todo)


def _write_run(path: Path, new: Run, retry: Sequence[Status], is_shared: bool) -> Run:
    """Compare a run with what is in its folder, write `run.json`, and return what it says.

    Raises DatasetError if the folder has estimates of something else.
    """
    estimates = path / ESTIMATES
    has_estimates = any(estimates.glob("*.zip"))
    is_there = (path / RUN).exists()
    if has_estimates and not is_there and "ok" not in retry:
        raise DatasetError(
            f"{path} has estimates, but no {RUN} that says what made them; restore it, delete the "
            "folder, or discard them by --retry ok" + " without --shard" * is_shared)
    if has_estimates and not is_there:
        _discard(estimates)
    elif is_there and (is_shared or has_estimates):
        old = read_run(path / RUN)
        changed = differences(_identity(old, new), _identity(new, old))
        if changed and "ok" in retry:
            _discard(estimates)
        elif changed:
            raise DatasetError(
                f"{path} holds estimates of something else ({'; '.join(changed)}); choose another "
                "--results folder, delete this one, or discard them by --retry ok"
                + " without --shard" * is_shared
            )
        elif left := len({*old.sequences} - {*new.sequences}):
            say(f"{path}: {left} sequences of an earlier command are not among those of this one; "
                "their estimates stay, but are not scored")
        there = [e for e in old.environments if e not in new.environments]
        new = replace(new, environments=(*there, *new.environments))
    if not write_run(path, new, create=is_shared and not (path / RUN).exists()):
        return _write_run(path, new, retry, is_shared)  # another shard has created it
    return new


def _discard(estimates: Path) -> None:
    for file in estimates.glob("*.zip"):
        file.unlink()


@contextmanager
def name_unwritable(path: Path) -> Generator[None]:
    """Turn an OSError of writing below `path` into a DatasetError."""
    try:
        yield
    except OSError as error:
        raise DatasetError(f"cannot write to {path}: {error.strerror or error}") from error


def describe_run(row: Row, source: str, data: Data, limits: Mapping[str, Any],
                 declared: Declaration | None = None) -> Run:
    """Return the record that `run.json` stores for a row on a dataset, with this environment.

    `declared` is the method's declaration; predictions have none. Raises DatasetError for a folder
    whose name no JSON can express.
    """
    path = address(data.dataset.path)
    if any("\ud800" <= c <= "\udfff" for c in path + data.name):
        raise DatasetError(f"{path}: its name is not UTF-8; rename it")
    info, environment = data.dataset.info, _describe_environment()
    if declared and declared.versions:
        environment["method"] = declared.versions
    return Run(
        row=row, source=source, dataset=data.name, data=path,
        config=info.config, assets=info.assets, sequences=data.sequences, left_out=data.left_out,
        limits=limits, environments=(environment,), settings=declared.settings if declared else {},
        digests=data.digests, attribution=declared.attribution if declared else Attribution(),
        files=fingerprint_options(source),
    )


def with_free_name(new: Run, results: Path) -> Run:
    """Add the seed to the name of a dataset if the results hold another seed under this name."""
    seed = new.config.get("seed")
    path = run_folder(results, new.row, new.dataset) / RUN
    if path.exists() and "/" not in new.dataset and read_run(path).config.get("seed") != seed:
        return replace(new, dataset=f"{new.dataset}-seed-{seed}")
    return new


def _describe_environment() -> dict[str, Any]:
    """Return package versions, CPU model and core count; no host name."""
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((x.partition(":")[2].strip() for x in lines if x.startswith("model name")), cpu)
    except OSError:
        pass
    return {"gcbench": __version__, **environment(), "cpu": cpu, "cores": cpu_count()}


def _identity(run: Run, other: Run) -> dict[str, Any]:
    """Return the fields that are equal in all estimates of one row, for comparison with `other`."""
    row = run.row
    common = run.digests.keys() & other.digests.keys()
    return json.loads(dump_json({
        "version": row.version, "training": row.training,
        "source": _without_folder(method_identity(run.source)),
        "config": run.config, "truth": {name: run.digests[name] for name in sorted(common)},
        "content of the file": {f"--{name}": run.files[name]
                                for name in sorted(run.files.keys() & other.files.keys())},
    }))


def _without_folder(source: str) -> str:
    """Return the source of a method with the name of its file in place of the path, which depends
    on the current folder."""
    name, mark, options = source.partition("?")
    return re.split(r"[/\\]", name)[-1] + mark + options


def _is_done(job: Job, sequence: str, retry: Sequence[Status]) -> bool:
    if not job.folder.estimate_path(sequence).exists():
        return False
    try:
        return job.read(sequence).status not in retry
    except StorageError:
        raise
    except GcbenchError:
        return False  # damaged
