"""What a long run needs: files, JSON, ZIP archives, processes, shards, progress, interruption."""

from __future__ import annotations

from .arguments import AnyPath, convert_fields, field_types, refuse_lone_values
from .interrupt import TerminationError, defer_interrupts, interrupt_on_sigterm
from .json import MAX_JSON, dump_json, parse_json, parse_toml, read_record, to_record
from .npz import ANY_SIZE, ArraySpec, dump_npy, parse_npz
from .object_store import (
    address,
    exists,
    find_object,
    is_remote,
    list_folder,
    refuse_other_addresses,
    require_local,
    store_file,
    upload_file,
)
from .problem import Problem
from .progress import Bar, frame_bar, plural, say, shard_bar
from .shards import Shard, parse_shard
from .streams import named_rng
from .supervisor import die_with_parent, end_like
from .workers import WorkerPool, WorkerSettings, count_workers, cpu_count, receive_tasks
from .zip_archive import Archive, ArchiveWriter, open_archive

__all__ = [
    "ANY_SIZE", "MAX_JSON", "AnyPath", "Archive", "ArchiveWriter", "ArraySpec", "Bar", "Problem",
    "Shard", "TerminationError", "WorkerPool", "WorkerSettings", "address", "convert_fields",
    "count_workers", "cpu_count", "defer_interrupts", "die_with_parent", "dump_json", "dump_npy",
    "end_like", "exists", "field_types", "find_object", "frame_bar", "interrupt_on_sigterm",
    "is_remote", "list_folder", "named_rng", "open_archive", "parse_json", "parse_npz",
    "parse_shard", "parse_toml", "plural", "read_record", "receive_tasks", "refuse_lone_values",
    "refuse_other_addresses", "require_local", "say", "shard_bar", "store_file", "to_record",
    "upload_file",
]
