"""Triangles on the device: one vertex array for a whole model, drawn in few calls.

Functions take the module of OpenGL's functions (`GLContext.gl`) as `gl`.
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
class DrawRange:
    """Triangles of an index buffer that are drawn with one material and one pose."""

    part: int
    """0-based part; -1 for the room, which stands in the world"""
    material: int
    """number of the visual (or of the room's surface) that the triangles belong to"""
    one_sided: bool
    """back faces are never visible and are not drawn"""
    deforms: bool
    """the vertices are in the camera frame and change with each frame"""
    first: int
    """first index in the index buffer"""
    count: int


@dataclass(frozen=True)
class VertexArray:
    """A vertex array object and the ranges in it."""

    id: int
    buffers: tuple[int, ...]
    ranges: tuple[DrawRange, ...]
    order: NDArray[np.uint32]
    """[F] number of each triangle of the index buffer, counted through the pieces by `material`"""
    first_vertex: dict[int, int]
    """of each piece, by `material`"""


@dataclass(frozen=True)
class Piece:
    """Triangles to upload."""

    part: int
    material: int
    vertices: Array  # [V 3] m
    faces: NDArray[np.int32]  # [F 3]
    normals: Array  # [V 3]
    uv: Array | None  # [V 2]
    one_sided: NDArray[np.bool_]  # [F]
    deforms: bool = False
    color: Array | None = None  # [V 4]


def upload_pieces(gl: Any, pieces: Sequence[Piece]) -> VertexArray:
    """Upload all pieces into one vertex buffer (position, normal, uv) and one index buffer."""
    counts = [len(piece.vertices) for piece in pieces]
    starts = np.cumsum([0, *counts]).tolist()
    first_vertex = {piece.material: start for piece, start in zip(pieces, starts, strict=False)}
    vertices = np.zeros((starts[-1], 8), np.float32)
    for piece, start, count in zip(pieces, starts, counts, strict=False):
        block = vertices[start:start + count]
        block[:, :3], block[:, 3:6] = piece.vertices, piece.normals
        if piece.uv is not None:
            block[:, 6:] = piece.uv
    index, ranges, order = _indices(pieces, first_vertex)
    vao = int(gl.glGenVertexArrays(1))
    gl.glBindVertexArray(vao)
    buffers = [_vertex_buffer(gl, vertices, ((0, 3, 0), (1, 3, 12), (2, 2, 24)))]
    buffers.append(_buffer(gl, gl.GL_ELEMENT_ARRAY_BUFFER, index))
    if any(piece.color is not None for piece in pieces):
        colors = np.concatenate([
            np.ones((len(p.vertices), 4), np.float32) if p.color is None
            else p.color.astype(np.float32) for p in pieces])
        buffers.append(_vertex_buffer(gl, colors, ((3, 4, 0),)))
    gl.glBindVertexArray(0)
    return VertexArray(vao, tuple(buffers), tuple(ranges), order, first_vertex)


def _indices(
    pieces: Sequence[Piece], first_vertex: dict[int, int]
) -> tuple[NDArray[np.uint32], list[DrawRange], NDArray[np.uint32]]:
    """The index buffer, its ranges, and the number of each of its triangles.

    A part's one-sided triangles stand together, as do its others: two draws for its truth.
    """
    groups: dict[tuple[int, bool], list[Piece]] = {}
    for piece in pieces:
        groups.setdefault((piece.part, piece.deforms), []).append(piece)
    first_face, faces = dict[int, int](), 0
    for piece in sorted(pieces, key=lambda piece: piece.material):
        first_face[piece.material] = faces
        faces += len(piece.faces)
    blocks, ranges, order, first = [np.zeros(0, np.uint32)], list[DrawRange](), list[Any](), 0
    for (part, deforms), members in groups.items():
        for closed in (True, False):
            for piece in members:
                found = np.flatnonzero(piece.one_sided == closed)
                if found.size:
                    count = 3 * found.size
                    ranges.append(DrawRange(part, piece.material, closed, deforms, first, count))
                    corners = np.asarray(piece.faces[found], np.uint32)
                    blocks.append((corners + np.uint32(first_vertex[piece.material])).ravel())
                    order.append(first_face[piece.material] + found)
                    first += count
    numbers = np.concatenate([np.zeros(0, np.int64), *order]).astype(np.uint32)
    return np.concatenate(blocks), ranges, numbers


def _buffer(gl: Any, kind: Any, data: NDArray[Any]) -> int:
    buffer = int(gl.glGenBuffers(1))
    gl.glBindBuffer(kind, buffer)
    gl.glBufferData(kind, max(data.nbytes, 4), data, gl.GL_STATIC_DRAW)
    return buffer


def _vertex_buffer(
    gl: Any, data: NDArray[np.float32], attributes: Iterable[tuple[int, int, int]]
) -> int:
    """A buffer of rows of `data`; attributes are (location, numbers, byte offset in a row)."""
    buffer = _buffer(gl, gl.GL_ARRAY_BUFFER, data)
    for location, size, offset in attributes:
        gl.glEnableVertexAttribArray(location)
        gl.glVertexAttribPointer(location, size, gl.GL_FLOAT, gl.GL_FALSE, 4 * data.shape[1],
                                 ctypes.c_void_p(offset))
    return buffer


def move_vertices(
    gl: Any, array: VertexArray, material: int, vertices: Array, normals: Array, uv: Array
) -> None:
    """Replace the vertices [V 3], normals [V 3] and uv [V 2] of the piece of that `material`."""
    block = np.concatenate([vertices, normals, uv], axis=1, dtype=np.float32, casting="same_kind")
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, array.buffers[0])
    gl.glBufferSubData(gl.GL_ARRAY_BUFFER, 32 * array.first_vertex[material], block.nbytes, block)


def delete_vertex_array(gl: Any, array: VertexArray | None) -> None:
    """Free a vertex array, if there is one."""
    if array is not None:
        gl.glDeleteVertexArrays(1, [array.id])
        gl.glDeleteBuffers(len(array.buffers), list(array.buffers))


def merge_ranges(ranges: Iterable[DrawRange]) -> list[DrawRange]:
    """Merge neighbors of one part: the same triangles in fewer draws."""
    runs: list[DrawRange] = []
    for r in ranges:
        last = runs[-1] if runs else None
        if (
            last
            and (last.part, last.one_sided, last.deforms) == (r.part, r.one_sided, r.deforms)
            and last.first + last.count == r.first
        ):
            runs[-1] = replace(last, count=last.count + r.count)
        else:
            runs.append(r)
    return runs


def draw_range(gl: Any, triangles: DrawRange) -> None:
    """Draw triangles of the bound vertex array."""
    (gl.glEnable if triangles.one_sided else gl.glDisable)(gl.GL_CULL_FACE)
    offset = ctypes.c_void_p(4 * triangles.first)
    gl.glDrawElements(gl.GL_TRIANGLES, triangles.count, gl.GL_UNSIGNED_INT, offset)
