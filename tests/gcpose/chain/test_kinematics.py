"""The chain's motions and their derivatives, against closed forms and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench.gcpose.chain.kernels import add_normal_equations
from gcbench.gcpose.chain.kinematics import (
    ancestors,
    axis_basis,
    derivatives,
    displace_axis,
    part_motions,
    relative_derivatives,
    screws_of,
    twists_of,
)
from gcbench.robots.geometry import inverse, revolute_motion, se3

PRISMATIC = np.array([False, True, False])
CHAIN = np.array([-1, 0, 1])
TREES = [CHAIN, np.array([-1, 0, 0]), np.array([-1, -1, 1])]


def chain(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Twists [3 6] and displacements [4 3] of a chain with a slide in its middle."""
    l = rng.normal(size=(3, 3))
    l /= np.linalg.norm(l, axis=1, keepdims=True)
    screw = np.concatenate([l, np.cross(rng.normal(size=(3, 3)), l)], axis=1)
    screw[1, 3:] = 0.0
    angle = rng.normal(size=(4, 3))
    angle[0] = 0.0
    return twists_of(screw, PRISMATIC), angle


def twist_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Small twist with exp(twist) a = b."""
    d = b @ inverse(a)
    return np.array([d[2, 1], d[0, 2], d[1, 0], *d[:3, 3]])


def test_a_screw_survives_the_way_to_a_twist_and_back() -> None:
    twist, _ = chain(np.random.default_rng(0))
    screw = screws_of(twist, PRISMATIC)
    assert np.allclose(screw[1, 3:], 0)
    assert np.allclose(twists_of(screw, PRISMATIC), twist)


def test_the_exponential_of_a_revolute_twist_is_its_motion() -> None:
    twist, _ = chain(np.random.default_rng(1))
    assert np.allclose(se3.exp(twist[0] * 0.7), revolute_motion(twist[0], 0.7))
    assert np.allclose(se3.exp(np.zeros(6)), np.eye(4))


def test_a_part_moves_with_all_that_carries_it() -> None:
    twist, angle = chain(np.random.default_rng(5))
    one, two, three = (se3.exp(t * a[:, None]) for t, a in zip(twist, angle.T, strict=True))
    for parent, expected in zip(TREES, (one @ two @ three, one @ three, two @ three), strict=True):
        assert np.allclose(part_motions(twist, angle, parent)[:, 3], expected)
        moves = ancestors(parent)
        assert not moves[0].any() and np.diagonal(moves[1:]).all()
    assert ancestors(TREES[2])[3].tolist() == [False, True, True]


@pytest.mark.parametrize("parent", TREES)
def test_derivatives_by_displacements_are_finite_differences(parent: np.ndarray) -> None:
    twist, angle = chain(np.random.default_rng(3))
    motion, step = part_motions(twist, angle, parent), 1e-6
    derivative = derivatives(twist, motion, parent, (np.zeros((6, 0)),) * 3)
    for t in range(1, 4):
        for i in range(3):
            more = angle.copy()
            more[t, i] += step
            moved, u = part_motions(twist, more, parent), 3 * (t - 1) + i
            for other in range(4):
                for j in range(4):
                    seen = twist_of(motion[other, j], moved[other, j]) / step
                    assert np.allclose(seen, derivative[other, j, u], atol=1e-4)


@pytest.mark.parametrize("parent", TREES)
@pytest.mark.parametrize("axis_dof", [0, 2, 4])
def test_derivatives_by_axes_are_finite_differences(axis_dof: int, parent: np.ndarray) -> None:
    twist, angle = chain(np.random.default_rng(4))
    motion, step = part_motions(twist, angle, parent), 1e-6
    near = np.array([0.3, -0.2, 1.5])
    pairs = zip(twist, PRISMATIC, strict=True)
    basis = tuple(axis_basis(s, bool(p), near, axis_dof) for s, p in pairs)
    derivative = derivatives(twist, motion, parent, basis)
    at = 9
    for i, b in enumerate(basis):
        for c in range(b.shape[1]):
            other = twist.copy()
            other[i] = displace_axis(twist[i], b[:, c] * step, bool(PRISMATIC[i]))
            moved = part_motions(other, angle, parent)
            for t in range(4):
                for j in range(4):
                    seen = twist_of(motion[t, j], moved[t, j]) / step
                    assert np.allclose(seen, derivative[t, j, at + c], atol=1e-4)
        at += b.shape[1]
    assert derivative[:, :, 9:].any(axis=(0, 1, 3)).all()  # every one of them does something
    assert at == derivative.shape[2] == {0: 9, 2: 13, 4: 19}[axis_dof]


def test_relative_derivatives_are_finite_differences() -> None:
    twist, angle = chain(np.random.default_rng(6))
    motion, step, u = part_motions(twist, angle, CHAIN), 1e-6, 3 + 1
    derivative = derivatives(twist, motion, CHAIN, (np.zeros((6, 0)),) * 3)
    more = angle.copy()
    more[2, 1] += step
    moved = part_motions(twist, more, CHAIN)
    apart, after = motion @ inverse(motion[2]), moved @ inverse(moved[2])
    found = relative_derivatives(derivative, apart, derivative[2:3])
    for t in range(4):
        for j in range(1, 4):
            assert np.allclose(twist_of(apart[t, j], after[t, j]) / step, found[t, j, u], atol=1e-4)
    apart, after = motion[1:] @ inverse(motion[:-1]), moved[1:] @ inverse(moved[:-1])
    found = relative_derivatives(derivative[1:], apart, derivative[:-1])
    for t in range(3):
        for j in range(1, 4):
            assert np.allclose(twist_of(apart[t, j], after[t, j]) / step, found[t, j, u], atol=1e-4)


def test_normal_equations_are_those_of_dense_sums() -> None:
    rng = np.random.default_rng(7)
    root, right = rng.normal(size=(4, 3, 6, 6)), rng.normal(size=(4, 3, 6))
    six = root @ root.swapaxes(2, 3)
    g = rng.normal(size=(4, 3, 10, 6)) * (rng.random((4, 3, 10, 1)) < 0.4)
    matrix, vector, scatter = np.zeros((10, 10)), np.zeros(10), np.zeros((10, 10))
    add_normal_equations(six, right, g, matrix, vector, scatter)
    six, right, g = six[:, 1:], right[:, 1:], g[:, 1:]  # part 0 says nothing
    each = np.einsum("tjua,tja->tju", g, right)
    assert np.allclose(matrix, np.einsum("tjua,tjab,tjvb->uv", g, six, g))
    assert np.allclose(vector, each.sum(axis=(0, 1)))
    assert np.allclose(scatter, np.einsum("tju,tjv->uv", each, each))
