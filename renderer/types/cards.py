"""Cards that notebooks show for datasets, sequences and results.

Names come from untrusted models and files. All text is escaped; a card has no script and no link.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError, printable

_SIDE = 160
"""px, longer side of a thumbnail"""
_LONGEST = 200
"""Characters of a text; the end of a longer one is left out."""
_CELL = "style='text-align:left;padding:1px 12px 1px 0;vertical-align:top'"


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
    lines = ["<div style='border:1px solid #8888;border-radius:4px;padding:8px 12px;"
             "display:inline-block;max-width:100%'>",
             f"<div style='font-weight:bold;margin-bottom:4px'>{_text(title)}</div>", "<table>"]
    lines += [f"<tr><th {_CELL}>{_text(name)}</th><td {_CELL}>{_text(value)}</td></tr>"
              for name, value in facts.items()]
    lines.append("</table>")
    if pictures:
        lines += [f"<div style='margin-top:6px'>{''.join(map(_figure, pictures.items()))}</div>"]
    tag = "th"
    lines.append("<table>")
    for row in table:
        lines.append("<tr>" + "".join(f"<{tag} {_CELL}>{_text(c)}</{tag}>" for c in row) + "</tr>")
        tag = "td"
    return "\n".join([*lines, "</table>", "</div>"])


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
