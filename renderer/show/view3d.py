"""The 3D view of a page: camera, joint axes, trajectories, and the model where it is at hand.

The page's script makes points of the depth images, so that every sequence has a view. It draws
with three.js, which trimesh distributes for its own viewer (MIT; the licence stays in the text).
"""

from __future__ import annotations

import base64
import re
import zipfile
from collections.abc import Sequence as Many
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...robots.geometry import Array, apply, inverse, pinhole
from ...robots.model import ArticulatedModel, Visual, forward_kinematics
from ..types import Meta, Sequence, State
from .annotations import axis_lines
from .colors import css, palette

_TRIANGLES, _POSES, _TRAJECTORIES = 20_000, 30_000, 12
"""Bounds of a page: triangles of the model (fewer than 65536 vertices), poses of parts (parts x
frames), trajectories."""
_LOOKS, _SIDE, _CANDIDATES = 8, 80, 200
"""Frames and px whose depth finds the object's points, and points of a part that are tried."""
_TOLERANCE = 1e-6
"""m, and the sines of angles: how well a model must reproduce the poses of a sequence."""


@cache
def three_js() -> str:
    """Return the text of three.js, or "" if this version of trimesh does not hold it."""
    from trimesh import resources  # slow to import

    try:
        with zipfile.ZipFile(BytesIO(resources.get_bytes("templates/viewer.zip"))) as archive:
            page = archive.read("viewer.html.template").decode()
    except (OSError, KeyError, ValueError, zipfile.BadZipFile):
        return ""
    found = re.search(r"<script>(/\*\*\s+\* @license.*?THREE=\{\}.*?)\n\(function\(", page, re.S)
    return found[1] if found and "WebGLRenderer=" in found[1] else ""


def view_data(
    sequence: Sequence, frames: Many[int], model: ArticulatedModel | None
) -> dict[str, Any]:
    """Return what the script draws in 3D at `frames`; arrays are base64 of little-endian numbers.

    Everything is in the world, m. `model` is drawn if it is the one that the sequence shows and
    its surfaces are rigid.
    """
    meta, state = sequence.meta, sequence.state
    chosen = list(frames)
    world_from_cam = inverse(state.cam_from_world[chosen])
    lines = np.array([axis_lines(meta, state, t) for t in chosen])  # [F 2 J 3] in the camera
    lines[:, 0] = apply(world_from_cam, lines[:, 0])
    lines[:, 1] = np.einsum("fij,fnj->fni", world_from_cam[:, :3, :3], lines[:, 1])
    points, part = _object_points(sequence, chosen)
    origins = state.world_from_part[chosen][:, state.joint_child_part - 1, :3, 3].reshape(-1, 3)
    seen = np.concatenate([points, origins[np.isfinite(origins).all(axis=-1)]])
    low, high = (seen.min(0), seen.max(0)) if len(seen) else (np.zeros(3), np.ones(3))
    k = state.intrinsics
    reason = _why_no_model(model, meta, state, chosen)
    meshes = _meshes(model) if model and not reason else []
    return {
        "camera": _floats(world_from_cam[:, :3]),
        "intrinsics": [float(x) for x in (k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1])],
        "axes": _floats(np.moveaxis(lines, 1, 2)),
        "center": _floats((low + high) / 2),
        "radius": max(float(np.linalg.norm(high - low)) / 2, 1e-6),
        "trajectories": _trajectories(meta, state, chosen, points, part),
        "meshes": meshes,
        "reason": reason,
        "poses": _floats(state.world_from_part[chosen, :, :3]) if meshes else "",
    }


def is_model_of(model: ArticulatedModel, meta: Meta, state: State, t: int) -> bool:
    """Return whether a model is the one that a sequence shows, posed at frame t as the truth says.

    The joints of an animated model are not in the sequence: then the parts alone decide.
    """
    if (meta.part_names != model.part_names or str(meta.asset.get("sha256", "")) != model.sha256):
        return False
    if meta.joint_names != model.joint_names:
        return not meta.joint_names
    posed = forward_kinematics(model, state.joint_positions[t])
    return bool(np.abs(posed - state.world_from_part[t]).max() <= _TOLERANCE)


