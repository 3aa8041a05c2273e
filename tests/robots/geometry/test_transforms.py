"""Round trips of rotations and transforms."""

from __future__ import annotations

import numpy as np
from gcbench.robots.geometry import (
    apply,
    inverse,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_about,
    rotation_from_quaternion,
    rotation_from_rpy,
    transform,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

NUMBERS = st.floats(-10, 10)
QUATERNIONS = arrays(float, (3, 4), elements=NUMBERS).filter(
    lambda q: bool((np.linalg.norm(q, axis=-1) > 0.1).all()))


def unit(q: np.ndarray) -> np.ndarray:
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


@given(QUATERNIONS)
def test_a_quaternion_comes_back_up_to_its_sign(q: np.ndarray) -> None:
    rotation = rotation_from_quaternion(unit(q))
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (3, 1, 1)),
                               atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)
    same = np.einsum("ni,ni->n", quaternion_from_rotation(rotation), unit(q))
    np.testing.assert_allclose(np.abs(same), 1.0, atol=1e-12)


@given(arrays(float, 3, elements=st.floats(-1.5, 1.5)))
def test_roll_pitch_and_yaw_come_back(rpy: np.ndarray) -> None:
    r = rotation_from_rpy(rpy)
    got = np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(np.clip(r[2, 0], -1, 1)), np.arctan2(r[1, 0],
                                                                                     r[0, 0])
    np.testing.assert_allclose(got, rpy, atol=1e-9)


@given(QUATERNIONS, arrays(float, (3, 3), elements=NUMBERS), arrays(float, (3, 5, 3),
                                                                     elements=NUMBERS))
def test_an_inverse_undoes_a_transform(
    q: np.ndarray, t: np.ndarray, points: np.ndarray
) -> None:
    pose = transform(rotation_from_quaternion(unit(q)), t)
    np.testing.assert_allclose(apply(inverse(pose), apply(pose, points)), points, atol=1e-9)
    np.testing.assert_allclose(inverse(inverse(pose)), pose, atol=1e-9)


@given(QUATERNIONS, arrays(float, 3, elements=st.floats(0.1, 10)), st.booleans())
def test_stretching_along_axes_leaves_the_nearest_rotation(
    q: np.ndarray, scale: np.ndarray, mirrors: bool
) -> None:
    rotation, basis = rotation_from_quaternion(unit(q))[:2]
    stretch = basis @ np.diag(scale) @ basis.T * (-1.0 if mirrors else 1.0)
    np.testing.assert_allclose(nearest_rotation(rotation @ stretch), rotation, atol=1e-9)


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_angles_about_one_axis_add(a: float, b: float) -> None:
    axis = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(rotation_about(axis, a) @ rotation_about(axis, b),
                               rotation_about(axis, a + b), atol=1e-12)
