"""Publish results: store estimates on a suite and their scores in compact form, and check them."""

from __future__ import annotations

import dataclasses
import datetime
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlencode

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, GcbenchError
from ...renderer.dataset import Dataset
from ...renderer.runtime import is_remote, require_local, say
from ...renderer.scene import (
    MotionSampler,
    Streams,
    config_tree,
    differences,
    draw_camera,
    model_source,
    parse_config,
)
from ...robots.model import joint_screws
from ..methods import method_identity
from ..protocol import shape_of, truth_digest, truth_of
from ..report import (
    PUBLISHED_ROWS,
    PublishedRow,
    PublishedTruth,
    pack_estimates,
    pack_truth,
    published_files,
    read_row,
    read_truth,
    row_path,
    score_published,
    truth_path,
    write_record,
)
from ..results import Run, RunFolder, Stored, find_runs, read_stored
from .datasets import ALL, select
from .submissions import SOURCE
from .suite import SuiteDataset, builtin_datasets

_LARGEST = {"displacement": 1e-5, "screw": 1e-4, "origin": 1e-4}
"""Largest difference of published truth to truth that is drawn again: single precision, rad, m."""


def publish(results: Sequence[Path], folder: Path = PUBLISHED_ROWS) -> list[Path]:
    """Add the estimates of results on built-in suites to published rows; return the files.

    Sequences are added to a row of the same version of the method, so that several people can
    measure parts of it; a row of another version is replaced, and a message tells how many of its
    sequences the new one lacks.

    Raises:
        DatasetError: If there are no such results, a run is not finished, its data are missing,
            changed or not those of the suite, its sequences differ in frames or joints, or the
            same version of the method is published with another source or training.
    """
    require_local(folder, "--to")
    datasets = builtin_datasets()
    runs = [run for run in find_runs(results) if run.run.dataset in datasets]
    if not runs:
        raise DatasetError("no results on a built-in suite to publish; run "
                           "`gcbench eval --suite standard --method NAME` first")
    return [_publish(run, datasets[run.run.dataset], folder) for run in runs]


def _publish(found: RunFolder, entry: SuiteDataset, folder: Path) -> Path:
    run = found.run
    if changes := differences(config_tree(entry.config), run.config):
        raise DatasetError(f"{found.path}: not the data of the suite ({changes[0]})")
    if is_remote(Path(run.data)):  # results of other people must not open connections
        raise DatasetError(f"{found.path}: its dataset is in object storage; download it, and "
                           "evaluate on the folder")
    data = select(run.dataset, Path(run.data), ALL).dataset
    run = replace(run, sequences=tuple(sorted(run.sequences, key=int)))
    if missing := [name for name in run.sequences if not found.estimate_path(name).exists()]:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise DatasetError(f"{found.path}: not finished, no estimates of {', '.join(missing[:3])}"
                           f"{more}; continue with the same `gcbench eval`, then publish")
    for name in run.sequences:
        if run.digests.get(name) not in (None, truth_digest(data[name])):
            raise DatasetError(f"{found.path}: sequence {name} of {run.data} changed after it was "
                               "estimated; restore it, or estimate it again")
    stored = [read_stored(found.estimate_path(name), shape_of(data[name]))
              for name in run.sequences]
    truth = _add_truth(found, data, folder)
    path = row_path(folder, run.row, run.dataset)
    new = _pack(run, stored, truth)
    old = read_row(path, folder, {}) if path.exists() else None
    if old:
        _compare(old, new, found)
        new = _join(old, new)
    write_record(truth_path(folder, run.dataset), truth)
    if old and (lost := len({*old.run.sequences} - {*new.run.sequences})):
        say(f"{path}: replaces a row of version {old.run.row.version} that had {lost} more "
            "sequences; run them as well, and publish again")
    write_record(path, score_published(new, truth))
    return path


def _pack(run: Run, stored: Sequence[Stored], truth: PublishedTruth) -> PublishedRow:
    run = replace(run, source=_without_folders(run.source), config={}, assets=(), digests={},
                  settings={}, data="", left_out=0)
    return PublishedRow(
        run, datetime.datetime.now(datetime.timezone.utc).date().isoformat(), _command(run),
        tuple(s.status for s in stored),
        arrays=pack_estimates(stored, truth.frames, len(truth.joint_names)),
    )


def _compare(old: PublishedRow, new: PublishedRow, found: RunFolder) -> None:
    """Raise DatasetError if two rows have the same version, but other code or training."""
    if old.run.row.version != new.run.row.version:
        return
    for name, a, b in (
        ("source", *(method_identity(row.run.source) for row in (old, new))),
        ("training", old.run.row.training, new.run.row.training),
    ):
        if a != b:
            raise DatasetError(
                f"{found.path}: version {new.run.row.version} of {new.run.row.title} is published "
                f"with the {name} {a!r}, and this one has {b!r}; raise the version of the method, "
                "or give it another name, and evaluate it again")


