"""Verify datasets: every sequence, every frame, every pixel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Stack
from contextlib import closing
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ...errors import ConfigError, GcbenchError, StorageError
from ...robots.model import ArticulatedModel
from ..dataset import (
    DATASET_FILE,
    SEQUENCES_FOLDER,
    Dataset,
    count_sequences,
    open_dataset,
    open_sequence,
    select_sequences,
)
from ..runtime import (
    Problem,
    WorkerPool,
    WorkerSettings,
    address,
    count_workers,
    exists,
    is_remote,
    list_folder,
    receive_tasks,
)
from ..scene import RenderConfig, check_model_paths, packages_of, robot_of
from ..types import Sequence
from .checks import CheckResult, VerifyReport, check, merge_checks
from .images import verify_images
from .kinematics import GLTF_FILES, URDF_FILES, verify_state
from .layers import verify_layers
from .meta_fields import check_config_fields
from .observability import verify_observability
from .surfaces import surfaces_to_check, verify_surface
from .tracks import verify_tracks

_FIRST = 5  # checks of a state that are the premise of all others
_POOL = 4  # sequences; so few are verified before processes have started


@dataclass(frozen=True)
class Reference:
    """What poses are compared with, besides the sequence itself. Either may be missing."""

    model: ArticulatedModel | None = None
    file: Path | None = None
    """URDF or glTF, which the verifier's own readers read a second time"""
    names: Mapping[str, str] = field(default_factory=dict[str, str])
    """the sequence's names of links of the URDF, where they differ"""
    scale: float = 1.0
    """factor of the lengths of the file"""


def verify_sequence(
    sequence: Sequence, model: ArticulatedModel | None = None, file: Path | None = None,
    names: Mapping[str, str] | None = None, scale: float = 1.0,
) -> VerifyReport:
    """Run all checks of one sequence, in memory or on disk.

    Args:
        sequence: The sequence.
        model: The model that it shows. Without one, joints are tested against their own screws.
        file: The model's URDF or glTF file, which is read a second time.
        names: The sequence's names of links of the URDF, where they differ.
        scale: Factor of the lengths of the file.

    Raises:
        DatasetError: an image cannot be decoded, or the record of the animation is malformed.
    """
    with np.errstate(all="ignore"):  # a broken value becomes an infinite residual, not a warning
        checks = verify_state(sequence, model, file, names, scale)
        # Without shapes, finite numbers, intrinsics and rigid poses nothing can be computed.
        if all(c.ok for c in checks[:_FIRST]):
            checks += verify_images(sequence)
            checks += verify_layers(sequence)
            checks += verify_surface(sequence, model)
            checks += verify_tracks(sequence, model)
            checks += verify_observability(sequence, model)
    return VerifyReport(merge_checks(checks))


def verify_dataset(
    path: str | Path | Dataset, workers: int = 1, progress: bool = True, allow_model: bool = False,
    sequences: str = "",
) -> VerifyReport:
    """Run all checks of every sequence of a dataset, and of the dataset as a whole.

    Nothing is downloaded. If the model is not on this machine, or is a file that may not be read,
    poses are tested against the joints' own screws only, and the report has a warning.

    Args:
        path: The folder of a dataset; or one sequence (a ZIP or a folder), which is verified
            against the configuration of its dataset, if it lies in one; or an open dataset, whose
            folder is read again.
        workers: Number of processes. 0: one for each core.
        progress: Whether to show a progress bar.
        allow_model: Whether to read the model from a path that the dataset names.
        sequences: Numbers and ranges of sequences, for example "0-9,15". Default: all, and then
            also that none is missing.

    Returns:
        The report with `ok`, `worst`, `failures` and `table()`. A sequence that cannot be read is a
        failed check.

    Raises:
        DatasetError: there is no readable dataset at `path`, or its storage does not answer.
        ConfigError: there are no such sequences, or a negative number of workers.
        GcbenchError: a process died, for example for lack of memory.

    Example:
        >>> report = gb.verify_dataset("data/ur5", progress=False)
        >>> report.ok
        True
    """
    if isinstance(path, Dataset):
        path, allow_model = path.path, allow_model or path.allow_model
    path = Path(path)
    workers = count_workers(workers)
    if path.suffix == ".zip" if is_remote(path) else (
            path.is_file() or (path / "meta.json").is_file()):
        if sequences:
            raise ConfigError(f"--sequences {sequences}: {address(path)} is one sequence")
        return _verify_one(path if is_remote(path) else path.absolute(), allow_model)
    dataset = open_dataset(path)
    files, warnings = sequence_files(path)
    if sequences:
        chosen = {*select_sequences(dataset, sequences)}
        files, warnings, checks = [f for f in files if f.stem in chosen], [], list[CheckResult]()
    else:
        checks = dataset_checks(files, dataset.info.counts)
    reference, notes = shared_reference(dataset.config, allow_model)
    jobs = [(file, reference, dataset.config) for file in files]
    for found in verify_files(jobs, workers, progress):
        checks += found
    return VerifyReport(merge_checks(checks), (*dataset.warnings, *warnings, *notes))


