"""Triangle surfaces of mesh files and solids, and the visuals made of them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from ..geometry import Array, face_normals, smooth_corners, valid_normals
from .visuals import Material, Visual


@dataclass(frozen=True, eq=False)
class TriangleSurface:
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
    """None if the file names none; the material of the URDF then applies."""
    vertex_color: tuple[float, float, float, float] | None = None
    """Linear mean of the file's vertex colours, used only without any material."""


def clean_surface(
    vertices: ArrayLike, faces: ArrayLike, normals: ArrayLike | None = None,
    uv: ArrayLike | None = None, material: Material | None = None,
    vertex_color: tuple[float, float, float, float] | None = None,
) -> TriangleSurface | None:
    """Return a clean surface from the arrays of a file; None if no triangle remains.

    Degenerate triangles and unused vertices are dropped. Normals that are absent or invalid are
    computed by crease angle.
    """
    v = np.array(vertices, np.float64).reshape(-1, 3)
    f = np.array(faces, np.int64).reshape(-1, 3)
    n = None if normals is None else np.asarray(normals, np.float64).reshape(-1, 3)
    t = None if uv is None else np.asarray(uv, np.float64)
    t = t[:, :2] if t is not None and t.ndim == 2 and len(t) == len(v) else None
    made = clean_triangles(v, f, n, distinct=t is not None)
    if made is None:
        return None
    source, f, n = made
    t = None if t is None else t[source]
    if t is not None and not np.isfinite(t).all():
        t = None
    return TriangleSurface(v[source], f, n, t, material, vertex_color)


def clean_triangles(
    v: Array, f: NDArray[np.int64], n: Array | None, distinct: bool, keep_flat: bool = False
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array] | None:
    """The vertices [V'] of v [V 3] that are left, faces [F' 3] of them, and normals [V' 3].

    None if nothing is left. Without `distinct`, vertices at one place may become one; with
    `keep_flat`, triangles without an area stay (a deformation may open them).
    """
    if not len(f):
        return None
    if f.min() < 0 or f.max() >= len(v):
        raise ModelError("a face refers to a vertex that does not exist")
    source, f = _compact(f, len(v))
    p = v[source]
    if not np.isfinite(p).all():
        raise ModelError("a vertex is not a finite number")
    if np.abs(p).max() > 1e9:
        raise ModelError("a vertex lies more than 1e9 units from the origin")
    keep = _solid(p, f)
    if not keep.any() and not keep_flat:
        return None
    if not keep.all() and not keep_flat:
        used, f = _compact(f[keep], len(source))
        source, p, keep = source[used], p[used], np.ones(len(f), bool)
    m = n[source] if n is not None and len(n) == len(v) else None
    if m is not None and (valid_normals(p, f[keep], m) if keep.any() else _have_length(m)):
        return source, f, m / np.linalg.norm(m, axis=-1, keepdims=True)
    group, group_normals = smooth_corners(p, f)
    corner = (f if distinct else 0) + group.ravel().reshape(-1, 3) * (len(p) if distinct else 1)
    _, first, index = np.unique(corner.ravel(), return_index=True, return_inverse=True)
    return (source[f.ravel()[first]], index.reshape(-1, 3).astype(np.int64),
            group_normals[group.ravel()[first]])


def move_surface(s: TriangleSurface, a_from_b: Array, scale: ArrayLike = 1.0) -> TriangleSurface:
    """Return the surface scaled (per axis, mirroring allowed), then moved to frame a.

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


def visuals_of_part(
    part: int, surfaces: Sequence[TriangleSurface], digests: dict[int, bytes] | None = None
) -> list[Visual]:
    """Return the visuals of a part: its surfaces, those of equal material joined.

    Calls for the parts of one model share `digests`: those of their textures, by id.
    """
    digests = {} if digests is None else digests
    groups: dict[object, list[TriangleSurface]] = {}
    for s in surfaces:
        groups.setdefault(_material_key(s.material or Material(), digests), []).append(s)
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


def _material_key(m: Material, digests: dict[int, bytes]) -> object:
    """Return what tells the look of a material from that of others; its name does not."""
    maps = m.maps
    pictures = [_picture_key(picture, digests) for picture in (
        m.texture, maps.metallic_roughness, maps.normal, maps.occlusion, maps.emission)]
    return (np.round([*m.base_color, m.metallic, m.roughness, *m.emission], 6).tobytes(),
            m.unlit, m.alpha_cutoff, m.blend, *pictures, m.tiling if any(pictures) else None)


def _picture_key(picture: NDArray[np.uint8] | None, digests: dict[int, bytes]) -> object:
    if picture is None:
        return None
    if id(picture) not in digests:
        digests[id(picture)] = hashlib.sha256(picture.tobytes()).digest()
    return picture.shape, digests[id(picture)]


def _compact(f: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The vertices [V'] of `count` that faces [F 3] use, and the faces in numbers of those."""
    used = np.zeros(count, bool)
    used[f.ravel()] = True
    return np.flatnonzero(used), (np.cumsum(used) - 1)[f]


def _have_length(normals: Array) -> bool:
    """Return whether normals [V 3] without a face that has a side can be kept."""
    length = np.linalg.norm(normals, axis=-1)
    return bool(np.isfinite(length).all() and (length > 1e-6).all())


def _solid(v: Array, f: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[F] whether a triangle has an area, measured against its longest edge."""
    _, area = face_normals(v, f)
    p = v[f]
    longest = (np.roll(p, -1, axis=1) - p)
    square = np.einsum("fci,fci->fc", longest, longest).max(axis=1)
    return (area > 1e-10 * square) & (square > 0)
