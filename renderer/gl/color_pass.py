"""The pass that draws colours, finer than the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from weakref import ref

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import Material
from ..scene import Scene, clip_from_light
from .buffers import DrawRange, Piece, VertexArray, delete_vertex_array, draw_range, upload_pieces
from .context import Program, Programs
from .framebuffers import (
    SHADOW_SIZE,
    Framebuffer,
    TextureCache,
    delete_textures,
    picture_texture,
    shadow_texture,
)
from .programs import TEXTURE_UNITS, Features, features_of, textures_of
from .uploaded_model import Shot


class DrawnColor:
    """The colours of one frame. The device draws it meanwhile; the first access waits for it."""

    def __init__(self, gl: Any, target: Framebuffer, finer: int, samples: NDArray[np.uint8]
                 ) -> None:
        """`samples` is memory for the target's RGBA, which is used only while reading."""
        self._gl, self._target, self._finer, self._samples = gl, target, finer, samples

    @cached_property
    def rgb(self) -> NDArray[np.uint8]:
        """[H W 3]"""
        gl, rgba = self._gl, self._samples
        self._target.read(0, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, rgba)
        if self._finer > 1:
            size = (rgba.shape[1] // self._finer, rgba.shape[0] // self._finer)
            rgba = cv2.resize(rgba, size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), np.uint8)


@dataclass(frozen=True, eq=False)
class _UploadedScene:
    """What goes with a scene on the device."""

    scene: Scene
    room: VertexArray | None
    features: Sequence[Features]
    """of each visual of the model"""
    room_materials: Sequence[Material]
    room_features: Sequence[Features]
    shadows: Sequence[int]
    """the shadow map of each light; none if the scene has no shadows"""
    textures: TextureCache
    """of the scene's pictures"""


def _upload_scene(gl: Any, scene: Scene) -> _UploadedScene:
    pieces = [Piece(-1, k, s.vertices, s.faces, s.normals, s.uv, np.zeros(len(s.faces), bool))
              for k, s in enumerate(scene.room)]
    features = [  # a drawn texture replaces all colour
        features_of(m, v.color is not None and size == 0) for m, v, size
        in zip(scene.materials, scene.model.visuals, scene.texture_size, strict=True)]
    materials = [Material(s.name, (*s.base_color, 1.0), 0.0, s.roughness, s.texture)
                 for s in scene.room]
    return _UploadedScene(
        scene, upload_pieces(gl, pieces) if pieces else None, features, materials,
        [features_of(m) for m in materials],
        [shadow_texture(gl) for _ in scene.lights if scene.shadows], TextureCache(gl))