def _verify_one(path: Path, allow_model: bool) -> VerifyReport:
    config, reference, notes = None, Reference(), ["alone, without a dataset's config"]
    if exists(path.parent.parent / DATASET_FILE):
        config = open_dataset(path.parent.parent).config
        reference, notes = shared_reference(config, allow_model)
    return VerifyReport(merge_checks(_verify_file((path, reference, config))), tuple(notes))


def shared_reference(
    config: RenderConfig, allow_model: bool
) -> tuple[Reference | RenderConfig, list[str]]:
    """The reference of all sequences; the config itself where each shows its own instance."""
    from ...robots.catalog import is_category

    return (config, []) if is_category(config.robot) else reference_of(config, None, allow_model)


def reference_of(
    config: RenderConfig, robot: str | None = None, allow_model: bool = False
) -> tuple[Reference, list[str]]:
    """Load the model of a config (or `robot`) without its rigid surfaces, and name its file.

    Also return notes on why these are not on this machine. Nothing is downloaded.
    """
    from ...robots.catalog import is_file, is_object, load_robot, robot_urdf
    from ...robots.urdf import partnet

    robot = robot or config.robot
    try:
        if not allow_model:
            check_model_paths(config)
        packages = packages_of(config)
        model = load_robot(robot, packages, config.allow_missing, False, config.root, config.scale)
        file = Path(robot) if is_file(robot) else robot_urdf(robot, packages, download=False)
        names = partnet.part_names(file.parent) if file and is_object(robot) else {}
        notes: list[str] = []
        if file is not None and file.suffix.lower() not in (*URDF_FILES, *GLTF_FILES):
            notes.append(f"poses are tested against the first reader's model only: {file.suffix} "
                         "files have no second reader")
    except (GcbenchError, OSError) as error:
        return Reference(), [f"poses are tested against the joints' own screws only: {error}"]
    return Reference(surfaces_to_check(model), file, names, config.scale), notes


def sequence_files(path: Path) -> tuple[list[Path], list[str]]:
    """The sequences in order, and a warning for each other file beside them."""
    entries = list_folder(path / SEQUENCES_FOLDER)
    files: list[Path] = []
    warnings: list[str] = []
    for entry in entries:
        name = entry.name.removesuffix(".zip")
        if name.isdecimal() and (name != entry.name or entry.is_dir()):
            files.append(entry)
        else:
            warnings.append(f"not a sequence, perhaps left by an interrupted run: {entry.name}")
    return files, warnings


