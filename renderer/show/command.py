"""`gcbench show`: a page, a contact sheet, a GIF or an MP4 of what was rendered."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from ..types import Sequence
from . import video as film
from .page import write_page as write_page


def show(
    path: str | Path,
    out: str | Path | None = None,
    contact_sheet: str | Path | None = None,
    gif: str | Path | None = None,
    mp4: str | Path | None = None,
    index: int = 0,
) -> list[Path]:
    """Show a dataset or a sequence as a page, a contact sheet, a GIF or an MP4.

    Args:
        path: A dataset, or one sequence (ZIP or folder).
        out: The HTML page. Default: `<sequence>.html` in the current folder, if no other file is
            named.
        contact_sheet: PNG of the first sequences of a dataset, or of a sequence's layers.
        gif: GIF of the images beside their ground truth.
        mp4: MP4 of the same.
        index: Number of the sequence in the dataset.

    Returns:
        The paths of the files that were written.

    Raises:
        DatasetError: `path` is neither a dataset nor a sequence, or lacks that sequence.
        RenderError: A file cannot be written or encoded.

    Example:
        >>> gb.show("data/ur5", out="ur5.html", contact_sheet="ur5.png")
        [PosixPath('ur5.html'), PosixPath('ur5.png')]
    """
    path = Path(path)
    many: Iterable[Sequence] | None = None
    if (path / "dataset.json").is_file():
        from ..dataset import open_dataset, sequence_name

        dataset = open_dataset(path)
        sequence = dataset[sequence_name(index)]
        many = iter(dataset)
    else:
        from ..dataset import open_sequence

        sequence = open_sequence(path)
    if not (out or contact_sheet or gif or mp4):
        out = re.sub(r"[^\w.-]+", "_", sequence.meta.name)[:100] + ".html"
    jobs: list[tuple[str | Path | None, Callable[[Path], Path]]] = [
        (out, lambda to: write_page(sequence, to)),
        (contact_sheet, lambda to: film.contact_sheet(many or sequence, to)),
        (gif, lambda to: film.write_gif(sequence, to)),
        (mp4, lambda to: film.write_mp4(sequence, to)),
    ]
    return [job(Path(to)) for to, job in jobs if to]