def _join(old: PublishedRow, new: PublishedRow) -> PublishedRow:
    """Add the sequences of `new` to `old`, if the version is the same; else return `new`."""
    if old.run.row != new.run.row:
        return new
    both = {name: (row, k) for row in (old, new) for k, name in enumerate(row.run.sequences)}
    names = tuple(sorted(both, key=int))
    there = [e for e in old.run.environments if e not in new.run.environments]
    run = replace(new.run, sequences=names, environments=(*there, *new.run.environments))
    return replace(
        new, run=run, command=_command(run),
        status=tuple(both[name][0].status[both[name][1]] for name in names),
        arrays={key: np.stack([both[name][0].arrays[key][both[name][1]] for name in names])
                for key in new.arrays},
    )


def _without_folders(source: str) -> str:
    """Return the identity of a method with the names of files in place of their paths."""
    name, mark, query = source.partition("?")
    options = [(key, " ".join(map(_without_folder, value.split(" "))) if key == "set"
                else _without_folder(value)) for key, value in parse_qsl(query)]
    return name.rpartition("/")[2] + mark + urlencode(options)


def _without_folder(value: str) -> str:
    """Return the value of an option with the name of a file in place of its path.

    What stands before a path stays, as "raft:" in raft:/w/sintel.pth, and so does a model
    OWNER/NAME of the Hugging Face hub.
    """
    path = re.sub(r"^(?:[\w.-]+[:=+])+", "", value)
    kind = value[: len(value) - len(path)]
    if re.search(r"\bhf(-\w+)?:$", kind) and re.fullmatch(r"\w[\w.-]*/[\w.-]+", path):
        return value
    return kind + path.rstrip("/").rpartition("/")[2]


def _command(run: Run) -> str:
    """Return the command that measures a row on a suite."""
    row, (source, _, query) = run.row, run.source.partition("?")
    suite, _, dataset = run.dataset.rpartition("/")
    of = ["--suite", suite.partition("-")[0], "--datasets", dataset]
    if run.source == SOURCE:  # the file says its inputs and its knowledge
        words = ["gcbench", "score", "--predictions", "predictions.csv", *of]
    else:
        words = ["gcbench", "eval", "--method", source + "".join(row.name.partition("@")[1:])]
        for name, value in parse_qsl(query):
            words += [f"--{name}", *value.split()]
        words += [*of, "--inputs", row.inputs, "--knowledge", row.knowledge]
    return shlex.join([*words, "--sequences", _ranges([int(name) for name in run.sequences])])


def _ranges(numbers: Sequence[int]) -> str:
    """Return increasing numbers as in "0-9,15"."""
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in zip(starts, ends, strict=True))


def _add_truth(found: RunFolder, data: Dataset, folder: Path) -> PublishedTruth:
    """Return the published truth of a dataset with that of the sequences of a run."""
    run, path = found.run, truth_path(folder, found.run.dataset)
    old = read_truth(path) if path.exists() else None
    found_truths = {name: truth_of(data[name]) for name in run.sequences}
    alike = {(t.joint_names, t.joint_types, len(t.displacement)) for t in found_truths.values()}
    if old:
        alike.add((old.joint_names, old.joint_types, old.frames))
    if len(alike) > 1:
        raise DatasetError(f"{data.path}: its sequences differ in frames or joints; rows on it "
                           "cannot be published")
    there = {*(old.sequences if old else ())}
    for name in sorted(there & {*found_truths}):
        if old and (wrong := _truth_differences(vars(found_truths[name]), old, name)):
            raise DatasetError(f"{data.path}: sequence {name} is not the one that is published: "
                               f"its {wrong[0]} differs; render the suite again and evaluate")
    names = sorted({*run.sequences} - there)
    if not names and old:
        return old
    cluster, truths = select(run.dataset, data.path, ALL).cluster, [found_truths[n] for n in names]
    joints, types, frames = alike.pop()
    attempts = [sum(data[name].meta.observability["refused"].values()) for name in names]
    new = PublishedTruth(
        config_tree(data.config), run.assets, joints, types, frames, tuple(names), tuple(attempts),
        tuple(cluster(name) for name in names), pack_truth(truths))
    if not old:
        return new
    joined = {field: (*getattr(old, field), *getattr(new, field))
              for field in ("sequences", "attempts", "clusters")}
    arrays = {key: np.concatenate([old.arrays[key], new.arrays[key]]) for key in new.arrays}
    return replace(old, **joined, arrays=arrays)


def _truth_differences(found: Mapping[str, Any], truth: PublishedTruth, name: str) -> list[str]:
    """Return which of the fields of _LARGEST differ from the published truth of a sequence."""
    k = truth.sequences.index(name)
    return [field for field, largest in _LARGEST.items()
            if not np.allclose(found[field], truth.arrays[field][k], 1e-5, largest)]


