"""The one module that touches OpenGL.

pyrender gives the EGL platform and the physically based shading (its mesh.frag, unchanged but for
two-sided normals); the drawing is ours: one vertex buffer for the whole model, locations looked up
once, and everything that does not move drawn once a sequence into a layer that each frame starts
from. Depth and part numbers come from their own pass, into float32 and integer targets without
multisampling, so that no value is ever a mixture of two surfaces.

OpenGL's pixel centres lie at j + 0.5; `_clip_from_cam` is the place where ours (at j) become them.
Images come out with row 0 on top because the projection draws them upside down, which also turns
counter-clockwise triangles clockwise (`glFrontFace`).
"""

# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .. import GcbenchError
from ..robots.geometry import Array, apply
from ..robots.model import ArticulatedModel, Material, Visual
from .camera import Camera
from .culling import one_sided
from .scene import Light, Scene
from .uv import box_projection

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyrender loads pyglet, which would load X11

_SHADOW_SIZE = 2048
_HERE = Path(__file__).parent


class NoRendererError(GcbenchError):
    """No EGL device of this machine can draw."""


@dataclass(frozen=True)
class Surface:
    """Triangles that are drawn with one material and one pose."""

    part: int
    """0-based part, -1 for what stands in the world (the room)."""
    material: int
    """Number of the visual (or of the room's surface) that it belongs to."""
    one_sided: bool
    """Back faces are never seen and are left out."""
    first: int
    """First index in the index buffer."""
    count: int


@dataclass(frozen=True)
class Mesh:
    """A vertex array object and the surfaces in it."""

    vao: int
    buffers: tuple[int, int]
    surfaces: tuple[Surface, ...]


class Context:
    """An EGL context on the first device that really draws; a GPU is tried before software.

    `EGL_DEVICE_ID` chooses a device by number. Raises NoRendererError with each device's reason.
    """

    def __init__(self) -> None:
        try:
            from pyrender.platforms import egl
        except Exception as error:
            why = f"EGL cannot be loaded ({_one_line(error)})"
            raise NoRendererError(f"{why}; {_INSTALL}") from None
        tried: list[str] = []
        for number, device in _devices(egl):
            try:
                self._platform: Any = egl.EGLPlatform(1, 1, device)
                self._platform.init_context()
                from OpenGL import GL

                self.gl: Any = GL
                self.renderer = str(self.gl.glGetString(GL.GL_RENDERER).decode())
                self.version = str(self.gl.glGetString(GL.GL_VERSION).decode())
                self.device = number
            except Exception as error:
                tried.append(f"device {number}: {_one_line(error)}")
                continue
            return
        reasons = "; ".join(tried) or "EGL reports no device"
        raise NoRendererError(f"no EGL device can draw ({reasons}); {_INSTALL}")

    def close(self) -> None:
        """Give the context back; the display stays, as other contexts of the process share it."""
        from OpenGL import EGL

        platform = self._platform
        if platform._egl_context is not None:
            EGL.eglMakeCurrent(
                platform._egl_display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
            )
            EGL.eglDestroyContext(platform._egl_display, platform._egl_context)
            platform._egl_context = platform._egl_display = None


def device_names() -> list[str]:
    """Every EGL device with its device file, in the order in which they are tried."""
    try:
        from pyrender.platforms import egl

        found = _devices(egl)
    except Exception as error:
        raise NoRendererError(f"EGL cannot be loaded ({_one_line(error)}); {_INSTALL}") from None
    return [f"device {i}: {device.name or 'software (Mesa)'}" for i, device in found]


_INSTALL = "on Debian or Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri"


def _devices(egl: Any) -> list[tuple[int, Any]]:
    """EGL devices with their numbers: those with a device file (GPUs) first."""
    devices = list(enumerate(egl.query_devices()))
    wanted = os.environ.get("EGL_DEVICE_ID", "")
    if wanted:
        devices = [(i, d) for i, d in devices if str(i) == wanted]
    return sorted(devices, key=lambda item: item[1].name is None)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or "no reason given"
    return f"{type(error).__name__}: {text[:200]}"


