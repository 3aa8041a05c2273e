"""Reader of COLLADA meshes. It applies the unit, but not the up axis.

The mesh coordinates of a URDF are link coordinates for every `up_axis`: RViz, MoveIt and Gazebo
undo the root rotation of their COLLADA importer, and robot models rely on that.
"""

# pycollada has no types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportUnknownParameterType=false
# pyright: reportMissingTypeStubs=false

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...errors import ModelError
from ..files import Asset, refuse_doctype
from ..geometry import Array
from ..model import Material, TriangleSurface, base_color, clean_surface, mean_color, move_surface
from .asset_reader import AssetReader

_MAX_NODES = 20_000
_MAX_DEPTH = 64


def read_collada(data: bytes, asset: Asset, reader: AssetReader) -> list[TriangleSurface]:
    """Return all triangles of a COLLADA file in metres; raise ModelError or a pycollada error."""
    import collada
    from collada.common import DaeError

    refuse_doctype(data)
    if zipfile.is_zipfile(io.BytesIO(data)):  # pycollada would read a file inside it
        raise ModelError("is a zip archive, not a COLLADA file")
    document = collada.Collada(io.BytesIO(data), ignore=[DaeError])
    document = _without_broken_bindings(document, asset, reader)
    for error in document.errors:
        text = " ".join(str(getattr(error, "msg", error)).split())[:120]
        if not text.startswith(("Camera", "Light")):
            reader.note(f"{asset.path.name}: {text}")
    if document.assetInfo and document.assetInfo.upaxis != "Z_UP" and b"<up_axis" in data:
        reader.note("COLLADA meshes name an up axis other than z; as in RViz it is not applied")
    unit = document.assetInfo.unitmeter if document.assetInfo else None
    meter = 1.0 if unit is None else float(unit)
    if not 1e-9 < meter < 1e9:
        raise ModelError(f"has the unit {meter} m")
    scene = document.scene or next(iter(document.scenes), None)
    if scene is None:
        raise ModelError("has no scene; export it with its nodes")
    materials: dict[int, Material | None] = {}
    shared: dict[tuple[int, int], TriangleSurface | None] = {}
    found: list[TriangleSurface] = []
    triangles = 0
    for matrix, geometry, bindings in _instances(scene.nodes):
        by_symbol = {b.symbol: b.target for b in bindings}
        for primitive in geometry.primitives:
            target = by_symbol.get(primitive.material)
            if target is None and primitive.material in document.materials:
                target = document.materials[primitive.material]
            if id(target) not in materials:
                materials[id(target)] = _material(target, asset, reader)
            key = (id(primitive), id(target))
            if key not in shared:
                shared[key] = _surface(primitive, materials[id(target)])
            made = shared[key]
            if made is None:
                continue
            triangles += len(made.faces)
            if triangles > reader.limits.triangles:
                raise ModelError(f"has more than {reader.limits.triangles} triangles")
            found.append(move_surface(made, matrix * [[meter], [meter], [meter], [1.0]]))
    return found


def _without_broken_bindings(document: Any, asset: Asset, reader: AssetReader) -> Any:
    """Return the document without bindings to missing materials.

    pycollada drops instances with such bindings; a wrong colour is better than a missing part.
    """
    import collada
    from collada.common import DaeError

    known = {f"#{material.id}" for material in document.materials}
    tag = document.tag("instance_material")
    broken = [node for node in document.xmlnode.iter(tag) if node.get("target") not in known]
    if not broken:
        return document
    for node in broken:
        reader.note(f"{asset.path.name}: material {str(node.get('target'))[:80]!r} is broken")
        node.getparent().remove(node)
    repaired = io.BytesIO()
    document.xmlnode.write(repaired)
    repaired.seek(0)
    return collada.Collada(repaired, ignore=[DaeError])


def _instances(roots: Any) -> Iterator[tuple[Array, Any, Any]]:
    """Yield world matrix, geometry and material bindings of each instance in document order."""
    from collada.scene import ControllerNode, GeometryNode, Node

    stack = [(root, np.eye(4), 0) for root in reversed(list(roots))]
    visited = 0
    while stack:
        node, parent, depth = stack.pop()
        visited += 1
        if visited > _MAX_NODES or depth > _MAX_DEPTH:
            raise ModelError(f"has more than {_MAX_NODES} nodes or {_MAX_DEPTH} levels")
        if isinstance(node, GeometryNode):
            yield parent, node.geometry, node.materials
        elif isinstance(node, ControllerNode):
            skin = node.controller
            bind = np.asarray(getattr(skin, "bind_shape_matrix", np.eye(4)), np.float64)
            if hasattr(skin, "geometry"):
                yield parent @ bind.reshape(4, 4), skin.geometry, node.materials
        elif isinstance(node, Node):
            matrix = parent @ np.asarray(node.matrix, np.float64)
            if not np.isfinite(matrix).all():
                raise ModelError("has a node whose transform is not finite")
            stack.extend((child, matrix, depth + 1) for child in reversed(node.children or []))


