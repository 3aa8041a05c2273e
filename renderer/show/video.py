"""Pictures and films of sequences: contact sheet, GIF and MP4."""

from __future__ import annotations

import itertools
import tempfile
import textwrap
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ...errors import ConfigError, DatasetError, RenderError
from ..types import Sequence
from .annotations import draw_axes
from .colors import NO_VALUE, RgbImage, color_depth, color_flow, color_parts
from .descriptions import joint_ranges
from .page import (
    color_layers,
    picture_size,
    resample,
    resize_rgb,
    select_frames,
    value_ranges,
    write_file,
)

_SHEET_SEQUENCES, _SHEET_FRAMES, _FILM_FRAMES = 100, 5, 300
_SHEET_TILE, _SMALL_TILE, _FILM_TILE = 320, 200, 400
"""px: longer side of one picture; small where there are more than _SHEET_LARGE."""
_SHEET_LARGE, _MOST_LINES = 20, 4
_GAP, _STRIP = 10, 20
"""px between pictures; height of a line of a picture's caption."""
_LETTER = 7
"""px, width"""
_PAPER, _LINE, _INK = 255, 205, 40
"""Grey levels."""
_SHORTEST = 2.0
"""s, minimum duration of a film; shorter ones are slowed down, and their captions say so."""
_LONGEST = 500.0
"""s of a picture: what OpenCV's MP4 can hold (a GIF: 655); longer ones are shortened likewise."""
_CODECS = ("vp09", "avc1", "mp4v")
"""The first two play in browsers. OpenCV's wheels can write the first but not the second."""


def contact_sheet(sequences: Sequence | Iterable[Sequence], out: Path) -> Path:
    """Write one picture, of the format that its suffix names, and return `out`.

    Of one sequence it shows RGB with axes, depth, parts and flow over time (a row each); of several
    the first frame of each, up to _SHEET_SEQUENCES. Captions name the robot, the seed and the
    ranges of the scored joints. Raises a GcbenchError if there is no sequence,
    or the file cannot be written.
    """
    _check_suffix(out, ".png", ".jpg", ".jpeg", ".webp")
    title = ""
    if isinstance(sequences, Sequence):
        rows, title = _over_time(sequences), ", ".join(_caption(sequences))
    else:
        shown = list(itertools.islice(sequences, _SHEET_SEQUENCES))
        few = len(shown) <= _SHEET_LARGE
        tiles = [_first(s, _SHEET_TILE if few else _SMALL_TILE) for s in shown]
        columns = min(len(tiles), 4 if len(tiles) <= 12 else 5 if few else 10)
        rows = [tiles[i : i + columns] for i in range(0, len(tiles), max(columns, 1))]
    if not rows:
        raise DatasetError("nothing to show: the dataset holds no sequence yet")
    return write_file(out, _encode(_grid(rows, title), out.suffix.lower()))


def film_frames(sequence: Sequence) -> Iterator[RgbImage]:
    """Pictures [h w 3] over time, of even size: RGB with axes, depth, parts and flow to the next
    frame, two by two."""
    numbers = [int(t) for t in select_frames(len(sequence), _FILM_FRAMES)]
    span = value_ranges(sequence, numbers)
    speed = _seconds_per_picture(sequence) / _true_seconds_per_picture(sequence)
    note = "" if 0.99 < speed < 1.01 else (
        f"  1/{speed:.2g} of true speed" if speed > 1 else f"  {1 / speed:.2g} times true speed")
    for t in numbers:
        rgb, depth, part, flow = _tiles(sequence, t, _FILM_TILE, span)
        title = f"t = {sequence.state.times[t]:.3f} s{note}"
        rows = [[(rgb[0], title), depth], [part, flow]]
        layers = _layers(sequence, t, _FILM_TILE)
        rows += [layers[i : i + 2] for i in range(0, len(layers), 2)]
        picture = _grid(rows)
        height, width = (n - n % 2 for n in picture.shape[:2])  # video codecs halve the colours
        yield picture[:height, :width]


