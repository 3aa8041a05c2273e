"""The `gcbench/1` format on disk: written whole or not at all, read lazily."""

from __future__ import annotations

from .codec import DEPTH_UNIT
from .provenance import (
    FILE,
    Provenance,
    count_sequences,
    describe,
    package_versions,
    read_provenance,
    write_provenance,
)
from .reader import Dataset, open_dataset, sequence_paths
from .schema import UNITS
from .state_arrays import state_shapes
from .storage import FOLDER, SequenceWriter, member_names, open_sequence, read_meta, sequence_name

__all__ = [
    "DEPTH_UNIT",
    "FILE",
    "FOLDER",
    "UNITS",
    "Dataset",
    "Provenance",
    "SequenceWriter",
    "count_sequences",
    "describe",
    "member_names",
    "open_dataset",
    "open_sequence",
    "package_versions",
    "read_meta",
    "read_provenance",
    "sequence_name",
    "sequence_paths",
    "state_shapes",
    "write_provenance",
]
