"""A glTF file as the mesh of a link: its surfaces in the frame of its scene."""

from __future__ import annotations

import numpy as np

from ..files import Asset
from ..geometry import transform
from ..meshes import AssetReader
from ..model import TriangleSurface
from .accessors import Accessors
from .document import read_gltf_document
from .materials import Materials
from .meshes import Meshes, move_patch
from .nodes import node_tree


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
    surfaces: list[TriangleSurface] = []
    for n in tree.order:
        world[n] = world[int(tree.parent[n])] @ transform(tree.linear[n], tree.translation[n])
        mesh = document.gltf.nodes[n].mesh
        if mesh is None or n not in tree.scene or tree.vanished[n]:
            continue
        moved = [move_patch(patch, world[n]) for patch in meshes.patches(mesh)]
        surfaces += [TriangleSurface(p.vertices, p.faces, p.normals, p.uv, p.material)
                     for p in moved]
    for note in [*document.notes, *tree.notes, *materials.notes, *meshes.notes]:
        reader.note(f"{asset.path.name}: {note}")
    return surfaces