def write_gif(sequence: Sequence, out: Path) -> Path:
    """Write the film as an animated GIF. Return `out`; RenderError if it fails."""
    import io

    from PIL import Image as Pillow

    _check_suffix(out, ".gif")
    pictures = [Pillow.fromarray(picture).quantize(256) for picture in film_frames(sequence)]
    buffer = io.BytesIO()
    milliseconds = max(20, round(_seconds_per_picture(sequence) * 100) * 10)  # the format's unit
    pictures[0].save(buffer, "GIF", save_all=True, append_images=pictures[1:],
                     duration=milliseconds, loop=0)  # fmt: skip
    return write_file(out, buffer.getvalue())


def write_mp4(sequence: Sequence, out: Path) -> Path:
    """Write the film as MP4 in the first of _CODECS that this OpenCV can write. Returns `out`.

    Warns if browsers will not play the result. Raises a GcbenchError if there is no encoder, the
    name does not end in .mp4 or the file cannot be written.
    """
    _check_suffix(out, ".mp4")
    try:
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as folder:
            part = Path(folder) / "film.mp4"
            _encode_mp4(sequence, part, out)
            part.replace(out)
    except OSError as error:
        raise RenderError(f"cannot write {out}: {error.strerror or error}") from error
    return out


def _encode_mp4(sequence: Sequence, part: Path, out: Path) -> None:
    import cv2

    pictures = film_frames(sequence)
    first = next(pictures)
    rate, size = 1 / _seconds_per_picture(sequence), first.shape[1::-1]
    for codec in _CODECS:
        writer = cv2.VideoWriter(str(part), cv2.VideoWriter.fourcc(*codec), rate, size)
        if writer.isOpened():
            break
    else:
        raise RenderError(f"this OpenCV ({cv2.__version__}) cannot write MP4: use a GIF")
    count = 0
    for picture in itertools.chain([first], pictures):
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
        count += 1
    writer.release()
    if int(cv2.VideoCapture(str(part)).get(cv2.CAP_PROP_FRAME_COUNT)) != count:
        raise RenderError(f"cannot write {out}: the file is incomplete; is the disk full?")
    if codec == "mp4v":
        warnings.warn(f"{out}: MPEG-4 Part 2, which players show and most browsers do not",
                      stacklevel=4)  # fmt: skip


_LAYER_CAPTIONS = {"normal": "normals", "coordinates": "coordinates in the parts",
                  "points": "keypoints and tracks"}

Tile = tuple[RgbImage, str]
"""A picture and its caption of one or more lines."""


def _tiles(
    sequence: Sequence, t: int, side: int, span: tuple[float, float, float]
) -> tuple[Tile, Tile, Tile, Tile]:
    """RGB with axes, depth, parts, flow of frame t."""
    meta, frame, (near, far, largest) = sequence.meta, sequence.frame(t), span
    size = picture_size(meta.width, meta.height, 1, side)
    rgb = draw_axes(resize_rgb(frame.rgb, *size), meta, sequence.state, t, scored_only=True)
    blank = np.full_like(rgb, NO_VALUE)
    flow = blank if frame.flow is None else color_flow(resample(frame.flow, *size), largest)
    why = "no flow stored" if "flow" in meta.omitted else "no next frame"
    return (
        (rgb, f"frame {t}, t = {sequence.state.times[t]:.2f} s"),
        (color_depth(resample(frame.depth, *size), near, far), f"depth {near:.2f} - {far:.2f} m"),
        (color_parts(resample(frame.part, *size), len(meta.part_names)), "parts"),
        (flow, why if frame.flow is None else f"flow, up to {largest:.1f} px"),
    )


def _layers(sequence: Sequence, t: int, side: int) -> list[Tile]:
    """Pictures of the layers of frame t, if the sequence has any."""
    size = picture_size(sequence.meta.width, sequence.meta.height, 1, side)
    found = color_layers(sequence, t, size)
    return [(image, _LAYER_CAPTIONS[name]) for name, image in found.items()]