class Rasterizer:
    """Draws one scene after another at one image size. One per process (lessons 18)."""

    def __init__(self, width: int, height: int, finer: int = 2) -> None:
        self.context = Context()
        self._gl = gl = self.context.gl
        self.width, self.height = width, height
        self._finer = finer
        size = (width * finer, height * finer)
        most = int(gl.glGetIntegerv(gl.GL_MAX_RENDERBUFFER_SIZE))
        if max(size) > most:
            raise NoRendererError(f"images of {width} x {height} are too large here: "
                                  f"the driver draws at most {most // finer} px a side")
        color, truth = [gl.GL_RGBA8], [gl.GL_R32F, gl.GL_R16UI]
        self._color = _Target(gl, *size, color, gl.GL_DEPTH_COMPONENT24)
        self._color_still = _Target(gl, *size, color, gl.GL_DEPTH_COMPONENT24)
        self._truth = _Target(gl, width, height, truth, gl.GL_DEPTH_COMPONENT32F)
        self._truth_still = _Target(gl, width, height, truth, gl.GL_DEPTH_COMPONENT32F)
        self._covered = _Target(gl, width, height, color, None)
        self._samples = np.empty((height * finer, width * finer, 4), np.uint8)
        self._programs = _Programs(gl)
        self._empty_vao = int(gl.glGenVertexArrays(1))
        self._model: Mesh | None = None
        self._loaded: ArticulatedModel | None = None
        self._projected = np.zeros(0, bool)
        self._corners = list[tuple[int, Array]]()
        self._outward = list[NDArray[np.bool_]]()
        self._room: Mesh | None = None
        self._scene_textures: list[int] = []
        self._shadow = _Target(gl, _SHADOW_SIZE, _SHADOW_SIZE, [], None)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glCullFace(gl.GL_BACK)
        gl.glDisable(gl.GL_DITHER)
        gl.glFrontFace(gl.GL_CW)
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)
        gl.glPixelStorei(gl.GL_UNPACK_ALIGNMENT, 1)

    # -- geometry: truth ----------------------------------------------------------------------

    def begin_truth(self, model: ArticulatedModel, camera: Camera, world_from_part: Array) -> None:
        """Draw the parts that stand still in all frames; world_from_part [T P 4 4]."""
        self._upload_model(model)
        self._split_by_motion(world_from_part)
        self._clip_from_world = _clip_from_world(camera, self._box(world_from_part))
        self._truth_still.bind()
        self._clear_truth()
        self._draw_truth(world_from_part[0], self._standing)

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
            for surface in _runs(self._room.surfaces):
                _draw(gl, surface)
        return self._read_depth()

    def outlines(self, camera: Camera, world_from_part: Array) -> NDArray[np.int64]:
        """[P 4] px: a box that holds each part of the model in the image, from poses [P 4 4].

        First column and row, and those after the last; parts without a surface have none.
        """
        out = np.zeros((len(world_from_part), 4), np.int64)
        whole = np.array([0, 0, self.width, self.height])
        for part in {part for part, _ in self._corners}:
            corners = np.concatenate([c for p, c in self._corners if p == part])
            uv = camera.project(apply(world_from_part[part], corners))
            if uv[:, 2].min() <= 0:
                out[part] = whole
                continue
            low, high = np.floor(uv[:, :2].min(0)) - 1, np.ceil(uv[:, :2].max(0)) + 2
            out[part] = np.clip(np.concatenate([low, high]), 0, np.tile(whole[2:], 2))
        return out

    # -- appearance: colours ------------------------------------------------------------------

    def begin_color(self, scene: Scene, world_from_part: Array) -> None:
        """Take a scene in and draw what stands still in all frames; world_from_part [T P 4 4]."""
        gl = self._gl
        self._forget_scene()
        self._scene = scene
        self._upload_model(scene.model, scene.texture_size > 0)
        self._split_by_motion(world_from_part)
        if scene.shadows:  # a moving shadow falls on what stands still
            self._moving, self._standing = [*self._standing, *self._moving], []
        self._room = self._upload([
            _Piece(-1, k, s.vertices, s.faces, s.normals, s.uv, np.zeros(len(s.faces), bool))
            for k, s in enumerate(scene.room)
        ])
        self._textures = [self._texture(m.texture) for m in scene.materials]
        self._room_materials = [
            Material(s.name, (*s.base_color, 1.0), 0.0, s.roughness, s.texture) for s in scene.room
        ]
        self._room_textures = [self._texture(m.texture) for m in self._room_materials]
        self._shadow_textures = [self._shadow_texture() for _ in scene.lights if scene.shadows]
        points = np.concatenate([self._box(world_from_part), *(s.vertices for s in scene.room)])
        self._clip_from_world = _clip_from_world(scene.camera, points)

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
        gl, program = self._gl, self._programs.coverage
        assert self._model is not None
        self._covered.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 0.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT)
        gl.glDisable(gl.GL_DEPTH_TEST)
        gl.glEnable(gl.GL_COLOR_LOGIC_OP)
        gl.glLogicOp(gl.GL_OR)
        gl.glEnable(gl.GL_SCISSOR_TEST)
        gl.glUseProgram(program.id)
        gl.glBindVertexArray(self._model.vao)
        boxes = np.concatenate([where[:, :2], where[:, 2:] - where[:, :2]], axis=1)
        drawn = (group >= 0) & (boxes[:, 2:] > 0).all(1)
        for surface in _runs(s for s in self._model.surfaces if drawn[s.part]):
            gl.glScissor(*boxes[surface.part].tolist())  # row 0 is OpenGL's lowest, too
            program.matrix("clip_from_part", self._clip_from_world @ world_from_part[surface.part])
            channel, bit = divmod(int(group[surface.part]), 8)
            gl.glUniform4f(program["bits"], *((1 << bit) / 255.0 * np.eye(4)[channel]))
            _draw(gl, surface)
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
        gl.glClearBufferuiv(gl.GL_COLOR, 1, np.zeros(4, np.uint32))
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)

    def _draw_truth(self, world_from_part: Array, surfaces: Sequence[Surface]) -> None:
        gl, program = self._gl, self._programs.truth
        assert self._model is not None
        gl.glUseProgram(program.id)
        gl.glBindVertexArray(self._model.vao)
        for surface in _runs(surfaces):
            program.matrix("clip_from_part", self._clip_from_world @ world_from_part[surface.part])
            gl.glUniform1ui(program["part"], surface.part + 1)
            _draw(gl, surface)

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
                self._shade_one(s, np.eye(4), material, self._room_textures[s.material], 1.0)
        if not surfaces:
            return
        self._gl.glBindVertexArray(self._model.vao)
        eye = scene.camera.world_from_cam[:3, 3]

        def far_first(s: Surface) -> float:
            """Opaque surfaces before all others; those from far to near."""
            if scene.materials[s.material].base_color[3] >= 1.0:
                return -np.inf
            return -float(np.linalg.norm(world_from_part[s.part][:3, 3] - eye))

        for s in sorted(surfaces, key=far_first):
            size = scene.texture_size[s.material]
            self._shade_one(
                s, world_from_part[s.part], scene.materials[s.material],
                self._textures[s.material], 1.0 / size if size > 0 else 1.0,
            )

    def _shade_one(
        self, surface: Surface, pose: Array, material: Material, texture: int, uv_scale: float
    ) -> None:
        gl, scene = self._gl, self._scene
        program = self._programs.surface(texture != 0, len(scene.lights), scene.shadows)
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
        if texture:
            gl.glActiveTexture(gl.GL_TEXTURE0)
            gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        transparent = material.base_color[3] < 1.0
        if transparent:
            gl.glEnable(gl.GL_BLEND)
            gl.glBlendFunc(gl.GL_SRC_ALPHA, gl.GL_ONE_MINUS_SRC_ALPHA)
        _draw(gl, surface)
        if transparent:
            gl.glDisable(gl.GL_BLEND)

    def _set_lights(self, program: _Program) -> None:
        gl, scene = self._gl, self._scene
        gl.glUniform3f(program["cam_pos"], *scene.camera.world_from_cam[:3, 3])
        gl.glUniform3f(program["ambient_light"], *[scene.ambient] * 3)
        gl.glUniform3f(program["material.emissive_factor"], 0.0, 0.0, 0.0)
        gl.glUniform1i(program["material.base_color_texture"], 0)
        for k, light in enumerate(scene.lights):
            name = f"directional_lights[{k}]."
            gl.glUniform3f(program[name + "direction"], *light.direction)
            gl.glUniform3f(program[name + "color"], *light.color)
            gl.glUniform1f(program[name + "intensity"], light.intensity)

    def _draw_backdrop(self, picture: NDArray[np.uint8]) -> None:
        gl = self._gl
        texture = self._texture(picture[::-1], repeat=False)  # _texture turns it upside down
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
            clip_from_world = _clip_from_light(light, points)
            self._shadow.bind_depth(self._shadow_textures[k])
            gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
            program = self._programs.truth
            gl.glUseProgram(program.id)
            gl.glBindVertexArray(self._model.vao)
            for surface in _runs(self._model.surfaces):
                program.matrix("clip_from_part", clip_from_world @ world_from_part[surface.part])
                _draw(gl, replace(surface, one_sided=False))  # handedness differs from the camera's
            for textured in (False, True):
                program = self._programs.surface(textured, len(scene.lights), True)
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
        self._moving = [s for s in self._model.surfaces if not stands[s.part]]
        self._standing = [s for s in self._model.surfaces if stands[s.part]]

    def _box(self, world_from_part: Array) -> Array:
        """Corners [N 3] of the visuals' bounding boxes in the world, for poses [... P 4 4]."""
        poses = world_from_part.reshape(-1, *world_from_part.shape[-3:])
        boxes = [apply(poses[:, part], corners).reshape(-1, 3) for part, corners in self._corners]
        return np.concatenate([np.zeros((0, 3)), *boxes])

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
            self._outward = _one_sided(model)
            self._corners = [(visual.part, _corners(visual)) for visual in model.visuals]
        self._delete_mesh(self._model)
        pieces = list[_Piece]()
        for k, visual in sorted(enumerate(model.visuals), key=lambda item: item[1].part):
            v, f, n, uv = visual.vertices, visual.faces, visual.normals, visual.uv
            if projected[k]:
                v, f, n, uv = box_projection(v, f, n, 1.0)
            pieces.append(_Piece(visual.part, k, v, f, n, uv, self._outward[k]))
        self._model = self._upload(pieces)
        self._loaded, self._projected = model, projected

    def _upload(self, pieces: Sequence[_Piece]) -> Mesh:
        """One vertex buffer (position, normal, uv) and one index buffer for all pieces."""
        gl = self._gl
        vertices = [np.zeros((0, 8), np.float32)]
        indices = list[tuple[_Piece, NDArray[np.uint32]]]()
        base = 0
        for piece in pieces:
            block = np.zeros((len(piece.vertices), 8), np.float32)
            block[:, :3], block[:, 3:6] = piece.vertices, piece.normals
            if piece.uv is not None:
                block[:, 6:] = piece.uv
            vertices.append(block)
            indices.append((piece, np.asarray(piece.faces, np.uint32) + np.uint32(base)))
            base += len(block)
        # A part's one-sided triangles stand together, as do its others: two draws for its truth.
        index_blocks, surfaces, first = [np.zeros(0, np.uint32)], list[Surface](), 0
        for part in dict.fromkeys(piece.part for piece in pieces):
            for closed in (True, False):
                for piece, index in indices:
                    chosen = index[piece.one_sided == closed].ravel()
                    if piece.part == part and chosen.size:
                        surfaces.append(Surface(part, piece.material, closed, first, chosen.size))
                        index_blocks.append(chosen)
                        first += chosen.size
        data = np.concatenate(vertices)
        index = np.concatenate(index_blocks)
        vao = int(gl.glGenVertexArrays(1))
        gl.glBindVertexArray(vao)
        buffers = (int(gl.glGenBuffers(1)), int(gl.glGenBuffers(1)))
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffers[0])
        gl.glBufferData(gl.GL_ARRAY_BUFFER, max(data.nbytes, 4), data, gl.GL_STATIC_DRAW)
        gl.glBindBuffer(gl.GL_ELEMENT_ARRAY_BUFFER, buffers[1])
        gl.glBufferData(gl.GL_ELEMENT_ARRAY_BUFFER, max(index.nbytes, 4), index, gl.GL_STATIC_DRAW)
        for location, (size, offset) in enumerate(((3, 0), (3, 12), (2, 24))):
            gl.glEnableVertexAttribArray(location)
            gl.glVertexAttribPointer(
                location, size, gl.GL_FLOAT, gl.GL_FALSE, 32, ctypes.c_void_p(offset)
            )
        gl.glBindVertexArray(0)
        return Mesh(vao, buffers, tuple(surfaces))

    def _texture(self, picture: NDArray[np.uint8] | None, repeat: bool = True) -> int:
        """A mipmapped texture whose row 0 is the picture's bottom (v = 0); 0 for no picture."""
        if picture is None:
            return 0
        gl = self._gl
        texture = int(gl.glGenTextures(1))
        self._scene_textures.append(texture)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        data = np.ascontiguousarray(picture[::-1])
        layout = {1: gl.GL_RED, 3: gl.GL_RGB, 4: gl.GL_RGBA}[data.shape[2]]
        height, width = data.shape[:2]
        gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_RGBA8, width, height, 0, layout,
                        gl.GL_UNSIGNED_BYTE, data)
        wrap = gl.GL_REPEAT if repeat else gl.GL_CLAMP_TO_EDGE
        smaller = gl.GL_LINEAR_MIPMAP_LINEAR if repeat else gl.GL_LINEAR
        for name, value in (
            (gl.GL_TEXTURE_WRAP_S, wrap), (gl.GL_TEXTURE_WRAP_T, wrap),
            (gl.GL_TEXTURE_MIN_FILTER, smaller), (gl.GL_TEXTURE_MAG_FILTER, gl.GL_LINEAR),
        ):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, name, value)
        if repeat:
            gl.glGenerateMipmap(gl.GL_TEXTURE_2D)
        return texture

    def _shadow_texture(self) -> int:
        gl = self._gl
        texture = int(gl.glGenTextures(1))
        self._scene_textures.append(texture)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_DEPTH_COMPONENT24, _SHADOW_SIZE, _SHADOW_SIZE,
                        0, gl.GL_DEPTH_COMPONENT, gl.GL_FLOAT, None)
        for name, value in (
            (gl.GL_TEXTURE_WRAP_S, gl.GL_CLAMP_TO_BORDER),
            (gl.GL_TEXTURE_WRAP_T, gl.GL_CLAMP_TO_BORDER),
            (gl.GL_TEXTURE_MIN_FILTER, gl.GL_NEAREST), (gl.GL_TEXTURE_MAG_FILTER, gl.GL_NEAREST),
        ):
            gl.glTexParameteri(gl.GL_TEXTURE_2D, name, value)
        gl.glTexParameterfv(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))
        return texture

    def _delete_mesh(self, mesh: Mesh | None) -> None:
        if mesh is not None:
            self._gl.glDeleteVertexArrays(1, [mesh.vao])
            self._gl.glDeleteBuffers(2, list(mesh.buffers))

    def _forget_scene(self) -> None:
        if self._scene_textures:
            self._gl.glDeleteTextures(len(self._scene_textures), self._scene_textures)
        self._scene_textures = list[int]()
        self._delete_mesh(self._room)
        self._room = None