def simplify(
    vertices: Array, faces: NDArray[np.integer], most: int
) -> tuple[Array, NDArray[np.integer]]:
    """Merge the vertices [V 3] of faces [F 3] in the cells of a grid, coarser until at most `most`
    faces are left. Vertices stay where they are; those of a cell become its first."""
    low, size = vertices.min(axis=0), max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    cells = 300.0
    while len(faces) > most:
        index = np.rint((vertices - low) * (cells / size)).astype(np.int64)
        _, first, merged = np.unique(index @ [1, 1000, 1000_000], return_index=True,
                                     return_inverse=True)
        vertices, faces = vertices[first], merged[faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        cells *= 0.7
    return vertices, faces


def _why_no_model(
    model: ArticulatedModel | None, meta: Meta, state: State, frames: Many[int]
) -> str:
    """Why the view has no model; "" if it has."""
    if model is None:
        return "The model is not available on this machine"
    if not is_model_of(model, meta, state, frames[0]):
        return "The available model is not the one that this sequence shows"
    if len(frames) * len(meta.part_names) > _POSES:
        return "The model has too many parts for this view"
    return "" if _rigid(model) else "The surfaces of the model deform"


def _rigid(model: ArticulatedModel) -> list[Visual]:
    return [v for v in model.visuals if not v.deforms]


def _meshes(model: ArticulatedModel) -> list[dict[str, Any]]:
    """The rigid surfaces, each in the frame of its part."""
    visuals = _rigid(model)
    total = sum(len(v.faces) for v in visuals)
    out: list[dict[str, Any]] = []
    for visual in visuals:
        most = len(visual.faces) if total <= _TRIANGLES else _TRIANGLES * len(visual.faces) // total
        vertices, faces = simplify(visual.vertices, visual.faces, most)
        if len(faces):
            used, faces = np.unique(faces, return_inverse=True)
            out.append({"part": visual.part, "vertices": _floats(vertices[used]),
                        "faces": _base64(faces, "<u2")})
    return out


def _object_points(sequence: Sequence, frames: Many[int]) -> tuple[Array, NDArray[np.uint16]]:
    """Points [N 3] of the object that some frames show, as they are in the first of `frames`, and
    their parts [N]."""
    state = sequence.state
    looks = [frames[i] for i in sorted({*np.linspace(0, len(frames) - 1, _LOOKS).astype(int)})]
    found: list[Array] = []
    parts: list[NDArray[np.uint16]] = []
    for t in looks:
        depth, part = sequence.depth[t], sequence.part[t]
        step = -(-max(depth.shape) // _SIDE)
        rows, columns = np.nonzero(((part > 0) & (depth > 0))[::step, ::step])
        rows, columns = rows * step, columns * step
        number = part[rows, columns]
        pixels = np.stack([columns, rows], axis=-1)
        cam = pinhole.unproject(state.intrinsics, pixels, depth[rows, columns])
        first_from_cam = (state.world_from_part[frames[0]]
                          @ inverse(state.cam_from_world[t] @ state.world_from_part[t]))
        found.append(apply(first_from_cam[number - 1], cam[:, None])[:, 0])
        parts.append(number)
    points, part = np.concatenate(found), np.concatenate(parts)
    finite = np.isfinite(points).all(axis=-1)
    return points[finite], part[finite]


def _trajectories(
    meta: Meta, state: State, frames: Many[int], points: Array, part: NDArray[np.uint16]
) -> list[dict[str, Any]]:
    """The path of the point that moves farthest on each part at the end of a chain of joints."""
    ends = sorted({*state.joint_child_part.tolist()} - {*state.joint_parent_part.tolist()})
    colors = palette(len(meta.part_names))
    out: list[dict[str, Any]] = []
    for number in ends[:_TRAJECTORIES]:
        pose = state.world_from_part[frames, number - 1]
        tried = points[part == number]
        tried = np.concatenate([tried[:: -(-len(tried) // _CANDIDATES) or 1], pose[:1, :3, 3]])
        path = apply(pose, apply(inverse(pose[0]), tried))  # [F N 3]
        length = np.linalg.norm(np.diff(path, axis=0), axis=-1).sum(axis=0)
        best = int(length.argmax())
        if length[best] > _TOLERANCE:
            out.append({"part": meta.part_names[number - 1], "color": css(colors[number]),
                        "points": _floats(path[:, best])})
    return out


def _floats(values: ArrayLike) -> str:
    return _base64(np.asarray(values), "<f4")


def _base64(values: NDArray[Any], dtype: str) -> str:
    return base64.b64encode(values.astype(dtype).tobytes()).decode()
