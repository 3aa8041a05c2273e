"""Labels of rows: what a reader needs to tell the rows of one board apart."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Hashable, Sequence

from ..results import Row


def label_rows(
    rows: Sequence[Row], groups: Sequence[Hashable], extents: Sequence[str]
) -> list[str]:
    """Return method, inputs, knowledge and extent of each row, and what else tells rows apart.

    This is the version where rows of one group have several, and the training where rows of one
    version, in any groups, have several.
    """
    plain = [" · ".join([row.name, *(w for w in (row.inputs, row.knowledge) if w != "none"),
                         *([extent] if extent else [])])
             for row, extent in zip(rows, extents, strict=True)]  # fmt: skip
    versions: dict[tuple[Hashable, str], set[str]] = defaultdict(set)
    trainings: dict[tuple[str, str], set[str]] = defaultdict(set)
    for row, group, label in zip(rows, groups, plain, strict=True):
        versions[group, label].add(row.version)
        trainings[label, row.version].add(row.training)
    by_version = {label for (_, label), found in versions.items() if len(found) > 1}
    by_training = {label for (label, _), found in trainings.items() if len(found) > 1}
    return [" · ".join([label, *[row.version] * (label in by_version),
                        *[row.training] * (label in by_training)])
            for row, label in zip(rows, plain, strict=True)]  # fmt: skip


def name_versions(rows: Sequence[Row], labels: Sequence[str]) -> list[str]:
    """Add the versions to each label that rows of several versions share, for a table that joins
    rows of equal labels: "gcpose · rgb · axes · versions 19, 20"."""
    versions: dict[str, set[str]] = defaultdict(set)
    for row, label in zip(rows, labels, strict=True):
        versions[label].add(row.version)
    return [f"{label} · versions {', '.join(sorted(found, key=_natural_order))}"
            if len(found := versions[label]) > 1 else label for label in labels]


def _natural_order(version: str) -> list[tuple[int, str]]:
    """Return a key that puts 9 before 10."""
    return [(int(part), "") if part.isdecimal() else (-1, part)
            for part in re.split(r"(\d+)", version)]