@dataclass(frozen=True)
class _Piece:
    """Triangles to upload."""

    part: int
    material: int
    vertices: Array
    faces: NDArray[np.int32]
    normals: Array
    uv: Array | None
    one_sided: NDArray[np.bool_]


def _one_sided(model: ArticulatedModel) -> list[NDArray[np.bool_]]:
    """For each visual, which of its triangles [F] are seen from outside only."""
    out = [np.zeros(0, bool)] * len(model.visuals)
    for part in {v.part for v in model.visuals}:
        chosen = [k for k, v in enumerate(model.visuals) if v.part == part]
        visuals = [model.visuals[k] for k in chosen]
        found = one_sided([v.vertices for v in visuals], [v.faces for v in visuals])
        for k, outward in zip(chosen, found, strict=True):
            out[k] = outward
    return out


def _runs(surfaces: Iterable[Surface]) -> list[Surface]:
    """The same triangles in fewer draws: neighbours of one part become one surface."""
    runs: list[Surface] = []
    for s in surfaces:
        last = runs[-1] if runs else None
        if (
            last
            and (last.part, last.one_sided) == (s.part, s.one_sided)
            and last.first + last.count == s.first
        ):
            runs[-1] = replace(last, count=last.count + s.count)
        else:
            runs.append(s)
    return runs