def rescore_published(folder: Path = PUBLISHED_ROWS) -> list[Path]:
    """Score the estimates of all published rows again, as after a change of a metric.

    Return the files. Raises DatasetError if a file is damaged.
    """
    truths: dict[str, PublishedTruth] = {}
    files = published_files(folder)
    for path in files:
        row = read_row(path, folder, truths)
        write_record(path, score_published(row, truths[row.run.dataset]))
    return files


@dataclass(frozen=True)
class Checked:
    """What `check_published` looked at, and what it found."""

    rows: int = 0
    """Rows on a dataset whose scores were computed again."""
    sequences: int = 0
    """Estimates of these."""
    drawn: int = 0
    """Sequences whose truth was drawn again."""
    skipped: tuple[str, ...] = ()
    """Datasets whose model is not here."""
    problems: tuple[str, ...] = ()
    """One line for each row or truth that is not what it says."""


def check_published(folder: Path = PUBLISHED_ROWS, draw: int = 2, seed: int = 0) -> Checked:
    """Check that scores are those of the estimates, and that the truth is that of the suite.

    The configuration must be that of the suite. The truth follows from it and from the number of
    a sequence: its motion and camera are drawn again, without images, of at most `draw` sequences
    of each dataset, which `seed` chooses. -1 draws all.

    Raises DatasetError if a file is damaged.
    """
    truths: dict[str, PublishedTruth] = {}
    problems: list[str] = []
    rows = [(path, read_row(path, folder, truths)) for path in published_files(folder)]
    for path, row in rows:
        again = score_published(row, truths[row.run.dataset])
        same = np.allclose(again.arrays["error"], row.arrays["error"], 1e-5, 1e-6)
        if not same or not _is_close([dataclasses.asdict(s) for s in again.scores],
                                     [dataclasses.asdict(s) for s in row.scores]):
            problems.append(f"{path}: its scores are not those of its estimates")
    skipped: list[str] = []
    drawn = 0
    suites = builtin_datasets()
    for dataset, truth in sorted(truths.items()):
        if wrong := _config_problem(truth, suites.get(dataset)):
            problems.append(f"{truth_path(folder, dataset)}: {wrong}")
            continue
        order = np.random.default_rng(seed).permutation(len(truth.sequences))
        chosen = order if draw < 0 else order[:draw]
        try:
            for k, found in _draw_again(truth, chosen):
                drawn += 1
                problems += [
                    f"{truth_path(folder, dataset)}: sequence {truth.sequences[k]}: its {name} is "
                    "not that of the suite"
                    for name in _truth_differences(found, truth, truth.sequences[k])
                ]
        except GcbenchError as error:  # a model that is not here and cannot be downloaded
            skipped.append(f"{dataset}: {error}")
    return Checked(len(rows), sum(len(row.status) for _, row in rows), drawn, tuple(skipped),
                   tuple(problems))


def _config_problem(truth: PublishedTruth, entry: SuiteDataset | None) -> str:
    """Return why a truth is not of a dataset of a suite; empty if it is."""
    if entry is None:
        return "no built-in suite has this dataset"
    changes = differences(config_tree(entry.config), truth.config)
    return f"its configuration is not that of the suite ({changes[0]})" if changes else ""


def _draw_again(
    truth: PublishedTruth, which: NDArray[np.int64]
) -> Iterator[tuple[int, dict[str, NDArray[np.float64]]]]:
    """Yield displacement [T J], screw [J 6] and origin [J 3] of sequences, as in `Truth`."""
    config = parse_config(dict(truth.config), "published truth")
    source = sampler = None
    for k in map(int, which):
        index, attempt = int(truth.sequences[k]), truth.attempts[k]
        last, source = source, model_source(config, index, source)
        if sampler is None or source is not last:
            sampler = MotionSampler(source.model, source.scored, config, source.fixed_motion)
        streams = Streams(config, index)
        motion = sampler.draw(streams.rng("motion", attempt))
        camera = draw_camera(
            streams.rng("camera", attempt), config.randomization.camera, config.width,
            config.height, sampler.outline(motion.posed, slice(1)), motion.floor)
        names = source.model.joint_names
        joints = [names.index(name) for name in truth.joint_names]
        poses = camera.cam_from_world @ motion.world_from_part[:1]
        q = motion.trajectory.positions[:, joints]
        yield k, {
            "displacement": q - q[:1],
            "screw": joint_screws(source.model, poses)[0, joints],
            "origin": poses[0, source.model.joint_child[joints], :3, 3],
        }


def _is_close(a: Any, b: Any) -> bool:
    """Return whether two trees are equal up to rounding."""
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(_is_close(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_is_close, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return bool(np.isclose(a, b, 1e-6, 1e-9))
    return a == b
