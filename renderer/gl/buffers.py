"""Triangles on the device: one vertex buffer for a whole model, drawn in few calls.

Functions are handed the module of OpenGL's functions (`Context.gl`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array


@dataclass(frozen=True)
class Surface:
    """Triangles that are drawn with one material and one pose."""

    part: int
    """0-based part, -1 for what stands in the world (the room)."""
    material: int
    """Number of the visual (or of the room's surface) that it belongs to."""
    one_sided: bool
    """Back faces are never seen and are left out."""
    deforms: bool
    """Its vertices are in the camera frame, and change with each frame."""
    first: int
    """First index in the index buffer."""
    count: int


@dataclass(frozen=True)
class Mesh:
    """A vertex array object and the surfaces in it."""

    vao: int
    buffers: tuple[int, ...]
    surfaces: tuple[Surface, ...]
    order: NDArray[np.uint32]
    """[F] number of each triangle of the index buffer, counted through the pieces by `material`."""
    first_vertex: dict[int, int]
    """Of each piece, by `material`."""


@dataclass(frozen=True)
class Piece:
    """Triangles to upload."""

    part: int
    material: int
    vertices: Array
    faces: NDArray[np.int32]
    normals: Array
    uv: Array | None
    one_sided: NDArray[np.bool_]
    deforms: bool = False
    color: Array | None = None


def upload(gl: Any, pieces: Sequence[Piece]) -> Mesh:
    """One vertex buffer (position, normal, uv) and one index buffer for all pieces."""
    vertices = [np.zeros((0, 8), np.float32)]
    indices: dict[tuple[int, bool], list[tuple[Piece, NDArray[np.uint32]]]] = {}
    base, first_vertex = 0, dict[int, int]()
    for piece in pieces:
        block = np.zeros((len(piece.vertices), 8), np.float32)
        block[:, :3], block[:, 3:6] = piece.vertices, piece.normals
        if piece.uv is not None:
            block[:, 6:] = piece.uv
        vertices.append(block)
        numbers = np.asarray(piece.faces, np.uint32) + np.uint32(base)
        indices.setdefault((piece.part, piece.deforms), []).append((piece, numbers))
        first_vertex[piece.material] = base
        base += len(block)
    first_face, faces = dict[int, int](), 0
    for piece in sorted(pieces, key=lambda piece: piece.material):
        first_face[piece.material] = faces
        faces += len(piece.faces)
    # A part's one-sided triangles stand together, as do its others: two draws for its truth.
    index_blocks, surfaces, first = [np.zeros(0, np.uint32)], list[Surface](), 0
    order = [np.zeros(0, np.int64)]
    for (part, deforms), members in indices.items():
        for closed in (True, False):
            for piece, index in members:
                found = np.flatnonzero(piece.one_sided == closed)
                if found.size:
                    count = 3 * found.size
                    surfaces.append(Surface(part, piece.material, closed, deforms, first, count))
                    index_blocks.append(index[found].ravel())
                    order.append(first_face[piece.material] + found)
                    first += count
    data = np.concatenate(vertices)
    index = np.concatenate(index_blocks)
    vao = int(gl.glGenVertexArrays(1))
    gl.glBindVertexArray(vao)
    buffers: tuple[int, ...] = (int(gl.glGenBuffers(1)), int(gl.glGenBuffers(1)))
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffers[0])
    gl.glBufferData(gl.GL_ARRAY_BUFFER, max(data.nbytes, 4), data, gl.GL_STATIC_DRAW)
    gl.glBindBuffer(gl.GL_ELEMENT_ARRAY_BUFFER, buffers[1])
    gl.glBufferData(gl.GL_ELEMENT_ARRAY_BUFFER, max(index.nbytes, 4), index, gl.GL_STATIC_DRAW)
    for location, (size, offset) in enumerate(((3, 0), (3, 12), (2, 24))):
        gl.glEnableVertexAttribArray(location)
        gl.glVertexAttribPointer(
            location, size, gl.GL_FLOAT, gl.GL_FALSE, 32, ctypes.c_void_p(offset)
        )
    if any(piece.color is not None for piece in pieces):
        colors = np.concatenate([
            np.ones((len(p.vertices), 4), np.float32) if p.color is None
            else p.color.astype(np.float32) for p in pieces])
        buffers = (*buffers, int(gl.glGenBuffers(1)))
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffers[2])
        gl.glBufferData(gl.GL_ARRAY_BUFFER, colors.nbytes, colors, gl.GL_STATIC_DRAW)
        gl.glEnableVertexAttribArray(3)
        gl.glVertexAttribPointer(3, 4, gl.GL_FLOAT, gl.GL_FALSE, 16, ctypes.c_void_p(0))
    gl.glBindVertexArray(0)
    triangles = np.concatenate(order).astype(np.uint32)
    return Mesh(vao, buffers, tuple(surfaces), triangles, first_vertex)


def move_vertices(gl: Any, mesh: Mesh, piece: int, vertices: Array, normals: Array, uv: Array
                  ) -> None:
    """Replace the vertices [V 3], normals [V 3] and uv [V 2] of the piece of that `material`."""
    block = np.concatenate([vertices, normals, uv], axis=1, dtype=np.float32, casting="same_kind")
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, mesh.buffers[0])
    gl.glBufferSubData(gl.GL_ARRAY_BUFFER, 32 * mesh.first_vertex[piece], block.nbytes, block)


def delete_mesh(gl: Any, mesh: Mesh | None) -> None:
    """Free a mesh, if there is one."""
    if mesh is not None:
        gl.glDeleteVertexArrays(1, [mesh.vao])
        gl.glDeleteBuffers(len(mesh.buffers), list(mesh.buffers))


def runs_of(surfaces: Iterable[Surface]) -> list[Surface]:
    """The same triangles in fewer draws: neighbours of one part become one surface."""
    runs: list[Surface] = []
    for s in surfaces:
        last = runs[-1] if runs else None
        if (
            last
            and (last.part, last.one_sided, last.deforms) == (s.part, s.one_sided, s.deforms)
            and last.first + last.count == s.first
        ):
            runs[-1] = replace(last, count=last.count + s.count)
        else:
            runs.append(s)
    return runs


def draw_surface(gl: Any, surface: Surface) -> None:
    (gl.glEnable if surface.one_sided else gl.glDisable)(gl.GL_CULL_FACE)
    offset = ctypes.c_void_p(4 * surface.first)
    gl.glDrawElements(gl.GL_TRIANGLES, surface.count, gl.GL_UNSIGNED_INT, offset)
