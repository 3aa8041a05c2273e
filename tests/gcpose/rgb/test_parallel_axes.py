"""Turns that parallel axes share: what the outer part does stays the same."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pytest
from gcbench.gcpose.chain.priors import JointPriors
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.foreground import subtract_background
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import FrontEnd, video_evidence
from gcbench.gcpose.rgb import search
from gcbench.gcpose.rgb.evidence import RgbEvidence, VideoHypothesis
from gcbench.gcpose.rgb.parallel_axes import (
    candidate_feet,
    keep_total_turn,
    parallel_joints,
    redistribute,
)
from gcbench.gcpose.rgb.scores import score_hypothesis
from gcbench.gcpose.rgb.settings import RgbSettings
from hypothesis import given
from hypothesis import strategies as st

from ...support.ray_scenes import FRAMES, chain, door


def test_neighboring_axes_are_parallel() -> None:
    state, _ = chain()
    assert parallel_joints(state, RgbSettings()) == [1]
    opposite = state.twist * np.array([1, -1, 1])[:, None]
    assert parallel_joints(replace(state, twist=opposite), RgbSettings()) == [1]
    one = replace(state, twist=state.twist[:1], angle=state.angle[:, :1])
    assert parallel_joints(one, RgbSettings()) == []


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


@pytest.mark.parametrize(("joints", "motions"), [(2, range(1, 2)), (3, range(2, 4))])
@pytest.mark.ci
def test_the_best_motions_exchange_turns(
    joints: int, motions: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    front = FrontEnd(dis_flow, lambda rgb: subtract_background(rgb, ImageSettings()))
    observation = door(0.5)
    video = video_evidence(observation, front, ImageSettings())
    direction = observation.axis_direction
    assert video is not None and direction is not None
    settings = RgbSettings(  # few, which takes less time
        sweep_points=120, tracking_points=50, max_points=60, final_points=80, exchange_points=80,
        beam_width=200, sweep_kept=20, first_kept=12, half_kept=8, tracked_kept=8,
        exchange_places=4, distinct_motion=0.05)
    priors = JointPriors(np.zeros(joints, bool), np.arange(joints) - 1,
                         np.repeat(direction, joints, axis=0), None)
    asked: list[VideoHypothesis] = []
    exchange = search.exchange_parallel_turns

    def record(evidence: RgbEvidence, hypothesis: VideoHypothesis, *others: Any) -> Any:
        asked.append(hypothesis)
        return exchange(evidence, hypothesis, *others)

    monkeypatch.setattr(search, "exchange_parallel_turns", record)
    assert search.search_video(RgbEvidence(video, priors, settings)) is not None
    scores = [score_hypothesis(h, settings) for h in asked]
    assert len(asked) in motions
    assert all(a <= b for a, b in pairwise(scores))
    last = [h.state.angle[-1] for h in asked]
    assert all(np.abs(a - b).max() > settings.distinct_motion for a, b in combinations(last, 2))
