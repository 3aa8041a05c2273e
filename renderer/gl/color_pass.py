"""The pass that draws colours, finer than the image: averaged, this smooths shading as well as
edges, and on a CPU it is half the price of multisampling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ...robots.model import Material, Tiling
from ..scene import Scene, clip_from_light
from .buffers import Mesh, Piece, Surface, delete_mesh, draw_surface, upload
from .context import Program, Programs
from .programs import Look, look_of
from .targets import Target
from .textures import SHADOW_SIZE, delete_textures, picture_texture, shadow_texture
from .uploaded_model import DeviceModel


class ColorPass:
    """Draws one scene after another at one image size."""

    scene: Scene

    def __init__(self, gl: Any, programs: Programs, width: int, height: int, finer: int) -> None:
        self._gl, self._programs = gl, programs
        self._size, self._finer = (width, height), finer
        fine = (width * finer, height * finer)
        self._target = Target(gl, *fine, [gl.GL_RGBA8], gl.GL_DEPTH_COMPONENT24)
        self._still = Target(gl, *fine, [gl.GL_RGBA8], gl.GL_DEPTH_COMPONENT24)
        self._samples = np.empty((height * finer, width * finer, 4), np.uint8)
        self._empty_vao = int(gl.glGenVertexArrays(1))
        self.room: Mesh | None = None
        self._scene_textures: dict[tuple[int, tuple[Tiling, Tiling]], int] = {}
        self._shadow_textures: list[int] = []
        self._shadow = Target(gl, SHADOW_SIZE, SHADOW_SIZE, [], None)

    def take(self, scene: Scene) -> None:
        """Upload what goes with a scene, and forget the one before."""
        gl = self._gl
        self.forget()
        self.scene = scene
        self.room = upload(gl, [
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

    def begin(self, model: DeviceModel, world_from_part: Array, clip_from_world: Array) -> None:
        """Draw what stands still, from poses [P 4 4]."""
        gl, scene = self._gl, self.scene
        self._still.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 1.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        if scene.backdrop is not None:
            self._draw_backdrop(scene.backdrop)
        if not scene.shadows:
            self._shade(model, world_from_part, clip_from_world, model.standing, room=True)

    def draw(self, model: DeviceModel, world_from_part: Array, clip_from_world: Array) -> None:
        """Begin to draw a frame."""
        shadows = self.scene.shadows  # a moving one falls on what stands still
        if shadows:
            self._draw_shadows(model, world_from_part)
        self._still.copy_to(self._target)
        self._target.bind()
        surfaces = [*model.standing, *model.moving] if shadows else model.moving
        self._shade(model, world_from_part, clip_from_world, surfaces, room=shadows)
        self._gl.glFlush()

    def read(self) -> NDArray[np.uint8]:
        """RGB [H W 3]."""
        gl, rgba = self._gl, self._samples
        self._target.read(0, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, rgba)
        if self._finer > 1:
            rgba = cv2.resize(rgba, self._size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2RGB), np.uint8)

    def forget(self) -> None:
        """Free what goes with the scene."""
        delete_textures(self._gl, [*self._scene_textures.values(), *self._shadow_textures])
        self._scene_textures, self._shadow_textures = {}, []
        delete_mesh(self._gl, self.room)
        self.room = None

    def _shade(
        self, model: DeviceModel, world_from_part: Array, clip_from_world: Array,
        surfaces: Sequence[Surface], room: bool,
    ) -> None:
        """Draw colours: opaque surfaces, then transparent ones from far to near."""
        self._clip_from_world = clip_from_world
        scene = self.scene
        if room and self.room is not None:
            self._gl.glBindVertexArray(self.room.vao)
            for s in self.room.surfaces:
                material = self._room_materials[s.material]
                self._shade_one(s, np.eye(4), material, self._room_looks[s.material], 1.0)
        if not surfaces:
            return
        self._gl.glBindVertexArray(model.mesh.vao)
        eye = scene.camera.world_from_cam[:3, 3]

        def far_first(s: Surface) -> float:
            """Opaque surfaces before all others; those from far to near."""
            if not scene.materials[s.material].transparent:
                return -np.inf
            return -float(np.linalg.norm(world_from_part[s.part][:3, 3] - eye))

        for s in sorted(surfaces, key=far_first):
            size = scene.texture_size[s.material]
            self._shade_one(
                s, model.pose(s, world_from_part), scene.materials[s.material],
                self._looks[s.material], 1.0 / size if size > 0 else 1.0,
            )

    def _shade_one(
        self, surface: Surface, pose: Array, material: Material, look: Look, uv_scale: float
    ) -> None:
        gl, scene = self._gl, self.scene
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
        gl, scene = self._gl, self.scene
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

    def _draw_shadows(self, model: DeviceModel, world_from_part: Array) -> None:
        """Depth seen from each light into its map. Walls throw no shadow: light passes them."""
        gl, scene = self._gl, self.scene
        points = model.box(world_from_part)
        # pyrender's shader looks up to two texels aside on both axes: a surface that slopes away
        # from the light must lie that much deeper, or it shades itself.
        gl.glEnable(gl.GL_POLYGON_OFFSET_FILL)
        gl.glPolygonOffset(4.0, 4.0)
        for k, light in enumerate(scene.lights):
            clip_from_world = clip_from_light(light, points)
            self._shadow.bind_depth(self._shadow_textures[k])
            gl.glClear(gl.GL_DEPTH_BUFFER_BIT)
            for _, surface in model.draws(
                    self._programs, "truth", model.mesh.surfaces, world_from_part, clip_from_world):
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

    def _texture(self, picture: NDArray[np.uint8], tiling: tuple[Tiling, Tiling]) -> int:
        """The texture of a picture that goes with the scene, made when first asked for."""
        key = id(picture), tiling  # the scene holds the picture: its id stays its own
        if key not in self._scene_textures:
            self._scene_textures[key] = picture_texture(self._gl, picture, tiling=tiling)
        return self._scene_textures[key]


_UNITS = {"base_color": 0, "metallic_roughness": 9, "normal": 10, "occlusion": 11, "emissive": 12}
"""Texture units by pyrender's names; shadow maps take those between."""


def _pictures(material: Material) -> tuple[NDArray[np.uint8] | None, ...]:
    """The textures of a material in the order of their units."""
    maps = material.maps
    return (material.texture, maps.metallic_roughness, maps.normal, maps.occlusion, maps.emission)
