"""Textures on the device: pictures and shadow maps.

Functions are handed the module of OpenGL's functions (`Context.gl`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.model import Tiling

SHADOW_SIZE = 2048
"""px a side of a shadow map"""


def picture_texture(gl: Any, picture: NDArray[np.uint8], repeat: bool = True,
                    tiling: tuple[Tiling, Tiling] = ("repeat", "repeat")) -> int:
    """A mipmapped texture whose row 0 is the picture's bottom (v = 0); without `repeat`, one that
    is shown once, as it is.
    """
    texture = int(gl.glGenTextures(1))
    gl.glActiveTexture(gl.GL_TEXTURE0)
    gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
    data = np.ascontiguousarray(picture[::-1])
    layout = {1: gl.GL_RED, 3: gl.GL_RGB, 4: gl.GL_RGBA}[data.shape[2]]
    height, width = data.shape[:2]
    gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_RGBA8, width, height, 0, layout,
                    gl.GL_UNSIGNED_BYTE, data)
    modes = {"repeat": gl.GL_REPEAT, "mirror": gl.GL_MIRRORED_REPEAT,
             "clamp": gl.GL_CLAMP_TO_EDGE}
    wrap = [modes[t] for t in tiling] if repeat else [gl.GL_CLAMP_TO_EDGE] * 2
    smaller = gl.GL_LINEAR_MIPMAP_LINEAR if repeat else gl.GL_LINEAR
    for name, value in (
        (gl.GL_TEXTURE_WRAP_S, wrap[0]), (gl.GL_TEXTURE_WRAP_T, wrap[1]),
        (gl.GL_TEXTURE_MIN_FILTER, smaller), (gl.GL_TEXTURE_MAG_FILTER, gl.GL_LINEAR),
    ):
        gl.glTexParameteri(gl.GL_TEXTURE_2D, name, value)
    if repeat:
        gl.glGenerateMipmap(gl.GL_TEXTURE_2D)
    return texture


def shadow_texture(gl: Any) -> int:
    """A depth texture of SHADOW_SIZE px a side; what lies outside it is lit."""
    texture = int(gl.glGenTextures(1))
    gl.glActiveTexture(gl.GL_TEXTURE0)
    gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
    gl.glTexImage2D(gl.GL_TEXTURE_2D, 0, gl.GL_DEPTH_COMPONENT24, SHADOW_SIZE, SHADOW_SIZE,
                    0, gl.GL_DEPTH_COMPONENT, gl.GL_FLOAT, None)
    for name, value in (
        (gl.GL_TEXTURE_WRAP_S, gl.GL_CLAMP_TO_BORDER),
        (gl.GL_TEXTURE_WRAP_T, gl.GL_CLAMP_TO_BORDER),
        (gl.GL_TEXTURE_MIN_FILTER, gl.GL_NEAREST), (gl.GL_TEXTURE_MAG_FILTER, gl.GL_NEAREST),
    ):
        gl.glTexParameteri(gl.GL_TEXTURE_2D, name, value)
    gl.glTexParameterfv(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))
    return texture


def delete_textures(gl: Any, textures: Sequence[int]) -> None:
    if textures:
        gl.glDeleteTextures(len(textures), list(textures))
