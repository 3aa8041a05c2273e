"""Nodes of a glTF file, and their decomposition into rigid part frames and residual scale.

The world pose of a node is affine, because it includes the scales of all its ancestors. The frame
of a part is rigid: its origin is that of the node, its rotation the product of the rotations of
the node and its ancestors. The residual `part_from_node` is applied to the node's surfaces.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..geometry import (
    Array,
    inverse,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_quaternion,
    transform,
)
from .document import GltfDocument
from .records import GltfNode

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from glTF's y-up frame to the z-up world."""
THIN = 1e-6
"""Smallest scale at rest, relative to the largest axis, so that node frames are invertible."""


@dataclass(frozen=True)
class NodeTree:
    """All N nodes of a file in file order."""

    names: tuple[str, ...]
    parent: NDArray[np.int64]
    """[N] -1 for roots"""
    order: tuple[int, ...]
    """All nodes, parents before children, nodes of the scene first."""
    scene: frozenset[int]
    """Nodes of the drawn scene."""
    has_matrix: NDArray[np.bool_]
    """[N] whether the pose is a matrix, which cannot be animated"""
    translation: Array
    """[N 3]"""
    rotation: Array
    """[N 4] unit quaternion (x, y, z, w); for a matrix, the nearest rotation"""
    scale: Array
    """[N 3] as in the file, zeros included; ones for a matrix"""
    linear: Array
    """[N 3 3] rotation * scale (or the matrix) at rest, no scale smaller than THIN"""
    vanished: NDArray[np.bool_]
    """[N] whether the node's own scale is zero"""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Rig:
    """Nodes that are parts, and their frames at rest. P parts; the first is the scene."""

    names: tuple[str, ...]
    node: NDArray[np.int64]
    """[P] index of the node; -1 for the scene"""
    parent: NDArray[np.int64]
    """[P] index of the parent part; -1 for the scene"""
    world_from_part: Array
    """[P 4 4] rigid"""
    part_from_node: Array
    """[P 4 4] scale, reflection and shear"""

    @cached_property
    def part_of_node(self) -> dict[int, int]:
        return {int(n): p for p, n in enumerate(self.node) if n >= 0}


def node_tree(document: GltfDocument) -> NodeTree:
    """Read the nodes; raise ModelError if they form no forest or a transform is invalid."""
    gltf = document.gltf
    nodes = gltf.nodes
    parent = np.full(len(nodes), -1, np.int64)
    for n, node in enumerate(nodes):
        for child in node.children:
            if parent[child] >= 0 or child == n:
                raise ModelError(f"nodes[{child}] has two parents, {parent[child]} and {n}; "
                                 "the nodes of a glTF file make a tree")
            parent[child] = n
    roots = [n for n in range(len(nodes)) if parent[n] < 0]
    order = _depth_first(nodes, roots)
    if len(order) < len(nodes):
        lost = min(set(range(len(nodes))) - set(order))
        raise ModelError(f"nodes[{lost}] is its own ancestor; the nodes of a glTF file make a tree")
    listed = dict.fromkeys(gltf.scenes[gltf.scene or 0].nodes if gltf.scenes else roots)
    root, shown = dict[int, int](), set[int]()
    for n in order:
        above = int(parent[n])
        root[n] = n if above < 0 else root[above]
        if n in listed or above in shown:
            shown.add(n)
    order = _depth_first(nodes, dict.fromkeys([*(root[n] for n in listed), *roots]))
    twice = [n for n in listed if parent[n] >= 0]
    notes = (f"its scene lists nodes[{twice[0]}], the child of another node",) if twice else ()
    if len(gltf.scenes) > 1:
        notes += (f"shows scene {gltf.scene or 0} of {len(gltf.scenes)}; the others are left out",)
    poses = [_pose(node, n) for n, node in enumerate(nodes)]
    translation, rotation, scale, linear, vanished = (
        np.array([p[k] for p in poses], np.float64) for k in range(5))
    count = len(nodes)
    return NodeTree(
        tuple(node.name for node in nodes), parent, tuple(order), frozenset(shown),
        np.array([node.matrix is not None for node in nodes], bool),
        translation.reshape(count, 3), rotation.reshape(count, 4), scale.reshape(count, 3),
        linear.reshape(count, 3, 3), vanished.astype(bool), notes)