def _draw(gl: Any, surface: Surface) -> None:
    (gl.glEnable if surface.one_sided else gl.glDisable)(gl.GL_CULL_FACE)
    offset = ctypes.c_void_p(4 * surface.first)
    gl.glDrawElements(gl.GL_TRIANGLES, surface.count, gl.GL_UNSIGNED_INT, offset)


class _Target:
    """A framebuffer with colour attachments and a depth buffer."""

    def __init__(
        self, gl: Any, width: int, height: int, formats: Sequence[Any], depth: Any
    ) -> None:
        self._gl, self._size, self._attachments = gl, (width, height), len(formats)
        self.id = int(gl.glGenFramebuffers(1))
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self.id)
        points = [gl.GL_COLOR_ATTACHMENT0 + k for k in range(len(formats))]
        for point, layout in [*zip(points, formats, strict=True), (gl.GL_DEPTH_ATTACHMENT, depth)]:
            if layout is None:
                continue
            buffer = int(gl.glGenRenderbuffers(1))
            gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
            gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, layout, width, height)
            gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, point, gl.GL_RENDERBUFFER, buffer)
        if not formats:
            gl.glDrawBuffer(gl.GL_NONE)
            gl.glReadBuffer(gl.GL_NONE)
            return
        gl.glDrawBuffers(len(points), points)
        status = gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER)
        if status != gl.GL_FRAMEBUFFER_COMPLETE:
            raise NoRendererError(f"the driver refuses a framebuffer of {width} x {height} "
                                  f"(status {int(status):#x})")

    def bind(self) -> None:
        self._gl.glBindFramebuffer(self._gl.GL_FRAMEBUFFER, self.id)
        self._gl.glViewport(0, 0, *self._size)

    def bind_depth(self, texture: int) -> None:
        gl = self._gl
        self.bind()
        gl.glFramebufferTexture2D(
            gl.GL_FRAMEBUFFER, gl.GL_DEPTH_ATTACHMENT, gl.GL_TEXTURE_2D, texture, 0
        )

    def copy_to(self, other: _Target) -> None:
        """Copy every attachment to a target of the same kind."""
        gl = self._gl
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self.id)
        gl.glBindFramebuffer(gl.GL_DRAW_FRAMEBUFFER, other.id)
        points = [gl.GL_COLOR_ATTACHMENT0 + k for k in range(self._attachments)]
        for k, point in enumerate(points):
            gl.glReadBuffer(point)
            gl.glDrawBuffers(k + 1, [gl.GL_NONE] * k + [point])
            bits = gl.GL_COLOR_BUFFER_BIT | (gl.GL_DEPTH_BUFFER_BIT if k == 0 else 0)
            box = (0, 0, *self._size)
            gl.glBlitFramebuffer(*box, *box, bits, gl.GL_NEAREST)
        gl.glDrawBuffers(len(points), points)

    def read(self, attachment: int, layout: Any, kind: Any, out: NDArray[Any]) -> None:
        gl = self._gl
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self.id)
        gl.glReadBuffer(gl.GL_COLOR_ATTACHMENT0 + attachment)
        gl.glReadPixels(0, 0, *self._size, layout, kind, out)


