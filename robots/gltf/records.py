"""The objects of a glTF 2.0 file, with the types and bounds of their fields.

Fields that are not read are left out; unknown fields are ignored.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

MAX_OBJECTS = 200_000


class AccessorIndex(int): ...
class BufferIndex(int): ...
class ImageIndex(int): ...
class MaterialIndex(int): ...
class MeshIndex(int): ...
class NodeIndex(int): ...
class SamplerIndex(int): ...
class SceneIndex(int): ...
class SkinIndex(int): ...
class TextureIndex(int): ...
class ViewIndex(int): ...


LISTS: dict[type[int], str] = {
    AccessorIndex: "accessors", BufferIndex: "buffers", ImageIndex: "images",
    MaterialIndex: "materials", MeshIndex: "meshes", NodeIndex: "nodes", SamplerIndex: "samplers",
    SceneIndex: "scenes", SkinIndex: "skins", TextureIndex: "textures", ViewIndex: "bufferViews",
}
"""The list that each type of index refers to."""
Size = Annotated[int, Meta(ge=0, le=2**53)]
GltfCount = Annotated[int, Meta(ge=1, le=2**53)]
GltfNumber = Annotated[float, Meta(ge=-1e30, le=1e30)]
Pair = tuple[GltfNumber, GltfNumber]
Triple = tuple[GltfNumber, GltfNumber, GltfNumber]
Quadruple = tuple[GltfNumber, GltfNumber, GltfNumber, GltfNumber]
Weights = Annotated[list[GltfNumber], Meta(max_length=1000)]
UvSet = Annotated[int, Meta(ge=0, le=15)]
Wrap = Literal[33071, 33648, 10497]
Attributes = dict[str, AccessorIndex]

class GltfObject(msgspec.Struct, rename="camel"):
    """A JSON object."""

class GltfAsset(GltfObject):
    version: Any = None
    min_version: Any = "2.0"
    copyright: Any = None
    extras: Any = None

class SparseIndices(GltfObject):
    buffer_view: ViewIndex
    component_type: Literal[5121, 5123, 5125]
    byte_offset: Size = 0

class SparseValues(GltfObject):
    buffer_view: ViewIndex
    byte_offset: Size = 0

class Sparse(GltfObject):
    count: GltfCount
    indices: SparseIndices
    values: SparseValues

class Accessor(GltfObject):
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    count: GltfCount
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    buffer_view: ViewIndex | None = None
    byte_offset: Size = 0
    normalized: bool = False
    sparse: Sparse | None = None

class AnimationTarget(GltfObject):
    path: str
    node: NodeIndex | None = None

class AnimationChannel(GltfObject):
    sampler: Size  # an index local to the animation, whose reader checks it
    target: AnimationTarget

class AnimationSampler(GltfObject):
    input: AccessorIndex
    output: AccessorIndex
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"

class GltfAnimation(GltfObject):
    channels: list[AnimationChannel]
    samplers: list[AnimationSampler]
    name: str = ""

class Buffer(GltfObject):
    byte_length: GltfCount
    uri: str | None = None

class BufferView(GltfObject):
    buffer: BufferIndex
    byte_length: GltfCount
    byte_offset: Size = 0
    byte_stride: Annotated[int, Meta(ge=4, le=252)] | None = None

class GltfImage(GltfObject):
    uri: str | None = None
    buffer_view: ViewIndex | None = None

class TextureTransform(GltfObject):
    """KHR_texture_transform."""

    offset: Pair = (0.0, 0.0)
    rotation: GltfNumber = 0.0
    scale: Pair = (1.0, 1.0)
    tex_coord: UvSet | None = None

class TextureInfoExtensions(GltfObject):
    transform: TextureTransform | None = field(default=None, name="KHR_texture_transform")

class TextureInfo(GltfObject):
    """Use of a texture; `scale` is a field of normal maps, `strength` one of occlusion maps."""

    index: TextureIndex
    tex_coord: UvSet = 0
    scale: GltfNumber = 1.0
    strength: GltfNumber = 1.0
    extensions: TextureInfoExtensions = field(default_factory=TextureInfoExtensions)

class Pbr(GltfObject):
    base_color_factor: Quadruple = (1.0, 1.0, 1.0, 1.0)
    metallic_factor: GltfNumber = 1.0
    roughness_factor: GltfNumber = 1.0
    base_color_texture: TextureInfo | None = None
    metallic_roughness_texture: TextureInfo | None = None

class SpecularGlossiness(GltfObject):
    """KHR_materials_pbrSpecularGlossiness."""

    diffuse_factor: Quadruple = (1.0, 1.0, 1.0, 1.0)
    specular_factor: Triple = (1.0, 1.0, 1.0)
    glossiness_factor: GltfNumber = 1.0
    diffuse_texture: TextureInfo | None = None
    specular_glossiness_texture: TextureInfo | None = None

class EmissiveStrength(GltfObject):
    """KHR_materials_emissive_strength."""

    emissive_strength: GltfNumber = 1.0

class MaterialExtensions(GltfObject):
    emissive_strength: EmissiveStrength = field(
        default_factory=EmissiveStrength, name="KHR_materials_emissive_strength")
    glossy: SpecularGlossiness | None = field(
        default=None, name="KHR_materials_pbrSpecularGlossiness")
    unlit: dict[str, Any] | None = field(default=None, name="KHR_materials_unlit")

class GltfMaterial(GltfObject):
    name: str = ""
    pbr: Pbr = field(default_factory=Pbr, name="pbrMetallicRoughness")
    normal_texture: TextureInfo | None = None
    occlusion_texture: TextureInfo | None = None
    emissive_texture: TextureInfo | None = None
    emissive_factor: Triple = (0.0, 0.0, 0.0)
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: GltfNumber = 0.5
    extensions: MaterialExtensions = field(default_factory=MaterialExtensions)

class Primitive(GltfObject):
    attributes: Attributes
    indices: AccessorIndex | None = None
    mode: Annotated[int, Meta(ge=0, le=6)] = 4
    material: MaterialIndex | None = None
    targets: Annotated[list[Attributes], Meta(max_length=1000)] = []

class GltfMesh(GltfObject):
    primitives: Annotated[list[Primitive], Meta(min_length=1)]
    weights: Weights | None = None

class GltfNode(GltfObject):
    name: str = ""
    children: list[NodeIndex] = []
    mesh: MeshIndex | None = None
    skin: SkinIndex | None = None
    translation: Triple | None = None
    rotation: Quadruple | None = None
    scale: Triple | None = None
    matrix: Annotated[list[GltfNumber], Meta(min_length=16, max_length=16)] | None = None
    weights: Weights | None = None

class GltfSampler(GltfObject):
    wrap_s: Wrap = 10497
    wrap_t: Wrap = 10497

class GltfScene(GltfObject):
    name: str = ""
    nodes: list[NodeIndex] = []

class GltfSkin(GltfObject):
    joints: Annotated[list[NodeIndex], Meta(min_length=1)]
    inverse_bind_matrices: AccessorIndex | None = None

class WebpSource(GltfObject):
    """EXT_texture_webp."""

    source: ImageIndex | None = None

class TextureExtensions(GltfObject):
    webp: WebpSource = field(default_factory=WebpSource, name="EXT_texture_webp")

class GltfTexture(GltfObject):
    sampler: SamplerIndex | None = None
    source: ImageIndex | None = None
    extensions: TextureExtensions = field(default_factory=TextureExtensions)

class Gltf(GltfObject):
    accessors: list[Accessor] = []
    animations: Annotated[list[GltfAnimation], Meta(max_length=MAX_OBJECTS)] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    images: list[GltfImage] = []
    materials: list[GltfMaterial] = []
    meshes: list[GltfMesh] = []
    nodes: list[GltfNode] = []
    samplers: list[GltfSampler] = []
    scene: SceneIndex | None = None
    scenes: list[GltfScene] = []
    skins: list[GltfSkin] = []
    textures: list[GltfTexture] = []
