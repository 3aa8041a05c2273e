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
Count = Annotated[int, Meta(ge=1, le=2**53)]
Number = Annotated[float, Meta(ge=-1e30, le=1e30)]
Pair = tuple[Number, Number]
Triple = tuple[Number, Number, Number]
Quadruple = tuple[Number, Number, Number, Number]
Weights = Annotated[list[Number], Meta(max_length=1000)]
UvSet = Annotated[int, Meta(ge=0, le=15)]
Wrap = Literal[33071, 33648, 10497]
Attributes = dict[str, AccessorIndex]

class Record(msgspec.Struct, rename="camel"):
    """A JSON object."""

class Asset(Record):
    version: Any = None
    min_version: Any = "2.0"
    copyright: Any = None
    extras: Any = None

class SparseIndices(Record):
    buffer_view: ViewIndex
    component_type: Literal[5121, 5123, 5125]
    byte_offset: Size = 0

class SparseValues(Record):
    buffer_view: ViewIndex
    byte_offset: Size = 0

class Sparse(Record):
    count: Count
    indices: SparseIndices
    values: SparseValues

class Accessor(Record):
    component_type: Literal[5120, 5121, 5122, 5123, 5125, 5126]
    count: Count
    type: Literal["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"]
    buffer_view: ViewIndex | None = None
    byte_offset: Size = 0
    normalized: bool = False
    sparse: Sparse | None = None

class AnimationTarget(Record):
    path: str
    node: NodeIndex | None = None

class AnimationChannel(Record):
    sampler: Size  # an index local to the animation, whose reader checks it
    target: AnimationTarget

class AnimationSampler(Record):
    input: AccessorIndex
    output: AccessorIndex
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"

class Animation(Record):
    channels: list[AnimationChannel]
    samplers: list[AnimationSampler]
    name: str = ""

class Buffer(Record):
    byte_length: Count
    uri: str | None = None

class BufferView(Record):
    buffer: BufferIndex
    byte_length: Count
    byte_offset: Size = 0
    byte_stride: Annotated[int, Meta(ge=4, le=252)] | None = None

class Image(Record):
    uri: str | None = None
    buffer_view: ViewIndex | None = None

class TextureTransform(Record):
    """KHR_texture_transform."""

    offset: Pair = (0.0, 0.0)
    rotation: Number = 0.0
    scale: Pair = (1.0, 1.0)
    tex_coord: UvSet | None = None

class TextureInfoExtensions(Record):
    transform: TextureTransform | None = field(default=None, name="KHR_texture_transform")

class TextureInfo(Record):
    """Use of a texture; `scale` is a field of normal maps, `strength` one of occlusion maps."""

    index: TextureIndex
    tex_coord: UvSet = 0
    scale: Number = 1.0
    strength: Number = 1.0
    extensions: TextureInfoExtensions = field(default_factory=TextureInfoExtensions)

class Pbr(Record):
    base_color_factor: Quadruple = (1.0, 1.0, 1.0, 1.0)
    metallic_factor: Number = 1.0
    roughness_factor: Number = 1.0
    base_color_texture: TextureInfo | None = None
    metallic_roughness_texture: TextureInfo | None = None

class SpecularGlossiness(Record):
    """KHR_materials_pbrSpecularGlossiness."""

    diffuse_factor: Quadruple = (1.0, 1.0, 1.0, 1.0)
    specular_factor: Triple = (1.0, 1.0, 1.0)
    glossiness_factor: Number = 1.0
    diffuse_texture: TextureInfo | None = None
    specular_glossiness_texture: TextureInfo | None = None

class EmissiveStrength(Record):
    """KHR_materials_emissive_strength."""

    emissive_strength: Number = 1.0

class MaterialExtensions(Record):
    emissive_strength: EmissiveStrength = field(
        default_factory=EmissiveStrength, name="KHR_materials_emissive_strength")
    glossy: SpecularGlossiness | None = field(
        default=None, name="KHR_materials_pbrSpecularGlossiness")
    unlit: dict[str, Any] | None = field(default=None, name="KHR_materials_unlit")

class Material(Record):
    name: str = ""
    pbr: Pbr = field(default_factory=Pbr, name="pbrMetallicRoughness")
    normal_texture: TextureInfo | None = None
    occlusion_texture: TextureInfo | None = None
    emissive_texture: TextureInfo | None = None
    emissive_factor: Triple = (0.0, 0.0, 0.0)
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: Number = 0.5
    extensions: MaterialExtensions = field(default_factory=MaterialExtensions)

class Primitive(Record):
    attributes: Attributes
    indices: AccessorIndex | None = None
    mode: Annotated[int, Meta(ge=0, le=6)] = 4
    material: MaterialIndex | None = None
    targets: Annotated[list[Attributes], Meta(max_length=1000)] = []

class Mesh(Record):
    primitives: Annotated[list[Primitive], Meta(min_length=1)]
    weights: Weights | None = None

class Node(Record):
    name: str = ""
    children: list[NodeIndex] = []
    mesh: MeshIndex | None = None
    skin: SkinIndex | None = None
    translation: Triple | None = None
    rotation: Quadruple | None = None
    scale: Triple | None = None
    matrix: Annotated[list[Number], Meta(min_length=16, max_length=16)] | None = None
    weights: Weights | None = None

class Sampler(Record):
    wrap_s: Wrap = 10497
    wrap_t: Wrap = 10497

class Scene(Record):
    name: str = ""
    nodes: list[NodeIndex] = []

class Skin(Record):
    joints: Annotated[list[NodeIndex], Meta(min_length=1)]
    inverse_bind_matrices: AccessorIndex | None = None

class WebpSource(Record):
    """EXT_texture_webp."""

    source: ImageIndex | None = None

class TextureExtensions(Record):
    webp: WebpSource = field(default_factory=WebpSource, name="EXT_texture_webp")

class Texture(Record):
    sampler: SamplerIndex | None = None
    source: ImageIndex | None = None
    extensions: TextureExtensions = field(default_factory=TextureExtensions)

class Gltf(Record):
    accessors: list[Accessor] = []
    animations: Annotated[list[Animation], Meta(max_length=MAX_OBJECTS)] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    images: list[Image] = []
    materials: list[Material] = []
    meshes: list[Mesh] = []
    nodes: list[Node] = []
    samplers: list[Sampler] = []
    scene: SceneIndex | None = None
    scenes: list[Scene] = []
    skins: list[Skin] = []
    textures: list[Texture] = []