class _Program:
    """A linked program with its uniform locations looked up once."""

    def __init__(self, gl: Any, vertex: str, fragment: str) -> None:
        from OpenGL.GL import shaders

        self._gl = gl
        self.scene: Scene | None = None
        self.id = int(shaders.compileProgram(
            shaders.compileShader(vertex, gl.GL_VERTEX_SHADER),
            shaders.compileShader(fragment, gl.GL_FRAGMENT_SHADER),
            validate=False,  # needs a bound vertex array; linking is checked anyway
        ))
        self._locations: dict[str, int] = {}

    def __getitem__(self, name: str) -> int:
        """Location of a uniform; -1, which GL ignores, where the compiler dropped it."""
        if name not in self._locations:
            self._locations[name] = int(self._gl.glGetUniformLocation(self.id, name))
        return self._locations[name]

    def matrix(self, name: str, value: Array) -> None:
        data = np.ascontiguousarray(value, np.float32)
        self._gl.glUniformMatrix4fv(self[name], 1, self._gl.GL_TRUE, data)


class _Programs:
    """The programs, compiled when first used."""

    def __init__(self, gl: Any) -> None:
        self._gl = gl
        self._surface: dict[tuple[bool, int, bool], _Program] = {}
        vertex = _source("truth.vert.glsl")
        self.truth = _Program(gl, vertex, _source("truth.frag.glsl"))
        self.coverage = _Program(gl, vertex, _source("coverage.frag.glsl"))
        self.backdrop = _Program(gl, _source("backdrop.vert.glsl"), _source("backdrop.frag.glsl"))

    def surface(self, textured: bool, lights: int, shadows: bool) -> _Program:
        """pyrender's shading for this many lights (a constant, so that samplers may be indexed)."""
        key = (textured, lights, shadows)
        if key not in self._surface:
            vertex = _source("surface.vert.glsl").replace("TEXTURED", str(int(textured)))
            fragment = _pyrender_fragment_shader(*key)
            self._surface[key] = _Program(self._gl, vertex, fragment)
        return self._surface[key]


