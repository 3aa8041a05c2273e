"""Turns of a chain from the rotations of its parts: all together, whichever are told."""

from __future__ import annotations

import numpy as np
from gcbench.robots.geometry import rotation_about
from gcbench.robots.motion.kinematics import chain_angles, chain_rotations


def test_the_chain_explains_all_rotations() -> None:
    """A part that tells nothing is read off what hangs on it; a wrong one has no say."""
    axes = np.array([[0, 0, 1.0], [0, 1, 0], [0, 1, 0]])
    still, prismatic, chain = np.zeros(3), np.zeros(3, bool), np.array([-1, 0, 1])
    angle = np.array([0.4, -0.3, 0.7])
    rotation = chain_rotations(axes, prismatic, chain, angle)
    trust = np.tile(np.eye(3), (3, 1, 1))
    got = chain_angles(rotation, trust, axes, prismatic, chain, still, still)
    np.testing.assert_allclose(got, angle, atol=1e-9)
    rotation[0], trust[0] = rotation_about([0, 0, 1], 2.0), np.diag([1, 1, 0.0])
    got = chain_angles(rotation, trust, axes, prismatic, chain, still, angle - 0.1)
    np.testing.assert_allclose(got, angle, atol=1e-6)
    slides = np.array([False, True, False])
    assert chain_angles(rotation, trust, axes, slides, chain, still, still)[1] == 0


def test_joints_side_by_side_do_not_carry_each_other() -> None:
    axes, parent = np.array([[0, 0, 1.0], [0, 1, 0], [0, 1, 0]]), np.array([-1, 0, 0])
    still, prismatic, angle = np.zeros(3), np.zeros(3, bool), np.array([0.4, -0.3, 0.7])
    rotation = chain_rotations(axes, prismatic, parent, angle)
    np.testing.assert_allclose(
        rotation[2], rotation[0] @ rotation_about([0, 1, 0], 0.7), atol=1e-12)
    trust = np.tile(np.eye(3), (3, 1, 1))
    got = chain_angles(rotation, trust, axes, prismatic, parent, still, still)
    np.testing.assert_allclose(got, angle, atol=1e-9)


def test_steps_add_up() -> None:
    axes = np.array([[0, 0, 1.0], [0.6, 0.8, 0]])
    prismatic, chain = np.zeros(2, bool), np.array([-1, 0])
    a, b = np.array([0.3, 0.2]), np.array([0.5, -0.1])
    before, after = (chain_rotations(axes, prismatic, chain, x) for x in (a, b))
    step = after @ np.swapaxes(before, 1, 2)
    trust = np.tile(np.eye(3), (2, 1, 1))
    np.testing.assert_allclose(
        chain_angles(step, trust, axes, prismatic, chain, a, a), b, atol=1e-9)
