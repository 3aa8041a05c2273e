"""The standard deviation on plain video: it grows with what speaks against the estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.estimator import BundleEquations, spread_of_motions
from gcbench.gcpose.rgb.evidence import VideoHypothesis
from gcbench.gcpose.rgb.pipeline import reported_deviation
from gcbench.gcpose.rgb.points import InverseDepthPoints
from gcbench.gcpose.rgb.search import SearchResult
from gcbench.gcpose.rgb.settings import RgbSettings, with_two_flows

from ...support.ray_scenes import chain

SETTINGS = RgbSettings()
DEVIATION = SETTINGS.deviation


def hypothesis(cost: float = DEVIATION.cost, information: float = 1e6) -> VideoHypothesis:
    state, at = chain()
    none = np.zeros(0, np.int64)
    points = InverseDepthPoints.without_measurements(none, np.zeros((0, 3)), none, np.zeros(0))
    size = state.angle[1:].size
    equations = BundleEquations(information * np.eye(size), np.zeros(size))
    return VideoHypothesis(state, points, at[0], cost, equations)


def moved(state: Articulation, by: float) -> Articulation:
    angle = state.angle.copy()
    angle[-1, 0] += by
    return replace(state, angle=angle)


def test_the_deviation_is_that_of_the_adjustment_with_a_floor() -> None:
    found, state = reported_deviation(SearchResult(hypothesis(), []), SETTINGS), hypothesis().state
    assert found.shape == state.angle.shape
    assert (found[0] == 0).all()
    formal = DEVIATION.factor * 1e-3
    assert np.allclose(found[1:], np.hypot(formal, DEVIATION.floor), rtol=1e-3)
    unseen = reported_deviation(SearchResult(hypothesis(information=0.0), []), SETTINGS)
    assert (unseen[1:] == SETTINGS.sigma_unknown).all()


def test_patches_that_do_not_fit_raise_the_deviation() -> None:
    last = [reported_deviation(SearchResult(hypothesis(cost), []), SETTINGS)[-1, 0]
            for cost in (2.0, 3.0, 4.0)]
    assert last[0] < last[1] < last[2]


def test_a_motion_that_no_other_search_finds_has_a_larger_deviation() -> None:
    settings = with_two_flows(SETTINGS)
    found, alone = (reported_deviation(SearchResult(hypothesis(), [], alone), settings)[1:]
                    for alone in (False, True))
    assert np.allclose(alone, settings.deviation.alone * found) and settings.deviation.alone > 1


def test_with_two_flows_the_deviation_grows_faster_than_the_formal_one() -> None:
    settings = with_two_flows(SETTINGS)
    how, unseen = settings.deviation, SETTINGS.sigma_unknown
    near, far = (reported_deviation(
        SearchResult(hypothesis(information=(how.formal * k) ** -2), []), settings)[-1, 0]
        for k in (1.0, 4.0))
    assert np.allclose(near, np.hypot(how.factor * how.formal, how.floor), rtol=1e-3)
    assert np.allclose(far, np.hypot(how.factor * how.formal * 4**how.power, how.floor), rtol=1e-3)
    assert far < unseen


def test_other_motions_count_by_how_well_they_fit() -> None:
    state = hypothesis().state
    same = state, 0.0
    near, far = ((moved(state, 0.3), k * DEVIATION.excess) for k in (0.0, 10.0))
    found = spread_of_motions(state, [same, near], DEVIATION.excess)
    assert np.isclose(found[-1, 0], 0.3 / np.sqrt(3))
    found[-1, 0] = 0.0
    assert (found == 0).all(), "the other joints and frames agree"
    assert spread_of_motions(state, [same, far], DEVIATION.excess).max() < 0.01
    alone, doubted = (reported_deviation(SearchResult(hypothesis(), others), SETTINGS)[-1]
                      for others in ([same], [same, near]))
    assert doubted[0] > alone[0] and (doubted[1:] == alone[1:]).all()


def test_an_axis_the_other_way_round_is_the_same() -> None:
    state = hypothesis().state
    mirrored = replace(state, twist=-state.twist, angle=-state.angle)
    assert (spread_of_motions(state, [(mirrored, 0.0)], 1.0) == 0).all()
