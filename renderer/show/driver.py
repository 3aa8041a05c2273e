"""`gcbench show`: a page, a contact sheet, a GIF or an MP4 of what was rendered."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from ...errors import ConfigError
from ..dataset import DATASET_FILE, open_dataset, open_sequence, select_sequences
from ..types import Sequence
from . import video as film
from .page import write_page


def show(
    path: str | Path,
    out: str | Path | None = None,
    contact_sheet: str | Path | None = None,
    gif: str | Path | None = None,
    mp4: str | Path | None = None,
    index: int | str = 0,
) -> list[Path]:
    """Show a dataset or a sequence as a page, a contact sheet, a GIF or an MP4.

    Args:
        path: A dataset, or one sequence (ZIP or folder).
        out: The HTML page. Default: `<sequence>.html` in the current folder, if no other file is
            named.
        contact_sheet: PNG, JPEG or WebP of the first sequences of a dataset, or of a sequence's
            layers.
        gif: GIF of the images beside their ground truth.
        mp4: MP4 of the same.
        index: Number of the sequence in the dataset. As text, numbers and ranges such as "2-5,9":
            the contact sheet shows these sequences, everything else the first of them.

    Returns:
        The paths of the files that were written.

    Raises:
        DatasetError: `path` is neither a dataset nor a sequence, or cannot be read.
        ConfigError: There is no such sequence, or the suffix of a file is not that of its format.
        RenderError: A file cannot be written or encoded.

    Example:
        >>> gb.show("data/ur5", out="ur5.html", contact_sheet="ur5.png")
        [PosixPath('ur5.html'), PosixPath('ur5.png')]
    """
    path = Path(path)
    many: Iterable[Sequence] | None = None
    if (path / DATASET_FILE).is_file():
        dataset = open_dataset(path)
        chosen = select_sequences(dataset, str(index))
        sequence = dataset[chosen[0]]
        many = iter(dataset) if isinstance(index, int) else (dataset[name] for name in chosen)
    elif isinstance(index, str):
        raise ConfigError(f"--sequences {index}: {path} is no dataset")
    else:
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