def _surface(primitive: Any, material: Material | None) -> TriangleSurface | None:
    from collada.polylist import Polylist
    from collada.triangleset import TriangleSet

    if isinstance(primitive, Polylist):
        primitive = primitive.triangleset()
    if not isinstance(primitive, TriangleSet) or primitive.vertex is None:
        return None
    positions = np.asarray(primitive.vertex, np.float64)
    index = np.asarray(primitive.vertex_index, np.int64).reshape(-1, 3)
    if not len(index):
        return None
    # Corners with equal indices share one vertex.
    columns = [index.ravel()]
    normals, uv, color = primitive.normal, None, None
    if normals is not None and primitive.normal_index is not None:
        columns.append(np.asarray(primitive.normal_index, np.int64).ravel())
    if len(primitive.texcoordset):
        columns.append(np.asarray(primitive.texcoord_indexset[0], np.int64).ravel())
    if any(c.min() < 0 or len(c) != len(columns[0]) for c in columns):
        raise ModelError("has broken indices")
    key = columns[0]
    for column in columns[1:]:
        key = np.unique(key, return_inverse=True)[1] * (int(column.max()) + 1) + column
    _, first, faces = np.unique(key, return_index=True, return_inverse=True)
    vertices = positions[columns[0][first]]
    if normals is not None and primitive.normal_index is not None:
        normals = np.asarray(normals)[columns[1][first]]
    if len(primitive.texcoordset):
        uv = np.asarray(primitive.texcoordset[0])[columns[-1][first]]
    colors = primitive.sources.get("COLOR") if material is None else None
    if colors:
        values = np.asarray(colors[0][4].data, np.float64).reshape(len(colors[0][4].data), -1)
        if len(values) and values.shape[1] >= 3 and np.isfinite(values).all():
            texels = np.clip(values[:, None, :3] * 255.0, 0.0, 255.0)
            color = mean_color(texels.astype(np.uint8))
    return clean_surface(vertices, faces.reshape(-1, 3), normals, uv, material, color)


def _material(target: Any, asset: Asset, reader: AssetReader) -> Material | None:
    """Return a COLLADA material as a flat colour or texture; None without an effect."""
    from collada.material import Map

    effect = getattr(target, "effect", None)
    if effect is None:
        return None
    name = str(getattr(target, "name", None) or getattr(target, "id", "") or "")
    diffuse, texture = effect.diffuse, None
    if isinstance(diffuse, Map):
        reference = str(diffuse.sampler.surface.image.path or "")
        texture = reader.nested_texture(asset, reference)
        diffuse = [1.0, 1.0, 1.0, 1.0] if texture is not None else [0.5, 0.5, 0.5, 1.0]
    if diffuse is None:  # <constant> effects emit their colour
        emission = effect.emission
        diffuse = [0.5, 0.5, 0.5] if emission is None or isinstance(emission, Map) else emission
    rgba = np.asarray(diffuse, np.float64).reshape(-1)
    if len(rgba) < 3 or not np.isfinite(rgba).all():
        raise ModelError(f"has a bad colour in material {name!r}")
    color = base_color(rgba[:3])
    return Material(name, (*color[:3], _alpha(effect, rgba)), texture=texture)


def _alpha(effect: Any, rgba: Array) -> float:
    """Return the opacity as COLLADA defines it; values near 0 are exporter errors and become 1."""
    from collada.material import OPAQUE_MODE

    share, mask = effect.transparency, effect.transparent
    try:
        share = 1.0 if share is None else float(share)
        values = np.asarray([1.0, 1.0, 1.0, 1.0] if mask is None else mask, np.float64)
        if mask is None and effect.transparency is None:
            alpha = float(rgba[3]) if len(rgba) > 3 else 1.0
        elif effect.opaque_mode == OPAQUE_MODE.RGB_ZERO:
            alpha = 1.0 - share * float(values[:3] @ [0.2126, 0.7152, 0.0722])
        else:
            alpha = share * float(values[3] if len(values) > 3 else 1.0)
    except (TypeError, ValueError):
        return 1.0
    return alpha if 0.01 < alpha <= 1.0 else 1.0
