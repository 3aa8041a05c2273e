"""Reader of glTF 2.0 files (.glb, .gltf), which are untrusted input, as articulated models.

Parts are the nodes with meshes, the bones of skins, and all ancestors of both. Frames are rigid;
the surfaces include the scale, and ModelState.stretch includes an animated scale. glTF is y up,
the model z up.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..files import Asset, AssetFinder, read_bounded
from ..geometry import Array, inverse
from ..meshes import AssetReader, file_errors
from ..model import ArticulatedModel, Link, Visual, rest_size
from .accessors import Accessors
from .animation import KeyedAnimation, read_animations
from .document import GltfDocument, read_gltf_document
from .invented_joints import invent_joints
from .materials import Materials
from .meshes import (
    Meshes,
    Patch,
    bound_visual,
    join_patches,
    move_patch,
    rigid_visual,
    skinned_visuals,
)
from .nodes import Rig, node_tree, rig
from .rest import inverse_binds, rest_weights

_SMALLEST, _LARGEST = 1e-3, 1e4
"""m: a model of a size outside this range is read in another unit, with a note."""
_MAX_MORPH_CHANNELS = 10_000


def load_gltf(
    path: str | Path, allow_missing: bool = False, scale: float = 1.0
) -> ArticulatedModel:
    """Read the .glb or .gltf file at `path`, and the files of its folder that it refers to.

    All lengths are multiplied by `scale`. With `allow_missing` a missing image becomes a
    note of the model instead of an error. Raises ModelError for any invalid file.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"{path}: no such file")
    data = read_bounded(path)
    real = path.resolve()
    files = AssetReader(AssetFinder(real.parent, real.parent))
    with file_errors(path, "glTF"):
        reader = _Reader(read_gltf_document(data), Asset(real, real.parent), files, allow_missing)
        model = reader.model(path.stem, scale)
        size = rest_size(model)
        if not _SMALLEST <= size <= _LARGEST:
            if size < 1e-30:
                raise ModelError("is a single point")
            unit = 10.0 ** -round(np.log10(size))
            model = reader.model(path.stem, scale * unit)
            note = f"is {size:g} m large: its lengths are multiplied by {unit:g}"
            model = replace(model, notes=(*model.notes, note))
    return replace(model, source=path.name, sha256=hashlib.sha256(data).hexdigest(),
                   licence=_licence(reader.document))


