"""The worst and the median sequence of each line: images and films of the estimated pose over the
true one, and a page that shows the worst sequence with its ground truth."""

from __future__ import annotations

import base64
import io
import re
import shlex
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, GcbenchError
from ...renderer.dataset import Dataset, open_dataset
from ...renderer.runtime import Bar, is_remote
from ...renderer.scene import model_of
from ...renderer.types import Sequence as Video
from ...robots.catalog import is_category
from ...robots.geometry import Array
from ..protocol import AXES_KNOWN, metrics, shape_of, truth_digest, truth_of
from ..results import read_stored
from .lines import Line

if TYPE_CHECKING:
    from ...renderer.show import Painter

WIDTH = 420
"""Largest width of a picture, px."""
MAX_LINES, MAX_PAGES = 48, 16
"""Largest number of lines with pictures, and of pages of single sequences."""
PAGES = "sequences"
"""Folder of these pages, in the folder of the report."""
_FILM_FRAMES, _FILM_MS, _LAST_MS = 8, 250, 1500
Kind = Literal["worst", "median"]


@dataclass(frozen=True)
class Picture:
    """A picture of one sequence of one line of the leaderboard."""

    line: int
    """Index of the line."""
    kind: Kind
    sequence: str
    error: float
    """Mean final error of the joints, in the unit of the line."""
    joints: tuple[tuple[str, float], ...]
    """Name and final error of each joint."""
    image: str = ""
    """A `data:` URL; empty without an image."""
    film: str = ""
    """A `data:` URL of an animation of the worst sequence; empty without one."""
    page: str = ""
    """Address of a page of the sequence, relative to the report; empty without one."""
    command: str = ""
    """Command that writes such a page."""
    reason: str = ""
    """Reason for a missing image."""


