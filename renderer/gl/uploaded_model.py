"""A model's geometry on the device, and where it is in the frames of a sequence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply
from ...robots.model import ArticulatedModel
from ..scene import PosedModel, box_corners, clip_from_world, rest, split_by_axis
from ..types import Camera
from .buffers import (
    DrawRange,
    Piece,
    VertexArray,
    delete_vertex_array,
    merge_ranges,
    move_vertices,
    upload_pieces,
)
from .context import Program, Programs
from .culling import find_one_sided
from .framebuffers import TextureCache

_WHITE = np.full((1, 1, 4), 255, np.uint8)


@dataclass(frozen=True)
class DeformingPiece:
    """What of a visual that deforms is uploaded again in each frame."""

    visual: int
    kept: NDArray[np.intp]
    """[V] the visual's vertex of each vertex on the device"""
    uv: Array
    """[V 2]"""


@dataclass(frozen=True, eq=False)
class UploadedModel:
    """A model on the device."""

    model: ArticulatedModel
    projected: NDArray[np.bool_]
    """[visuals] whether the UVs come from box projection"""
    array: VertexArray
    one_sided: Sequence[NDArray[np.bool_]]
    """of each visual [F]"""
    rigid: NDArray[np.intp]
    """[R] the part of each rigid visual"""
    boxes: Array
    """[R 8 3] m, corners of the box around each rigid visual in its part's frame"""
    deforming: Sequence[DeformingPiece]
    """in the order of the visuals"""
    cut: Mapping[int, int]
    """the texture whose alpha cuts holes, by visual"""
    textures: TextureCache

    def delete(self, gl: Any) -> None:
        """Free what is on the device."""
        delete_vertex_array(gl, self.array)
        self.textures.delete()


def upload_model(
    gl: Any, model: ArticulatedModel, projected: NDArray[np.bool_] | None,
    previous: UploadedModel | None,
) -> UploadedModel:
    """Return the model on the device, in place of the previous one, which is freed or kept.

    `projected` [visuals] selects box-projected UVs; None means that UVs do not matter.
    """
    same = previous is not None and previous.model is model
    if previous is not None and same and (
            projected is None or np.array_equal(previous.projected, projected)):
        return previous
    if projected is None:
        projected = np.zeros(len(model.visuals), bool)
    if previous is not None:
        previous.delete(gl)
    one_sided = previous.one_sided if previous is not None and same else find_one_sided(model)
    deforming = [k for k, v in enumerate(model.visuals) if v.deforms]
    at_rest = {k: v.vertices for k, v in enumerate(model.visuals)}
    if deforming:  # a skin's own frame may have any scale
        found = zip(deforming, rest(model).surfaces(0), strict=True)
        at_rest |= {k: vertices for k, (vertices, _) in found}
    pieces, moving = list[Piece](), dict[int, DeformingPiece]()
    for k, visual in sorted(enumerate(model.visuals), key=lambda item: item[1].part):
        kept, faces, uv = np.arange(len(visual.vertices)), visual.faces, visual.uv
        if projected[k]:
            kept, faces, uv = split_by_axis(at_rest[k], faces, 1.0)
        color = None if visual.color is None else visual.color[kept]
        pieces.append(Piece(visual.part, k, visual.vertices[kept], faces, visual.normals[kept], uv,
                            one_sided[k], visual.deforms, color))
        moving[k] = DeformingPiece(k, kept, np.zeros((len(kept), 2)) if uv is None else uv)
    rigid = [v for v in model.visuals if not v.deforms]
    boxes = np.array([box_corners(v.vertices) for v in rigid]).reshape(-1, 8, 3)
    textures = TextureCache(gl)
    cut = {k: textures.texture(_WHITE if m.texture is None else m.texture, m.tiling)
           for k, m in enumerate(v.material for v in model.visuals) if m.alpha_cutoff is not None}
    return UploadedModel(model, projected, upload_pieces(gl, pieces), one_sided,
                         np.array([v.part for v in rigid], np.intp), boxes,
                         [moving[k] for k in deforming], cut, textures)


