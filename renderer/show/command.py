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
    """Write the requested files, and return their paths.

    `path` is a sequence (ZIP or folder) or a dataset, of which the sequence named by `index` is
    shown; the contact sheet of a dataset shows its first sequences. By default the
    page goes to `<sequence>.html` in the current folder. Raises GcbenchError if `path` is neither,
    if the dataset has no such sequence, or if a file cannot be written.
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
