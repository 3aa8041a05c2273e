"""The pass that draws truth: depth, part numbers and, if asked for, triangles.

They go into float32 and integer targets without multisampling, so that no value is ever a mixture
of two surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .buffers import Mesh, Surface, draw_surface, runs_of
from .context import Programs
from .targets import Target
from .uploaded_model import DeviceModel


class TruthPass:
    """Draws into images of one size; what stands still is drawn once a sequence."""

    def __init__(self, gl: Any, programs: Programs, width: int, height: int, faces: bool) -> None:
        self._gl, self._programs, self._faces = gl, programs, faces
        self.width, self.height = width, height
        layout = [gl.GL_R32F, gl.GL_R16UI, *([gl.GL_R32UI] * faces)]
        self._target = Target(gl, width, height, layout, gl.GL_DEPTH_COMPONENT32F)
        self._still = Target(gl, width, height, layout, gl.GL_DEPTH_COMPONENT32F)

    def begin(self, model: DeviceModel, world_from_part: Array, clip_from_world: Array) -> None:
        """Draw what stands still, from poses [P 4 4]."""
        self._still.bind()
        self._clear()
        self._draw(model, model.standing, world_from_part, clip_from_world)

    def draw(self, model: DeviceModel, world_from_part: Array, clip_from_world: Array) -> None:
        """Begin to draw a frame."""
        self._still.copy_to(self._target)
        self._target.bind()
        self._draw(model, model.moving, world_from_part, clip_from_world)
        self._gl.glFlush()

    def draw_room(self, room: Mesh | None, clip_from_world: Array) -> None:
        """Draw a room alone."""
        self._target.bind()
        self._clear()
        if room is None:
            return
        gl, program = self._gl, self._programs.truth
        gl.glUseProgram(program.id)
        gl.glBindVertexArray(room.vao)
        program.matrix("clip_from_part", clip_from_world)
        gl.glUniform1ui(program["part"], 0)
        self._drawn = room
        for surface in runs_of(room.surfaces):
            gl.glUniform1ui(program["first_face"], surface.first // 3)
            draw_surface(gl, surface)

    def read_depth(self) -> NDArray[np.float32]:
        """[H W] m, 0 where nothing was drawn."""
        depth = np.empty((self.height, self.width), np.float32)
        self._target.read(0, self._gl.GL_RED, self._gl.GL_FLOAT, depth)
        return depth

    def read_part(self) -> NDArray[np.uint16]:
        """[H W]"""
        part = np.empty((self.height, self.width), np.uint16)
        self._target.read(1, self._gl.GL_RED_INTEGER, self._gl.GL_UNSIGNED_SHORT, part)
        return part

    def read_faces(self) -> NDArray[np.int32]:
        """[H W] number of the triangle in what was drawn last, -1: none."""
        drawn = np.empty((self.height, self.width), np.uint32)
        self._target.read(2, self._gl.GL_RED_INTEGER, self._gl.GL_UNSIGNED_INT, drawn)
        numbers = np.concatenate([np.array([-1]), self._drawn.order]).astype(np.int32)
        return numbers[drawn]

    def _clear(self) -> None:
        gl = self._gl
        gl.glClearBufferfv(gl.GL_COLOR, 0, np.zeros(4, np.float32))
        for target in (1, 2)[: 1 + self._faces]:
            gl.glClearBufferuiv(gl.GL_COLOR, target, np.zeros(4, np.uint32))
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)

    def _draw(
        self, model: DeviceModel, surfaces: Sequence[Surface], world_from_part: Array,
        clip_from_world: Array,
    ) -> None:
        gl = self._gl
        self._drawn = model.mesh
        for program, surface in model.draws(
                self._programs, "truth", surfaces, world_from_part, clip_from_world):
            gl.glUniform1ui(program["part"], surface.part + 1)
            gl.glUniform1ui(program["first_face"], surface.first // 3)
            draw_surface(gl, surface)
