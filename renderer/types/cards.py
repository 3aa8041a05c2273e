"""Cards that notebooks show for datasets, sequences and results.

Names come from untrusted models and files. All text is escaped; a card has no script and no link.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
from html import escape
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError, printable

_SIDE = 160
"""px, longer side of a thumbnail"""
_LONGEST = 200
"""Characters of a text; the end of a longer one is left out."""
_FRAME = ("border:1px solid #8888;border-radius:4px;padding:8px 12px;display:inline-block;"
          "max-width:100%")
_CELL = "text-align:left;padding:1px 12px 1px 0;vertical-align:top"


def html_card(
    title: str,
    facts: Mapping[str, object],
    pictures: Mapping[str, Callable[[], NDArray[np.uint8]]] | None = None,
    table: Iterable[Iterable[object]] = (),
) -> str:
    """Return a card as HTML: a title, named facts, thumbnails and a table.

    Args:
        title: The first line.
        facts: Values by their names.
        pictures: Functions by caption that return RGB images [H W 3]. A picture that cannot be
            read is replaced by the reason.
        table: Rows of cells; the first is the head.
    """
    head = [_row(fact, ("th", "td")) for fact in facts.items()]
    rows = [_row(row, repeat("td" if k else "th")) for k, row in enumerate(table)]
    figures = map(_figure, (pictures or {}).items())
    return (f"<div style='{_FRAME}'><div style='font-weight:bold'>{_text(title)}</div>\n"
            f"<table>{''.join(head)}</table>\n<div>{''.join(figures)}</div>\n"
            f"<table>{''.join(rows)}</table></div>")


def _row(cells: Iterable[object], tags: Iterable[str]) -> str:
    texts = (f"<{tag} style='{_CELL}'>{_text(cell)}</{tag}>"
             for cell, tag in zip(cells, tags, strict=False))
    return f"<tr>{''.join(texts)}</tr>"


def _text(value: object) -> str:
    text = printable(str(value))
    return escape(text if len(text) <= _LONGEST else text[:_LONGEST] + "…")


def _figure(item: tuple[str, Callable[[], NDArray[np.uint8]]]) -> str:
    caption, read = item
    try:
        picture = f"<img alt='' src='data:image/jpeg;base64,{_thumbnail(read())}'>"
    except GcbenchError as error:
        picture = f"<div style='width:{_SIDE}px'>{_text(error)}</div>"
    return ("<div style='display:inline-block;margin:0 6px 0 0;vertical-align:top'>"
            f"{picture}<div>{_text(caption)}</div></div>")


def _thumbnail(rgb: NDArray[Any]) -> str:
    import cv2

    height, width = rgb.shape[:2]
    zoom = min(1.0, _SIDE / max(height, width))
    size = max(1, round(width * zoom)), max(1, round(height * zoom))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR))[1]
    return base64.b64encode(data.tobytes()).decode()
