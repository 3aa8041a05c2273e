"""What a surface's shader must do, and pyrender's mesh.frag changed to do it."""

from __future__ import annotations

from dataclasses import dataclass

from ...robots.model import Material
from .targets import NoRendererError


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


def defines_of(look: Look, lights: int, shadows: bool) -> dict[str, int]:
    """The macros that mesh.frag is compiled with."""
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
    return defines


def changed(text: str, look: Look, lights: int) -> str:
    """mesh.frag with what it lacks. Raises NoRendererError if it is not the text that we know."""
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
