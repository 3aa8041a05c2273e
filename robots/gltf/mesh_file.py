"""A glTF file as the mesh of a link: its surfaces in the frame of its scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...errors import ModelError
from ..files import Asset
from ..geometry import Array, transform
from ..meshes import AssetReader
from ..model import TriangleSurface, Visual, clean_surface, deform_visual
from .accessors import Accessors
from .document import GltfDocument, read_gltf_document
from .materials import Materials
from .meshes import Meshes, bound_visual, move_patch, skinned_visuals
from .nodes import node_tree
from .rest import inverse_binds, rest_weights


def read_gltf_surfaces(data: bytes, asset: Asset, reader: AssetReader) -> list[TriangleSurface]:
    """Return the surfaces of a glTF file, m; raise ModelError.

    The axes are the file's own. Skins and morph targets are at rest, vertex colours are ignored.
    """
    document = read_gltf_document(data)
    accessors = Accessors(document, asset, reader)
    materials = Materials(document, accessors, reader.textures, allow_missing=True)
    meshes = Meshes(document, accessors, materials)
    tree = node_tree(document)
    world = {-1: np.eye(4)}
    for n in tree.order:
        world[n] = world[int(tree.parent[n])] @ transform(tree.linear[n], tree.translation[n])
    surfaces: list[TriangleSurface] = []
    for n in tree.order:
        node = document.gltf.nodes[n]
        if node.mesh is None or n not in tree.scene or (tree.vanished[n] and node.skin is None):
            continue
        weights = np.array(rest_weights(document, n, meshes.targets(node.mesh)), np.float64)
        if node.skin is None and not weights.any():
            moved = [move_patch(patch, world[n]) for patch in meshes.patches(node.mesh)]
            surfaces += [TriangleSurface(p.vertices, p.faces, p.normals, p.uv, p.material)
                         for p in moved]
            continue
        try:
            visuals = _visuals(document, meshes, accessors, n, world)
        except ModelError as error:
            raise ModelError(f"nodes[{n}]: {error}") from error
        found = [_surface_at_rest(visual, weights) for visual in visuals]
        surfaces += [surface for surface in found if surface is not None]
    for note in [*document.notes, *tree.notes, *materials.notes, *meshes.notes]:
        reader.note(f"{asset.path.name}: {note}")
    return surfaces


def _visuals(
    document: GltfDocument, meshes: Meshes, accessors: Accessors, node: int,
    world: Mapping[int, Array],
) -> list[Visual]:
    """Return the deforming visuals of a node, bound to the scene; `world` holds poses of nodes."""
    given = document.gltf.nodes[node]
    assert given.mesh is not None
    channels = slice(0, meshes.targets(given.mesh))
    if given.skin is None:
        return [bound_visual(patch, 0, world[node], channels)
                for patch in meshes.patches(given.mesh)]
    joints = document.gltf.skins[given.skin].joints
    scene_from_mesh = (np.array([world[j] for j in joints])
                       @ inverse_binds(document, given.skin, accessors))
    return [visual for patch in meshes.patches(given.mesh)
            for visual in skinned_visuals(patch, np.zeros(len(joints), np.int64), scene_from_mesh,
                                          np.eye(4)[None], channels)]


def _surface_at_rest(visual: Visual, weights: Array) -> TriangleSurface | None:
    """Return a visual of the scene where the weights [M] put it; None if it is flat."""
    vertices, normals = deform_visual(visual, np.eye(4)[None], None, weights)
    return clean_surface(vertices, visual.faces, normals, visual.uv, visual.material)
