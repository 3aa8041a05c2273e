"""`gcbench show`: pages, a contact sheet, a GIF or an MP4 of what was rendered."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from ...errors import ConfigError
from ..dataset import (
    DATASET_FILE,
    Dataset,
    default_output,
    open_dataset,
    open_sequence,
    select_sequences,
)
from ..runtime import address, exists, require_local, say
from . import video as film
from .dataset_pages import Models, write_dataset_pages
from .page import write_page

_PAGES = 10
"""Sequences of a dataset that get a page if none are named."""


def show(
    path: str | Path | Dataset,
    out: str | Path | None = None,
    contact_sheet: str | Path | None = None,
    gif: str | Path | None = None,
    mp4: str | Path | None = None,
    index: int | str | None = None,
) -> list[Path]:
    """Show a dataset or a sequence as pages, a contact sheet, a GIF or an MP4.

    Args:
        path: A dataset, or one sequence (ZIP or folder). An open dataset says whether its model
            may be read for the 3D view (`open_dataset`).
        out: The HTML page of one sequence if it ends in .html, else a folder for the index of the
            dataset and pages of its sequences. Default, if no other file is named:
            `<dataset>-show` for a dataset, `<sequence>.html` for a sequence, in the current folder
            (beside the dataset if that is the current folder).
        contact_sheet: PNG, JPEG or WebP: of a dataset the first frame of each sequence; of one
            sequence its images, depth, parts and flow over time.
        gif: GIF of the images beside their ground truth.
        mp4: MP4 of the same.
        index: Number of the sequence in the dataset. As text, numbers and ranges such as "2-5,9":
            the contact sheet and the folder show these sequences, everything else the first of
            them. Default: the first one, and in the folder the first ten.

    Returns:
        The paths of the files that were written; of a folder, the index.

    Raises:
        DatasetError: `path` is neither a dataset nor a sequence, or cannot be read.
        ConfigError: There is no such sequence, or the suffix of a file is not that of its format.
        RenderError: A file cannot be written or encoded.

    Example:
        >>> gb.show("data/ur5", out="ur5.html", contact_sheet="ur5.png")
        [PosixPath('ur5.html'), PosixPath('ur5.png')]
    """
    dataset = path if isinstance(path, Dataset) else _dataset_at(Path(path))
    if dataset is None:
        if isinstance(index, str):
            raise ConfigError(f"--sequences {index}: {address(Path(str(path)))} is no dataset")
        chosen, model, sequence = [], None, open_sequence(Path(str(path)))
    else:
        chosen = select_sequences(dataset, "" if index is None else str(index))
        for warning in dataset.warnings:
            say(warning)
        sequence = dataset[chosen[0]]
        model = Models(dataset)
    nothing = not (out or contact_sheet or gif or mp4)
    if nothing and (dataset is None or isinstance(index, int)):
        out = re.sub(r"[^\w.-]+", "_", sequence.meta.name)[:100] + ".html"
        if dataset:
            out = default_output(dataset.path, "-show").with_name(out)
    elif nothing and dataset:
        out = default_output(dataset.path, "-show")

    def page(to: Path) -> Path:
        if dataset and to.suffix.lower() != ".html":
            wanted = chosen if isinstance(index, str) else chosen[:_PAGES]
            return write_dataset_pages(dataset, to, wanted)
        return write_page(sequence, to, model and model.of(sequence.meta))

    many = sequence if dataset is None else dataset if isinstance(index, int) else (
        dataset[name] for name in chosen)
    jobs: list[tuple[str | Path | None, Callable[[Path], Path]]] = [
        (out, page),
        (contact_sheet, lambda to: film.contact_sheet(many, to)),
        (gif, lambda to: film.write_gif(sequence, to)),
        (mp4, lambda to: film.write_mp4(sequence, to)),
    ]
    targets = [(Path(to), job) for to, job in jobs if to]
    for to, _ in targets:
        require_local(to, "output")
    return [job(to) for to, job in targets]


def _dataset_at(path: Path) -> Dataset | None:
    return open_dataset(path) if exists(path / DATASET_FILE) else None
