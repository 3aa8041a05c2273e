"""The one module that imports OpenGL: contexts, programs and targets.

pyrender gives the EGL platform and the physically based shading (its mesh.frag, unchanged but for
two-sided normals); the drawing is ours (rasterizer.py).
"""

# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import GcbenchError
from ..robots.geometry import Array
from ..robots.model import Material
from .scene import Scene

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyrender loads pyglet, which would load X11

_HERE = Path(__file__).parent


class NoRendererError(GcbenchError):
    """No EGL device of this machine can draw."""


@dataclass(frozen=True)
class Look:
    """Which features of the shader a surface needs."""

    textured: bool = False
    metallic_roughness: bool = False
    normal: bool = False
    occlusion: bool = False
    emission: bool = False
    colored: bool = False
    """Has vertex colours."""
    unlit: bool = False
    cut: bool = False

    @property
    def uses_uv(self) -> bool:
        return (self.textured or self.metallic_roughness or self.normal or self.occlusion
                or self.emission)


def look_of(material: Material, colored: bool = False) -> Look:
    """What draws a material on a surface with or without vertex colours."""
    maps = material.maps
    return Look(
        material.texture is not None, maps.metallic_roughness is not None, maps.normal is not None,
        maps.occlusion is not None, maps.emission is not None, colored, material.unlit,
        material.alpha_cutoff is not None)


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


class Program:
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


class Programs:
    """The programs, compiled when first used.

    With `faces`, that of the truth tells triangles too.
    """

    def __init__(self, gl: Any, faces: bool = False) -> None:
        self._gl, self._faces = gl, faces
        self._surface: dict[tuple[Look, int, bool], Program] = {}
        self._solid: dict[tuple[str, bool], Program] = {}
        self.truth = self.solid("truth", False)
        self.backdrop = Program(gl, _source("backdrop.vert.glsl"), _source("backdrop.frag.glsl"))

    def solid(self, name: str, cut: bool) -> Program:
        """The program of the pass "truth" or "coverage", with or without holes where alpha is low.
        """
        if (name, cut) not in self._solid:
            vertex, fragment = _source("truth.vert.glsl"), _source(f"{name}.frag.glsl")
            fragment = fragment.replace("FACES", str(int(self._faces))).replace(
                "CUTTING", _source("cut.glsl"))
            self._solid[name, cut] = Program(
                self._gl, *(text.replace("#if CUT", f"#if {int(cut)}")
                            for text in (vertex, fragment)))
        return self._solid[name, cut]

    def surface(self, look: Look, lights: int, shadows: bool) -> Program:
        """pyrender's shading for this many lights (a constant, so that samplers may be indexed)."""
        key = (look, lights, shadows)
        if key not in self._surface:
            vertex = _source("surface.vert.glsl").replace(
                "TEXTURED", str(int(look.uses_uv))).replace("COLORED", str(int(look.colored)))
            fragment = _pyrender_fragment_shader(*key)
            self._surface[key] = Program(self._gl, vertex, fragment)
        return self._surface[key]


def _source(name: str) -> str:
    return (_HERE / name).read_text()


def _pyrender_fragment_shader(look: Look, lights: int, shadows: bool) -> str:
    import pyrender
    from pyrender.shader_program import ShaderProgram

    path = Path(pyrender.__file__).parent / "shaders" / "mesh.frag"
    defines = {"USE_METALLIC_MATERIAL": 1, "NORMAL_LOC": 1, "MAX_POINT_LIGHTS": 1,
               "MAX_SPOT_LIGHTS": 1, "MAX_DIRECTIONAL_LIGHTS": lights}
    for wanted, define in (
        (look.uses_uv, "TEXCOORD_0_LOC"), (look.textured, "HAS_BASE_COLOR_TEX"),
        (look.metallic_roughness, "HAS_METALLIC_ROUGHNESS_TEX"), (look.normal, "HAS_NORMAL_TEX"),
        (look.occlusion, "HAS_OCCLUSION_TEX"), (look.emission, "HAS_EMISSIVE_TEX"),
        (look.colored, "COLOR_0_LOC"), (shadows, "DIRECTIONAL_LIGHT_SHADOWS"),
    ):
        if wanted:
            defines[define] = 1
    program: Any = ShaderProgram(None, None, defines=defines)
    text = str(program._load(str(path)))
    changes = [
        ("vec3 n = normalize(get_normal());",
         "vec3 n = normalize(get_normal()); if (!gl_FrontFacing) n = -n;"),
        ("i < n_directional_lights", f"i < {lights}"),
        ("i < n_point_lights", "i < 0"),
        ("i < n_spot_lights", "i < 0"),
        # glTF 2.0 has roughness in green and metallic in blue, and emission once
        ("metallic_roughness_texture, uv_0).rg", "metallic_roughness_texture, uv_0).gb"),
        ("color.xyz += emissive * material.emissive_factor;", "color.xyz += emissive;"),
        # vertex colours belong to the base colour, not to what shines from it
        ("color *= color_multiplier;", ""),
        ("    // Compute specular and diffuse colors", _BASE_COLOR
         + ("    base_color *= color_multiplier;\n" if look.colored else "")
         + ("    if (base_color.a < alpha_cutoff) discard;\n" if look.cut else "")),
        ("uniform Material material;", "uniform Material material;\nuniform float alpha_cutoff;"),
        # mirrored textures have their second axis on the other side
        ("vec3 b = normalize(cross(ng, t));",
         "vec3 b = cross(ng, t); float turn = tex_dx.s * tex_dy.t - tex_dy.s * tex_dx.t;\n"
         "    if (abs(turn) < 1e-20) return ng;\n"
         "    if (dot(b, (tex_dx.s * pos_dy - tex_dy.s * pos_dx) / turn) < 0.0) b = -b;"),
    ]
    if look.unlit:
        changes.append(("    // Apply occlusion", "    color.xyz = base_color.rgb;"))
    for old, new in changes:
        if old not in text:
            raise NoRendererError(f"pyrender's mesh.frag has changed: {old!r} is not in it; "
                                  "install scikit-robot-pyrender 0.1.50")
        text = text.replace(old, new)
    return text


_BASE_COLOR = "    // Vertex colours, holes; then specular and diffuse colors\n"
