"""`gcbench export`: a dataset in the layouts of other benchmarks and tools.

An export is written into a hidden folder beside `out`, which is renamed when it is complete; an
interrupted one continues there. Each format has a module with a `Writer`. `export.json` in the
result records its origin.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from ... import __version__
from ...errors import ConfigError, GcbenchError, RenderError, StorageError
from ...robots.files import LOCK, lock_folder
from ..dataset import Dataset, open_dataset, select_sequences, sequence_paths
from ..runtime import dump_json, frame_bar, open_archive, require_local, say
from .journal import Journal
from .writer import Writer

WRITERS: dict[str, str] = {
    "kitti": "kitti:Kitti",
    "bop": "bop:Bop",
    "coco": "coco:Coco",
    "webdataset": "webdataset:WebDataset",
    "tapvid": "tapvid:TapVid",
    "rerun": "rerun:Rerun",
    "hf": "huggingface:HuggingFace",
    "screwnet": "screwnet:ScrewNetData",
}
_FILE = "export.json"


@dataclass(frozen=True)
class Exported:
    """What an export holds."""

    folder: Path
    sequences: int
    frames: int


def export_dataset(
    dataset: str | Path | Dataset, format: str, out: str | Path, sequences: str = "",
    progress: bool = True, allow_model: bool = False,
) -> Exported:
    """Write a dataset in the format of another benchmark or tool.

    An interrupted export continues when it is called again with the same arguments.

    Args:
        dataset: Folder of the dataset, or an open dataset.
        format: "kitti", "bop", "coco", "webdataset", "hf", "tapvid", "rerun" or "screwnet".
        out: Folder of the export, which must not exist.
        sequences: Numbers and ranges of sequences, for example "0-9,15". Default: all.
        progress: Whether to show a progress bar.
        allow_model: Whether to read the model from a path that the dataset names, or to download
            it. bop needs the model, rerun shows it. An open dataset may allow it, too.

    Returns:
        The folder, and the number of sequences and frames in it.

    Raises:
        DatasetError: there is no dataset, or the format cannot hold it.
        ConfigError: there is no such format, `out` exists, or there are no such sequences.

    Example:
        >>> gb.export_dataset("data/ur5", "kitti", "ur5-kitti", "0", progress=False).sequences
        1
    """
    if format not in WRITERS:
        raise ConfigError(f"--format {format}: choose one of {', '.join(WRITERS)} or observation "
                          "(in Python, gb.export_observations)")
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    data = replace(data, allow_model=allow_model or data.allow_model)
    names = select_sequences(data, sequences)
    module, _, name = WRITERS[format].partition(":")
    try:
        kind = getattr(import_module(f".{module}", __package__), name)
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"the format {format} needs {error.name}: pip install '.[export]'") from error
    origin = {"dataset": {"config": data.info.config, "generator": data.info.generator}}
    return write_export(kind, data, names, out, {"format": format, **origin}, progress)


def write_export(
    kind: Callable[[Path, Dataset], Writer], dataset: Dataset, names: list[str],
    out: str | Path, origin: Mapping[str, Any], progress: bool,
) -> Exported:
    """Write sequences of a dataset with a `Writer`; for formats outside of this package.

    `origin` is the content of `export.json`, beside the generator, the models and the names. It
    tells this export from others of the dataset. Raises ConfigError if `out` exists, and
    GcbenchError if it cannot be written.
    """
    out = Path(out)
    require_local(out, "--out")
    if out.exists() or out.is_symlink():
        raise ConfigError(f"{out} is there already; choose another --out, or delete it")
    for warning in dataset.warnings:
        say(warning)
    part = out.with_name(f".{out.name}.part")
    origin = {"generator": {"name": "gcbench", "version": __version__},
              "assets": dataset.info.assets, **origin}
    try:
        part.mkdir(parents=True, exist_ok=True)
        with lock_folder(part):
            frames = _write_all(kind, part, dataset, names, origin, progress)
            (part / LOCK).unlink()
            part.rename(out)
    except OSError as error:
        waits = f"; what is done waits in {part}, the same command continues" * part.exists()
        raise RenderError(f"cannot write to {out}: {error.strerror or error}{waits}") from error
    return Exported(out, len(names), frames)


def _write_all(
    kind: Callable[[Path, Dataset], Writer], part: Path, data: Dataset, names: list[str],
    origin: Mapping[str, Any], progress: bool,
) -> int:
    """Fill `part` and return the number of frames in it. It is removed if that fails for good, or
    if nothing is done when the run is stopped."""
    plan = {**origin, "name": data.path.absolute().name, "config": data.info.config}
    with closing(Journal(part, plan, names)) as journal:
        try:
            with closing(kind(part, data)) as writer:
                _write(writer, names, journal, progress)
        except BaseException as error:
            final = isinstance(error, GcbenchError) and not isinstance(error, StorageError)
            if final or not journal.entries:
                shutil.rmtree(part, ignore_errors=True)
            raise
    (part / _FILE).write_bytes(dump_json({**origin, "sequences": names}))
    journal.path.unlink()
    return sum(entry["frames"] for entry in journal.entries)


def _write(writer: Writer, names: list[str], journal: Journal, progress: bool) -> None:
    """Write the sequences that are not done yet."""
    dataset, done = writer.dataset, len(journal.entries)
    paths, each = sequence_paths(dataset.path), dataset.config.frames
    for entry in journal.entries:
        writer.keep(entry["record"])
    with frame_bar(len(names) * each, done * each, progress, "export") as bar:
        for name in names[done:]:
            sequence = dataset[name]
            record = writer.add(sequence, open_archive(paths[name]))
            writer.keep(journal.add(name, len(sequence), record))
            bar.update(len(sequence))
        writer.finish()
