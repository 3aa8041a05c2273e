"""The shape of each object for BOP: a mesh, its diameter and its box."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import Material, Visual, mean_color

_MM = 1000.0
_PAIRS = 2**22
"""Of points whose distances are held at once."""


def write_ply(path: Path, visuals: list[Visual]) -> None:
    """A part's surfaces in mm, with normals and the colour of each material (not textures)."""
    import trimesh

    counts = np.cumsum([0, *(len(v.vertices) for v in visuals)])
    colors = [np.tile(_color(v.material), (len(v.vertices), 1)) for v in visuals]
    trimesh.Trimesh(
        np.concatenate([v.vertices for v in visuals]) * _MM,
        np.concatenate([v.faces + n for v, n in zip(visuals, counts, strict=False)]),
        vertex_normals=np.concatenate([v.normals for v in visuals]),
        vertex_colors=np.concatenate(colors), process=False,
    ).export(path, file_type="ply", vertex_normal=True)


def size_of(vertices: Array) -> dict[str, float]:
    """Return the entry of models_info.json for a mesh: diameter and axis-aligned box, mm."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import cdist

    points = np.unique(vertices, axis=0) * _MM
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # flat
        corners = points
    rows = max(1, _PAIRS // len(corners))
    diameter = max(float(cdist(corners[i:i + rows], corners[i:]).max())
                   for i in range(0, len(corners), rows))
    low, size = points.min(0), np.ptp(points, axis=0)
    return {"diameter": diameter,
            **{f"min_{axis}": float(x) for axis, x in zip("xyz", low, strict=True)},
            **{f"size_{axis}": float(x) for axis, x in zip("xyz", size, strict=True)}}


def _color(material: Material) -> NDArray[np.uint8]:
    """sRGB, 0..255."""
    linear = np.array(material.base_color[:3])
    if material.texture is not None:
        linear *= mean_color(material.texture)[:3]
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * np.clip(srgb, 0, 1)).astype(np.uint8)
