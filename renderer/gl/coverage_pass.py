"""The pass that draws who would be seen where if nothing were before it: a bit a group of parts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .buffers import draw_surface
from .context import Programs
from .targets import Target
from .uploaded_model import DeviceModel


class CoveragePass:
    """Draws into images of one size."""

    def __init__(self, gl: Any, programs: Programs, width: int, height: int) -> None:
        self._gl, self._programs = gl, programs
        self.width, self.height = width, height
        self._target = Target(gl, width, height, [gl.GL_RGBA8], None)

    def draw(
        self, model: DeviceModel, world_from_part: Array, clip_from_world: Array,
        group: NDArray[np.int64], where: NDArray[np.int64],
    ) -> None:
        """See Rasterizer.draw_coverage."""
        gl = self._gl
        self._target.bind()
        gl.glClearColor(0.0, 0.0, 0.0, 0.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT)
        gl.glDisable(gl.GL_DEPTH_TEST)
        gl.glEnable(gl.GL_COLOR_LOGIC_OP)
        gl.glLogicOp(gl.GL_OR)
        gl.glEnable(gl.GL_SCISSOR_TEST)
        boxes = np.concatenate([where[:, :2], where[:, 2:] - where[:, :2]], axis=1)
        drawn = (group >= 0) & (boxes[:, 2:] > 0).all(1)
        surfaces = [s for s in model.mesh.surfaces if drawn[s.part]]
        for program, surface in model.draws(
                self._programs, "coverage", surfaces, world_from_part, clip_from_world):
            gl.glScissor(*boxes[surface.part].tolist())  # row 0 is OpenGL's lowest, too
            channel, bit = divmod(int(group[surface.part]), 8)
            gl.glUniform4f(program["bits"], *((1 << bit) / 255.0 * np.eye(4)[channel]))
            draw_surface(gl, surface)
        gl.glDisable(gl.GL_SCISSOR_TEST)
        gl.glDisable(gl.GL_COLOR_LOGIC_OP)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glFlush()

    def read(self) -> NDArray[np.uint32]:
        """[H W] bits."""
        rgba = np.empty((self.height, self.width, 4), np.uint8)
        self._target.read(0, self._gl.GL_RGBA, self._gl.GL_UNSIGNED_BYTE, rgba)
        return rgba.view("<u4")[..., 0]
