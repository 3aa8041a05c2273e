"""What poses the meshes of a glTF file at rest: weights of morph targets, and skins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import ModelError
from ..geometry import Array
from .accessors import Accessors
from .document import GltfDocument


def rest_weights(document: GltfDocument, node: int, count: int) -> Sequence[float]:
    """Return the weights at rest of the `count` morph targets of a node's mesh."""
    gltf, given = document.gltf, document.gltf.nodes[node]
    own = () if given.mesh is None else gltf.meshes[given.mesh].weights
    weights = given.weights or own or [0.0] * count
    if len(weights) != count:
        raise ModelError(f"nodes[{node}] has {len(weights)} weights for {count} morph targets")
    return weights


def inverse_binds(document: GltfDocument, skin: int, accessors: Accessors) -> Array:
    """Return the inverse bind matrices [B 4 4] of a skin."""
    given = document.gltf.skins[skin]
    accessor, count = given.inverse_bind_matrices, len(given.joints)
    if accessor is None:
        return np.tile(np.eye(4), (count, 1, 1))
    if accessors.kind(accessor) != "MAT4" or accessors.count(accessor) < count:
        raise ModelError(f"a skin has {accessors.count(accessor)} inverse bind matrices "
                         f"({accessors.kind(accessor)}) for {count} joints")
    matrices = accessors.floats(accessor, count).reshape(-1, 4, 4).swapaxes(1, 2)
    if np.abs(matrices[:, 3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-3:
        raise ModelError("a skin has an inverse bind matrix that is not affine")
    matrices[:, 3] = (0.0, 0.0, 0.0, 1.0)
    return matrices
