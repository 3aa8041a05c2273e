"""Images of the worst and the median sequence of each line: estimated pose over true pose."""

from __future__ import annotations

import base64
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from ...renderer.dataset import Dataset, open_dataset
from ...renderer.runtime import Bar
from ...renderer.scene import model_of
from ...renderer.types import Sequence as Video
from ...robots.catalog import is_category
from ..protocol import AXES_KNOWN, metrics, shape_of, truth_of
from ..results import read_stored
from .leaderboard import Line

if TYPE_CHECKING:
    from ...renderer.show import Painter

WIDTH = 420
"""Largest width of a picture, px."""
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
    reason: str = ""
    """Reason for a missing image."""


def select_pictures(lines: Sequence[Line]) -> list[Picture]:
    """Select the worst and the median sequence of each line; the pictures have no images yet."""
    out: list[Picture] = []
    for number, line in enumerate(lines):
        errors = sequence_errors(line)
        order = sorted(errors, key=lambda name: (errors[name], name))
        picks: list[tuple[Kind, str]] = [("worst", order[-1])]
        if len(order) > 1:
            picks.append(("median", order[(len(order) - 1) // 2]))
        for kind, name in picks:
            joints = tuple((j.name, line.error[name, j.name]) for j in line.joints
                           if (name, j.name) in line.error)  # fmt: skip
            out.append(Picture(number, kind, name, errors[name], joints))
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
             disable=not progress) as bar:  # fmt: skip
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
                image = _image(dataset, painter, lines[picture.line], picture.sequence)
                yield k, replace(picture, image=_address(image))
            except Exception as error:
                yield k, _without_image(picture, error)


def _without_image(picture: Picture, error: Exception) -> Picture:
    """Drivers raise any type, and the report needs no image."""
    name = "" if isinstance(error, GcbenchError) else f"{type(error).__name__}: "
    return replace(picture, reason=f"{name}{error}")


def _image(dataset: Dataset, painter: Painter, line: Line, name: str) -> NDArray[np.uint8]:
    sequence = dataset[name]
    if is_category(dataset.config.robot):
        painter.model = model_of(dataset.config, sequence.meta, dataset.allow_model)
    return painter.paint(sequence, final_estimate(line, sequence, name))


def final_estimate(line: Line, sequence: Video, name: str) -> dict[str, float]:
    """Return the estimate of each scored joint at the last frame, rad or m, as it is scored: with
    the chosen sign, and zero where it is missing."""
    truth = truth_of(sequence)
    stored = read_stored(line.run.estimate_path(name), shape_of(sequence)).estimate
    given = None if stored is None else stored.displacement
    screw = None if stored is None else stored.screw
    moved = metrics.fill_missing(given, truth.displacement)
    known = line.row.knowledge in AXES_KNOWN
    sign, _ = metrics.signs(
        moved, truth.displacement, truth.prismatic, known, screw, truth.screw
    )
    final = sign * moved[-1]
    return {joint: float(x) for joint, x in zip(truth.joint_names, final, strict=True)}


def _address(image: NDArray[np.uint8]) -> str:
    """Return an image [H W 3] as a `data:` URL, at most WIDTH px wide."""
    import cv2

    height, width = image.shape[:2]
    if width > WIDTH:
        size = (WIDTH, max(1, round(height * WIDTH / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    pixels = np.ascontiguousarray(image[..., ::-1])
    _, code = cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, 82])
    return "data:image/webp;base64," + base64.b64encode(code.tobytes()).decode()
