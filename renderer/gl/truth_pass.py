"""The passes that draw truth: depth, part numbers, triangles; and coverage.

They draw into float32 and integer targets without multisampling, so that no value is ever a
mixture of two surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from .buffers import DrawRange, VertexArray, draw_range, merge_ranges
from .context import Programs
from .framebuffers import Framebuffer
from .uploaded_model import Shot


class DrawnTruth:
    """The truth of one frame. The device draws it meanwhile; the first access waits for it."""

    def __init__(self, gl: Any, target: Framebuffer, order: NDArray[np.uint32] | None) -> None:
        self._gl, self._target, self._order = gl, target, order

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """[H W] m; 0 where nothing is drawn"""
        return self._read(0)

    @cached_property
    def part(self) -> NDArray[np.uint16]:
        """[H W] 1-based part number; 0 where no part is drawn"""
        return self._read(1)

    @cached_property
    def face(self) -> NDArray[np.int32] | None:
        """[H W] triangle, counted through all visuals (or the room's surfaces); -1 where nothing
        is drawn. None if the rasterizer draws no triangles' numbers.
        """
        if self._order is None:
            return None
        return np.concatenate([np.array([-1]), self._order]).astype(np.int32)[self._read(2)]

    def read(self) -> None:
        """Copy all images from the device."""
        _ = self.depth, self.part, self.face

    def _read(self, attachment: int) -> NDArray[Any]:
        layout, kind, dtype = _layouts(self._gl)[attachment]
        width, height = self._target.size
        out = np.empty((height, width), dtype)
        self._target.read(attachment, layout, kind, out)
        return out


def _layouts(gl: Any) -> tuple[tuple[Any, Any, type[Any]], ...]:
    """How depth, part numbers and triangles are read."""
    return ((gl.GL_RED, gl.GL_FLOAT, np.float32),
            (gl.GL_RED_INTEGER, gl.GL_UNSIGNED_SHORT, np.uint16),
            (gl.GL_RED_INTEGER, gl.GL_UNSIGNED_INT, np.uint32))


class TruthPass:
    """Draws truth into images of one size; what stands still is drawn once a shot."""

    def __init__(self, programs: Programs, width: int, height: int) -> None:
        self._programs, self._gl = programs, programs.gl
        gl, self._faces = programs.gl, programs.faces
        layout = [gl.GL_R32F, gl.GL_R16UI, *([gl.GL_R32UI] * self._faces)]
        self._target = Framebuffer(gl, width, height, layout, gl.GL_DEPTH_COMPONENT32F)
        self._still = Framebuffer(gl, width, height, layout, gl.GL_DEPTH_COMPONENT32F)
        self._still_of: Shot | None = None
        self._last: ref[DrawnTruth] | None = None

    def draw(self, shot: Shot, t: int) -> DrawnTruth:
        """Draw a frame of a shot."""
        drawn = self._begin(shot.uploaded.array)
        if self._still_of is not shot:
            self._still.bind()
            self._clear()
            self._draw(shot, shot.static_ranges, t)
            self._still_of = shot
        self._still.copy_to(self._target)
        self._target.bind()
        self._draw(shot, shot.moving_ranges, t)
        self._send()
        return drawn

    def draw_room(self, room: VertexArray, clip_from_world: Array) -> DrawnTruth:
        """Draw a room alone; its part number is 0."""
        drawn = self._begin(room)
        self._target.bind()
        self._clear()
        gl, program = self._gl, self._programs.solid("truth", False)
        gl.glUseProgram(program.id)
        gl.glBindVertexArray(room.id)
        program.matrix("clip_from_part", clip_from_world)
        gl.glUniform1ui(program["part"], 0)
        for r in merge_ranges(room.ranges):
            gl.glUniform1ui(program["first_face"], r.first // 3)
            draw_range(gl, r)
        self._send()
        return drawn

    def finish(self) -> None:
        """Copy the frame that was drawn last from the device, if someone still holds it."""
        last = self._last() if self._last is not None else None
        if last is not None:
            last.read()
        self._last = None

    def _begin(self, array: VertexArray) -> DrawnTruth:
        self.finish()
        drawn = DrawnTruth(self._gl, self._target, array.order if self._faces else None)
        self._last = ref(drawn)
        return drawn

    def _send(self) -> None:
        """Have the device draw, while the caller works."""
        if self._programs.copies_ahead:
            for k, (layout, kind, dtype) in enumerate(_layouts(self._gl)[: 2 + self._faces]):
                self._target.copy_ahead(k, layout, kind, np.dtype(dtype).itemsize)
        self._gl.glFlush()

    def _clear(self) -> None:
        gl = self._gl
        gl.glClearBufferfv(gl.GL_COLOR, 0, np.zeros(4, np.float32))
        for target in (1, 2)[: 1 + self._faces]:
            gl.glClearBufferuiv(gl.GL_COLOR, target, np.zeros(4, np.uint32))
        gl.glClear(gl.GL_DEPTH_BUFFER_BIT)

    def _draw(self, shot: Shot, ranges: Sequence[DrawRange], t: int) -> None:
        gl = self._gl
        for program, r in shot.draws(self._programs, "truth", ranges, t, shot.clip_from_world):
            gl.glUniform1ui(program["part"], r.part + 1)
            gl.glUniform1ui(program["first_face"], r.first // 3)
            draw_range(gl, r)


class CoveragePass:
    """Draws where parts would be visible if nothing were in front of them."""

    def __init__(self, programs: Programs, width: int, height: int) -> None:
        self._programs, self._gl = programs, programs.gl
        self._target = Framebuffer(programs.gl, width, height, [programs.gl.GL_RGBA8], None)

    def draw(
        self, shot: Shot, t: int, group: NDArray[np.int64], where: NDArray[np.int64]
    ) -> NDArray[np.uint32]:
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
        ranges = [r for r in shot.uploaded.array.ranges if drawn[r.part]]
        for program, r in shot.draws(self._programs, "coverage", ranges, t, shot.clip_from_world):
            gl.glScissor(*boxes[r.part].tolist())  # row 0 is OpenGL's lowest, too
            channel, bit = divmod(int(group[r.part]), 8)
            gl.glUniform4f(program["bits"], *((1 << bit) / 255.0 * np.eye(4)[channel]))
            draw_range(gl, r)
        gl.glDisable(gl.GL_SCISSOR_TEST)
        gl.glDisable(gl.GL_COLOR_LOGIC_OP)
        gl.glEnable(gl.GL_DEPTH_TEST)
        width, height = self._target.size
        rgba = np.empty((height, width, 4), np.uint8)
        self._target.read(0, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, rgba)
        return rgba.view("<u4")[..., 0]