class _Reader:
    """Conversion of one document to a model."""

    def __init__(
        self, document: GltfDocument, asset: Asset, files: AssetReader, allow_missing: bool
    ) -> None:
        self.document = document
        self.accessors = Accessors(document, asset, files)
        self.materials = Materials(document, self.accessors, files.textures, allow_missing)
        self.tree = node_tree(document)
        nodes = document.gltf.nodes
        drawn = [n for n in self.tree.order if n in self.tree.scene and nodes[n].mesh is not None]
        self.skinned = [n for n in drawn if nodes[n].skin is not None]
        self.plain = [n for n in drawn if nodes[n].skin is None]
        if not drawn:
            raise ModelError("has nothing to draw: no node of its scene carries a mesh")

    def model(self, name: str, unit: float) -> ArticulatedModel:
        """Return the model; `unit` m is the file's unit of length."""
        gltf, tree = self.document.gltf, self.tree
        meshes = Meshes(self.document, self.accessors, self.materials)
        bones = {n: list(gltf.skins[cast("int", gltf.nodes[n].skin)].joints) for n in self.skinned}
        scene = gltf.scenes[gltf.scene or 0].name if gltf.scenes else ""
        parts = rig(tree, [*self.plain, *(j for joints in bones.values() for j in joints)],
                    scene or "scene", unit)
        channels, weights = self._morphs(meshes)
        animations = read_animations(self.document, self.accessors, tree, parts, channels, weights)
        stretched = np.any([np.zeros(len(parts.node), bool),
                            *(a.stretches for a in animations)], axis=0)
        visuals = self._rigid_visuals(meshes, parts, channels, stretched, animations)
        visuals += self._skinned_visuals(meshes, parts, channels, bones)
        if not visuals:
            raise ModelError("; ".join(["has nothing to draw: its meshes hold no triangles",
                                        *self.document.notes]))
        part = parts.part_of_node
        links = _links(parts)
        complete = partial(replace, visuals=tuple(visuals), animations=animations,
                           morph_weights=weights)
        still = complete(ArticulatedModel.from_links(name, links, keep_order=True))
        moving = {p for a in animations for p in _own_motion(a, part)}
        bone_parts = {part[j] for joints in bones.values() for j in joints}
        joints, note = invent_joints(still, bone_parts, moving, {part[n] for n in self.plain})
        links = [replace(link, joint=joints.get(link.name, link.joint)) for link in links]
        notes = [*self.document.notes, *tree.notes, *meshes.notes, *self.materials.notes, note]
        return complete(ArticulatedModel.from_links(name, links, keep_order=True),
                        notes=tuple(dict.fromkeys(notes)))

    def _morphs(self, meshes: Meshes) -> tuple[dict[int, slice], Array]:
        """Return the morph channels of each drawn node, and their weights [M] at rest."""
        gltf = self.document.gltf
        channels: dict[int, slice] = {}
        weights: list[float] = []
        for n in [*self.plain, *self.skinned]:
            node = gltf.nodes[n]
            mesh = cast("int", node.mesh)
            count = meshes.targets(mesh)
            if not count:
                continue
            channels[n] = slice(len(weights), len(weights) + count)
            weights.extend(rest_weights(self.document, n, count))
            if len(weights) > _MAX_MORPH_CHANNELS:
                raise ModelError(f"has more than {_MAX_MORPH_CHANNELS} morph weights")
        return channels, np.array(weights, np.float64)

    def _rigid_visuals(
        self, meshes: Meshes, parts: Rig, channels: dict[int, slice],
        stretched: NDArray[np.bool_], animations: Collection[KeyedAnimation],
    ) -> list[Visual]:
        tree, part = self.tree, parts.part_of_node
        scaled = {track.node for a in animations for track in a.tracks if track.path == "scale"}
        gone: dict[int, bool] = {-1: False}
        for n in tree.order:
            gone[n] = gone[int(tree.parent[n])] or (bool(tree.vanished[n]) and n not in scaled)
        visuals: list[Visual] = []
        for n in self.plain:
            if gone[n]:
                meshes.notes["nodes of scale zero are not drawn"] = None
                continue
            p = part[n]
            shape, own = parts.part_from_node[p], channels.get(n)
            still: list[Patch] = []
            for patch in meshes.patches(cast("int", self.document.gltf.nodes[n].mesh)):
                if stretched[p] or (own is not None and np.abs(shape - np.eye(4)).max() > 1e-12):
                    visuals.append(bound_visual(patch, p, shape, own))
                elif own is not None:
                    visuals.append(rigid_visual(patch, p, own))
                else:
                    still.append(move_patch(patch, shape))
            visuals.extend(rigid_visual(patch, p, None) for patch in join_patches(still))
        return visuals

    def _skinned_visuals(
        self, meshes: Meshes, parts: Rig, channels: dict[int, slice],
        bones: Mapping[int, Sequence[int]],
    ) -> list[Visual]:
        gltf, part = self.document.gltf, parts.part_of_node
        visuals: list[Visual] = []
        for n, joints in bones.items():
            bone_part = np.array([part[j] for j in joints], np.int64)
            bind = inverse_binds(self.document, cast("int", gltf.nodes[n].skin), self.accessors)
            part_from_mesh = parts.part_from_node[bone_part] @ bind
            for i, patch in enumerate(meshes.patches(cast("int", gltf.nodes[n].mesh))):
                try:
                    visuals += skinned_visuals(patch, bone_part, part_from_mesh,
                                               parts.world_from_part, channels.get(n))
                except ModelError as error:
                    raise ModelError(f"nodes[{n}], piece {i} of its mesh: {error}") from error
        return visuals


def _links(parts: Rig) -> list[Link]:
    """Return a link for each part, fixed to its parent."""
    at_zero = parts.world_from_part.copy()
    at_zero[1:] = inverse(parts.world_from_part[parts.parent[1:]]) @ at_zero[1:]
    return [Link(name, parts.names[above] if above >= 0 else None, pose)
            for name, above, pose in zip(parts.names, parts.parent, at_zero, strict=True)]


def _own_motion(animation: KeyedAnimation, part_of_node: dict[int, int]) -> set[int]:
    """Return the parts with rotation or translation tracks of their own that change."""
    return {part_of_node[track.node] for track in animation.tracks
            if track.path in ("rotation", "translation")
            and float(np.ptp(track.values, axis=0).max()) > 1e-6}


def _licence(document: GltfDocument) -> str:
    """Return the licence or copyright text of the file, at most 200 characters."""
    asset = document.asset
    extras = cast("dict[str, object]", asset.extras) if isinstance(asset.extras, dict) else {}
    found = [extras.get(key) for key in ("license", "licence")] + [asset.copyright]
    texts = [" ".join(text.split())[:200] for text in found if isinstance(text, str)]
    return next((text for text in texts if text), "")
