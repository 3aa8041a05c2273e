"""What a surface's shader must do, and its GLSL: pyrender's shading with a main of our own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...robots.model import Material
from .framebuffers import NoRendererError

_SHADERS = Path(__file__).parent / "shaders"
_ALWAYS = ("USE_METALLIC_MATERIAL", "NORMAL_LOC", "MAX_POINT_LIGHTS", "MAX_SPOT_LIGHTS")
TEXTURE_UNITS = {
    "base_color": 0, "metallic_roughness": 9, "normal": 10, "occlusion": 11, "emissive": 12,
}
"""By pyrender's names of the textures; shadow maps take the units between."""
Features = frozenset[str]
"""Macros that select what the shaders of a surface do."""


def textures_of(material: Material) -> dict[str, NDArray[np.uint8]]:
    """Return the textures that a material has, by pyrender's names."""
    maps = material.maps
    pictures = (material.texture, maps.metallic_roughness, maps.normal, maps.occlusion,
                maps.emission)
    named = zip(TEXTURE_UNITS, pictures, strict=True)
    return {name: picture for name, picture in named if picture is not None}


def features_of(material: Material, colored: bool = False) -> Features:
    """Return what a material needs on a surface with or without vertex colours."""
    textures = textures_of(material)
    macros = {
        "TEXCOORD_0_LOC": bool(textures), "COLOR_0_LOC": colored, "UNLIT": material.unlit,
        "CUT": material.alpha_cutoff is not None,
    } | {f"HAS_{name.upper()}_TEX": True for name in textures}
    return Features(name for name, wanted in macros.items() if wanted)


def shader_source(name: str) -> str:
    """Return the text of a shader file."""
    return (_SHADERS / name).read_text()


def surface_shaders(
    pyrender_text: str, features: Features, lights: int, shadows: bool
) -> tuple[str, str]:
    """Return the vertex and the fragment shader of a coloured surface.

    `pyrender_text` is pyrender's mesh.frag. Its declarations and functions (structures, shadows)
    stay as they are; main and the light's reflection are those of surface.frag.glsl. The number of
    lights is a constant because GLSL 3.30 indexes samplers by constants only.
    """
    declarations = pyrender_text.partition("void main()")[0]
    if not declarations.startswith("#version") or "shadow_calc" not in declarations:
        raise NoRendererError("pyrender's mesh.frag has changed; install "
                              "scikit-robot-pyrender 0.1.50")
    names = [*_ALWAYS, *sorted(features), *["DIRECTIONAL_LIGHT_SHADOWS"] * shadows]
    macros = [f"#define {name} 1" for name in names]
    macros.append(f"#define MAX_DIRECTIONAL_LIGHTS {lights}")

    def define(text: str) -> str:
        version, _, rest = text.partition("\n")
        return "\n".join([version, *macros, rest])

    return (define(shader_source("surface.vert.glsl")),
            define(f"{declarations}\n{shader_source('surface.frag.glsl')}"))
