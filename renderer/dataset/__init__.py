"""The `gcbench/1` format on disk: written whole or not at all, read lazily."""

from __future__ import annotations

from .codes import DEPTH_UNIT
from .provenance import (
    DATASET_FILE,
    Provenance,
    environment,
    new_provenance,
    read_provenance,
    write_provenance,
)
from .reader import (
    Dataset,
    count_sequences,
    default_output,
    open_dataset,
    select_sequences,
    sequence_paths,
)
from .rounding import round_as_stored
from .schema import UNITS
from .state_arrays import state_shapes
from .storage import (
    SEQUENCES_FOLDER,
    SequenceWriter,
    image_member,
    image_times,
    open_sequence,
    read_meta,
    sequence_name,
)

__all__ = [
    "DATASET_FILE", "DEPTH_UNIT", "SEQUENCES_FOLDER", "UNITS", "Dataset", "Provenance",
    "SequenceWriter", "count_sequences", "default_output", "environment", "image_member",
    "image_times", "new_provenance", "open_dataset", "open_sequence", "read_meta",
    "read_provenance", "round_as_stored", "select_sequences", "sequence_name", "sequence_paths",
    "state_shapes", "write_provenance",
]
