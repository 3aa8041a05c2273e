"""Draws a scene's frames: the truth of its geometry, and its colours.

One vertex buffer holds the whole model, and everything that does not move is drawn once a sequence
into a layer that each frame starts from. Depth and part numbers come from their own pass, into
float32 and integer targets without multisampling, so that no value is ever a mixture of two
surfaces. Colours are drawn finer and averaged: on a CPU that is half the price of multisampling,
and smooths shading as well as edges.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import itemgetter

import cv2
import numpy as np
from numpy.typing import NDArray

from ..robots.geometry import Array, apply, inverse
from ..robots.model import ArticulatedModel, Material, Tiling
from .buffers import (
    Mesh,
    Piece,
    Surface,
    delete_mesh,
    draw_surface,
    move_vertices,
    runs_of,
    upload,
)
from .camera import Camera
from .culling import one_sided_of
from .gl import Context, Look, NoRendererError, Program, Programs, Target, look_of
from .gl_textures import SHADOW_SIZE, picture_texture, shadow_texture
from .posed import rest
from .projection import box_corners, clip_from_light, clip_from_world
from .scene import Scene
from .uv import box_split

Posed = Sequence[tuple[Array, Array]]
"""World vertices [V 3] m and normals [V 3] of each visual that deforms, at one instant."""


class Rasterizer:
    """Draws one scene after another at one image size. One per process (lessons 18).

    With `faces`, the truth tells the triangle of each pixel too. Surfaces that deform are drawn
    where `place` put them last.
    """

    def __init__(self, width: int, height: int, finer: int = 2, faces: bool = False) -> None:
        self.context = Context()
        self._gl = gl = self.context.gl
        self.width, self.height = width, height
        self._finer = finer
        size = (width * finer, height * finer)
        most = int(gl.glGetIntegerv(gl.GL_MAX_RENDERBUFFER_SIZE))
        if max(size) > most:
            raise NoRendererError(f"images of {width} x {height} are too large here: "
                                  f"the driver draws at most {most // finer} px a side")
        color, truth = [gl.GL_RGBA8], [gl.GL_R32F, gl.GL_R16UI, *([gl.GL_R32UI] * faces)]
        self._color = Target(gl, *size, color, gl.GL_DEPTH_COMPONENT24)
        self._color_still = Target(gl, *size, color, gl.GL_DEPTH_COMPONENT24)
        self._truth = Target(gl, width, height, truth, gl.GL_DEPTH_COMPONENT32F)
        self._truth_still = Target(gl, width, height, truth, gl.GL_DEPTH_COMPONENT32F)
        self._covered = Target(gl, width, height, color, None)
        self._samples = np.empty((height * finer, width * finer, 4), np.uint8)
        self.faces = faces
        self._programs = Programs(gl, faces)
        self._empty_vao = int(gl.glGenVertexArrays(1))
        self._model: Mesh | None = None
        self._loaded: ArticulatedModel | None = None
        self._projected = np.zeros(0, bool)
        self._corners = list[tuple[int, Array]]()
        self._placed = list[tuple[int, Array]]()
        self._deforming = list[tuple[int, NDArray[np.intp], Array]]()
        self._outward = list[NDArray[np.bool_]]()
        self._room: Mesh | None = None
        self._scene_textures: dict[tuple[int, tuple[Tiling, Tiling]], int] = {}
        self._shadow_textures: list[int] = []
        self._cut: dict[int, int] = {}
        self._shadow = Target(gl, SHADOW_SIZE, SHADOW_SIZE, [], None)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glCullFace(gl.GL_BACK)
        gl.glDisable(gl.GL_DITHER)
        gl.glFrontFace(gl.GL_CW)
        gl.glVertexAttrib4f(3, 1.0, 1.0, 1.0, 1.0)  # of meshes without vertex colours
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
        gl.glPixelStorei(gl.GL_UNPACK_ALIGNMENT, 1)

    # -- geometry: truth ----------------------------------------------------------------------

    def begin_truth(
        self, model: ArticulatedModel, camera: Camera, world_from_part: Array,
        bounds: Array | None = None,
    ) -> None:
        """Draw the parts that stand still in all frames; world_from_part [T P 4 4].

        World points `bounds` [N 3] m are around what deforms, in all frames.
        """
        self._upload_model(model)
        self._split_by_motion(world_from_part)
        self._world_from_cam = camera.world_from_cam
        self._bounds = np.zeros((0, 3)) if bounds is None else bounds
        self._clip_from_world = clip_from_world(camera, self._box(world_from_part))
        self._truth_still.bind()
        self._clear_truth()
        self._draw_truth(world_from_part[0], self._standing)

    def place(self, surfaces: Posed) -> None:
        """Put the surfaces that deform where they are drawn from now on; after `begin_truth`."""
        if not self._deforming:
            return
        assert self._model is not None
        # In the camera frame single precision is enough, wherever in the world that is.
        cam_from_world = inverse(self._world_from_cam)
        self._placed = []
        for (k, kept, uv), (vertices, normals) in zip(self._deforming, surfaces, strict=True):
            local = apply(cam_from_world, vertices)
            turned = normals @ cam_from_world[:3, :3].T
            move_vertices(self._gl, self._model, k, local[kept], turned[kept], uv)
            self._placed.append((self._parts[k], box_corners(vertices)))

    def truth(self, world_from_part: Array) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Depth [H W] m (0: none) and part [H W] of the model alone, from part poses [P 4 4]."""
        self.draw_truth(world_from_part)
        return self.read_truth()

    def draw_truth(self, world_from_part: Array) -> None:
        """Begin to draw what `read_truth` gives.

        The software rasterizer works in threads of its own: what is drawn before something is
        read goes on meanwhile.
        """
        self._truth_still.copy_to(self._truth)
        self._truth.bind()
        self._draw_truth(world_from_part, self._moving)
        self._gl.glFlush()

    def read_truth(self) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
        """Depth [H W] m (0: none) and part [H W] of the model alone."""
        return self._read_depth(), self._read_part()

    def read_faces(self) -> NDArray[np.int32]:
        """[H W] number of the triangle that `read_truth` tells of, through all visuals; -1: none.

        After `room_depth`, through the room's surfaces.
        """
        drawn = np.empty((self.height, self.width), np.uint32)
        self._truth.read(2, self._gl.GL_RED_INTEGER, self._gl.GL_UNSIGNED_INT, drawn)
        numbers = np.concatenate([np.array([-1]), self._drawn.order]).astype(np.int32)
        return numbers[drawn]

    def room_depth(self) -> NDArray[np.float32]:
        """Depth [H W] m of the current scene's room alone; 0 where there is none."""
        self._truth.bind()
        self._clear_truth()
        if self._room is not None:
            gl, program = self._gl, self._programs.truth
            gl.glUseProgram(program.id)
            gl.glBindVertexArray(self._room.vao)
            program.matrix("clip_from_part", self._clip_from_world)
            gl.glUniform1ui(program["part"], 0)
            self._drawn = self._room
            for surface in runs_of(self._room.surfaces):
                gl.glUniform1ui(program["first_face"], surface.first // 3)
                draw_surface(gl, surface)
        return self._read_depth()

    def outlines(self, camera: Camera, world_from_part: Array) -> NDArray[np.int64]:
        """[P 4] px: a box that holds each part of the model in the image, from poses [P 4 4].

        First column and row, and those after the last; parts without a surface have none.
        """
        out = np.zeros((len(world_from_part), 4), np.int64)
        whole = np.array([0, 0, self.width, self.height])
        found = [(part, apply(world_from_part[part], c)) for part, c in self._corners]
        found += self._placed
        for part in {part for part, _ in found}:
            uv = camera.project(np.concatenate([c for p, c in found if p == part]))
            if uv[:, 2].min() <= 0:
                out[part] = whole
                continue
            low, high = np.floor(uv[:, :2].min(0)) - 1, np.ceil(uv[:, :2].max(0)) + 2
            out[part] = np.clip(np.concatenate([low, high]), 0, np.tile(whole[2:], 2))
        return out

    # -- appearance: colours ------------------------------------------------------------------

    def begin_color(
        self, scene: Scene, world_from_part: Array, bounds: Array | None = None
    ) -> None:
        """Take a scene in and draw what stands still in all frames (see `begin_truth`)."""
        gl = self._gl
        self._forget_scene()
        self._scene = scene
        self._upload_model(scene.model, scene.texture_size > 0)
        self._split_by_motion(world_from_part)
        self._world_from_cam = scene.camera.world_from_cam
        self._bounds = np.zeros((0, 3)) if bounds is None else bounds
        if scene.shadows:  # a moving shadow falls on what stands still
            self._moving, self._standing = [*self._standing, *self._moving], []
        self._room = upload(gl, [
            Piece(-1, k, s.vertices, s.faces, s.normals, s.uv, np.zeros(len(s.faces), bool))
            for k, s in enumerate(scene.room)
        ])
        self._looks = [
            look_of(m, v.color is not None and size == 0)  # a drawn texture replaces all colour
            for m, v, size in zip(scene.materials, scene.model.visuals, scene.texture_size,
                                  strict=True)
        ]
        self._room_materials = [
            Material(s.name, (*s.base_color, 1.0), 0.0, s.roughness, s.texture) for s in scene.room
        ]
        self._room_looks = [look_of(m) for m in self._room_materials]
        self._shadow_textures = [shadow_texture(gl) for _ in scene.lights if scene.shadows]
        points = np.concatenate([self._box(world_from_part), *(s.vertices for s in scene.room)])
        self._clip_from_world = clip_from_world(scene.camera, points)

        self._color_still.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 1.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        if scene.backdrop is not None:
            self._draw_backdrop(scene.backdrop)
        if not scene.shadows:
            self._shade(world_from_part[0], self._standing, room=True)

    def draw_color(self, world_from_part: Array) -> None:
        """Begin to draw the colours of one frame from part poses [P 4 4] (see `draw_truth`)."""
        if self._scene.shadows:
            self._draw_shadows(world_from_part)
        self._color_still.copy_to(self._color)
        self._color.bind()
        self._shade(world_from_part, self._moving, room=self._scene.shadows)
        self._gl.glFlush()

    def read_color(self) -> NDArray[np.uint8]:
        """RGB [H W 3] of the frame that `draw_color` began."""
        gl, rgba = self._gl, self._samples
        self._color.read(0, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, rgba)
        if self._finer > 1:
            size = (self.width, self.height)
            rgba = cv2.resize(rgba, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), np.uint8)

    def draw_coverage(
        self, world_from_part: Array, group: NDArray[np.int64], where: NDArray[np.int64]
    ) -> None:
        """Begin to draw what `read_coverage` gives; `begin_truth` was before it.

        Poses are [P 4 4], `group` [P] is 0..31, or -1 for parts that are left out. Each part is
        drawn in its box `where` [P 4] px alone: first column and row, and those after the last.
        """
        gl = self._gl
        assert self._model is not None
        self._covered.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 0.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT)
        gl.glDisable(gl.GL_DEPTH_TEST)
        gl.glEnable(gl.GL_COLOR_LOGIC_OP)
        gl.glLogicOp(gl.GL_OR)
        gl.glEnable(gl.GL_SCISSOR_TEST)
        boxes = np.concatenate([where[:, :2], where[:, 2:] - where[:, :2]], axis=1)
        drawn = (group >= 0) & (boxes[:, 2:] > 0).all(1)
        surfaces = [s for s in self._model.surfaces if drawn[s.part]]
        for program, surface in self._solid("coverage", surfaces, world_from_part,
                                            self._clip_from_world):
            gl.glScissor(*boxes[surface.part].tolist())  # row 0 is OpenGL's lowest, too
            channel, bit = divmod(int(group[surface.part]), 8)
            gl.glUniform4f(program["bits"], *((1 << bit) / 255.0 * np.eye(4)[channel]))
            draw_surface(gl, surface)
        gl.glDisable(gl.GL_SCISSOR_TEST)
        gl.glDisable(gl.GL_COLOR_LOGIC_OP)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glFlush()

    def read_coverage(self) -> NDArray[np.uint32]:
        """[H W] bits: bit g is set where a part of group g would be seen with nothing before it
        (and its box allows).
        """
        gl = self._gl
        rgba = np.empty((self.height, self.width, 4), np.uint8)
        self._covered.read(0, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, rgba)
        return rgba.view("<u4")[..., 0]

    def close(self) -> None:
        """Free everything that OpenGL holds."""
        self._forget_scene()
        self.context.close()

    # -- passes -------------------------------------------------------------------------------

    def _clear_truth(self) -> None:
        gl = self._gl
        gl.glClearBufferfv(gl.GL_COLOR, 0, np.zeros(4, np.float32))
        for target in (1, 2)[: 1 + self.faces]:
            gl.glClearBufferuiv(gl.GL_COLOR, target, np.zeros(4, np.uint32))
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)

    def _draw_truth(self, world_from_part: Array, surfaces: Sequence[Surface]) -> None:
        gl = self._gl
        assert self._model is not None
        self._drawn = self._model
        for program, surface in self._solid("truth", surfaces, world_from_part,
                                            self._clip_from_world):
            gl.glUniform1ui(program["part"], surface.part + 1)
            gl.glUniform1ui(program["first_face"], surface.first // 3)
            draw_surface(gl, surface)

    def _solid(
        self, name: str, surfaces: Sequence[Surface], world_from_part: Array, clip_from_world: Array
    ) -> Iterator[tuple[Program, Surface]]:
        """The model's surfaces in few draws, each with the pass's program ready to draw it:
        whole ones first, then those in which alpha cuts holes.
        """
        gl = self._gl
        assert self._model is not None and self._loaded is not None
        gl.glBindVertexArray(self._model.vao)
        whole = runs_of(s for s in surfaces if s.material not in self._cut)
        holed = [s for s in surfaces if s.material in self._cut]
        for cut, chosen in ((False, whole), (True, holed)):
            if not chosen:
                continue
            program = self._programs.solid(name, cut)
            gl.glUseProgram(program.id)
            for surface in chosen:
                pose = self._pose(surface, world_from_part)
                program.matrix("clip_from_part", clip_from_world @ pose)
                if cut:
                    material = self._loaded.visuals[surface.material].material
                    gl.glActiveTexture(gl.GL_TEXTURE0)
                    gl.glBindTexture(gl.GL_TEXTURE_2D, self._cut[surface.material])
                    gl.glUniform1i(program["picture"], 0)
                    gl.glUniform1f(program["alpha"], material.base_color[3])
                    gl.glUniform1f(program["cutoff"], material.alpha_cutoff)
                yield program, surface

    def _pose(self, surface: Surface, world_from_part: Array) -> Array:
        """[4 4] world from the frame that a surface's vertices are in."""
        return self._world_from_cam if surface.deforms else world_from_part[surface.part]

    def _read_depth(self) -> NDArray[np.float32]:
        depth = np.empty((self.height, self.width), np.float32)
        self._truth.read(0, self._gl.GL_RED, self._gl.GL_FLOAT, depth)
        return depth

    def _read_part(self) -> NDArray[np.uint16]:
        part = np.empty((self.height, self.width), np.uint16)
        self._truth.read(1, self._gl.GL_RED_INTEGER, self._gl.GL_UNSIGNED_SHORT, part)
        return part

    def _shade(self, world_from_part: Array, surfaces: Sequence[Surface], room: bool) -> None:
        """Draw colours: opaque surfaces, then transparent ones from far to near."""
        assert self._model is not None
        scene = self._scene
        if room and self._room is not None:
            self._gl.glBindVertexArray(self._room.vao)
            for s in self._room.surfaces:
                material = self._room_materials[s.material]
                self._shade_one(s, np.eye(4), material, self._room_looks[s.material], 1.0)
        if not surfaces:
            return
        self._gl.glBindVertexArray(self._model.vao)
        eye = scene.camera.world_from_cam[:3, 3]

        def far_first(s: Surface) -> float:
            """Opaque surfaces before all others; those from far to near."""
            if not scene.materials[s.material].transparent:
                return -np.inf
            return -float(np.linalg.norm(world_from_part[s.part][:3, 3] - eye))

        for s in sorted(surfaces, key=far_first):
            size = scene.texture_size[s.material]
            self._shade_one(
                s, self._pose(s, world_from_part), scene.materials[s.material],
                self._looks[s.material], 1.0 / size if size > 0 else 1.0,
            )

    def _shade_one(
        self, surface: Surface, pose: Array, material: Material, look: Look, uv_scale: float
    ) -> None:
        gl, scene = self._gl, self._scene
        program = self._programs.surface(look, len(scene.lights), scene.shadows)
        gl.glUseProgram(program.id)
        if program.scene is not scene:
            program.scene = scene
            self._set_lights(program)
        program.matrix("clip_from_part", self._clip_from_world @ pose)
        program.matrix("world_from_part", pose)
        gl.glUniform2f(program["uv_scale"], uv_scale, uv_scale)
        gl.glUniform4f(program["material.base_color_factor"], *material.base_color)
        gl.glUniform1f(program["material.metallic_factor"], material.metallic)
        gl.glUniform1f(program["material.roughness_factor"], material.roughness)
        gl.glUniform3f(program["material.emissive_factor"], *material.emission)
        if material.alpha_cutoff is not None:
            gl.glUniform1f(program["alpha_cutoff"], material.alpha_cutoff)
        textures = [(unit, self._texture(picture, material.tiling)) for unit, picture
                    in zip(_UNITS.values(), _pictures(material), strict=True)
                    if picture is not None]
        for unit, texture in textures:  # once all are made: making one binds it
            gl.glActiveTexture(gl.GL_TEXTURE0 + unit)
            gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        if material.transparent:
            gl.glEnable(gl.GL_BLEND)
            gl.glBlendFunc(gl.GL_SRC_ALPHA, gl.GL_ONE_MINUS_SRC_ALPHA)
        draw_surface(gl, surface)
        if material.transparent:
            gl.glDisable(gl.GL_BLEND)

    def _set_lights(self, program: Program) -> None:
        gl, scene = self._gl, self._scene
        gl.glUniform3f(program["cam_pos"], *scene.camera.world_from_cam[:3, 3])
        gl.glUniform3f(program["ambient_light"], *[scene.ambient] * 3)
        for name, unit in _UNITS.items():
            gl.glUniform1i(program[f"material.{name}_texture"], unit)
        for k, light in enumerate(scene.lights):
            name = f"directional_lights[{k}]."
            gl.glUniform3f(program[name + "direction"], *light.direction)
            gl.glUniform3f(program[name + "color"], *light.color)
            gl.glUniform1f(program[name + "intensity"], light.intensity)

    def _draw_backdrop(self, picture: NDArray[np.uint8]) -> None:
        gl = self._gl
        texture = picture_texture(gl, picture[::-1], repeat=False)  # it turns them upside down
        gl.glUseProgram(self._programs.backdrop.id)
        gl.glUniform1i(self._programs.backdrop["picture"], 0)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        gl.glDepthMask(gl.GL_FALSE)
        gl.glDisable(gl.GL_DEPTH_TEST)
        gl.glDisable(gl.GL_CULL_FACE)  # left by whatever was drawn before
        gl.glBindVertexArray(self._empty_vao)
        gl.glDrawArrays(gl.GL_TRIANGLES, 0, 3)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthMask(gl.GL_TRUE)
        gl.glDeleteTextures(1, [texture])

    def _draw_shadows(self, world_from_part: Array) -> None:
        """Depth seen from each light into its map. Walls throw no shadow: light passes them."""
        gl, scene = self._gl, self._scene
        assert self._model is not None
        points = self._box(world_from_part)
        # pyrender's shader looks up to two texels aside on both axes: a surface that slopes away
        # from the light must lie that much deeper, or it shades itself.
        gl.glEnable(gl.GL_POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(4.0, 4.0)
        for k, light in enumerate(scene.lights):
            clip_from_world = clip_from_light(light, points)
            self._shadow.bind_depth(self._shadow_textures[k])
            gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
            for _, surface in self._solid("truth", self._model.surfaces, world_from_part,
                                          clip_from_world):
                # A light's clip space has the other handedness: front faces would be left out.
                draw_surface(gl, replace(surface, one_sided=False))
            for look in {*self._looks, *self._room_looks}:
                program = self._programs.surface(look, len(scene.lights), True)
                gl.glUseProgram(program.id)
                name = f"directional_lights[{k}]."
                program.matrix(name + "light_matrix", clip_from_world)
                gl.glUniform1i(program[name + "shadow_map"], 1 + k)
            gl.glActiveTexture(gl.GL_TEXTURE0 + 1 + k)
            gl.glBindTexture(gl.GL_TEXTURE_2D, self._shadow_textures[k])
        gl.glDisable(gl.GL_POLYGON_OFFSET_FILL)

    # -- what lives on the device -------------------------------------------------------------

    def _split_by_motion(self, world_from_part: Array) -> None:
        """Which surfaces have one pose in all frames [T P 4 4], and which move."""
        assert self._model is not None
        stands = np.all(world_from_part == world_from_part[:1], axis=(0, 2, 3))
        self._moving = [s for s in self._model.surfaces if s.deforms or not stands[s.part]]
        self._standing = [s for s in self._model.surfaces if not s.deforms and stands[s.part]]

    def _box(self, world_from_part: Array) -> Array:
        """Points [N 3] (world) around the model: corners of the visuals' bounding boxes in poses
        [... P 4 4], and the bounds of what deforms.
        """
        poses = world_from_part.reshape(-1, *world_from_part.shape[-3:])
        boxes = [apply(poses[:, part], corners).reshape(-1, 3) for part, corners in self._corners]
        return np.concatenate([self._bounds, *boxes])

    def _upload_model(
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
            self._delete_textures(list(set(self._cut.values())))
            self._cut = self._cut_textures(model)
            self._at_rest = {k: v.vertices for k, v in enumerate(model.visuals)}
            deforming = [k for k, v in enumerate(model.visuals) if v.deforms]
            if deforming:  # a skin's own frame may have any scale
                found = zip(deforming, rest(model).surfaces(0), strict=True)
                self._at_rest |= {k: vertices for k, (vertices, _) in found}
        delete_mesh(self._gl, self._model)
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
        self._model = upload(self._gl, pieces)
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

    def _texture(self, picture: NDArray[np.uint8], tiling: tuple[Tiling, Tiling]) -> int:
        """The texture of a picture that goes with the scene, made when first asked for."""
        key = id(picture), tiling  # the scene holds the picture: its id stays its own
        if key not in self._scene_textures:
            self._scene_textures[key] = picture_texture(self._gl, picture, tiling=tiling)
        return self._scene_textures[key]

    def _forget_scene(self) -> None:
        self._delete_textures([*self._scene_textures.values(), *self._shadow_textures])
        self._scene_textures, self._shadow_textures = {}, []
        delete_mesh(self._gl, self._room)
        self._room = None

    def _delete_textures(self, textures: Sequence[int]) -> None:
        if textures:
            self._gl.glDeleteTextures(len(textures), list(textures))


_WHITE = np.full((1, 1, 4), 255, np.uint8)
_UNITS = {"base_color": 0, "metallic_roughness": 9, "normal": 10, "occlusion": 11, "emissive": 12}
"""Texture units by pyrender's names; shadow maps take those between."""


def _pictures(material: Material) -> tuple[NDArray[np.uint8] | None, ...]:
    """The textures of a material in the order of their units."""
    maps = material.maps
    return (material.texture, maps.metallic_roughness, maps.normal, maps.occlusion, maps.emission)
