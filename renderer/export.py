"""`gcbench export`: a dataset in the layouts of other benchmarks and tools.

An export is written under a temporary name and renamed when it is whole. Each format has a file
`export_FORMAT.py` with a class as `Writer`; `export.json` in the result says what it was made of.
"""

from __future__ import annotations

import glob
import json
import os
import re
import shutil
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal, Protocol

from .. import GcbenchError, __version__
from .archive import Archive, open_archive
from .atomic import is_alive, temporary_name
from .dataset import Dataset, open_dataset, sequence_paths
from .metadata import dump_json
from .progress import frame_bar
from .sequence import Sequence

Format = Literal["kitti", "bop", "coco", "webdataset", "tapvid", "rerun"]
WRITERS: dict[str, str] = {
    "kitti": "export_kitti:Kitti",
    "bop": "export_bop:Bop",
    "coco": "export_coco:Coco",
    "webdataset": "export_webdataset:WebDataset",
    "tapvid": "export_tapvid:TapVid",
    "rerun": "export_rerun:Rerun",
}
FILE = "export.json"


class Writer(Protocol):
    """Writes sequences of a dataset into an empty folder; made with (folder, dataset)."""

    def add(self, sequence: Sequence, archive: Archive) -> None:
        """Write one more sequence; `archive` holds its encoded images.

        Raises GcbenchError if the format cannot hold it.
        """
        ...

    def finish(self) -> None:
        """Write what is known at the end only."""
        ...

    def close(self) -> None:
        """Let go of what is held open, after success or failure."""
        ...


@dataclass(frozen=True)
class Exported:
    """What an export holds."""

    folder: Path
    sequences: int
    frames: int


def export(
    dataset: str | Path, format: Format, out: Path, sequences: str = "", progress: bool = True
) -> Exported:
    """Write the dataset in the folder `dataset` into the folder `out`, which must not exist.

    `sequences` chooses some by their numbers, as in "0-9,15". Raises GcbenchError if there is no
    dataset or something at `out`, or if the format needs a package that is not installed or cannot
    hold what is in the dataset; nothing is left behind then.
    """
    data = open_dataset(dataset)
    names = chosen(data, sequences)
    if out.exists() or out.is_symlink():
        raise GcbenchError(f"{out} is there already; choose another --out, or delete it")
    module, _, name = WRITERS[format].partition(":")
    try:
        kind = getattr(import_module(f".{module}", __package__), name)
    except ModuleNotFoundError as error:
        raise GcbenchError(
            f"--format {format} needs {error.name}: pip install 'gcbench[export]'") from error
    temporary = temporary_name(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(out)
        temporary.mkdir()
        frames = _write(kind(temporary, data), data, names, progress)
        (temporary / FILE).write_bytes(dump_json(_account(format, data, names)))
        temporary.rename(out)
    except OSError as error:
        raise GcbenchError(f"cannot write to {out}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return Exported(out, len(names), frames)


def chosen(dataset: Dataset, text: str) -> list[str]:
    """Names of the sequences that `text` means ("": all). Raises GcbenchError."""
    if not dataset.names:
        raise GcbenchError(f"{dataset.path} has no sequences yet")
    there = {int(name): name for name in dataset.names}
    if not text:
        return list(dataset.names)
    numbers: dict[int, None] = {}
    for item in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})(?:\s*-\s*(\d{1,9}))?\s*", item)
        if not match:
            raise GcbenchError(f"--sequences {text}: give numbers and ranges, as in 0-9,15")
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        found = [k for k in there if first <= k <= last]
        if not found or (match[2] is None and first not in there):
            raise GcbenchError(f"--sequences {text}: {dataset.path} has none of {item.strip()}; "
                               f"there are {dataset.names[0]} to {dataset.names[-1]}")
        numbers.update(dict.fromkeys(sorted(found)))
    return [there[k] for k in numbers]


def _write(writer: Writer, dataset: Dataset, names: list[str], progress: bool) -> int:
    """The number of frames written."""
    paths = sequence_paths(dataset.path)
    frames = 0
    bar = frame_bar(len(names) * dataset.config.frames, 0, progress, "export")
    with bar, closing(writer):
        for name in names:
            sequence = dataset[name]
            writer.add(sequence, open_archive(paths[name]))
            frames += len(sequence)
            bar.update(len(sequence))
        writer.finish()
    return frames


def _account(format: str, dataset: Dataset, names: list[str]) -> dict[str, object]:
    """What `export.json` says: the licences of the models come along."""
    return {
        "format": format,
        "generator": {"name": "gcbench", "version": __version__},
        "dataset": {"config": dataset.info.config, "generator": dataset.info.generator},
        "assets": json.loads(dump_json(dataset.info.assets)),
        "sequences": names,
    }


def _remove_leftovers(out: Path) -> None:
    """Delete what processes that are gone have left of this export."""
    for path in out.parent.glob(f".{glob.escape(out.name)}.*.tmp"):
        pid = path.name.rsplit(".", 2)[1]
        if pid.isdecimal() and int(pid) != os.getpid() and not is_alive(int(pid)):
            shutil.rmtree(path, ignore_errors=True)
