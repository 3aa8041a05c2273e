"""Turns that parallel axes share: what the outer part does stays the same."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench.gcpose.rgb.parallel_axes import candidate_feet, keep_total_turn, redistribute
from gcbench.gcpose.rgb.settings import RgbSettings
from hypothesis import given
from hypothesis import strategies as st

from ...support.ray_scenes import FRAMES, chain


@given(share=st.floats(-3, 3))
def test_a_turn_that_is_redistributed_has_the_same_sum(share: float) -> None:
    state, _ = chain()  # axes 1 and 2 are parallel
    other = redistribute(state, 1, share)
    assert np.allclose(other.angle[:, 1:].sum(axis=1), state.angle[:, 1:].sum(axis=1))
    assert np.allclose(other.angle[:, 1], share * state.angle[:, 1:].sum(axis=1))
    turns = [s.motions(FRAMES)[:, 3, :3, :3] for s in (state, other)]
    assert np.allclose(*turns)


def test_the_true_hinge_and_foot_give_the_true_turns() -> None:
    state, at = chain()
    wrong = redistribute(state, 1, 0.3)
    same = keep_total_turn(state, 1, at[2], at[1], RgbSettings())
    assert same is not None
    assert np.allclose(same.angle, state.angle)
    assert np.allclose(same.motions(FRAMES), state.motions(FRAMES))
    assert np.abs(wrong.angle - state.angle).max() > 0.1


def test_axes_at_one_place_share_nothing() -> None:
    state, at = chain()
    assert keep_total_turn(state, 1, at[2], at[2] + 0.01, RgbSettings()) is None


@pytest.mark.parametrize("most", [1, 2])
def test_the_foot_is_where_the_hinge_keeps_its_distance(most: int) -> None:
    state, at = chain()
    rng = np.random.default_rng(1)
    places = np.concatenate([at[:1], at[1] + 0.3 * rng.standard_normal((9, 3)), at[1:2]])
    feet = candidate_feet(state, 1, at[2], places, most)
    assert len(feet) == 1 + most
    assert np.allclose(feet[:2], [at[0], at[1]])
