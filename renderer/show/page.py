"""One self-contained page that shows a sequence and its truth."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from collections.abc import Sequence as Many
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...errors import RenderError
from ...robots.files import remove_leftovers, write_atomically
from ...robots.model import ArticulatedModel
from ..types import Frame, Meta, Sequence, State
from .annotations import draw_points, has_points, joint_axes
from .colors import (
    NO_VALUE,
    VISIBILITY,
    RgbImage,
    color_coordinates,
    color_depth,
    color_flow,
    color_normals,
    color_parts,
    color_visibility,
    css,
    depth_colors,
    flow_wheel,
    palette,
)
from .descriptions import joint_table, sections
from .html import render_page, shared_text
from .static_html import Links, static_page
from .view3d import three_js, view_data

TEMPLATE = Path(__file__).parent / "show.html"
PAGE_FRAMES, PAGE_SIDE, PAGE_PIXELS = 120, 640, 20_000_000
"""Bounds of a page: frames, px of a picture's longer side, px of all frames together."""
VALUES_SIDE = 320
"""px, longer side of the grid of values that the page shows under the pointer."""
FLOW_UNIT = 1 / 64
"""px, as on disk"""
PANES = ("rgb", "depth", "part", "flow", "flow_backward", "visibility", "normal", "coordinates",
         "points")
"""The last six exist only if the sequence has these images."""


def write_page(
    sequence: Sequence, out: Path, model: ArticulatedModel | None = None, links: Links = ()
) -> Path:
    """Write the page of a sequence to `out`: one HTML file that needs no network. Return `out`.

    Long or large sequences are shown with fewer frames and smaller pictures; the page says so.
    The 3D view shows `model` if it is that of the sequence. Raises RenderError if the file cannot
    be written.
    """
    return write_file(out, page_html(sequence, model, links).encode())


def page_html(
    sequence: Sequence, model: ArticulatedModel | None = None, links: Links = ()
) -> str:
    """Return the page of `write_page`."""
    data = page_data(sequence, model, links)
    scripts = f"{three_js()}\n{shared_text('view3d.js')}"
    return render_page(TEMPLATE, data, scripts, static_page(data))


def page_data(
    sequence: Sequence, model: ArticulatedModel | None = None, links: Links = ()
) -> dict[str, Any]:
    """Return everything that the page's script reads, as JSON values."""
    meta, state = sequence.meta, sequence.state
    frames = [int(t) for t in select_frames(len(sequence))]
    width, height = picture_size(meta.width, meta.height, len(frames))
    grid = picture_size(meta.width, meta.height, len(frames), VALUES_SIDE)
    near, far, largest = value_ranges(sequence, frames)
    unit = far * 4 / 65535  # m; what is farther than that is shown as that far
    parts = len(meta.part_names)
    layers = layer_names(sequence)
    panes = [name for name in PANES[: 6 if len(sequence) > 1 else 3]  # a frame alone has no flow
             if name not in meta.omitted]
    images: dict[str, list[str | None]] = {name: [] for name in (*panes, *layers)}
    values: list[str] = []
    for t in frames:
        frame = sequence.frame(t)
        pictures = _pictures(frame, (width, height), (near, far, largest), parts)
        for name in panes:
            images[name].append(pictures[name])
        for name, image in color_layers(sequence, t, (width, height)).items():
            images[name].append(data_uri(image, 85 if name == "points" else None))
        values.append(data_uri(_values(frame, *grid, unit)))
    colors = [css(c) for c in palette(parts)]
    return {
        "version": __version__,
        "name": meta.name,
        "robot": str(meta.asset.get("name", "")),
        "total": len(sequence),
        "frames": frames,
        "times": _round(state.times),
        "size": [meta.width, meta.height],
        "picture": [width, height],
        "grid": list(grid),
        "images": images,
        "values": values,
        "depth": {"near": near, "far": far, "unit": unit,
                  "colors": [css(c) for c in depth_colors()[::15]]},
        "flow": {"largest": largest, "unit": FLOW_UNIT, "wheel": data_uri(flow_wheel(96))},
        "nothing": css(NO_VALUE),
        "visibility": [{"name": text, "color": css(c)} for text, c in VISIBILITY.values()],
        "parts": [{"name": name, "color": color, "pixels": state.part_pixels[:, i].tolist()}
                  for i, (name, color) in enumerate(zip(meta.part_names, colors[1:], strict=True))],
        "joints": _joints(meta, state, colors),
        "axes": [[[a.joint, *_round(np.array([a.tail, a.point, a.head]).ravel())]
                  for a in joint_axes(meta, state, t)] for t in frames],
        "table": joint_table(meta, state),
        "space": view_data(sequence, frames, model) if three_js() else None,
        "links": [list(link) for link in links],
        "sections": sections(meta, state),
    }  # fmt: skip