def _source(name: str) -> str:
    return (_HERE / name).read_text()


def _pyrender_fragment_shader(textured: bool, lights: int, shadows: bool) -> str:
    import pyrender
    from pyrender.shader_program import ShaderProgram

    path = Path(pyrender.__file__).parent / "shaders" / "mesh.frag"
    defines = {"USE_METALLIC_MATERIAL": 1, "NORMAL_LOC": 1, "MAX_POINT_LIGHTS": 1,
               "MAX_SPOT_LIGHTS": 1, "MAX_DIRECTIONAL_LIGHTS": lights}
    if textured:
        defines |= {"TEXCOORD_0_LOC": 2, "HAS_BASE_COLOR_TEX": 1}
    if shadows:
        defines |= {"DIRECTIONAL_LIGHT_SHADOWS": 1}
    program: Any = ShaderProgram(None, None, defines=defines)
    text = str(program._load(str(path)))
    for old, new in (
        ("vec3 n = normalize(get_normal());",
         "vec3 n = normalize(get_normal()); if (!gl_FrontFacing) n = -n;"),
        ("i < n_directional_lights", f"i < {lights}"),
        ("i < n_point_lights", "i < 0"),
        ("i < n_spot_lights", "i < 0"),
    ):
        if old not in text:
            raise NoRendererError(f"pyrender's mesh.frag has changed: {old!r} is not in it; "
                                  "install scikit-robot-pyrender 0.1.50")
        text = text.replace(old, new)
    return text