@dataclass(frozen=True, eq=False)
class Shot:
    """A model on the device over T frames, seen by one camera."""

    uploaded: UploadedModel
    posed: PosedModel
    camera: Camera
    around: Array
    """[N 3] m, further world points that the clip space encloses"""

    @cached_property
    def clip_from_world(self) -> Array:
        """[4 4] encloses everything in all frames."""
        return clip_from_world(self.camera, np.concatenate([self.box(), self.around]))

    @cached_property
    def moving_ranges(self) -> list[DrawRange]:
        """Ranges that move or deform."""
        return [r for r in self.uploaded.array.ranges if r.deforms or not self._is_static[r.part]]

    @cached_property
    def static_ranges(self) -> list[DrawRange]:
        """Ranges with one pose in all frames."""
        return [r for r in self.uploaded.array.ranges if not r.deforms and self._is_static[r.part]]

    @cached_property
    def _is_static(self) -> NDArray[np.bool_]:
        poses = self.posed.world_from_part
        return np.all(poses == poses[:1], axis=(0, 2, 3))

    def box(self, t: int | None = None) -> Array:
        """World points [N 3] m around the model in frame t (default: all frames), and around
        what deforms in all frames.
        """
        poses = self.posed.world_from_part[slice(None) if t is None else slice(t, t + 1)]
        boxes = apply(poses[:, self.uploaded.rigid], self.uploaded.boxes)
        return np.concatenate([self.posed.bounds, boxes.reshape(-1, 3)])

    def boxes(self, t: int) -> tuple[NDArray[np.intp], Array]:
        """The part [K] and world corners [K 8 3] m of the box around each visual in frame t."""
        rigid, deforming = self.uploaded.rigid, self.posed.deforming
        boxes = apply(self.posed.world_from_part[t, rigid], self.uploaded.boxes)
        more = [box_corners(vertices) for vertices, _ in self.posed.surfaces(t)]
        part = np.concatenate([rigid, np.array([v.part for v in deforming], np.intp)])
        return part, np.concatenate([boxes, np.array(more).reshape(-1, 8, 3)])

    def place(self, gl: Any, t: int) -> None:
        """Upload the vertices that deform, of frame t, in the camera frame: there single
        precision suffices wherever in the world the camera is.
        """
        cam_from_world = self.camera.cam_from_world
        for piece, (vertices, normals) in zip(
                self.uploaded.deforming, self.posed.surfaces(t), strict=True):
            local, turned = apply(cam_from_world, vertices), normals @ cam_from_world[:3, :3].T
            move_vertices(gl, self.uploaded.array, piece.visual, local[piece.kept],
                          turned[piece.kept], piece.uv)

    def pose(self, triangles: DrawRange, t: int) -> Array:
        """[4 4] world from the frame that the vertices of a range are in."""
        poses = self.posed.world_from_part
        return self.camera.world_from_cam if triangles.deforms else poses[t, triangles.part]

    def draws(
        self, programs: Programs, name: str, ranges: Sequence[DrawRange], t: int,
        clip_from_world: Array,
    ) -> Iterator[tuple[Program, DrawRange]]:
        """Ranges in few draws, each with the program of pass `name` ready to draw it: whole ones
        first, then those in which alpha cuts holes.
        """
        gl, cut_textures = programs.gl, self.uploaded.cut
        gl.glBindVertexArray(self.uploaded.array.id)
        whole = merge_ranges(r for r in ranges if r.material not in cut_textures)
        holed = [r for r in ranges if r.material in cut_textures]
        for cut, members in ((False, whole), (True, holed)):
            if not members:
                continue
            program = programs.solid(name, cut)
            gl.glUseProgram(program.id)
            for r in members:
                program.matrix("clip_from_part", clip_from_world @ self.pose(r, t))
                if cut:
                    material = self.uploaded.model.visuals[r.material].material
                    gl.glActiveTexture(gl.GL_TEXTURE0)
                    gl.glBindTexture(gl.GL_TEXTURE_2D, cut_textures[r.material])
                    gl.glUniform1i(program["picture"], 0)
                    gl.glUniform1f(program["alpha"], material.base_color[3])
                    gl.glUniform1f(program["cutoff"], material.alpha_cutoff)
                yield program, r
