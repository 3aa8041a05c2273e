"""A glTF file as the mesh of a URDF: it stands as the same file does as a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gcbench.robots.files.paths import asset_finder
from gcbench.robots.gltf.reader import load_gltf
from gcbench.robots.model import deform_visual, forward_kinematics
from gcbench.robots.urdf.library import MeshLibrary

from ...support.gltf_maker import Maker, bent_bar

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def as_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Corners and normals [N 3], in any order of triangles."""
    library = MeshLibrary(asset_finder(path.parent / "m.urdf", {}, None))
    found = library.surfaces(path.name)
    return (np.concatenate([s.vertices[s.faces].reshape(-1, 3) for s in found]),
            np.concatenate([s.normals[s.faces].reshape(-1, 3) for s in found]))


def as_model(path: Path) -> tuple[np.ndarray, np.ndarray]:
    model = load_gltf(path)
    poses = forward_kinematics(model, np.zeros(len(model.joint_names)))
    found = [(v.faces, *deform_visual(v, poses, None, model.morph_weights)) for v in model.visuals]
    return (np.concatenate([v[f].reshape(-1, 3) for f, v, _ in found]) @ Z_UP,
            np.concatenate([n[f].reshape(-1, 3) for f, _, n in found]) @ Z_UP)


def check(path: Path) -> None:
    mesh, model = as_mesh(path), as_model(path)
    assert len(mesh[0]) == len(model[0])
    both = [np.round(np.concatenate(pair, 1), 5) + 0.0 for pair in (mesh, model)]
    one, other = (rows[np.lexsort(rows.T)] for rows in both)
    np.testing.assert_allclose(one, other, atol=2e-5)


def test_a_skinned_mesh_follows_its_bones_and_not_its_node(tmp_path: Path) -> None:
    maker = Maker()
    base, tip, body = bent_bar(maker)
    nodes = maker.tree["nodes"]
    nodes[base] |= {"translation": [1, 2, 3], "scale": [0.01, 0.01, 0.01]}
    nodes[tip]["rotation"] = [0.0, 0.0, 0.6, 0.8]
    nodes[body] |= {"translation": [50, 0, 0], "scale": [7, 7, 7]}
    maker.node(mesh=maker.mesh(), translation=[1, 1, 1])
    check(maker.save(tmp_path))


def test_a_morphed_mesh_has_its_weights_at_rest(tmp_path: Path) -> None:
    maker, rng = Maker(), np.random.default_rng(3)
    targets = [{"POSITION": maker.accessor(0.2 * rng.normal(size=(8, 3)))} for _ in range(2)]
    mesh = maker.mesh(targets=targets, mesh={"weights": [0.5, 1.0]})
    maker.node(mesh=mesh, scale=[1, 2, 3], translation=[0, 1, 0])
    maker.node(mesh=mesh, weights=[1.0, 0.0], scale=[-1, 1, 1], translation=[4, 0, 0])
    maker.node(mesh=mesh, weights=[0.0, 0.0], translation=[8, 0, 0])
    check(maker.save(tmp_path))