def select_pictures(lines: Sequence[Line]) -> list[Picture]:
    """Select the worst and the median sequence of MAX_LINES lines, the best of each dataset first.

    The pictures have no images yet.
    """
    out: list[Picture] = []
    before: Counter[tuple[str, str]] = Counter()
    place: list[tuple[int, int]] = []
    for number, line in enumerate(lines):
        if line.published:  # its images are not here
            continue
        place.append((before[line.group], number))
        before[line.group] += 1
    for number in sorted(number for _, number in sorted(place)[:MAX_LINES]):
        line = lines[number]
        errors = sequence_errors(line)
        order = sorted(errors, key=lambda name: (errors[name], name))
        picks: list[tuple[Kind, str]] = [("worst", order[-1])]
        if len(order) > 1:
            picks.append(("median", order[(len(order) - 1) // 2]))
        for kind, name in picks:
            joints = tuple((j.name, line.error[name, j.name]) for j in line.joints
                           if (name, j.name) in line.error)
            command = f"gcbench show {shlex.quote(line.run.run.data)} --index {int(name)}"
            out.append(Picture(number, kind, name, errors[name], joints, command=command))
    return out


def sequence_errors(line: Line) -> dict[str, float]:
    """Return the mean final error of each sequence."""
    errors: dict[str, list[float]] = defaultdict(list)
    for (sequence, _), value in line.error.items():
        errors[sequence].append(value)
    return {name: float(np.mean(errors[name])) for name in sorted(errors)}


def draw_pictures(
    lines: Sequence[Line], pictures: Sequence[Picture], progress: bool = True,
    allow_model: bool = False,
) -> list[Picture]:
    """Return the pictures, in the same order, with images or the reason for a missing image."""
    out = list(pictures)

    def folder_of(k: int) -> str:
        return lines[out[k].line].run.run.data

    with Bar(total=len(out), desc="draw", unit="picture", delay=2, file=sys.stderr,
             disable=not progress) as bar:
        for folder, mine in groupby(sorted(range(len(out)), key=folder_of), folder_of):
            chosen = {k: out[k] for k in mine}
            for k, picture in _draw_folder(Path(folder), lines, chosen, allow_model):
                out[k] = picture
                bar.update()
    return out


def _draw_folder(
    folder: Path, lines: Sequence[Line], pictures: dict[int, Picture], allow_model: bool
) -> Iterator[tuple[int, Picture]]:
    """Draw the pictures of one dataset; only one OpenGL context is open at a time."""
    from ...renderer.show import Painter

    if is_remote(folder):  # results of other people must not open connections
        yield from ((k, replace(p, reason="its dataset is in object storage"))
                    for k, p in pictures.items())
        return
    with ExitStack() as stack:
        try:
            dataset = open_dataset(folder, allow_model)
            model = model_of(dataset.config, dataset[0].meta, allow_model)
            config = dataset.config
            painter = stack.enter_context(Painter(model, config.width, config.height))
        except Exception as error:
            yield from ((k, _without_image(p, error)) for k, p in pictures.items())
            return
        for k, picture in pictures.items():
            try:
                yield k, _draw_picture(picture, dataset, painter, lines[picture.line])
            except Exception as error:
                yield k, _without_image(picture, error)


def _without_image(picture: Picture, error: Exception) -> Picture:
    """Drivers raise any type, and the report needs no image."""
    name = "" if isinstance(error, GcbenchError) else f"{type(error).__name__}: "
    return replace(picture, reason=f"{name}{error}")


def _draw_picture(picture: Picture, dataset: Dataset, painter: Painter, line: Line) -> Picture:
    """Return the picture with its image and, of the worst sequence, its film."""
    name = picture.sequence
    sequence = dataset[name]
    if line.run.run.digests.get(name) not in (None, truth_digest(sequence)):
        raise DatasetError(f"{dataset.path}: sequence {name} changed after it was estimated")
    if is_category(dataset.config.robot):
        painter.model = model_of(dataset.config, sequence.meta, dataset.allow_model)
    moved = estimated_motion(line, sequence, name)

    def frame(t: int) -> NDArray[np.uint8]:
        return _shrink(painter.paint(sequence, {j: float(x[t]) for j, x in moved.items()}, t))

    last = len(sequence) - 1
    numbers = np.unique(np.rint(np.linspace(0, last, min(last, _FILM_FRAMES))).astype(int))
    film = [frame(int(t)) for t in numbers] if picture.kind == "worst" else []
    return replace(
        picture, image=_film_url([film[-1] if film else frame(last)], quality=82),
        film=_film_url(film) if len(film) > 1 else "",
    )


def estimated_motion(line: Line, sequence: Video, name: str) -> dict[str, Array]:
    """Return the estimate [T] of each scored joint, rad or m, as it is scored: with the chosen
    sign, and zero where it is missing."""
    truth = truth_of(sequence)
    stored = read_stored(line.run.estimate_path(name), shape_of(sequence)).estimate
    given = None if stored is None else stored.displacement
    screw = None if stored is None else stored.screw
    moved = metrics.fill_missing(given, truth.displacement)
    known = line.row.knowledge in AXES_KNOWN
    sign, _ = metrics.signs(moved, truth.displacement, truth.prismatic, known, screw, truth.screw)
    return dict(zip(truth.joint_names, (sign * moved).T, strict=True))


def write_pages(
    lines: Sequence[Line], pictures: Sequence[Picture], out: Path, progress: bool = True
) -> list[Picture]:
    """Write pages of the worst sequences that were drawn to `out`/PAGES, at most MAX_PAGES.

    Return the pictures with the address of their page, if it could be written.
    """
    from ...renderer.show import show

    def key_of(picture: Picture) -> tuple[str, str]:
        return lines[picture.line].run.run.data, picture.sequence

    drawn = dict.fromkeys(key_of(p) for p in pictures if p.kind == "worst" and p.image)
    wanted = list(drawn)[:MAX_PAGES]
    pages: dict[tuple[str, str], str] = {}
    with Bar(total=len(wanted), desc="write", unit="page", delay=2, file=sys.stderr,
             disable=not progress) as bar:
        for folder, sequence in wanted:
            name = re.sub(r"[^A-Za-z0-9-]+", "-", Path(folder).name)[:80]
            file = f"{len(pages) + 1:02d}-{name}-{sequence}.html"
            with suppress(OSError, GcbenchError):
                (out / PAGES).mkdir(parents=True, exist_ok=True)
                show(folder, out / PAGES / file, index=int(sequence))
                pages[folder, sequence] = f"{PAGES}/{file}"
            bar.update()
    return [replace(p, page=pages.get(key_of(p), "")) for p in pictures]


def _shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image [H W 3] of at most WIDTH px."""
    import cv2

    height, width = image.shape[:2]
    if width <= WIDTH:
        return image
    size = (WIDTH, max(1, round(height * WIDTH / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _film_url(frames: Sequence[NDArray[np.uint8]], quality: int = 60) -> str:
    """Return images [H W 3] as a `data:` URL of an animation, or of one image."""
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    buffer = io.BytesIO()
    pictures[0].save(
        buffer, "WEBP", save_all=len(pictures) > 1, append_images=pictures[1:], loop=0,
        duration=[_FILM_MS] * (len(pictures) - 1) + [_LAST_MS], quality=quality, method=3,
    )
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode()
