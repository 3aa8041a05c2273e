"""Random objects: models like any other, equal for equal numbers."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.robots.catalog import find_robot, is_local, load_robot
from gcbench.robots.generated.random_chains import random_object
from gcbench.robots.geometry.normals import face_normals
from gcbench.robots.model import forward_kinematics

NUMBERS = range(40)


@pytest.mark.parametrize("number", NUMBERS)
def test_it_is_a_model(number: int) -> None:
    model = random_object(number)
    parts, joints = len(model.parent), len(model.joint_names)
    assert joints == np.count_nonzero(model.joint >= 0) >= 2
    assert all(p < k for k, p in enumerate(model.parent))
    assert (model.limits[:, 0] < 0).all() and (model.limits[:, 1] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(model.screw[model.joint_child, :3], axis=1), 1.0)
    poses = forward_kinematics(model, model.limits.mean(axis=1))
    assert poses.shape == (parts, 4, 4)
    rotations = poses[:, :3, :3]
    square = rotations @ rotations.transpose(0, 2, 1)
    np.testing.assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), atol=1e-12)


@pytest.mark.parametrize("number", NUMBERS)
def test_surfaces_face_outward(number: int) -> None:
    """The volume that the triangles enclose is positive, and normals point where they do."""
    for visual in random_object(number).visuals:
        corners = visual.vertices[visual.faces]
        volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum()
        assert volume > 0
        flat, area = face_normals(visual.vertices, visual.faces)
        smooth = visual.normals[visual.faces].mean(axis=1)
        along = np.einsum("fi,fi->f", flat, smooth)
        assert along[area > 1e-9].min() > 0
        np.testing.assert_allclose(np.linalg.norm(visual.normals, axis=1), 1.0, atol=1e-9)


def test_a_number_is_a_model() -> None:
    a, b, other = random_object(7), random_object(7), random_object(8)
    np.testing.assert_array_equal(a.parent_from_part_at_zero, b.parent_from_part_at_zero)
    for u, v in zip(a.visuals, b.visuals, strict=True):
        np.testing.assert_array_equal(u.vertices, v.vertices)
        assert u.material == v.material
    assert len(a.parent) != len(other.parent) or not np.array_equal(
        a.parent_from_part_at_zero, other.parent_from_part_at_zero)


def test_both_families_occur() -> None:
    """A chain shows the part that it stands on, loose bodies hang on one that shows nothing."""
    stands = [any(v.part == 0 for v in random_object(n).visuals) for n in NUMBERS]
    assert any(stands) and not all(stands)


def test_the_catalogue_knows_them_by_number() -> None:
    model = load_robot("random:12")
    assert (model.name, model.licence) == ("random:12", "MIT")
    assert is_local(find_robot("random:12"))
    with pytest.raises(GcbenchError, match="random:NUMBER"):
        find_robot("random:x")
