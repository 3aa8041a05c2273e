"""Is a dataset what it promises to be? Every sequence, every frame, every pixel.

`verify_sequence` tests a sequence in memory or on disk, `verify_dataset` a folder; both return a
`Report`, whose `table()` a person reads and whose `ok` decides the exit status.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Mapping
from collections.abc import Sequence as Stack
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ...errors import GcbenchError
from ...robots.model import ArticulatedModel
from ..scene import RenderConfig, packages_of
from ..types import Sequence
from .checks import Check, Report, check, merge
from .images import verify_images
from .kinematics import verify_state
from .layers import verify_layers
from .observability import verify_observability
from .surfaces import surfaces_to_check, verify_surface
from .tracks import verify_points

__all__ = ["Check", "Reference", "Report", "reference_of", "verify_dataset", "verify_sequence"]

_POOL = 4  # sequences that are verified sooner than processes start


@dataclass(frozen=True)
class Reference:
    """What poses are compared with, beside the sequence itself. Either may be missing."""

    model: ArticulatedModel | None = None
    urdf: Path | None = None
    """Read a second time, by another reader."""
    names: Mapping[str, str] = field(default_factory=dict[str, str])
    """What the sequence calls links of the URDF that it does not call by their own names."""


def verify_sequence(sequence: Sequence, model: ArticulatedModel | None = None,
                    urdf: Path | None = None, names: Mapping[str, str] | None = None) -> Report:
    """All checks of one sequence; without a model, joints are tested against their own screws.

    Raises what the sequence raises if it cannot be decoded.
    """
    with np.errstate(all="ignore"):  # a broken value becomes an infinite residual, not a warning
        checks = verify_state(sequence, model, urdf, names)
        if all(c.ok for c in checks[:2]):  # shapes and finite: without them nothing can be computed
            checks += verify_images(sequence)
            checks += verify_layers(sequence)
            checks += verify_surface(sequence, model)
            checks += verify_points(sequence, model)
            checks += verify_observability(sequence, model)
    return Report(merge(checks))


def verify_dataset(path: str | Path, workers: int = 1, progress: bool = True) -> Report:
    """All checks of every sequence of a dataset, and of the dataset as a whole.

    `path` may also be one sequence (a ZIP or a folder), which is verified against its dataset's
    config if it lies in one. Raises GcbenchError if there is no readable dataset at `path`; a
    sequence that is not readable is a check that fails.
    """
    from ..dataset import open_dataset

    path = Path(path)
    if path.is_file() or (path / "meta.json").is_file():
        return _verify_one(path.absolute())
    dataset = open_dataset(path)
    files, warnings = _sequence_files(path)
    reference, notes = _shared_reference(dataset.config)
    jobs = [(file, reference, dataset.config.seed) for file in files]
    checks = _whole(files, dataset.info.counts)
    for found in _run(jobs, workers, progress):
        checks += found
    return Report(merge(checks), (*warnings, *notes))


def _verify_one(path: Path) -> Report:
    from ..dataset import open_dataset

    seed, reference, notes = None, Reference(), ["alone, without a dataset's config"]
    if (path.parent.parent / "dataset.json").is_file():
        config = open_dataset(path.parent.parent).config
        seed = config.seed
        reference, notes = _shared_reference(config)
    return Report(merge(_verify_file((path, reference, seed))), tuple(notes))


def _shared_reference(config: RenderConfig) -> tuple[Reference | RenderConfig, list[str]]:
    """What all sequences are compared with; the config itself where each has its own instance."""
    from ...robots.catalog import is_category

    return (config, []) if is_category(config.robot) else reference_of(config)


def reference_of(
    config: RenderConfig, robot: str | None = None
) -> tuple[Reference, list[str]]:
    """A model without rigid surfaces, and why it or its URDF is not at hand; default: the config's.

    Nothing is downloaded: to verify a dataset is to read it.
    """
    from ...robots.catalog import is_object, load_robot, robot_urdf
    from ...robots.urdf import partnet

    robot = robot or config.robot
    try:
        packages = packages_of(config)
        model = load_robot(robot, packages, config.allow_missing, download=False)
        urdf = robot_urdf(robot, packages, download=False)
        names = partnet.part_names(urdf.parent) if urdf and is_object(robot) else {}
    except (GcbenchError, OSError) as error:
        return Reference(), [f"poses are tested against the joints' own screws only: {error}"]
    return Reference(surfaces_to_check(model), urdf, names), []


def _sequence_files(path: Path) -> tuple[list[Path], list[str]]:
    """Sequences in order, and a warning for everything else that lies beside them."""
    folder = path / "sequences"
    entries = sorted(folder.iterdir()) if folder.is_dir() else []
    named = {e: e.name.removesuffix(".zip") for e in entries}
    files = [e for e, name in named.items()
             if name.isdecimal() and (e.is_dir() or e.suffix == ".zip")]
    strays = [e.name for e in entries if e not in files]
    warnings = [f"not a sequence, perhaps left by a run that was killed: {x}" for x in strays]
    return files, warnings


def _whole(files: Stack[Path], counts: Mapping[str, Any] | None) -> list[Check]:
    """Checks of the dataset apart from its sequences; `counts` is what it says of itself."""
    indices = [int(f.stem) for f in files]
    missing = sorted({*range(max(indices, default=0) + 1)} - {*indices})
    said = int(counts["sequences"]) if counts and "sequences" in counts else len(files)
    return [
        check("sequences present", int(not files), 0, "datasets", "there is none"),
        check("sequences counted", said - len({*indices}), 0, "sequences",
              f"dataset.json says {said}"),
        check("no sequence missing", len(missing), 0, "sequences",
              f"first: {missing[0]:06d}" if missing else "", samples=len(files)),
        check("no sequence twice", len(indices) - len({*indices}), 0, "sequences",
              "a ZIP and a folder", samples=len(files))]


_Job = tuple[Path, "Reference | RenderConfig", "int | None"]


def _run(jobs: Stack[_Job], workers: int, progress: bool) -> Iterator[list[Check]]:
    """The checks of each sequence, in order."""
    from tqdm import tqdm

    bar = tqdm(total=len(jobs), desc="verify", unit="sequence", delay=2, disable=not progress)
    with bar:
        if workers <= 1 or len(jobs) <= _POOL:
            for job in jobs:
                yield _verify_file(job)
                bar.update()
            return
        # spawn: a forked OpenCV or BLAS may hang on locks of threads that were not copied
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context) as pool:
            for found in pool.map(_verify_file, jobs):
                yield found
                bar.update()


def _verify_file(job: _Job) -> list[Check]:
    """The checks of one file, with its name in front of every place."""
    from ..dataset import open_sequence
    from ..scene import robot_of

    file, reference, seed = job
    try:
        sequence = open_sequence(file)
        meta = sequence.meta
        if isinstance(reference, RenderConfig):
            reference, _ = reference_of(reference, robot_of(reference, meta))
        found = [check("readable", 0, 0, "sequences"),
                 check("seed and index", seed is not None
                       and (meta.seed, f"{meta.index:06d}") != (seed, file.stem), 0,
                       "sequences", f"says seed {meta.seed}, index {meta.index}")]
        found += verify_sequence(
            sequence, reference.model, reference.urdf, reference.names).checks
    except (GcbenchError, OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        found = [check("readable", 1, 0, "sequences", f"{type(error).__name__}: {error}")]
    return [replace(c, where=f"{file.stem} {c.where}".rstrip()) if c.worst > 0 else c
            for c in found]
