"""The verifier's own reading of a glTF file: the frames of its nodes at rest.

The loader parses glTF with records of its own. This reader uses pygltflib, and composes the frames
with SciPy, so that a mistake of either shows as a difference of poses. The file has been accepted
by the loader before. Meshes, materials and animations are skipped.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pygltflib
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from ...errors import ModelError
from ...robots.files import read_bounded
from ...robots.geometry import Array

_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_FLAT = 1e-5  # scales below this share of the largest leave a frame undefined


@dataclass(frozen=True)
class GltfFrame:
    """The frame of a node at rest, in the scene with z up."""

    parent: str
    """Name of the parent node; empty for a root."""
    position: Array
    """[3] in the file's unit of length"""
    rotation: Array
    """[3 3] the product of the rotations of the node and its ancestors, without scales"""


def read_gltf_frames(path: Path) -> Mapping[str, GltfFrame]:
    """Return the frames of the nodes of a glTF file by name; node 3 without a name is "node_3".

    Nodes are left out if they share their name, or if a flat or mirrored transform leaves their
    frame ambiguous. Raises ModelError if the file is no glTF.
    """
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read(path: Path, _mtime: int) -> Mapping[str, GltfFrame]:
    data = read_bounded(path)
    if data[:4] == b"glTF":
        data = data[20:20 + struct.unpack_from("<I", data, 12)[0]]
    try:
        tree = {k: v for k, v in json.loads(data.decode("utf-8-sig")).items() if k == "nodes"}
        nodes: list[pygltflib.Node] = pygltflib.GLTF2.from_json(
            json.dumps(tree), infer_missing=True).nodes
        return _frames(nodes)
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise ModelError(f"{path}: cannot be read as glTF by pygltflib ({error})") from error


def _frames(nodes: list[pygltflib.Node]) -> dict[str, GltfFrame]:
    names = [node.name or f"node_{n}" for n, node in enumerate(nodes)]
    count = Counter(names)
    parent = {child: n for n, node in enumerate(nodes) for child in node.children or ()}
    out: dict[str, GltfFrame] = {}
    stack = [(n, np.eye(4), _Z_UP) for n in range(len(nodes)) if n not in parent]
    while stack:
        n, above, turn = stack.pop()
        affine, rotation = _pose(nodes[n])
        affine, turn = above @ affine, turn @ rotation
        stack += [(child, affine, turn) for child in nodes[n].children or ()]
        if count[names[n]] == 1 and np.isfinite(turn).all():
            above_name = names[parent[n]] if n in parent else ""
            out[names[n]] = GltfFrame(above_name, _Z_UP @ affine[:3, 3], turn)
    return out


def _pose(node: pygltflib.Node) -> tuple[Array, Array]:
    """Return the transform [4 4] of a node, and its rotation [3 3]; NaN if that is ambiguous."""
    affine = np.eye(4)
    if node.matrix:
        affine = np.array(node.matrix, float).reshape(4, 4).T
        rotation, stretch = polar(affine[:3, :3])
        scales = np.linalg.eigvalsh(stretch) * np.sign(np.linalg.det(rotation))
    else:
        rotation = Rotation.from_quat(node.rotation or (0, 0, 0, 1)).as_matrix()
        scales = np.array(node.scale or (1, 1, 1), float)
        affine[:3, :3] = rotation * scales
        affine[:3, 3] = node.translation or (0, 0, 0)
        scales = np.abs(scales)
    if scales.min() <= _FLAT * np.abs(scales).max():
        rotation = np.full((3, 3), np.nan)
    return affine, rotation