class ColorPass:
    """Draws one scene after another at one image size."""

    def __init__(self, programs: Programs, width: int, height: int, finer: int) -> None:
        gl = programs.gl
        self._gl, self._programs, self._finer = gl, programs, finer
        fine = (width * finer, height * finer)
        self._target = Framebuffer(gl, *fine, [gl.GL_RGBA8], gl.GL_DEPTH_COMPONENT24)
        self._still = Framebuffer(gl, *fine, [gl.GL_RGBA8], gl.GL_DEPTH_COMPONENT24)
        self._shadow = Framebuffer(gl, SHADOW_SIZE, SHADOW_SIZE, [], None)
        self._samples = np.empty((height * finer, width * finer, 4), np.uint8)
        self._empty_vao = int(gl.glGenVertexArrays(1))
        self._uploaded: _UploadedScene | None = None
        self._still_of: Shot | None = None
        self._last: ref[DrawnColor] | None = None

    @property
    def scene(self) -> Scene | None:
        """The scene on the device."""
        return None if self._uploaded is None else self._uploaded.scene

    @property
    def room(self) -> VertexArray | None:
        """Its room."""
        return None if self._uploaded is None else self._uploaded.room

    def upload(self, scene: Scene) -> None:
        """Upload a scene in place of the one before."""
        self.delete_scene()
        self._uploaded = _upload_scene(self._gl, scene)

    def draw(self, shot: Shot, t: int) -> DrawnColor:
        """Draw a frame of the scene on the device."""
        assert self._uploaded is not None
        self.finish()
        drawn = DrawnColor(self._gl, self._target, self._finer, self._samples)
        self._last = ref(drawn)
        if self._still_of is not shot:
            self._draw_still(self._uploaded, shot, t)
            self._still_of = shot
        shadows = self._uploaded.scene.shadows  # a moving one falls on what stands still
        if shadows:
            self._draw_shadows(self._uploaded, shot, t)
        self._still.copy_to(self._target)
        self._target.bind()
        ranges = [*shot.static_ranges, *shot.moving_ranges] if shadows else shot.moving_ranges
        if shadows:
            self._shade_room(self._uploaded, shot)
        self._shade(self._uploaded, shot, t, ranges)
        if self._programs.copies_ahead:
            self._target.copy_ahead(0, self._gl.GL_RGBA, self._gl.GL_UNSIGNED_BYTE, 4)
        self._gl.glFlush()
        return drawn

    def finish(self) -> None:
        """Copy the frame that was drawn last from the device, if someone still holds it."""
        last = self._last() if self._last is not None else None
        if last is not None:
            _ = last.rgb
        self._last = None

    def delete_scene(self) -> None:
        """Free what goes with the scene."""
        if self._uploaded is not None:
            self._uploaded.textures.delete()
            delete_textures(self._gl, self._uploaded.shadows)
            delete_vertex_array(self._gl, self._uploaded.room)
        self._uploaded = self._still_of = None

    def _draw_still(self, uploaded: _UploadedScene, shot: Shot, t: int) -> None:
        """Draw what stands still; with shadows, only the backdrop does."""
        gl, scene = self._gl, uploaded.scene
        self._still.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 1.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        backdrop = scene.backdrop_seen_by(shot.camera)
        if backdrop is not None:
            self._draw_backdrop(backdrop)
        if not scene.shadows:
            self._shade_room(uploaded, shot)
            self._shade(uploaded, shot, t, shot.static_ranges)

    def _shade_room(self, uploaded: _UploadedScene, shot: Shot) -> None:
        if uploaded.room is not None:
            self._gl.glBindVertexArray(uploaded.room.id)
            for r in uploaded.room.ranges:
                program = self._program(uploaded, shot, uploaded.room_features[r.material])
                self._set_pose(program, shot, np.eye(4), 1.0)
                self._shade_range(uploaded, program, r, uploaded.room_materials[r.material])

    def _shade(
        self, uploaded: _UploadedScene, shot: Shot, t: int, ranges: Sequence[DrawRange]
    ) -> None:
        """Draw opaque surfaces, then transparent ones from far to near."""
        if not ranges:
            return
        scene, poses = uploaded.scene, shot.posed.world_from_part[t]
        self._gl.glBindVertexArray(shot.uploaded.array.id)
        eye = shot.camera.world_from_cam[:3, 3]

        def far_first(r: DrawRange) -> float:
            if not scene.materials[r.material].transparent:
                return -np.inf
            return -float(np.linalg.norm(poses[r.part][:3, 3] - eye))

        for r in sorted(ranges, key=far_first):
            size = scene.texture_size[r.material]
            program = self._program(uploaded, shot, uploaded.features[r.material])
            self._set_pose(program, shot, shot.pose(r, t), 1.0 / size if size > 0 else 1.0)
            self._shade_range(uploaded, program, r, scene.materials[r.material])

    def _program(self, uploaded: _UploadedScene, shot: Shot, features: Features) -> Program:
        """The program for a surface, in use, with the scene's lights and the camera set."""
        scene = uploaded.scene
        program = self._programs.surface(features, len(scene.lights), scene.shadows)
        self._gl.glUseProgram(program.id)
        if program.scene is not scene:
            program.scene = scene
            self._set_lights(program, scene)
        if program.camera is not shot.camera:
            program.camera = shot.camera
            self._gl.glUniform3f(program["cam_pos"], *shot.camera.world_from_cam[:3, 3])
        return program

    def _set_pose(self, program: Program, shot: Shot, pose: Array, uv_scale: float) -> None:
        program.matrix("clip_from_part", shot.clip_from_world @ pose)
        program.matrix("world_from_part", pose)
        self._gl.glUniform2f(program["uv_scale"], uv_scale, uv_scale)

    def _shade_range(
        self, uploaded: _UploadedScene, program: Program, triangles: DrawRange, material: Material
    ) -> None:
        gl = self._gl
        gl.glUniform4f(program["material.base_color_factor"], *material.base_color)
        gl.glUniform1f(program["material.metallic_factor"], material.metallic)
        gl.glUniform1f(program["material.roughness_factor"], material.roughness)
        gl.glUniform3f(program["material.emissive_factor"], *material.emission)
        if material.alpha_cutoff is not None:
            gl.glUniform1f(program["alpha_cutoff"], material.alpha_cutoff)
        textures = [(TEXTURE_UNITS[name], uploaded.textures.texture(picture, material.tiling))
                    for name, picture in textures_of(material).items()]
        for unit, texture in textures:  # once all are made: making one binds it
            gl.glActiveTexture(gl.GL_TEXTURE0 + unit)
            gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        if material.transparent:
            gl.glEnable(gl.GL_BLEND)
            gl.glBlendFunc(gl.GL_SRC_ALPHA, gl.GL_ONE_MINUS_SRC_ALPHA)
        draw_range(gl, triangles)
        if material.transparent:
            gl.glDisable(gl.GL_BLEND)

    def _set_lights(self, program: Program, scene: Scene) -> None:
        gl = self._gl
        gl.glUniform3f(program["ambient_light"], *[scene.ambient] * 3)
        for name, unit in TEXTURE_UNITS.items():
            gl.glUniform1i(program[f"material.{name}_texture"], unit)
        for k, light in enumerate(scene.lights):
            name = f"directional_lights[{k}]."
            direction = light.direction / np.linalg.norm(light.direction)
            gl.glUniform3f(program[name + "direction"], *direction)
            gl.glUniform3f(program[name + "color"], *(light.intensity * np.array(light.color)))

    def _draw_backdrop(self, picture: NDArray[np.uint8]) -> None:
        gl, program = self._gl, self._programs.backdrop
        texture = picture_texture(gl, picture[::-1], None)  # it turns them upside down
        gl.glUseProgram(program.id)
        gl.glUniform1i(program["picture"], 0)
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

    def _draw_shadows(self, uploaded: _UploadedScene, shot: Shot, t: int) -> None:
        """Draw depth seen from each light into its map. Walls cast no shadow: light passes them."""
        gl, lights = self._gl, uploaded.scene.lights
        points = shot.box(t)
        # pyrender's shader looks up to two texels aside on both axes: a surface that slopes away
        # from the light must lie that much deeper, or it shades itself.
        gl.glEnable(gl.GL_POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(4.0, 4.0)
        for k, (light, texture) in enumerate(zip(lights, uploaded.shadows, strict=True)):
            clip_from_world = clip_from_light(light, points)
            self._shadow.bind_depth(texture)
            gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
            for _, r in shot.draws(
                    self._programs, "truth", shot.uploaded.array.ranges, t, clip_from_world):
                # A light's clip space has the other handedness: front faces would be left out.
                draw_range(gl, replace(r, one_sided=False))
            for features in {*uploaded.features, *uploaded.room_features}:
                program = self._programs.surface(features, len(lights), True)
                gl.glUseProgram(program.id)
                name = f"directional_lights[{k}]."
                program.matrix(name + "light_matrix", clip_from_world)
                gl.glUniform1i(program[name + "shadow_map"], 1 + k)
            gl.glActiveTexture(gl.GL_TEXTURE0 + 1 + k)
            gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
        gl.glDisable(gl.GL_POLYGON_OFFSET_FILL)
