"""The one module that imports OpenGL: contexts, programs, targets, buffers, textures.

pyrender gives the EGL platform and the physically based shading (its mesh.frag, unchanged but for
two-sided normals); the drawing is ours (rasterizer.py).
"""

# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import GcbenchError
from ..robots.geometry import Array
from ..robots.model import Material, Tiling
from .scene import Scene

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyrender loads pyglet, which would load X11

SHADOW_SIZE = 2048
_HERE = Path(__file__).parent


class NoRendererError(GcbenchError):
    """No EGL device of this machine can draw."""


@dataclass(frozen=True)
class Surface:
    """Triangles that are drawn with one material and one pose."""

    part: int
    """0-based part, -1 for what stands in the world (the room)."""
    material: int
    """Number of the visual (or of the room's surface) that it belongs to."""
    one_sided: bool
    """Back faces are never seen and are left out."""
    deforms: bool
    """Its vertices are in the camera frame, and change with each frame."""
    first: int
    """First index in the index buffer."""
    count: int


@dataclass(frozen=True)
class Mesh:
    """A vertex array object and the surfaces in it."""

    vao: int
    buffers: tuple[int, ...]
    surfaces: tuple[Surface, ...]
    order: NDArray[np.uint32]
    """[F] number of each triangle of the index buffer, counted through the pieces by `material`."""
    first_vertex: dict[int, int]
    """Of each piece, by `material`."""


@dataclass(frozen=True)
class Piece:
    """Triangles to upload."""

    part: int
    material: int
    vertices: Array
    faces: NDArray[np.int32]
    normals: Array
    uv: Array | None
    one_sided: NDArray[np.bool_]
    deforms: bool = False
    color: Array | None = None


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


def upload(gl: Any, pieces: Sequence[Piece]) -> Mesh:
    """One vertex buffer (position, normal, uv) and one index buffer for all pieces."""
    vertices = [np.zeros((0, 8), np.float32)]
    indices = list[tuple[Piece, NDArray[np.uint32]]]()
    base, first_vertex = 0, dict[int, int]()
    for piece in pieces:
        block = np.zeros((len(piece.vertices), 8), np.float32)
        block[:, :3], block[:, 3:6] = piece.vertices, piece.normals
        if piece.uv is not None:
            block[:, 6:] = piece.uv
        vertices.append(block)
        indices.append((piece, np.asarray(piece.faces, np.uint32) + np.uint32(base)))
        first_vertex[piece.material] = base
        base += len(block)
    first_face, faces = dict[int, int](), 0
    for piece in sorted(pieces, key=lambda piece: piece.material):
        first_face[piece.material] = faces
        faces += len(piece.faces)
    # A part's one-sided triangles stand together, as do its others: two draws for its truth.
    index_blocks, surfaces, first = [np.zeros(0, np.uint32)], list[Surface](), 0
    order = [np.zeros(0, np.int64)]
    for part, deforms in dict.fromkeys((piece.part, piece.deforms) for piece in pieces):
        for closed in (True, False):
            for piece, index in indices:
                found = np.flatnonzero(piece.one_sided == closed)
                if (piece.part, piece.deforms) == (part, deforms) and found.size:
                    count = 3 * found.size
                    surfaces.append(Surface(part, piece.material, closed, deforms, first, count))
                    index_blocks.append(index[found].ravel())
                    order.append(first_face[piece.material] + found)
                    first += count
    data = np.concatenate(vertices)
    index = np.concatenate(index_blocks)
    vao = int(gl.glGenVertexArrays(1))
    gl.glBindVertexArray(vao)
    buffers: tuple[int, ...] = (int(gl.glGenBuffers(1)), int(gl.glGenBuffers(1)))
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffers[0])
    gl.glBufferData(gl.GL_ARRAY_BUFFER, max(data.nbytes, 4), data, gl.GL_STATIC_DRAW)
    gl.glBindBuffer(gl.GL_ELEMENT_ARRAY_BUFFER, buffers[1])
    gl.glBufferData(gl.GL_ELEMENT_ARRAY_BUFFER, max(index.nbytes, 4), index, gl.GL_STATIC_DRAW)
    for location, (size, offset) in enumerate(((3, 0), (3, 12), (2, 24))):
        gl.glEnableVertexAttribArray(location)
        gl.glVertexAttribPointer(
            location, size, gl.GL_FLOAT, gl.GL_FALSE, 32, ctypes.c_void_p(offset)
        )
    if any(piece.color is not None for piece in pieces):
        colors = np.concatenate([
            np.ones((len(p.vertices), 4), np.float32) if p.color is None
            else p.color.astype(np.float32) for p in pieces])
        buffers = (*buffers, int(gl.glGenBuffers(1)))
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, buffers[2])
        gl.glBufferData(gl.GL_ARRAY_BUFFER, colors.nbytes, colors, gl.GL_STATIC_DRAW)
        gl.glEnableVertexAttribArray(3)
        gl.glVertexAttribPointer(3, 4, gl.GL_FLOAT, gl.GL_FALSE, 16, ctypes.c_void_p(0))
    gl.glBindVertexArray(0)
    triangles = np.concatenate(order).astype(np.uint32)
    return Mesh(vao, buffers, tuple(surfaces), triangles, first_vertex)


def move_vertices(gl: Any, mesh: Mesh, piece: int, vertices: Array, normals: Array, uv: Array
                  ) -> None:
    """Replace the vertices [V 3], normals [V 3] and uv [V 2] of the piece of that `material`."""
    block = np.concatenate([vertices, normals, uv], axis=1, dtype=np.float32, casting="same_kind")
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, mesh.buffers[0])
    gl.glBufferSubData(gl.GL_ARRAY_BUFFER, 32 * mesh.first_vertex[piece], block.nbytes, block)


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


def delete_mesh(gl: Any, mesh: Mesh | None) -> None:
    """Free a mesh, if there is one."""
    if mesh is not None:
        gl.glDeleteVertexArrays(1, [mesh.vao])
        gl.glDeleteBuffers(len(mesh.buffers), list(mesh.buffers))


def runs_of(surfaces: Iterable[Surface]) -> list[Surface]:
    """The same triangles in fewer draws: neighbours of one part become one surface."""
    runs: list[Surface] = []
    for s in surfaces:
        last = runs[-1] if runs else None
        if (
            last
            and (last.part, last.one_sided, last.deforms) == (s.part, s.one_sided, s.deforms)
            and last.first + last.count == s.first
        ):
            runs[-1] = replace(last, count=last.count + s.count)
        else:
            runs.append(s)
    return runs


def draw_surface(gl: Any, surface: Surface) -> None:
    (gl.glEnable if surface.one_sided else gl.glDisable)(gl.GL_CULL_FACE)
    offset = ctypes.c_void_p(4 * surface.first)
    gl.glDrawElements(gl.GL_TRIANGLES, surface.count, gl.GL_UNSIGNED_INT, offset)


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