def _joints(meta: Meta, state: State, colors: Many[str]) -> list[dict[str, Any]]:
    """Each joint's positions, in degrees or metres, and its colour, which is that of its part."""
    scale = [180 / math.pi if kind != "prismatic" else 1.0 for kind in meta.joint_types]
    return [{"name": name, "unit": "m" if meta.joint_types[j] == "prismatic" else "°",
             "scored": name in meta.scored_joints,
             "color": colors[int(state.joint_child_part[j])],
             "positions": _round(state.joint_positions[:, j] * scale[j])}
            for j, name in enumerate(meta.joint_names)]  # fmt: skip


def layer_names(sequence: Sequence) -> list[str]:
    """Return which of the panes "normal", "coordinates" and "points" the sequence has."""
    there = {"normal": sequence.normal is not None,
             "coordinates": sequence.coordinates is not None, "points": has_points(sequence.state)}
    return [name for name, is_there in there.items() if is_there]


def color_layers(sequence: Sequence, t: int, size: tuple[int, int]) -> dict[str, RgbImage]:
    """Draw the pictures of frame t for `layer_names`, of (width, height) px."""
    frame, box = sequence.frame(t), sequence.state.coordinate_box
    out: dict[str, RgbImage] = {}
    if frame.normal is not None:
        out["normal"] = color_normals(resample(frame.normal, *size))
    if frame.coordinates is not None and box is not None:
        chosen = (resample(frame.coordinates, *size), resample(frame.part, *size))
        out["coordinates"] = color_coordinates(*chosen, box)
    if has_points(sequence.state):
        out["points"] = draw_points(resize_rgb(frame.rgb, *size), sequence.meta, sequence.state, t)
    return out


def select_frames(frames: int, most: int = PAGE_FRAMES) -> NDArray[np.int64]:
    """Select at most `most` of `frames` frame numbers, evenly spread, with the first and last."""
    return np.unique(np.rint(np.linspace(0, frames - 1, min(frames, most))).astype(np.int64))


def picture_size(
    width: int, height: int, frames: int, side: int = PAGE_SIDE
) -> tuple[int, int]:
    """Return (width, height) px of a page's pictures, at most those of the sequence."""
    zoom = min(1.0, side / max(width, height),
               math.sqrt(PAGE_PIXELS / (max(frames, 1) * width * height)))  # fmt: skip
    return max(1, round(width * zoom)), max(1, round(height * zoom))


def value_ranges(sequence: Sequence, frames: Iterable[int]) -> tuple[float, float, float]:
    """Return (near m, far m, largest flow px) over frames, so that colours do not flicker."""
    near, far, largest = math.inf, 0.0, 0.0
    for t in frames:
        frame = sequence.frame(t)
        z = frame.depth[::2, ::2]
        z = z[np.isfinite(z) & (z > 0)]
        if z.size:
            near, far = min(near, float(z.min())), max(far, float(np.percentile(z, 99)))
        for flow in (frame.flow, frame.flow_backward):
            if flow is not None:
                squared = (flow[..., 0] ** 2 + flow[..., 1] ** 2)[np.isfinite(flow).all(axis=-1)]
                largest = max(largest, math.sqrt(float(squared.max(initial=0.0))))
    if not near < far:
        near, far = (near * 0.99, near * 1.01) if near < math.inf else (0.5, 1.0)
    return near, far, largest


