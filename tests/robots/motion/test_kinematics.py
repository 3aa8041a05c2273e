"""Angles of a chain from the rotations of its parts, all fitted together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gcbench.robots.geometry import rotation_about
from gcbench.robots.motion import ChainAxes, chain_rotations, fit_chain_angles


def test_the_chain_explains_all_rotations() -> None:
    """A part that tells nothing is read off what hangs on it; a wrong one has no say."""
    axes = np.array([[0, 0, 1.0], [0, 1, 0], [0, 1, 0]])
    still, chain = np.zeros(3), ChainAxes(axes, np.zeros(3, bool), np.array([-1, 0, 1]))
    angle = np.array([0.4, -0.3, 0.7])
    rotation = chain_rotations(chain, angle)
    trust = np.tile(np.eye(3), (3, 1, 1))
    got = fit_chain_angles(chain, rotation, trust, still, still)
    np.testing.assert_allclose(got, angle, atol=1e-9)
    rotation[0], trust[0] = rotation_about([0, 0, 1], 2.0), np.diag([1, 1, 0.0])
    got = fit_chain_angles(chain, rotation, trust, still, angle - 0.1)
    np.testing.assert_allclose(got, angle, atol=1e-6)
    slides = replace(chain, prismatic=np.array([False, True, False]))
    assert fit_chain_angles(slides, rotation, trust, still, still)[1] == 0


def test_joints_side_by_side_do_not_carry_each_other() -> None:
    axes = np.array([[0, 0, 1.0], [0, 1, 0], [0, 1, 0]])
    chain = ChainAxes(axes, np.zeros(3, bool), np.array([-1, 0, 0]))
    still, angle = np.zeros(3), np.array([0.4, -0.3, 0.7])
    rotation = chain_rotations(chain, angle)
    np.testing.assert_allclose(
        rotation[2], rotation[0] @ rotation_about([0, 1, 0], 0.7), atol=1e-12)
    trust = np.tile(np.eye(3), (3, 1, 1))
    got = fit_chain_angles(chain, rotation, trust, still, still)
    np.testing.assert_allclose(got, angle, atol=1e-9)


def test_steps_add_up() -> None:
    axes = np.array([[0, 0, 1.0], [0.6, 0.8, 0]])
    chain = ChainAxes(axes, np.zeros(2, bool), np.array([-1, 0]))
    a, b = np.array([0.3, 0.2]), np.array([0.5, -0.1])
    before, after = (chain_rotations(chain, x) for x in (a, b))
    step = after @ np.swapaxes(before, 1, 2)
    trust = np.tile(np.eye(3), (2, 1, 1))
    np.testing.assert_allclose(
        fit_chain_angles(chain, step, trust, a, a), b, atol=1e-9)