def _over_time(sequence: Sequence) -> list[list[Tile]]:
    # The last frame has no flow, so it is left out.
    numbers = [int(t) for t in select_frames(max(len(sequence) - 1, 1), _SHEET_FRAMES)]
    span = value_ranges(sequence, numbers)
    columns = [[*_tiles(sequence, t, _SHEET_TILE, span), *_layers(sequence, t, _SHEET_TILE)]
               for t in numbers]
    return [list(row) for row in zip(*columns, strict=True)]


def _first(sequence: Sequence, side: int) -> Tile:
    meta = sequence.meta
    rgb = resize_rgb(sequence.rgb[0], *picture_size(meta.width, meta.height, 1, side))
    lines = _caption(sequence)
    return rgb, "\n".join(lines if len(lines) <= _MOST_LINES else
                          [*lines[:_MOST_LINES - 1], f"{len(lines) - _MOST_LINES + 1} more joints"])


def _caption(sequence: Sequence) -> list[str]:
    """Number, robot and seed of a sequence, and the range of each scored joint."""
    meta = sequence.meta
    robot = meta.asset.get("instance") or meta.asset.get("name", meta.name)
    return [f"{meta.index}: {robot}, seed {meta.seed}", *joint_ranges(meta, sequence.state)]


def _grid(rows: list[list[Tile]], title: str = "") -> RgbImage:
    """The tiles on paper, each with its caption below, and a title above them; pictures may differ
    in size."""
    height = max(tile.shape[0] for row in rows for tile, _ in row)
    width = max(tile.shape[1] for row in rows for tile, _ in row)
    lines = max(caption.count("\n") + 1 for row in rows for _, caption in row)
    high, wide = height + lines * _STRIP + _GAP, width + _GAP
    across = _GAP + wide * len(rows[0])
    head = textwrap.wrap(title, max((across - 2 * _GAP) // _LETTER, 20))
    down = _GAP + len(head) * _STRIP
    sheet = np.full((down + high * len(rows), across, 3), _PAPER, np.uint8)
    for k, line in enumerate(head):
        _write(sheet, line, (_GAP, _GAP + k * _STRIP))
    for y, row in enumerate(rows):
        for x, (tile, caption) in enumerate(row):
            top, left = down + y * high, _GAP + x * wide
            bottom, end = top + tile.shape[0], left + tile.shape[1]
            sheet[top - 1 : bottom + 1, left - 1 : end + 1] = _LINE  # zero flow is white, as paper
            sheet[top:bottom, left:end] = tile
            for k, line in enumerate(caption.split("\n")):
                _write(sheet, line[: width // _LETTER], (left + 1, bottom + k * _STRIP))
    return sheet


def _write(sheet: RgbImage, text: str, at: tuple[int, int]) -> None:
    """Write a line whose top left corner is at (u, v) px."""
    import cv2

    shown = text.encode("ascii", "replace").decode()
    cv2.putText(sheet, shown, (at[0], at[1] + _STRIP - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.42,
                (_INK, _INK, _INK), 1, cv2.LINE_AA)  # fmt: skip


def _encode(picture: RgbImage, suffix: str) -> bytes:
    import cv2

    return cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]))[1].tobytes()


def _check_suffix(out: Path, *suffixes: str) -> None:
    if out.suffix.lower() not in suffixes:
        raise ConfigError(f"{out}: give a name that ends in {' or '.join(suffixes)}")


def _true_seconds_per_picture(sequence: Sequence) -> float:
    times = sequence.state.times
    pictures = min(len(times), _FILM_FRAMES)
    span = float(times[-1] - times[0])
    return span / (pictures - 1) if pictures > 1 and span > 0 else _SHORTEST


def _seconds_per_picture(sequence: Sequence) -> float:
    shortest = _SHORTEST / min(len(sequence), _FILM_FRAMES)
    return min(max(_true_seconds_per_picture(sequence), shortest), _LONGEST)
