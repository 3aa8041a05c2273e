"""A model's geometry on the device, from scene to scene: what of it moves, and where it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse
from ...robots.model import ArticulatedModel, Tiling
from ..scene import box_corners, box_split, rest
from ..types import Camera
from .buffers import Mesh, Piece, Surface, delete_mesh, move_vertices, runs_of, upload
from .context import Program, Programs
from .culling import one_sided_of
from .textures import delete_textures, picture_texture

Posed = Sequence[tuple[Array, Array]]
"""World vertices [V 3] m and normals [V 3] of each visual that deforms, at one instant."""
_WHITE = np.full((1, 1, 4), 255, np.uint8)


class DeviceModel:
    """Holds one model; `begin` says how it moves, `place` where its deforming surfaces are."""

    moving: Sequence[Surface]
    standing: Sequence[Surface]
    """Those with one pose in all frames."""

    def __init__(self, gl: Any) -> None:
        self._gl = gl
        self._mesh: Mesh | None = None
        self._loaded: ArticulatedModel | None = None
        self._projected = np.zeros(0, bool)
        self._corners = list[tuple[int, Array]]()
        self._placed = list[tuple[int, Array]]()
        self._deforming = list[tuple[int, NDArray[np.intp], Array]]()
        self._outward = list[NDArray[np.bool_]]()
        self._cut: dict[int, int] = {}

    @property
    def mesh(self) -> Mesh:
        """After `load`."""
        assert self._mesh is not None
        return self._mesh

    def load(
        self, model: ArticulatedModel, projected: NDArray[np.bool_] | None = None
    ) -> None:
        """Geometry stays on the device from scene to scene.

        `projected` [visuals] says which get box-projected UVs; None: it does not matter.
        """
        if self._loaded is model and projected is None:
            return
        if projected is None:
            projected = np.zeros(len(model.visuals), bool)
        if self._loaded is model and np.array_equal(self._projected, projected):
            return
        if self._loaded is not model:
            self._outward = one_sided_of(model)
            self._parts = [visual.part for visual in model.visuals]
            self._corners = [(visual.part, box_corners(visual.vertices))
                             for visual in model.visuals if not visual.deforms]
            delete_textures(self._gl, list(set(self._cut.values())))
            self._cut = self._cut_textures(model)
            self._at_rest = {k: v.vertices for k, v in enumerate(model.visuals)}
            deforming = [k for k, v in enumerate(model.visuals) if v.deforms]
            if deforming:  # a skin's own frame may have any scale
                found = zip(deforming, rest(model).surfaces(0), strict=True)
                self._at_rest |= {k: vertices for k, (vertices, _) in found}
        delete_mesh(self._gl, self._mesh)
        pieces, self._placed = list[Piece](), list[tuple[int, Array]]()
        self._deforming = list[tuple[int, NDArray[np.intp], Array]]()
        for k, visual in sorted(enumerate(model.visuals), key=lambda item: item[1].part):
            kept, f, uv = np.arange(len(visual.vertices)), visual.faces, visual.uv
            if projected[k]:
                kept, f, uv = box_split(self._at_rest[k], f, 1.0)
            v, n = visual.vertices[kept], visual.normals[kept]
            color = None if visual.color is None else visual.color[kept]
            pieces.append(
                Piece(visual.part, k, v, f, n, uv, self._outward[k], visual.deforms, color))
            if visual.deforms:
                self._deforming.append((k, kept, np.zeros((len(v), 2)) if uv is None else uv))
        self._deforming.sort(key=itemgetter(0))  # the order in which `place` is told them
        self._mesh = upload(self._gl, pieces)
        self._loaded, self._projected = model, projected

    def _cut_textures(self, model: ArticulatedModel) -> dict[int, int]:
        """The texture whose alpha cuts holes into each visual that may have some."""
        made: dict[tuple[int, tuple[Tiling, Tiling]], int] = {}
        found: dict[int, int] = {}
        for k, material in enumerate(v.material for v in model.visuals):
            if material.alpha_cutoff is not None:
                picture = _WHITE if material.texture is None else material.texture
                key = id(picture), material.tiling
                if key not in made:
                    made[key] = picture_texture(self._gl, picture, tiling=material.tiling)
                found[k] = made[key]
        return found

    def begin(self, camera: Camera, world_from_part: Array, bounds: Array | None) -> None:
        """Take in what moves in poses [T P 4 4]; world points `bounds` [N 3] m are around what
        deforms, in all frames.
        """
        self._world_from_cam = camera.world_from_cam
        self._bounds = np.zeros((0, 3)) if bounds is None else bounds
        stands = np.all(world_from_part == world_from_part[:1], axis=(0, 2, 3))
        self.moving = [s for s in self.mesh.surfaces if s.deforms or not stands[s.part]]
        self.standing = [s for s in self.mesh.surfaces if not s.deforms and stands[s.part]]

    def place(self, surfaces: Posed) -> None:
        """Put the surfaces that deform where they are drawn from now on; after `begin`."""
        if not self._deforming:
            return
        # In the camera frame single precision is enough, wherever in the world that is.
        cam_from_world = inverse(self._world_from_cam)
        self._placed = []
        for (k, kept, uv), (vertices, normals) in zip(self._deforming, surfaces, strict=True):
            local = apply(cam_from_world, vertices)
            turned = normals @ cam_from_world[:3, :3].T
            move_vertices(self._gl, self.mesh, k, local[kept], turned[kept], uv)
            self._placed.append((self._parts[k], box_corners(vertices)))

    def pose(self, surface: Surface, world_from_part: Array) -> Array:
        """[4 4] world from the frame that a surface's vertices are in."""
        return self._world_from_cam if surface.deforms else world_from_part[surface.part]

    def box(self, world_from_part: Array) -> Array:
        """Points [N 3] (world) around the model: corners of the visuals' bounding boxes in poses
        [... P 4 4], and the bounds of what deforms.
        """
        poses = world_from_part.reshape(-1, *world_from_part.shape[-3:])
        boxes = [apply(poses[:, part], corners).reshape(-1, 3) for part, corners in self._corners]
        return np.concatenate([self._bounds, *boxes])

    def boxes(self, world_from_part: Array) -> tuple[NDArray[np.intp], Array]:
        """The part [K] and world corners [K 8 3] of boxes around surfaces, from poses [P 4 4]."""
        part = np.array([p for p, _ in [*self._corners, *self._placed]], np.intp)
        local = np.array([c for _, c in self._corners]).reshape(-1, 8, 3)
        placed = np.array([c for _, c in self._placed]).reshape(-1, 8, 3)
        moved = apply(world_from_part[part[:len(local)]], local)
        return part, np.concatenate([moved, placed])

    def draws(
        self, programs: Programs, name: str, surfaces: Sequence[Surface], world_from_part: Array,
        clip_from_world: Array,
    ) -> Iterator[tuple[Program, Surface]]:
        """Surfaces of the model in few draws, each with the program of pass `name` ready to draw
        it: whole ones first, then those in which alpha cuts holes.
        """
        gl = self._gl
        assert self._loaded is not None
        gl.glBindVertexArray(self.mesh.vao)
        whole = runs_of(s for s in surfaces if s.material not in self._cut)
        holed = [s for s in surfaces if s.material in self._cut]
        for cut, chosen in ((False, whole), (True, holed)):
            if not chosen:
                continue
            program = programs.solid(name, cut)
            gl.glUseProgram(program.id)
            for surface in chosen:
                pose = self.pose(surface, world_from_part)
                program.matrix("clip_from_part", clip_from_world @ pose)
                if cut:
                    material = self._loaded.visuals[surface.material].material
                    gl.glActiveTexture(gl.GL_TEXTURE0)
                    gl.glBindTexture(gl.GL_TEXTURE_2D, self._cut[surface.material])
                    gl.glUniform1i(program["picture"], 0)
                    gl.glUniform1f(program["alpha"], material.base_color[3])
                    gl.glUniform1f(program["cutoff"], material.alpha_cutoff)
                yield program, surface
