"""Runs that are the same: datasets of one name, and copies of a row in several folders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import DatasetError
from ...renderer.scene import differences as config_differences
from ..results import Row, Run, RunFolder
from .statistics import SequenceJoint

if TYPE_CHECKING:
    import pandas

_OF_MACHINE = ("peak_memory", "seconds", "seconds_per_frame")
_SAME_MOTION = 1e-3
"""Relative difference of the true displacements of one motion."""
_OF_FILES = ("dataset", "robot")  # columns; `without_copies` compares the datasets
_ORDER = ["sequence", "joint_index", "metric", "frame"]


def dataset_title(run: Run) -> str:
    """Return SUITE/NAME of a dataset of a suite; else the name of the folder, and the seed."""
    seed = run.config.get("seed")
    if "/" in run.dataset or seed is None:
        return run.dataset
    return f"{run.dataset.removesuffix(f'-seed-{seed}')}, seed {seed}"


def without_copies(folders: Iterable[RunFolder]) -> list[RunFolder]:
    """Keep one of several folders with the same row and scores, also of other machines, and join
    folders with the same row on other sequences.

    Folders may share some sequences. Their order does not matter.

    Raises DatasetError if the scores of a sequence differ, or if two datasets of one title differ.
    """
    same: dict[tuple[Row, str], dict[Path, RunFolder]] = {}
    first: dict[str, RunFolder] = {}
    for folder in folders:
        run, title = folder.run, dataset_title(folder.run)
        like = first.setdefault(title, folder)
        if changes := _dataset_differences(like.run, run):
            raise DatasetError(
                f"{like.path} and {folder.path} are on two datasets of one name ({changes[0]}); "
                "report them separately"
            )
        same.setdefault((run.row, title), {}).setdefault(folder.path, folder)
    return [reduce(_merge, (mine[path] for path in sorted(mine))) for mine in same.values()]


def _merge(kept: RunFolder, folder: RunFolder) -> RunFolder:
    """Return a run with the sequences of another folder that it lacks."""
    there, more = {*kept.run.sequences}, {*folder.run.sequences}
    if not there & more:
        return kept.join(folder, folder.run.sequences)
    a, b = kept.scores(), folder.scores()
    scored, found = (_scored_names(table) for table in (a, b))
    if wrong := _different_sequences(a, b, scored & found):
        others = f" and {len(wrong) - 3} more" * (len(wrong) > 3)
        raise DatasetError(
            f"{kept.estimate_path(wrong[0]).parents[1]} and {folder.path} are the same row with "
            f"other scores of the sequences {', '.join(wrong[:3])}{others}; give one a label: "
            "--label NAME=RESULTS_FOLDER"
        )
    taken = (found - scored) | (more - there)
    return kept.join(folder, [n for n in folder.run.sequences if n in taken]) if taken else kept


def _scored_names(table: pandas.DataFrame) -> set[str]:
    return {*table["sequence"][table["metric"] == "final_error"]}


def _dataset_differences(one: Run, other: Run) -> list[str]:
    """Return what differs in the configurations of two datasets.

    Colleagues have the files of a dataset in other folders; then the truth decides.
    """
    common = one.digests.keys() & other.digests.keys()
    if common and all(one.digests[name] == other.digests[name] for name in common):
        return config_differences(_without_folders(one.config), _without_folders(other.config))
    return config_differences(one.config, other.config)


def _without_folders(tree: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _without_folders(value) if isinstance(value, Mapping)
            else re.split(r"[/\\]", value)[-1] if isinstance(value, str) else value
            for key, value in tree.items()}


def have_equal_motions(
    one: Mapping[SequenceJoint, float], other: Mapping[SequenceJoint, float]
) -> bool:
    """Whether the true displacements (deg or m) of two lines are equal, where both have one.

    Hashes of the truth say that it differs by rounding too, as of another machine that rendered the
    same dataset.
    """
    common = [pair for pair in one if pair in other]
    return np.allclose([one[pair] for pair in common], [other[pair] for pair in common],
                       _SAME_MOTION, 0.1 * _SAME_MOTION)


def _different_sequences(
    one: pandas.DataFrame, other: pandas.DataFrame, names: set[str]
) -> list[str]:
    """Return which of the sequences have other scores in two tables."""
    a, b = (table.loc[table["sequence"].isin(names) & ~table["metric"].isin(_OF_MACHINE), :]
            for table in (one, other))
    if _are_equal(a, b):
        return []
    return [name for name in sorted(names)
            if not _are_equal(a.loc[a["sequence"] == name, :], b.loc[b["sequence"] == name, :])]


def _are_equal(one: pandas.DataFrame, other: pandas.DataFrame) -> bool:
    """Whether two tables have the same scores, except for the order of lines, the rounding of the
    machine, and the name that the dataset has beside others."""
    a, b = (table.sort_values(_ORDER) for table in (one, other))
    return len(a) == len(b) and all(
        np.allclose(a[name], b[name], 1e-6, 1e-9, True) if name == "value"
        else name in _OF_FILES or np.array_equal(a[name], b[name]) for name in a)
