"""The one module that imports OpenGL: contexts and programs.

pyrender provides the EGL platform and the functions of the physically based shading (programs.py).
"""

# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...robots.geometry import Array
from ..scene import Scene
from ..types import Camera
from .devices import (
    DEVICE_VARIABLE,
    EglDevice,
    choose_devices,
    examine_device,
    is_drawn_by_software,
)
from .framebuffers import NoRendererError
from .programs import Features, shader_source, surface_shaders

os.environ["PYOPENGL_PLATFORM"] = "egl"  # the only one that this package draws with
os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyrender loads pyglet, which would load X11
_INSTALL = ("for software rendering on Debian or Ubuntu: "
            "apt-get install libegl1 libgl1 libgl1-mesa-dri")


class GLContext:
    """An EGL context on the first device that draws; GPUs are tried before software.

    The environment variable `EGL_DEVICE_ID` (`gcbench render --device`) chooses a device. Who
    chooses a GPU never gets software in its place. Raises NoRendererError with the reason of each
    device.
    """

    def __init__(self) -> None:
        (egl, devices), wanted = _load_egl(), os.environ.get(DEVICE_VARIABLE, "")
        tried: list[str] = []
        for device in choose_devices(devices, wanted):
            try:
                self._platform: Any = egl.EGLPlatform(1, 1, device.handle)
                self._platform.init_context()
                from OpenGL import GL

                self.gl: Any = GL
                self.renderer = str(self.gl.glGetString(GL.GL_RENDERER).decode())
                self.version = str(self.gl.glGetString(GL.GL_VERSION).decode())
                self.is_software = is_drawn_by_software(self.renderer)
                self.device = device.number
            except Exception as error:
                tried.append(f"device {device.number}: {_reason(error)}")
                continue
            if wanted and not device.is_software and self.is_software:
                tried.append(f"device {device.number}: its driver draws in software "
                             f"({self.renderer})")
                self.close()
                continue
            return
        raise NoRendererError(
            f"no EGL device draws OpenGL 4.1 ({'; '.join(tried)}); update its driver, or "
            f"{_INSTALL}")

    def make_current(self) -> None:
        """Draw in this context from now on, if the process has used another."""
        self._platform.make_current()

    def close(self) -> None:
        """Free the context; the display stays, because other contexts of the process share it."""
        from OpenGL import EGL

        platform = self._platform
        if platform._egl_context is not None:
            EGL.eglMakeCurrent(
                platform._egl_display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
            )
            EGL.eglDestroyContext(platform._egl_display, platform._egl_context)
            platform._egl_context = platform._egl_display = None


def device_names() -> list[str]:
    """Return every EGL device with the names by which it can be chosen, GPUs first."""
    return [device.describe() for device in _load_egl()[1]]


def _load_egl() -> tuple[Any, list[EglDevice]]:
    """pyrender's EGL, and its devices, GPUs first. Raises NoRendererError if there is none."""
    try:
        from pyrender.platforms import egl

        devices = [examine_device(egl, i, device) for i, device in enumerate(egl.query_devices())]
    except ModuleNotFoundError as error:
        raise NoRendererError(
            f"the package {error.name} is missing; pip install scikit-robot-pyrender") from None
    except Exception as error:
        raise NoRendererError(f"EGL cannot be loaded ({_reason(error)}); {_INSTALL}") from None
    if not devices:
        raise NoRendererError(f"EGL reports no device; {_INSTALL}")
    return egl, sorted(devices, key=lambda device: device.is_software)


def _reason(error: BaseException) -> str:
    text = " ".join(str(error).split()) or "no reason given"
    if found := re.search(r"err = (\w+), baseOperation = (\w+)", text):  # of PyOpenGL
        return f"{found[2]} fails with {found[1]}"
    return f"{type(error).__name__}: {text[:200]}"


class Program:
    """A linked program with its uniform locations looked up once."""

    def __init__(self, gl: Any, vertex: str, fragment: str) -> None:
        from OpenGL.GL import shaders

        self._gl = gl
        self.scene: Scene | None = None
        self.camera: Camera | None = None
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
        """Set a uniform matrix [4 4]."""
        data = np.ascontiguousarray(value, np.float32)
        self._gl.glUniformMatrix4fv(self[name], 1, self._gl.GL_TRUE, data)


class Programs:
    """The programs, compiled on first use, and how the passes use them.

    With `faces`, that of the truth tells triangles too. With `copies_ahead`, the passes have the
    device copy what they draw at once, while the caller works.
    """

    def __init__(self, gl: Any, faces: bool = False, copies_ahead: bool = False) -> None:
        self.gl, self.faces, self.copies_ahead = gl, faces, copies_ahead
        self._surface: dict[tuple[Features, int, bool], Program] = {}
        self._solid: dict[tuple[str, bool], Program] = {}
        self.backdrop = Program(
            gl, shader_source("backdrop.vert.glsl"), shader_source("backdrop.frag.glsl"))

    def solid(self, name: str, cut: bool) -> Program:
        """The program of the pass "truth" or "coverage", with or without holes where alpha is low.
        """
        if (name, cut) not in self._solid:
            vertex, fragment = shader_source("truth.vert.glsl"), shader_source(f"{name}.frag.glsl")
            fragment = fragment.replace("FACES", str(int(self.faces))).replace(
                "CUTTING", shader_source("cut.glsl"))
            self._solid[name, cut] = Program(
                self.gl, *(text.replace("#if CUT", f"#if {int(cut)}")
                           for text in (vertex, fragment)))
        return self._solid[name, cut]

    def surface(self, features: Features, lights: int, shadows: bool) -> Program:
        """The program of the colours of a surface, for a number of lights."""
        key = (features, lights, shadows)
        if key not in self._surface:
            import pyrender

            mesh_frag = Path(pyrender.__file__).parent / "shaders" / "mesh.frag"
            self._surface[key] = Program(self.gl, *surface_shaders(mesh_frag.read_text(), *key))
        return self._surface[key]