def resample(image: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Return the values [height width ...] of the pixels in the middle of each cell.

    Parts and depths must not be averaged: a mean of two of them shows nothing real.
    """
    rows, columns = (((np.arange(n) + 0.5) * whole / n).astype(np.intp)
                     for n, whole in zip((height, width), image.shape[:2], strict=True))
    return image[rows[:, None], columns]


def resize_rgb(rgb: RgbImage, width: int, height: int) -> RgbImage:
    """Resize a photograph to [height width 3], averaged over each cell."""
    import cv2

    if rgb.shape[:2] == (height, width):
        return rgb
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _pictures(
    frame: Frame, size: tuple[int, int], span: tuple[float, float, float], parts: int
) -> dict[str, str | None]:
    """The address of each pane's picture; None where this frame has none."""
    near, far, largest = span

    def flow_uri(flow: NDArray[np.float32] | None) -> str | None:
        return None if flow is None else data_uri(color_flow(resample(flow, *size), largest), 90)

    seen = frame.visibility
    return {
        "rgb": data_uri(resize_rgb(frame.rgb, *size), 85),
        "depth": data_uri(color_depth(resample(frame.depth, *size), near, far)),
        "part": data_uri(color_parts(resample(frame.part, *size), parts)),
        "flow": flow_uri(frame.flow),
        "flow_backward": flow_uri(frame.flow_backward),
        "visibility": None if seen is None else data_uri(color_visibility(resample(seen, *size))),
    }


def _values(frame: Frame, width: int, height: int, depth_unit: float) -> RgbImage:
    """[13 height, width] grey: visibility and the bytes (high first) of depth, part and both
    flows, one plane below the other. Browsers decode pictures fastest."""
    depth, part, visibility, *flows = (
        None if image is None else resample(image, width, height)
        for image in (frame.depth, frame.part, frame.visibility, frame.flow, frame.flow_backward)
    )
    assert depth is not None and part is not None
    words = [np.clip(np.rint(np.nan_to_num(depth) / depth_unit), 0, 65535), part]
    for flow in flows:
        known = np.full((height, width, 2), np.nan) if flow is None else flow
        code = np.nan_to_num(np.clip(np.rint(known / FLOW_UNIT) + 32768, 1, 65535))
        words += [code[..., 0], code[..., 1]]
    planes = [np.zeros((height, width)) if visibility is None else visibility]
    for word in words:
        planes += [word.astype(np.uint16) >> 8, word.astype(np.uint16) & 255]
    return np.concatenate(planes).astype(np.uint8)


def data_uri(picture: RgbImage, quality: int | None = None) -> str:
    """Encode a picture, RGB [H W 3] or grey [H W], as a `data:` URI; lossless by default."""
    import cv2

    if picture.ndim == 2:
        kind, pixels, options = "png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 6]
    else:
        kind, pixels = "webp", np.ascontiguousarray(picture[..., ::-1])
        options = [cv2.IMWRITE_WEBP_QUALITY, quality or 101]
    _, code = cv2.imencode(f".{kind}", pixels, options)
    return f"data:image/{kind};base64," + base64.b64encode(code.tobytes()).decode()


def write_file(out: Path, content: bytes) -> Path:
    """Write a file whole or not at all, and return its path; RenderError if that fails."""
    try:
        remove_leftovers(out.parent, (out.name,))
        write_atomically(out, content)
    except OSError as error:
        raise RenderError(f"cannot write {out}: {error.strerror or error}") from error
    return out


def _round(values: NDArray[np.float64]) -> list[float | None]:
    return [round(float(x), 4) if math.isfinite(x) else None for x in values]
