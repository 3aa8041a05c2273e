"""Framebuffers: what is drawn into, and read from.

Functions are handed the module of OpenGL's functions (`Context.gl`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from ...errors import RenderError


class NoRendererError(RenderError):
    """No EGL device of this machine can draw."""


class Target:
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

    def copy_to(self, other: Target) -> None:
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
