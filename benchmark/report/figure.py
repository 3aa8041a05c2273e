"""The pictures of a report as one image, in the arrangement of the paper's figure 3."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

from .formats import one_line
from .gallery import Picture
from .lines import Line
from .published_numbers import OBJECTS, OWI

FIGURE = "figure.jpg"
CAPTION = (
    "In the form of figure 3 of the GC-Pose paper: articulated objects, the OWI-535, other robots. "
    "The last frame of the median sequence of the best row of each dataset that has pictures; the "
    "image shows the true pose, red the estimated pose."
)
_TEXT = 18  # px of the line below a picture


def draw_figure(
    lines: Sequence[Line], labels: Sequence[str], pictures: Sequence[Picture]
) -> bytes | None:
    """Return a JPEG of one picture a dataset, or None if there are no pictures with an image."""
    from PIL import Image, ImageDraw

    chosen: dict[tuple[str, str], Picture] = {}
    for picture in sorted(pictures, key=lambda p: (lines[p.line].summary.mean, p.line)):
        if picture.kind == "median" and picture.image:
            chosen.setdefault(lines[picture.line].group, picture)
    rows: dict[int, list[Picture]] = {}
    for picture in sorted(chosen.values(), key=lambda p: p.line):
        robot = lines[picture.line].robot
        rows.setdefault(0 if robot in OBJECTS else 1 if robot == OWI else 2, []).append(picture)
    if not rows:
        return None
    drawn = [[Image.open(io.BytesIO(base64.b64decode(p.image.partition(",")[2])))
              for p in rows[k]] for k in sorted(rows)]
    width = max(sum(image.width for image in row) for row in drawn)
    heights = [max(image.height for image in row) + _TEXT for row in drawn]
    sheet = Image.new("RGB", (width, sum(heights)), "white")
    pen, y = ImageDraw.Draw(sheet), 0
    for row, height, mine in zip(drawn, heights, (rows[k] for k in sorted(rows)), strict=True):
        x = 0
        for image, picture in zip(row, mine, strict=True):
            line, label = lines[picture.line], labels[picture.line]
            text = f"{line.dataset}: {label}, {picture.error:.3g} {line.unit}"
            sheet.paste(image, (x, y))
            pen.text((x + 3, y + height - _TEXT + 2), _ascii(text), fill="black")
            x += image.width
        y += height
    out = io.BytesIO()
    sheet.save(out, "JPEG", quality=85)
    return out.getvalue()


def _ascii(text: str) -> str:
    """Return text in the letters of Pillow's own font."""
    return one_line(text).replace("·", "-").encode("ascii", "replace").decode()
