"""What the 3D view of a page draws is what the data say."""

from __future__ import annotations

import base64
import dataclasses
from typing import Any

import numpy as np
import pytest
from gcbench.renderer.show.view3d import is_model_of, simplify, three_js, view_data
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.geometry import apply, inverse
from gcbench.robots.meshes.solids import box, sphere
from gcbench.robots.model import ArticulatedModel
from gcbench.robots.model.surface import visuals_of_part

from ...support.analytic import arm, render


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    made = render(width=160, height=120, frames=5)
    return dataclasses.replace(made, meta=dataclasses.replace(made.meta, asset={"name": "arm"}))


def modelled() -> ArticulatedModel:
    """The arm of the sequence, a box on each of its parts."""
    model = arm()
    surfaces = (visuals_of_part(p, [box([0.1, 0.1, 0.1])], {}) for p in range(5))
    return dataclasses.replace(model, visuals=tuple(v for visuals in surfaces for v in visuals))


def floats(text: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(shape)


def view(sequence: Sequence, model: ArticulatedModel | None = None) -> dict[str, Any]:
    return view_data(sequence, range(len(sequence)), model)


def test_three_js_comes_with_its_licence_and_cannot_end_a_script() -> None:
    text = three_js()
    assert "SPDX-License-Identifier: MIT" in text
    assert "</script" not in text.lower()
    assert "<!--" not in text
    assert 500_000 < len(text) < 700_000, "three.js alone, without the loaders beside it"


def test_axes_are_those_of_the_truth(sequence: Sequence) -> None:
    axes = floats(view(sequence)["axes"], 5, 3, 6)
    state = sequence.state
    for t in range(5):
        points = apply(state.cam_from_world[t], axes[t, :, :3])
        along = axes[t, :, 3:] @ state.cam_from_world[t, :3, :3].T
        assert np.allclose(along, state.joint_screw[t, :, :3], atol=1e-5)
        moment = np.cross(points[:2], along[:2])
        assert np.allclose(moment, state.joint_screw[t, :2, 3:], atol=1e-5)
        child = state.world_from_part[t, state.joint_child_part[2] - 1, :3, 3]
        assert np.allclose(axes[t, 2, :3], child, atol=1e-5), "a prismatic axis at its child"


def test_a_trajectory_is_the_path_of_one_point_of_the_last_part(sequence: Sequence) -> None:
    (path,) = view(sequence)["trajectories"]
    number = sequence.meta.part_names.index(path["part"]) + 1
    assert number not in sequence.state.joint_parent_part
    in_part = apply(inverse(sequence.state.world_from_part[:, number - 1]),
                    floats(path["points"], 5, 1, 3))
    assert np.allclose(in_part, in_part[0], atol=1e-5)
    assert np.linalg.norm(np.diff(floats(path["points"], 5, 3), axis=0), axis=1).min() > 0.01


def test_the_view_is_about_the_object(sequence: Sequence) -> None:
    data = view(sequence)
    center = floats(data["center"], 3)
    origins = sequence.state.world_from_part[..., :3, 3].reshape(-1, 3)
    assert np.linalg.norm(origins - center, axis=1).max() < 1.5 * data["radius"] < 2.0


def test_only_the_model_of_the_sequence_is_drawn(sequence: Sequence) -> None:
    model = modelled()
    assert is_model_of(model, sequence.meta, sequence.state, 3)
    data = view(sequence, model)
    assert [mesh["part"] for mesh in data["meshes"]] == [0, 1, 2, 3, 4]
    assert np.allclose(floats(data["poses"], 5, 5, 3, 4), sequence.state.world_from_part[:, :, :3],
                       atol=1e-6)
    vertices = floats(data["meshes"][0]["vertices"], -1, 3)
    faces = np.frombuffer(base64.b64decode(data["meshes"][0]["faces"]), "<u2")
    assert np.allclose(np.abs(vertices), 0.05)
    assert faces.max() < len(vertices)
    assert len(faces) == 36

    moved = model.parent_from_part_at_zero.copy()
    moved[2, 0, 3] += 1e-3
    others = {
        "not available": None,
        "not the one": dataclasses.replace(model, parent_from_part_at_zero=moved),
        "is not the one": dataclasses.replace(model, sha256="12"),
        "deform": dataclasses.replace(model, visuals=()),
    }
    for reason, other in others.items():
        data = view(sequence, other)
        assert not data["meshes"]
        assert not data["poses"]
        assert reason in data["reason"]


def test_a_fine_mesh_is_made_coarser_and_stays_where_it_is() -> None:
    ball = sphere(2.0)
    vertices, faces = ball.vertices, ball.faces
    coarse, fewer = simplify(vertices, faces, len(faces) // 3)
    assert len(faces) // 20 < len(fewer) <= len(faces) // 3
    assert np.allclose(np.linalg.norm(coarse, axis=1), 2.0)
    assert np.ptp(coarse[fewer].reshape(-1, 3), axis=0).min() > 3.5
    assert simplify(vertices, faces, len(faces))[1] is faces
    assert len(simplify(vertices, faces, 0)[1]) == 0


def test_a_model_of_many_triangles_is_bounded(sequence: Sequence) -> None:
    model = modelled()
    fine = dataclasses.replace(
        model.visuals[0], **{k: np.tile(getattr(model.visuals[0], k), (9000, 1))
                             for k in ("vertices", "normals")},
        faces=(np.arange(9000)[:, None, None] * len(model.visuals[0].vertices)
               + model.visuals[0].faces).reshape(-1, 3))
    data = view(sequence, dataclasses.replace(model, visuals=(fine, *model.visuals[1:])))
    assert sum(len(mesh["faces"]) * 3 / 4 / 6 for mesh in data["meshes"]) <= 20_000


def test_parts_that_are_never_seen_and_a_sequence_without_joints(sequence: Sequence) -> None:
    s = sequence.state
    none = np.zeros(0, np.int64)
    state = dataclasses.replace(s, joint_positions=np.zeros((5, 0)), joint_child_part=none,
                                joint_screw=np.zeros((5, 0, 6)), joint_parent_part=none)
    meta = dataclasses.replace(sequence.meta, joint_names=(), joint_types=(), joint_limits=(),
                               scored_joints=())
    empty = [np.zeros((120, 160), np.uint16)] * 5
    data = view(Sequence(meta, state, sequence.rgb, sequence.depth, empty, [], [], []))
    assert data["trajectories"] == []
    assert data["radius"] > 0