# -- projections ------------------------------------------------------------------------------


def _clip_from_cam(camera: Camera, near: float, far: float) -> Array:
    """OpenGL clip space from our camera frame: row 0 at the bottom of OpenGL's window."""
    w, h, k = camera.width, camera.height, camera.intrinsics
    clip = np.zeros((4, 4))
    clip[0] = 2.0 / w * np.append(k[0], 0.0)  # u_gl = u + 0.5, from 0 at the left edge
    clip[0, 2] += 1.0 / w - 1.0
    clip[1] = 2.0 / h * np.append(k[1], 0.0)
    clip[1, 2] += 1.0 / h - 1.0
    clip[2, 2] = (far + near) / (far - near)
    clip[2, 3] = -2.0 * far * near / (far - near)
    clip[3, 2] = 1.0
    return clip


def _corners(visual: Visual) -> Array:
    """[8 3] m of its bounding box, in its part's frame."""
    low, high = visual.vertices.min(0), visual.vertices.max(0)
    return np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)


def _clip_from_world(camera: Camera, points: Array) -> Array:
    """Clip space whose near and far planes enclose world points [N 3] in front of the camera."""
    z = apply(camera.cam_from_world, points)[:, 2] if len(points) else np.ones(1)
    far = max(float(z.max()) * 1.01, 1e-3)
    # Room walls lie behind the camera too: then a thousandth of the depth is near enough.
    near = max(float(z.min()) * 0.9, far * 1e-3)
    return _clip_from_cam(camera, near, far) @ camera.cam_from_world


def _clip_from_light(light: Light, points: Array) -> Array:
    """Orthographic clip space of a light that just encloses `points` [N 3]."""
    z = light.direction / np.linalg.norm(light.direction)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.99 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z])
    local = points @ axes.T
    low, high = local.min(0) - 1e-3, local.max(0) + 1e-3
    clip = np.eye(4)
    clip[:3, :3] = axes * (2.0 / (high - low))[:, None]
    clip[:3, 3] = -(high + low) / (high - low)
    return clip
