"""What a surface's shader must do, and its GLSL: pyrender's shading with a main of our own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...robots.model import Material
from .framebuffers import NoRendererError

_SHADERS = Path(__file__).parent / "shaders"


@dataclass(frozen=True)
class ShaderFeatures:
    """Which features of the shader a surface needs."""

    textured: bool = False
    metallic_roughness: bool = False
    normal: bool = False
    occlusion: bool = False
    emission: bool = False
    colored: bool = False
    """has vertex colours"""
    unlit: bool = False
    cut: bool = False
    """alpha cuts holes"""

    @property
    def uses_uv(self) -> bool:
        """Whether the surface has any texture."""
        return (self.textured or self.metallic_roughness or self.normal or self.occlusion
                or self.emission)


def features_of(material: Material, colored: bool = False) -> ShaderFeatures:
    """Return what a material needs on a surface with or without vertex colours."""
    maps = material.maps
    return ShaderFeatures(
        material.texture is not None, maps.metallic_roughness is not None, maps.normal is not None,
        maps.occlusion is not None, maps.emission is not None, colored, material.unlit,
        material.alpha_cutoff is not None)


def shader_source(name: str) -> str:
    """Return the text of a shader file."""
    return (_SHADERS / name).read_text()


def surface_vertex_shader(features: ShaderFeatures) -> str:
    """Return the vertex shader of a coloured surface."""
    text = shader_source("surface.vert.glsl")
    return text.replace("TEXTURED", str(int(features.uses_uv))).replace(
        "COLORED", str(int(features.colored)))


def surface_fragment_shader(
    pyrender_text: str, features: ShaderFeatures, lights: int, shadows: bool
) -> str:
    """Return the fragment shader of a coloured surface, for a fixed number of lights.

    `pyrender_text` is pyrender's mesh.frag. Its declarations and functions (structures, BRDF,
    shadows) stay as they are; its main is replaced by surface.frag.glsl. The number of lights is
    a constant because GLSL 3.30 indexes samplers by constants only.
    """
    defines = {"USE_METALLIC_MATERIAL": True, "NORMAL_LOC": True, "MAX_POINT_LIGHTS": True,
               "MAX_SPOT_LIGHTS": True, "TEXCOORD_0_LOC": features.uses_uv,
               "HAS_BASE_COLOR_TEX": features.textured,
               "HAS_METALLIC_ROUGHNESS_TEX": features.metallic_roughness,
               "HAS_NORMAL_TEX": features.normal, "HAS_OCCLUSION_TEX": features.occlusion,
               "HAS_EMISSIVE_TEX": features.emission, "COLOR_0_LOC": features.colored,
               "DIRECTIONAL_LIGHT_SHADOWS": shadows, "UNLIT": features.unlit, "CUT": features.cut}
    macros = [f"#define {name} 1" for name, wanted in defines.items() if wanted]
    version, _, declarations = pyrender_text.partition("void main()")[0].partition("\n")
    if not version.startswith("#version") or "compute_brdf" not in declarations:
        raise NoRendererError("pyrender's mesh.frag has changed; install "
                              "scikit-robot-pyrender 0.1.50")
    macros.append(f"#define MAX_DIRECTIONAL_LIGHTS {lights}")
    return "\n".join([version, *macros, declarations, shader_source("surface.frag.glsl")])
