"""Triangle surfaces on their way from a file to the visuals of a part."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .geometry import Array
from .model import Material, ModelError, Visual
from .normals import face_normals, smooth_corners, valid_normals


@dataclass(frozen=True)
class Surface:
    """Triangles with one material."""

    vertices: Array
    """[V 3] m."""
    faces: NDArray[np.int64]
    """[F 3]."""
    normals: Array
    """[V 3] unit."""
    uv: Array | None = None
    """[V 2] or None."""
    material: Material | None = None
    """None where the file says nothing, so that the URDF may."""
    vertex_color: tuple[float, float, float, float] | None = None
    """Linear mean of the file's vertex colours, used only where nobody names a material."""


def surface(
    vertices: ArrayLike,
    faces: ArrayLike,
    normals: ArrayLike | None = None,
    uv: ArrayLike | None = None,
    material: Material | None = None,
    vertex_color: tuple[float, float, float, float] | None = None,
) -> Surface | None:
    """A clean surface from what a file says, None if nothing is left of it.

    Degenerate triangles and unused vertices are dropped; normals that are absent or invalid are
    made by crease angle. Raises ModelError on numbers that are not finite or indices that are out
    of range.
    """
    v = np.array(vertices, np.float64).reshape(-1, 3)
    f = np.array(faces, np.int64).reshape(-1, 3)
    if not len(f):
        return None
    if f.min() < 0 or f.max() >= len(v):
        raise ModelError("a face refers to a vertex that does not exist")
    v, f, used = _compact(v, f)
    if not np.isfinite(v).all():
        raise ModelError("a vertex is not a finite number")
    if np.abs(v).max() > 1e9:
        raise ModelError("a vertex lies more than 1e9 units from the origin")
    n = None if normals is None else np.asarray(normals, np.float64).reshape(-1, 3)
    n = n[used] if n is not None and len(n) == len(used) else None
    t = None if uv is None else np.asarray(uv, np.float64)
    t = t[used, :2] if t is not None and t.ndim == 2 and len(t) == len(used) else None
    if t is not None and not np.isfinite(t).all():
        t = None
    keep = _solid(v, f)
    if not keep.any():
        return None
    if not keep.all():
        v, f, used = _compact(v, f[keep])
        n, t = (None if x is None else x[used] for x in (n, t))
    if n is not None and valid_normals(v, f, n):
        n = n / np.linalg.norm(n, axis=-1, keepdims=True)
        return Surface(v, f, n, t, material, vertex_color)
    group, group_normals = smooth_corners(v, f)
    corner = (f if t is not None else 0) + group.ravel().reshape(-1, 3) * (
        len(v) if t is not None else 1)
    _, first, index = np.unique(corner.ravel(), return_index=True, return_inverse=True)
    vertex = f.ravel()[first]
    return Surface(v[vertex], index.reshape(-1, 3), group_normals[group.ravel()[first]],
                   None if t is None else t[vertex], material, vertex_color)


def moved(s: Surface, a_from_b: Array, scale: ArrayLike = 1.0) -> Surface:
    """The surface scaled (per axis, mirroring allowed), then taken to frame a.

    `a_from_b` [4 4] may hold scale and shear too: nodes of mesh files do.
    """
    linear = a_from_b[:3, :3] * np.broadcast_to(np.asarray(scale, np.float64), 3)
    det = float(np.linalg.det(linear))
    if not np.isfinite(linear).all() or abs(det) < 1e-30:
        raise ModelError("a scale of zero leaves no surface")
    normals = s.normals @ np.linalg.inv(linear)  # outward stays outward, also in a mirror
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    faces = s.faces[:, ::-1] if det < 0 else s.faces
    return replace(s, vertices=s.vertices @ linear.T + a_from_b[:3, 3], faces=faces,
                   normals=normals)


def visuals_of_part(part: int, surfaces: Sequence[Surface]) -> list[Visual]:
    """The part's surfaces, those of equal material joined into one visual each."""
    groups: dict[object, list[Surface]] = {}
    for s in surfaces:
        groups.setdefault(_material_key(s.material or Material()), []).append(s)
    visuals: list[Visual] = []
    for group in groups.values():
        counts = np.cumsum([0, *(len(s.vertices) for s in group)])
        uvs = [s.uv for s in group if s.uv is not None]
        visuals.append(Visual(
            part=part,
            vertices=np.concatenate([s.vertices for s in group]),
            faces=np.concatenate([s.faces + n for s, n in zip(group, counts, strict=False)])
            .astype(np.int32),
            normals=np.concatenate([s.normals for s in group]),
            uv=np.concatenate(uvs) if len(uvs) == len(group) else None,
            material=group[0].material or Material(),
        ))
    return visuals


def _material_key(m: Material) -> object:
    texture = None
    if m.texture is not None:
        texture = (m.texture.shape, hashlib.sha256(m.texture.tobytes()).digest())
    return (np.round(m.base_color, 6).tobytes(), round(m.metallic, 6), round(m.roughness, 6),
            texture)


def _compact(v: Array, f: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64], NDArray[np.bool_]]:
    """Only the vertices that faces use; `used` [V] says which they are."""
    used = np.zeros(len(v), bool)
    used[f.ravel()] = True
    if used.all():
        return v, f, used
    return v[used], (np.cumsum(used) - 1)[f], used


def _solid(v: Array, f: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[F] whether a triangle has an area, measured against its longest edge."""
    _, area = face_normals(v, f)
    p = v[f]
    longest = (np.roll(p, -1, axis=1) - p)
    square = np.einsum("fci,fci->fc", longest, longest).max(axis=1)
    return (area > 1e-10 * square) & (square > 0)
