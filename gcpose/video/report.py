"""What is written of the estimate of a video file: a table and a picture."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from ...errors import ConfigError
from ...renderer.types import Estimate
from ...robots.files import write_atomically
from ...robots.geometry import Array
from .frames import VideoFrames

_COLORS = np.array([[0, 0, 0], [255, 60, 40], [40, 160, 255], [60, 220, 60], [255, 200, 0],
                    [220, 80, 255]], np.uint8)
"""RGB of parts in a picture; the first is not used."""
_HEADER = "frame,time,joint,displacement,deviation,unit"
_MARK = "gcbench estimate"
"""Near the beginning of a picture. Only files with this, or with the header, are replaced."""


def name_outputs(
    video: Path, table: Path | None, picture: Path | None, *, no_picture: bool
) -> tuple[Path, Path | None]:
    """Return the table and the picture to write: by default, with the name of the video.

    Raises:
        ConfigError: If one cannot be written; see `check_outputs`.
    """
    if picture and no_picture:
        raise ConfigError("--picture and --no-picture: give one of them")
    table = table or Path(video.stem + ".csv")
    picture = None if no_picture else picture or table.parent / f"{table.stem}.png"
    check_outputs(video, table, picture)
    return table, picture


def check_outputs(video: Path, table: Path, picture: Path | None) -> None:
    """Refuse a table and a picture to write that have no folder, or one that cannot be written, are
    the video, are the same, or would replace what another program wrote.

    Raises:
        ConfigError: If there is one.
    """
    outputs = [table] if picture is None else [table, picture]
    for k, path in enumerate(outputs):
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{path}: its folder does not exist; make it")
        if path.resolve() == video.resolve():
            raise ConfigError(f"{path}: is the video; name another file")
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; name a file")
        if path.resolve() in [other.resolve() for other in outputs[:k]]:
            raise ConfigError(f"{path}: is named for two outputs; name two files")
        _check_writable(path, *(("--picture", _MARK) if k else ("--out", _HEADER)))
    if picture is not None and picture.suffix.lower() != ".png":
        raise ConfigError(f"--picture {picture}: give a name that ends in .png")


def _check_writable(path: Path, option: str, mark: str) -> None:
    """Refuse a file that cannot be written, or that exists without the mark at its beginning."""
    try:
        with tempfile.TemporaryFile(dir=path.absolute().parent):
            pass
        if path.is_file():
            with path.open("rb") as file:
                begin = file.read(200)
            if begin and mark.encode() not in begin:
                raise ConfigError(f"{path}: exists, and is not of `gcbench estimate`; name another "
                                  f"file ({option})")
        elif path.exists():
            raise ConfigError(f"{path}: is no file that can be replaced; name another ({option})")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}); name another file "
                          f"({option})") from None


def towards_camera(estimate: Estimate) -> tuple[Estimate, Array]:
    """Return the estimate of one slide with the sign that makes its axis point towards the camera,
    and that axis [1 3]."""
    assert estimate.screw is not None
    sign = -1.0 if estimate.screw[0, 2] > 0 else 1.0
    screw = sign * estimate.screw
    return replace(estimate, displacement=sign * estimate.displacement, screw=screw), screw[:, :3]


def write_table(
    path: Path, video: VideoFrames, estimate: Estimate, types: Sequence[str]
) -> None:
    """Write CSV: one line for each frame and joint, deg or m."""
    assert estimate.sigma is not None
    lines = [_HEADER]
    for t, (moved, sigma) in enumerate(zip(estimate.displacement, estimate.sigma, strict=True)):
        for j, (unit, factor, digits) in enumerate(map(_unit_of, types)):
            lines.append(f"{video.number[t]},{video.times[t]:.6g},{j + 1},"
                         f"{factor * moved[j]:.{digits}f},{factor * sigma[j]:.{digits}f},{unit}")
    write_atomically(path, "".join(f"{line}\n" for line in lines).encode())


def summarize_estimate(
    video: VideoFrames, estimate: Estimate, axes: Array, types: Sequence[str],
    reasons: Sequence[str | None],
) -> list[dict[str, Any]]:
    """Return what is estimated of each joint at the last frame, deg or m, its largest displacement
    and the time of it, s, its axis [J 3], and the reason if it is not reliable."""
    assert estimate.sigma is not None and estimate.reliable is not None
    last = zip(estimate.displacement[-1], estimate.sigma[-1], estimate.reliable, axes, types,
               strict=True)
    out = list[dict[str, Any]]()
    for j, (moved, sigma, reliable, axis, type_) in enumerate(last, 1):
        unit, factor, _ = _unit_of(type_)
        all_moved = estimate.displacement[:, j - 1]
        largest = np.abs(all_moved).argmax()
        out.append({"joint": f"joint {j}", "displacement": float(factor * moved),
                    "deviation": float(factor * sigma), "unit": unit, "reliable": bool(reliable),
                    "reason": reasons[j - 1], "largest": float(factor * all_moved[largest]),
                    "largest_time": float(video.times[largest]),
                    "axis": [round(float(x), 4) for x in axis]})
    return out


def describe_joints(joints: list[dict[str, Any]]) -> list[str]:
    """Return a line of text for each joint of `summarize_estimate`."""
    out = list[str]()
    for j in joints:
        digits, unit = 4 if j["unit"] == "m" else 2, j["unit"]
        out.append(f"{j['joint']}: {j['displacement']:.{digits}f} {unit} at the last frame "
                   f"(largest: {j['largest']:.{digits}f} {unit} at {j['largest_time']:.2f} s), "
                   f"standard deviation {j['deviation']:.{digits}f} {unit}"
                   + ("" if j["reliable"] else f", not reliable: {j['reason']}"))
    return out


def _unit_of(joint_type: str) -> tuple[str, float, int]:
    """The unit of a displacement in a table, its size by rad or m, and the digits shown."""
    return ("m", 1.0, 6) if joint_type == "prismatic" else ("deg", 180 / np.pi, 4)


def draw_parts(path: Path, video: VideoFrames, estimate: Estimate, most: int = 6) -> None:
    """Write a PNG of at most so many frames, in two rows, with the estimated parts in color."""
    assert estimate.part is not None
    shown = list[NDArray[np.uint8]]()
    for t in np.unique(np.linspace(0, len(video.rgb) - 1, most).astype(int)):
        part = estimate.part[t]
        color = _COLORS[np.where(part > 0, (part - 1) % (len(_COLORS) - 1) + 1, 0)]
        mixed = np.where(part[..., None] > 0, video.rgb[t] // 2 + color // 2, video.rgb[t])
        shown.append(np.asarray(cv2.resize(mixed, None, fx=0.5, fy=0.5,
                                           interpolation=cv2.INTER_AREA), np.uint8))
    half = -(-len(shown) // 2)
    shown += [np.zeros_like(shown[0])] * (2 * half - len(shown))
    rows = np.vstack([np.hstack(shown[:half]), np.hstack(shown[half:])])
    mark, data = PngInfo(), BytesIO()
    mark.add_text("Software", _MARK)
    Image.fromarray(rows).save(data, "PNG", pnginfo=mark)
    write_atomically(path, data.getvalue())