def _depth_first(nodes: Sequence[GltfNode], roots: Iterable[int]) -> list[int]:
    order: list[int] = []
    stack = list(roots)[::-1]
    while stack:
        n = stack.pop()
        order.append(n)
        stack.extend(reversed(nodes[n].children))
    return order


def _pose(node: GltfNode, n: int) -> tuple[Array, Array, Array, Array, bool]:
    """Return translation, quaternion, scale, invertible linear part, and if the scale is zero."""
    if node.matrix is None:
        q = np.array(node.rotation or (0.0, 0.0, 0.0, 1.0))
        length = float(np.linalg.norm(q))
        if length < 1e-6:
            raise ModelError(f"nodes[{n}] has a rotation of zero length")
        scale = np.array(node.scale or (1.0, 1.0, 1.0))
        least = THIN * (np.abs(scale).max() or 1.0)
        thick = np.where(np.abs(scale) < least, np.copysign(least, scale), scale)
        linear = rotation_from_quaternion(q / length) * thick
        return (np.array(node.translation or (0.0, 0.0, 0.0)), q / length, scale, linear,
                bool((scale == 0.0).all()))
    if node.translation or node.rotation or node.scale:
        raise ModelError(f"nodes[{n}] has a matrix and a translation, rotation or scale, too")
    matrix = np.array(node.matrix).reshape(4, 4).T
    if np.abs(matrix[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-6:
        raise ModelError(f"nodes[{n}] has a matrix that is not affine")
    u, s, v = np.linalg.svd(matrix[:3, :3])
    linear = matrix[:3, :3] if s[2] > THIN * s[0] else u * np.maximum(s, THIN * (s[0] or 1.0)) @ v
    return (matrix[:3, 3], quaternion_from_rotation(nearest_rotation(linear)), np.ones(3), linear,
            bool(s[0] == 0.0))


def rig(tree: NodeTree, wanted: Iterable[int], scene_name: str, unit: float) -> Rig:
    """Return the parts of the wanted nodes and their ancestors; `unit` m is the file's unit."""
    keep: set[int] = set()
    for n in wanted:
        while n >= 0 and n not in keep:
            keep.add(n)
            n = int(tree.parent[n])
    nodes = [n for n in tree.order if n in keep]
    part = {-1: 0, **{n: p + 1 for p, n in enumerate(nodes)}}
    names = _unique([scene_name, *(tree.names[n] or f"node_{n}" for n in nodes)])
    world = [transform(unit * Z_UP)]
    turn = [Z_UP]
    for n in nodes:
        above = part[int(tree.parent[n])]
        world.append(world[above] @ transform(tree.linear[n], tree.translation[n]))
        turn.append(turn[above] @ rotation_from_quaternion(tree.rotation[n]))
    turn[0] = np.eye(3)  # the scene frame is the world frame
    poses = transform(np.array(turn), np.array(world)[:, :3, 3])
    return Rig(
        names, np.array([-1, *nodes], np.int64),
        np.array([-1, *(part[int(tree.parent[n])] for n in nodes)], np.int64), poses,
        inverse(poses) @ np.array(world))


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique printable names of at most 100 characters."""
    out: dict[str, None] = {}
    counts: dict[str, int] = {}
    for name in names:
        text = "".join(c if c.isprintable() else "_" for c in name).strip()[:100] or "node"
        unique = text
        while unique in out:
            counts[text] = counts.get(text, 1) + 1
            unique = f"{text}_{counts[text]}"
        out[unique] = None
    return tuple(out)
