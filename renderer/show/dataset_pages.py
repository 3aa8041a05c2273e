"""The pages of a dataset in one folder: an index, and pages of sequences that link to each other.

A page ends with a comment that tells from what it was made. A second run writes only the pages
that are not there or were made from something else.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

from ... import __version__
from ...errors import GcbenchError, RenderError
from ...robots.files import show_progress
from ...robots.model import ArticulatedModel
from ..dataset import Dataset, sequence_paths
from ..runtime import find_object, is_remote
from ..scene import model_of, robot_of
from ..types import Meta
from .descriptions import joint_ranges
from .page import data_uri, page_html, picture_size, resize_rgb, write_file
from .static_html import IndexEntry, Links, index_page

INDEX = "index.html"
_LISTED, _THUMBNAIL, _LINES = 500, 240, 12
"""Sequences that an index lists; px, longer side of their pictures; lines below these."""


class Models:
    """The model of each sequence of a dataset, the last one kept."""

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self._last: tuple[str, ArticulatedModel | None] = "", None

    def of(self, meta: Meta) -> ArticulatedModel | None:
        """Return the model; None if it is not at hand or may not be read."""
        with suppress(GcbenchError):
            robot = robot_of(self.dataset.config, meta)
            if robot != self._last[0]:
                self._last = robot, None
                self._last = robot, model_of(self.dataset.config, meta, self.dataset.allow_model)
            return self._last[1]
        return None


def write_dataset_pages(dataset: Dataset, out: Path, wanted: Collection[str]) -> Path:
    """Write the index of a dataset and the pages of the `wanted` sequences into the folder `out`.

    Pages of other sequences that are there are kept, and linked. Return the index.
    Raises a GcbenchError if a file cannot be read or written.
    """
    names = [n for n in dataset.names if n in wanted or (out / f"{n}.html").is_file()]
    try:
        out.mkdir(parents=True, exist_ok=True)
        _write_sequences(dataset, out, names)
        entries = [_entry(dataset, name, name in names)
                   for name in show_progress(dataset.names[:_LISTED], "index")]
        return write_file(out / INDEX, index_page(dataset, entries).encode())
    except OSError as error:
        raise RenderError(f"cannot write {out}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            out.rmdir()  # if nothing is in it


def _write_sequences(dataset: Dataset, out: Path, names: list[str]) -> None:
    models, paths = Models(dataset), sequence_paths(dataset.path)
    for k, name in enumerate(show_progress(names, "pages")):
        links = _links(names, k)
        origin = f"<!-- gcbench {_digest(paths[name], links, dataset.allow_model)} -->"
        page = out / f"{name}.html"
        if not _ends_with(page, origin):
            sequence = dataset[name]
            html = page_html(sequence, models.of(sequence.meta), links)
            write_file(page, f"{html}{origin}".encode())


def _entry(dataset: Dataset, name: str, has_page: bool) -> IndexEntry:
    sequence = dataset[name]
    size = picture_size(sequence.meta.width, sequence.meta.height, 1, _THUMBNAIL)
    picture = data_uri(resize_rgb(sequence.rgb[0], *size), 80)
    meta = sequence.meta
    robot = str(meta.asset.get("instance") or meta.asset.get("name", ""))
    lines = (f"{robot}, seed {meta.seed}", *joint_ranges(meta, sequence.state))
    return IndexEntry(name, lines[:_LINES], picture, f"{name}.html" if has_page else "")


def _links(names: list[str], k: int) -> Links:
    links = [("up", INDEX, "All sequences")]
    if k > 0:
        links.append(("prev", f"{names[k - 1]}.html", f"← {names[k - 1]}"))
    if k + 1 < len(names):
        links.append(("next", f"{names[k + 1]}.html", f"{names[k + 1]} →"))
    return links


def _digest(path: Path, links: Links, allow_model: bool) -> str:
    """Tells from what a page was made: the sequence's file, its links, and this version."""
    if stored := find_object(path) if is_remote(path) else None:
        identity = [stored.size, stored.version]
    else:
        stat = (path / "meta.json" if path.is_dir() else path).stat()
        identity = [stat.st_size, stat.st_mtime_ns]
    made_of = [__version__, *identity, list(links), allow_model]
    return hashlib.sha256(json.dumps(made_of).encode()).hexdigest()


def _ends_with(path: Path, text: str) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(text)))
        return file.read() == text.encode()
