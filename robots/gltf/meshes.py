"""Triangles and vertex attributes of glTF meshes, and their conversion to visuals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..geometry import Array, apply, face_normals
from ..meshes import MeshLimits
from ..model import Material, Morph, Skin, Visual, clean_triangles
from .accessors import Accessors
from .document import GltfDocument
from .materials import Materials
from .records import Attributes, Primitive

_LIMITS = MeshLimits()
_TRIANGLES = 4
"""Modes from this one on are triangles: a list, a strip, a fan."""
MAX_VISITS = 20 * _LIMITS.triangles
"""Limit on vertices and corners of all primitives of all nodes; it bounds the reading time."""
MAX_MORPH_NUMBERS = 2**27


@dataclass(frozen=True)
class Patch:
    """Triangles of one primitive in the mesh frame. V vertices, F faces, M morph targets."""

    vertices: Array
    """[V 3]"""
    faces: NDArray[np.int64]
    """[F 3]"""
    normals: Array
    """[V 3] unit"""
    uv: Array | None
    """[V 2], v upward"""
    material: Material
    key: object
    """Patches with equal keys share one material."""
    joints: NDArray[np.int64] | None
    """[V K] indices of joints of the skin"""
    weights: Array | None
    """[V K], rows sum to 1"""
    displacement: Array | None
    """[M V 3]"""
    normal_displacement: Array | None
    """[M V 3]"""
    color: Array | None
    """[V 4] linear"""


class Meshes:
    """Cached reader of the primitives of one document."""

    def __init__(self, document: GltfDocument, accessors: Accessors, materials: Materials) -> None:
        self._gltf, self._accessors, self._materials = document.gltf, accessors, materials
        self._patches: dict[int, list[Patch]] = {}
        self._visits = self._triangles = self._instances = self._morphs = 0
        self.notes: dict[str, None] = {}

    def patches(self, mesh: int) -> list[Patch]:
        """Return the patches of a mesh and count one more instance of it; raise ModelError."""
        if mesh not in self._patches:
            found: list[Patch] = []
            for i, primitive in enumerate(self._gltf.meshes[mesh].primitives):
                try:
                    patch = self._patch(primitive)
                except ModelError as error:
                    raise type(error)(f"meshes[{mesh}].primitives[{i}]: {error}") from error
                if patch is not None:
                    found.append(patch)
            self._patches[mesh] = found
        found = self._patches[mesh]
        self._instances += len(found)
        self._triangles += sum(len(p.faces) for p in found)
        if self._triangles > _LIMITS.triangles or self._instances > _LIMITS.instances:
            raise ModelError(f"has more than {_LIMITS.triangles} triangles "
                             f"or {_LIMITS.instances} pieces")
        self._visit(sum(len(p.vertices) for p in found))
        return found

    def targets(self, mesh: int) -> int:
        """Return the number of morph targets of a mesh, equal in all its primitives."""
        counts = {len(p.targets) for p in self._gltf.meshes[mesh].primitives}
        if len(counts) > 1:
            raise ModelError(f"meshes[{mesh}] has primitives of {sorted(counts)} morph targets")
        return counts.pop()

    def _visit(self, count: int) -> None:
        self._visits += count
        if self._visits > MAX_VISITS:
            raise ModelError(f"has more than {MAX_VISITS} vertices and corners")

    def _patch(self, primitive: Primitive) -> Patch | None:
        attributes = primitive.attributes
        if primitive.mode < _TRIANGLES or "POSITION" not in attributes:
            self.notes["points and lines are not drawn"] = None
            return None
        positions = self._attribute(attributes["POSITION"], "POSITION", None, "VEC3")
        count = len(positions)
        indices = np.arange(count) if primitive.indices is None else self._indices(primitive, count)
        self._visit(count + len(indices))
        faces = triangles_of(indices, primitive.mode)
        normals = (self._attribute(attributes["NORMAL"], "NORMAL", count, "VEC3")
                   if "NORMAL" in attributes else None)
        joints, weights = self._bones(attributes, count)
        deltas = [self._deltas(target, "POSITION", count) for target in primitive.targets]
        bends = [self._deltas(target, "NORMAL", count) for target in primitive.targets]
        place = self._materials.placement(primitive.material)
        uv = None
        if place.uv_set is not None and f"TEXCOORD_{place.uv_set}" in attributes:
            name = f"TEXCOORD_{place.uv_set}"
            uv = place.uv(self._attribute(attributes[name], name, count, "VEC2"))
        color = self._colors(attributes, count, self._materials.shows_alpha(primitive.material))
        made = clean_triangles(positions, faces, normals, distinct=True,
                               keep_flat=bool(deltas) or joints is not None)
        if made is None:
            return None
        source, faces, new_normals = made
        displacement = bend = None
        if deltas:
            self._morphs += len(deltas) * len(source) * 6
            if self._morphs > MAX_MORPH_NUMBERS:
                raise ModelError("has too many morph targets to hold")
            zero = np.zeros((count, 3))
            displacement = np.stack([(zero if d is None else d)[source] for d in deltas])
            # whether the normals are those of the file, not computed here
            kept = normals is not None and np.abs(
                _normalize(normals[source]) - new_normals).max() < 1e-3
            if kept and any(b is not None for b in bends):
                bend = np.stack([(zero if b is None else b)[source] for b in bends])
            else:
                bend = _normal_changes(positions[source], faces, displacement)
        material, key = self._materials.material(primitive.material, uv is not None, color)
        return Patch(
            positions[source], faces, _normalize(new_normals), None if uv is None else uv[source],
            material, key, None if joints is None else joints[source],
            None if weights is None else weights[source], displacement, bend,
            None if color is None else color[source])

    def _attribute(self, accessor: int, name: str, count: int | None, kind: str) -> Array:
        if self._accessors.kind(accessor) != kind:
            raise ModelError(f"{name} is {self._accessors.kind(accessor)}, not {kind}")
        if count is not None and self._accessors.count(accessor) != count:
            raise ModelError(f"{name} has {self._accessors.count(accessor)} entries for {count} "
                             "vertices")
        return self._accessors.floats(accessor)

    def _colors(self, attributes: Attributes, count: int, alpha: bool) -> Array | None:
        """Return vertex colours [V 4], opaque without `alpha`; None if all are white."""
        if "COLOR_0" not in attributes:
            return None
        kind = self._accessors.kind(attributes["COLOR_0"])
        given = self._attribute(attributes["COLOR_0"], "COLOR_0", count,
                                "VEC3" if kind == "VEC3" else "VEC4")
        out = np.ones((count, 4))
        wide = given.shape[1] if alpha else 3
        out[:, :wide] = np.clip(given[:, :wide], 0.0, 1.0)
        return None if (out == 1.0).all() else out

    def _deltas(self, target: Attributes, name: str, count: int) -> Array | None:
        if name not in target:
            return None
        self._visit(count)
        return self._attribute(target[name], f"morph target {name}", count, "VEC3")

    def _indices(self, primitive: Primitive, count: int) -> NDArray[np.int64]:
        number = primitive.indices
        assert number is not None
        if self._accessors.kind(number) != "SCALAR":
            raise ModelError("indices are not scalars")
        indices = self._accessors.integers(number)
        if indices.max(initial=0) >= count:
            raise ModelError(f"index {int(indices.max())} of {count} vertices")
        return indices

    def _bones(
        self, attributes: Attributes, count: int
    ) -> tuple[NDArray[np.int64] | None, Array | None]:
        """Return joints [V K] and weights [V K] of all sets, without columns of zero weight."""
        joints: list[NDArray[np.int64]] = []
        weights: list[Array] = []
        for k in range(8):
            if f"JOINTS_{k}" not in attributes:
                break
            if f"WEIGHTS_{k}" not in attributes:
                raise ModelError(f"has JOINTS_{k} but no WEIGHTS_{k}")
            number = attributes[f"JOINTS_{k}"]
            if self._accessors.kind(number) != "VEC4" or self._accessors.count(number) != count:
                raise ModelError(f"JOINTS_{k} is not VEC4, or not one for each vertex")
            joints.append(self._accessors.integers(number))
            weights.append(self._attribute(attributes[f"WEIGHTS_{k}"], f"WEIGHTS_{k}", count,
                                           "VEC4"))
        if not joints:
            return None, None
        bone, weight = np.concatenate(joints, 1), np.concatenate(weights, 1)
        weight = np.maximum(weight, 0.0)
        total = weight.sum(1, keepdims=True)
        weight[:, :1] = np.where(total > 0.0, weight[:, :1], 1.0)  # without weights: first joint
        weight = weight / np.where(total > 0.0, total, 1.0)
        used = weight.any(0)
        return np.where(weight > 0.0, bone, 0)[:, used], weight[:, used]


def triangles_of(indices: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return [F 3] of a list (mode 4), strip (5) or fan (6); glTF 2.0, section 3.7.2.1."""
    if mode == 4:
        return indices[:len(indices) // 3 * 3].reshape(-1, 3)
    count = max(len(indices) - 2, 0)
    i = np.arange(count)
    if mode == 5:
        odd = i % 2
        return np.stack([indices[i], indices[i + 1 + odd], indices[i + 2 - odd]], 1)
    return np.stack([indices[i + 1], indices[i + 2], np.full(count, indices[0])], 1)


def skinned_visuals(
    patch: Patch, bone_part: NDArray[np.int64], part_from_mesh: Array, world_from_part: Array,
    channels: slice | None,
) -> list[Visual]:
    """Split a skinned patch into visuals by the part of the dominant bone of each triangle.

    bone_part [B], part_from_mesh [B 4 4], world_from_part [P 4 4] at rest.
    """
    bone, weight = patch.joints, patch.weights
    if bone is None or weight is None:
        raise ModelError("is skinned, but has no JOINTS_0")
    if bone.max(initial=0) >= len(bone_part):
        raise ModelError(f"joint {int(bone.max())} of a skin that has {len(bone_part)}")
    follows = dominant_bones(patch.faces, bone, weight, len(bone_part))
    visuals: list[Visual] = []
    inside_out = turn_inside_out(patch)
    mirrored = np.linalg.det((world_from_part[bone_part] @ part_from_mesh)[:, :3, :3]) < 0.0
    for part in np.unique(bone_part[follows]):
        chosen = bone_part[follows] == part
        shown = inside_out if mirrored[follows[chosen][0]] else patch
        visuals.append(_visual(shown, int(part), shown.faces[chosen],
                               Skin(bone_part, part_from_mesh, bone, weight), channels))
    return visuals


def bound_visual(patch: Patch, part: int, part_from_mesh: Array, channels: slice | None) -> Visual:
    """Return a patch bound to one part by a skin, for animated scale or morphs under a scale."""
    patch = turn_inside_out(patch) if np.linalg.det(part_from_mesh[:3, :3]) < 0.0 else patch
    bone = np.zeros((len(patch.vertices), 1), np.int64)
    skin = Skin(np.array([part]), part_from_mesh[None], bone, np.ones(bone.shape))
    return _visual(patch, part, patch.faces, skin, channels)


def rigid_visual(patch: Patch, part: int, channels: slice | None) -> Visual:
    """Return a patch whose mesh frame is the part frame as a visual."""
    return _visual(patch, part, patch.faces, None, channels)


def move_patch(patch: Patch, part_from_mesh: Array) -> Patch:
    """Move a patch without morphs to the part frame; part_from_mesh [4 4] may scale and mirror."""
    linear = part_from_mesh[:3, :3]
    mirrored = np.linalg.det(linear) < 0.0
    return replace(
        patch, vertices=apply(part_from_mesh, patch.vertices),
        faces=patch.faces[:, ::-1] if mirrored else patch.faces,
        normals=_normalize(patch.normals @ np.linalg.inv(linear)))


def turn_inside_out(patch: Patch) -> Patch:
    """Reverse faces and normals; a mirroring skin reverses them back (cofactors map normals)."""
    bend = patch.normal_displacement
    return replace(patch, faces=patch.faces[:, ::-1], normals=-patch.normals,
                   normal_displacement=None if bend is None else -bend)


def join_patches(patches: list[Patch]) -> list[Patch]:
    """Join patches of one part, without skins or morphs, that share a material."""
    groups: dict[object, list[Patch]] = {}
    for patch in patches:
        groups.setdefault((patch.key, patch.uv is None, patch.color is None), []).append(patch)
    out: list[Patch] = []
    for group in groups.values():
        starts = np.cumsum([0, *(len(p.vertices) for p in group)])
        uvs = [p.uv for p in group if p.uv is not None]
        colors = [p.color for p in group if p.color is not None]
        out.append(replace(
            group[0], vertices=np.concatenate([p.vertices for p in group]),
            faces=np.concatenate([p.faces + s for p, s in zip(group, starts, strict=False)]),
            normals=np.concatenate([p.normals for p in group]),
            uv=np.concatenate(uvs) if uvs else None,
            color=np.concatenate(colors) if colors else None))
    return out


def dominant_bones(
    faces: NDArray[np.int64], bone: NDArray[np.int64], weight: Array, bones: int
) -> NDArray[np.int64]:
    """Return [F] the bone with the largest sum of weights over a face's corners; ties: first."""
    out = np.zeros(len(faces), np.int64)
    step = max(1, 2**22 // bones)
    for start in range(0, len(faces), step):
        chunk = faces[start:start + step]
        row = np.arange(len(chunk))[:, None, None] * bones
        sums = np.bincount((row + bone[chunk]).ravel(), weight[chunk].ravel(), len(chunk) * bones)
        # rounded to the precision of float32, so that ties do not depend on the order of summation
        out[start:start + step] = np.round(sums.reshape(-1, bones), 6).argmax(1)
    return out


def _visual(
    patch: Patch, part: int, faces: NDArray[np.int64], skin: Skin | None, channels: slice | None
) -> Visual:
    """Return a visual of the chosen faces [F 3] of a patch and the vertices in use."""
    used = np.zeros(len(patch.vertices), bool)
    used[faces.ravel()] = True
    made_skin = made_morph = None
    if skin is not None:
        bone = skin.bone[used]
        seen, at = np.unique(bone, return_inverse=True)
        made_skin = Skin(skin.bone_part[seen], skin.part_from_mesh[seen], at.reshape(bone.shape),
                         skin.weight[used])
    if patch.displacement is not None and channels is not None:
        moving = patch.displacement[:, used].any((1, 2))
        bend = patch.normal_displacement
        if moving.any():
            made_morph = Morph(
                np.arange(channels.start, channels.stop)[moving],
                patch.displacement[np.ix_(moving, used)],
                None if bend is None else bend[np.ix_(moving, used)])
    return Visual(
        part, patch.vertices[used], (np.cumsum(used) - 1)[faces].astype(np.int32),
        patch.normals[used], None if patch.uv is None else patch.uv[used], patch.material,
        made_skin, made_morph, None if patch.color is None else patch.color[used])


def _normal_changes(vertices: Array, faces: NDArray[np.int64], displacement: Array) -> Array:
    """Return [M V 3] the change of the computed vertex normals with each morph target."""
    def vertex_normals(points: Array) -> Array:
        flat, area = face_normals(points, faces)
        out = np.zeros_like(points)
        for k in range(3):
            np.add.at(out, faces[:, k], flat * area[:, None])
        return _normalize(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300))

    rest = vertex_normals(vertices)
    return np.stack([vertex_normals(vertices + d) - rest for d in displacement])


def _normalize(normals: Array) -> Array:
    """Return unit normals [V 3]; zero vectors become +z."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-300), (0.0, 0.0, 1.0))
