"""What is written of the estimate of a video file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...renderer.types import Estimate
from ...robots.files import write_atomically
from ...robots.geometry import Array
from ..images import ImageSettings, still_texture_share
from .frames import VideoFrames

_COLORS = np.array([[0, 0, 0], [255, 60, 40], [40, 160, 255], [60, 220, 60], [255, 200, 0],
                    [220, 80, 255]], np.uint8)
"""RGB of parts in a picture; the first is not used."""


def check_outputs(video: Path, outputs: Iterable[Path]) -> None:
    """Refuse files to write that have no folder, are one, are the video, or are the same.

    Raises:
        ConfigError: If there is one.
    """
    outputs = list(outputs)
    for k, path in enumerate(outputs):
        if not path.absolute().parent.is_dir():
            raise ConfigError(f"{path}: its folder does not exist; make it")
        if path.resolve() == video.resolve():
            raise ConfigError(f"{path}: is the video; name another file")
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; name a file")
        if path.resolve() in [other.resolve() for other in outputs[:k]]:
            raise ConfigError(f"{path}: is named for two outputs; name two files")


def towards_camera(estimate: Estimate) -> tuple[Estimate, Array]:
    """Return the estimate of one slide with the sign that makes its axis point towards the camera,
    and that axis [1 3].

    Raises:
        ConfigError: If nothing was seen to move.
    """
    if estimate.screw is None:
        raise ConfigError("nothing is seen to slide; choose a part of the video in which it does "
                          "(--start, --end), or the part of the images where it is (--region)")
    sign = -1.0 if estimate.screw[0, 2] > 0 else 1.0
    screw = sign * estimate.screw
    return replace(estimate, displacement=sign * estimate.displacement, screw=screw), screw[:, :3]


def doubt_still_texture(
    video: VideoFrames, estimate: Estimate, settings: ImageSettings
) -> tuple[Estimate, float]:
    """Return an estimate that is not reliable if much of the texture of its parts stays where it
    is, and that share."""
    assert estimate.part is not None and estimate.reliable is not None
    share = still_texture_share(video.rgb, estimate.part > 0, settings)
    reliable = estimate.reliable & (share <= settings.max_still_texture)
    return replace(estimate, reliable=reliable), share


def write_table(
    path: Path, video: VideoFrames, estimate: Estimate, types: Sequence[str]
) -> None:
    """Write CSV: one line for each frame and joint, deg or m."""
    assert estimate.sigma is not None
    lines = ["frame,time,joint,displacement,deviation,unit"]
    for t, (moved, sigma) in enumerate(zip(estimate.displacement, estimate.sigma, strict=True)):
        for j, (unit, factor, digits) in enumerate(map(_unit_of, types)):
            lines.append(f"{video.number[t]},{video.times[t]:.6g},{j + 1},"
                         f"{factor * moved[j]:.{digits}f},{factor * sigma[j]:.{digits}f},{unit}")
    write_atomically(path, "".join(f"{line}\n" for line in lines).encode())


def summarize_estimate(
    estimate: Estimate, axes: Array, types: Sequence[str]
) -> list[dict[str, Any]]:
    """Return what is estimated of each joint at the last frame, deg or m, and its axis [J 3]."""
    assert estimate.sigma is not None and estimate.reliable is not None
    last = zip(estimate.displacement[-1], estimate.sigma[-1], estimate.reliable, axes, types,
               strict=True)
    out = list[dict[str, Any]]()
    for j, (moved, sigma, reliable, axis, type_) in enumerate(last, 1):
        unit, factor, _ = _unit_of(type_)
        out.append({"joint": f"joint {j}", "displacement": float(factor * moved),
                    "deviation": float(factor * sigma), "unit": unit, "reliable": bool(reliable),
                    "axis": [round(float(x), 4) for x in axis]})
    return out


def describe_joints(joints: list[dict[str, Any]]) -> list[str]:
    """Return a line of text for each joint of `summarize_estimate`."""
    out = list[str]()
    for j in joints:
        digits, unit = 4 if j["unit"] == "m" else 2, j["unit"]
        out.append(f"{j['joint']}: {j['displacement']:.{digits}f} {unit}, standard deviation "
                   f"{j['deviation']:.{digits}f} {unit}" + ", not reliable" * (not j["reliable"]))
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
    write_atomically(path, cv2.imencode(".png", rows[..., ::-1])[1].tobytes())
