"""Vertices of deforming surfaces, by morph targets and linear blend skinning."""

from __future__ import annotations

import numpy as np

from ..geometry import Array, apply
from .visuals import Visual


def deform_visual(
    visual: Visual, world_from_part: Array, stretch: Array | None, morph: Array
) -> tuple[Array, Array]:
    """Return the world vertices [V 3] m and unit normals [V 3] of a visual, rigid or deforming.

    Normals are mapped by the cofactors of the blended matrix of their vertex, which is exact for
    uneven and for mirroring scale. The poses [P 4 4], the stretch [P 4 4] and the morph weights
    [M] are those of one instant.
    """
    points, normals = visual.vertices, visual.normals
    if visual.morph is not None:
        weight = morph[visual.morph.channel]
        points = points + np.tensordot(weight, visual.morph.displacement, 1)
        if visual.morph.normal_displacement is not None:
            normals = normals + np.tensordot(weight, visual.morph.normal_displacement, 1)
    if visual.skin is None:
        pose = world_from_part[visual.part]
        return apply(pose, points), _unit(normals @ pose[:3, :3].T)
    skin = visual.skin
    part = world_from_part[skin.bone_part]
    if stretch is not None:
        part = part @ stretch[skin.bone_part]
    bones = part @ skin.part_from_mesh
    matrix = np.zeros((len(points), 3, 4))
    for bone, weight in zip(skin.bone.T, skin.weight.T, strict=True):
        matrix += weight[:, None, None] * bones[bone, :3]
    points = np.einsum("vij,vj->vi", matrix[:, :, :3], points) + matrix[:, :, 3]
    a, b, c = (matrix[:, :, i] for i in range(3))
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return points, _unit(np.einsum("vij,vj->vi", cofactor, normals))


def _unit(vectors: Array) -> Array:
    """[N 3] of length 1; zeros stay."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
