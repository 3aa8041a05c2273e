"""Chains from the motion of parts, from hinges, and from places."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench.gcpose.chain import (
    Chains,
    ChainSettings,
    Goal,
    fit_chains,
    fit_displacements,
    locate_hinges,
    misfit,
    spread_places,
)
from gcbench.gcpose.chain.kinematics import part_motions
from gcbench.gcpose.numerics import thread_map


@pytest.mark.parametrize("axis_dof", [2, 4])
@pytest.mark.parametrize("place", [[2], [2, 1]])
def test_a_chain_is_found_from_the_motion_of_its_last_parts(
    axis_dof: int, place: list[int]
) -> None:
    """The truth makes the motion; so does what is fitted, from axes that are some way off."""
    rng = np.random.default_rng(5)
    l = np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 1.0]])
    p = np.array([[0, 0.3, 2.0], [0.1, 0.1, 2.0], [0.2, -0.2, 1.9]])
    twist = np.concatenate([l, np.cross(p, l)], axis=1)
    time = np.linspace(0, 1, 12)
    angle = np.stack([0.7 * time, -0.5 * time**2, 0.4 * np.sin(2 * time)], axis=1)
    path, which = np.arange(3), np.array(place)
    motion = part_motions(twist, angle, path - 1)[:, which + 1]
    goal = Goal(path, path - 1, which, motion, np.tile(np.eye(6), (12, len(place), 1, 1)),
                np.zeros(3, bool), p, axis_dof)
    assert misfit(goal, Chains(twist[None], angle[None]))[0] < 1e-9
    held = fit_displacements(goal, twist[None], ChainSettings())
    assert np.allclose(held.angle[0], angle, atol=1e-3)
    off = np.concatenate([l, np.cross(p + rng.normal(0, 0.05, (3, 3)), l)], axis=1)
    start = fit_displacements(goal, off[None], ChainSettings())
    found = fit_chains(goal, start, ChainSettings())
    assert misfit(goal, found)[0] < 0.02 * misfit(goal, start)[0]
    if axis_dof == 2:
        assert np.abs(found.angle[0] - angle).max() < np.radians(1.0)


def test_a_hinge_is_where_a_part_is_nearest_to_what_carries_it() -> None:
    rng = np.random.default_rng(4)
    points = rng.random((90, 3)) + np.repeat([[0, 0, 0], [1, 0, 0], [0, 2, 0]], 30, axis=0)
    label, base = np.repeat([1, 2, 3], 30), np.array([5.0, 5.0, 5.0])

    def nearest(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
        apart = np.linalg.norm(outer[:, None] - inner, axis=2).min(axis=1)
        return outer[np.argsort(apart)[: 1 + len(outer) // 12]].mean(axis=0)

    chain, fork = (locate_hinges(points, label, base, np.array(p), ChainSettings())
                   for p in ([-1, 0, 1], [-1, 0, 0]))
    assert (chain[0] == base).all() and (fork[0] == base).all()
    assert np.allclose(chain[1], nearest(points[:30], points[30:]))
    assert np.allclose(chain[2], nearest(points[:60], points[60:]))
    assert np.allclose(fork[1:], [nearest(points[:30], points[i : i + 30]) for i in (30, 60)])
    hidden = locate_hinges(points, np.where(label == 3, 0, label), base, np.array([-1, 0, 1]),
                    ChainSettings())
    assert (hidden[2] == hidden[1]).all()  # nothing is seen of it: its carrier's


def test_places_are_spread_and_threads_keep_the_order() -> None:
    points = np.random.default_rng(0).random((200, 3))
    places = spread_places(points, 10, 1000)
    assert places.shape == (10, 3)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(10)
    assert apart.min() > 0.15 and spread_places(points[:3], 10, 1000).shape == (3, 3)
    assert thread_map(lambda i: i * i, range(20)) == [i * i for i in range(20)]
