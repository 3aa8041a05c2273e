"""Framebuffers and textures: the images on the device.

Functions take the module of OpenGL's functions (`GLContext.gl`) as `gl`.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RenderError
from ...robots.model import Tiling

SHADOW_SIZE = 2048  # px a side of a shadow map


class NoRendererError(RenderError):
    """No EGL device of this machine can draw."""


class Framebuffer:
    """A framebuffer with colour attachments and a depth buffer."""

    def __init__(
        self, gl: Any, width: int, height: int, formats: Sequence[Any], depth: Any
    ) -> None:
        self._gl, self.size, self._attachments = gl, (width, height), len(formats)
        self._copies: dict[int, int] = {}  # pixel buffer of each attachment, once it is needed
        self._copied: set[int] = set()  # attachments whose buffer holds what was drawn last
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
        """Draw into this framebuffer from now on."""
        self._copied.clear()
        self._gl.glBindFramebuffer(self._gl.GL_FRAMEBUFFER, self.id)
        self._gl.glViewport(0, 0, *self.size)

    def bind_depth(self, texture: int) -> None:
        """Draw depth into a texture from now on."""
        gl = self._gl
        self.bind()
        gl.glFramebufferTexture2D(
            gl.GL_FRAMEBUFFER, gl.GL_DEPTH_ATTACHMENT, gl.GL_TEXTURE_2D, texture, 0
        )

    def copy_to(self, other: Framebuffer) -> None:
        """Copy every attachment to a target of the same kind."""
        gl = self._gl
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self.id)
        gl.glBindFramebuffer(gl.GL_DRAW_FRAMEBUFFER, other.id)
        points = [gl.GL_COLOR_ATTACHMENT0 + k for k in range(self._attachments)]
        for k, point in enumerate(points):
            gl.glReadBuffer(point)
            gl.glDrawBuffers(k + 1, [gl.GL_NONE] * k + [point])
            bits = gl.GL_COLOR_BUFFER_BIT | (gl.GL_DEPTH_BUFFER_BIT if k == 0 else 0)
            box = (0, 0, *self.size)
            gl.glBlitFramebuffer(*box, *box, bits, gl.GL_NEAREST)
        gl.glDrawBuffers(len(points), points)

    def read(self, attachment: int, layout: Any, kind: Any, out: NDArray[Any]) -> None:
        """Copy a colour attachment into `out`; waits until it is drawn."""
        gl = self._gl
        if attachment in self._copied:
            self._copied.remove(attachment)
            gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, self._copies[attachment])
            data = out.reshape(-1).view(np.uint8)  # PyOpenGL would convert another type
            gl.glGetBufferSubData(gl.GL_PIXEL_PACK_BUFFER, 0, data.nbytes, data)
            gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, 0)
            return
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self.id)
        gl.glReadBuffer(gl.GL_COLOR_ATTACHMENT0 + attachment)
        gl.glReadPixels(0, 0, *self.size, layout, kind, out)

    def copy_ahead(self, attachment: int, layout: Any, kind: Any, pixel: int) -> None:
        """Have the device copy a colour attachment, of `pixel` bytes a pixel, for a later `read`.

        The caller does not wait. Software renderers would: for them it is of no use.
        """
        gl, (width, height) = self._gl, self.size
        if attachment not in self._copies:
            self._copies[attachment] = int(gl.glGenBuffers(1))
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self.id)
        gl.glReadBuffer(gl.GL_COLOR_ATTACHMENT0 + attachment)
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, self._copies[attachment])
        gl.glBufferData(
            gl.GL_PIXEL_PACK_BUFFER, pixel * width * height, None, gl.GL_STREAM_READ)
        gl.glReadPixels(0, 0, width, height, layout, kind, c_void_p(0))
        gl.glBindBuffer(gl.GL_PIXEL_PACK_BUFFER, 0)
        self._copied.add(attachment)


def picture_texture(
    gl: Any, picture: NDArray[np.uint8], tiling: tuple[Tiling, Tiling] | None
) -> int:
    """Upload a picture [H W 1|3|4]: mipmapped, with row 0 of the texture at its bottom (v = 0).

    Without `tiling` the texture has no mipmaps and is shown once.
    """
    data = np.ascontiguousarray(picture[::-1])
    layout = {1: gl.GL_RED, 3: gl.GL_RGB, 4: gl.GL_RGBA}[data.shape[2]]
    height, width = data.shape[:2]
    modes = {"repeat": gl.GL_REPEAT, "mirror": gl.GL_MIRRORED_REPEAT,
             "clamp": gl.GL_CLAMP_TO_EDGE}
    wrap_s, wrap_t = (modes[t] for t in tiling or ("clamp", "clamp"))
    smaller = gl.GL_LINEAR_MIPMAP_LINEAR if tiling else gl.GL_LINEAR
    texture = _new_texture(gl, wrap_s, wrap_t, smaller, gl.GL_LINEAR)
    gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_RGBA8, width, height, 0, layout,
                    gl.GL_UNSIGNED_BYTE, data)
    if tiling:
        gl.glGenerateMipmap(gl.GL_TEXTURE_2D)
    return texture


class TextureCache:
    """Tiled textures of pictures, uploaded on first use. The caller keeps the pictures alive."""

    def __init__(self, gl: Any) -> None:
        self._gl = gl
        self._made: dict[tuple[int, tuple[Tiling, Tiling]], int] = {}

    def texture(self, picture: NDArray[np.uint8], tiling: tuple[Tiling, Tiling]) -> int:
        """Return the texture of a picture."""
        key = id(picture), tiling
        if key not in self._made:
            self._made[key] = picture_texture(self._gl, picture, tiling)
        return self._made[key]

    def delete(self) -> None:
        """Free the textures."""
        delete_textures(self._gl, [*self._made.values()])


def shadow_texture(gl: Any) -> int:
    """Make a depth texture of SHADOW_SIZE px a side; what lies outside it is lit."""
    border = gl.GL_CLAMP_TO_BORDER
    texture = _new_texture(gl, border, border, gl.GL_NEAREST, gl.GL_NEAREST)
    gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE,
                    0, gl.GL_DEPTH_COMPONENT, gl.GL_FLOAT, None)
    gl.glTexParameterfv(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))
    return texture


def _new_texture(gl: Any, wrap_s: Any, wrap_t: Any, smaller: Any, larger: Any) -> int:
    """A texture, bound to unit 0."""
    texture = int(gl.glGenTextures(1))
    gl.glActiveTexture(gl.GL_TEXTURE0)
    gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
    for name, value in ((gl.GL_TEXTURE_WRAP_S, wrap_s), (gl.GL_TEXTURE_WRAP_T, wrap_t),
                        (gl.GL_TEXTURE_MIN_FILTER, smaller), (gl.GL_TEXTURE_MAG_FILTER, larger)):
        gl.glTexParameteri(gl.GL_TEXTURE_2D, name, value)
    return texture


def delete_textures(gl: Any, textures: Sequence[int]) -> None:
    """Free textures."""
    if textures:
        gl.glDeleteTextures(len(textures), list(textures))