def dataset_checks(files: Stack[Path], counts: Mapping[str, Any] | None) -> list[CheckResult]:
    """Checks of the dataset apart from its sequences; `counts` is from dataset.json."""
    indices = [int(f.stem) for f in files]
    there = sorted({*indices})
    said = counts["sequences"] if counts and "sequences" in counts else len(files)
    # A dataset of chosen sequences (`render --sequences`) has gaps, and says how many there are.
    whole = counts is not None and said == len(there)
    missing = 0 if whole else min(max(there, default=0) + 1 - len(there), 2**53)
    first = next((i for i, index in enumerate(there) if i != index), 0)
    return [
        check("sequences present", int(not files), 0, "datasets", "the dataset has none"),
        check("sequences counted", said - len(there), 0, "sequences",
              f"dataset.json says {said}"),
        check("no sequence missing", missing, 0, "sequences", f"first: {first:06d}",
              samples=len(files)),
        check("no sequence twice", len(indices) - len(there), 0, "sequences",
              "a ZIP and a folder", samples=len(files)),
        *(_check_counts(files, counts) if counts and len(counts) > 1 else [])]


def _check_counts(files: Stack[Path], counts: Mapping[str, Any]) -> list[CheckResult]:
    """The check that `counts` are those of the sequences; none if a sequence cannot be read, which
    is a failed check of its own."""
    try:
        found = count_sequences(files)
    except StorageError:
        raise
    except _UNREADABLE:
        return []
    wrong = [f"{name}, which are {found[name]}" for name in ("frames", "unobservable", "refused")
             if counts.get(name, found[name]) != found[name]]
    return [check("counts of dataset.json", len(wrong), 0, "fields", ", ".join(wrong), samples=3)]


_Job = tuple[Path, "Reference | RenderConfig", "RenderConfig | None"]
_UNREADABLE = (GcbenchError, OSError, ValueError, KeyError, EOFError, BadZipFile)


def verify_files(jobs: Stack[_Job], workers: int, progress: bool) -> Iterator[list[CheckResult]]:
    """The checks of each sequence, in order."""
    from tqdm import tqdm

    bar = tqdm(total=len(jobs), desc="verify", unit="sequence", delay=2, disable=not progress)
    with bar:
        if workers <= 1 or len(jobs) <= _POOL:
            for job in jobs:
                yield _verify_file(job)
                bar.update()
            return
        settings = WorkerSettings(
            "gcbench.renderer.verify.driver:check_files", workers=min(workers, len(jobs)))
        pool = WorkerPool(settings, range(len(jobs)), lambda to, job: to.send(jobs[job]))
        found, following = dict[int, list[CheckResult]](), 0
        with closing(pool.events()) as events:
            for event in events:
                if event.kind != "message":
                    raise GcbenchError("a process that verifies died (out of memory?); run the "
                                       "same command again, with fewer --workers")
                if isinstance(event.content, Problem):
                    event.content.throw()
                if event.worker.task is not None:
                    found[event.worker.task] = event.content
                    bar.update()
                event.worker.release()
                while following in found:
                    yield found.pop(following)
                    following += 1


def check_files(connection: Connection) -> None:
    """Check each file that arrives, and send what was found: the target of `verify_files`."""
    try:
        connection.send([])  # ready
        for job in receive_tasks(connection, Connection.recv):
            connection.send(_verify_file(job))
    except Exception as error:
        connection.send(Problem.describe(error))


def _verify_file(job: _Job) -> list[CheckResult]:
    """The checks of one file; places start with its name. StorageError says nothing of them."""
    file, reference, config = job
    try:
        sequence = open_sequence(file)
        meta = sequence.meta
        if isinstance(reference, RenderConfig):
            reference, _ = reference_of(reference, robot_of(reference, meta))
        found = [check("readable", 0, 0, "sequences"),
                 check("seed and index", config is not None
                       and (meta.seed, f"{meta.index:06d}") != (config.seed, file.stem), 0,
                       "sequences", f"says seed {meta.seed}, index {meta.index}")]
        if config is not None:
            found.append(check_config_fields(sequence, config))
        found += verify_sequence(
            sequence, reference.model, reference.file, reference.names,
            reference.scale).checks
    except StorageError:
        raise
    except _UNREADABLE as error:
        found = [check("readable", 1, 0, "sequences", f"{type(error).__name__}: {error}")]
    return [replace(c, where=f"{file.stem} {c.where}".rstrip()) if c.worst > 0 else c
            for c in found]
