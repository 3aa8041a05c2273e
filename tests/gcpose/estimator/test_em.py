"""The estimator on hypotheses without images: extrapolation, stages, and formal deviations."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from gcbench.gcpose.chain import extrapolate_to
from gcbench.gcpose.estimator import (
    BundleEquations,
    Hypothesis,
    label_difference,
    refine_in_stages,
    select_distinct,
)
from gcbench.gcpose.rgbd.labels import Cloud, Clouds

from ...support.ray_scenes import FRAMES, chain


def hypothesis(cost: float, label: int) -> Hypothesis[Clouds]:
    state, at = chain()
    cloud = Cloud(0, np.zeros((4, 3)), np.zeros((4, 3)), np.full(4, label))
    return Hypothesis(state, Clouds([cloud]), at[0], cost)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_an_even_motion_goes_on_and_is_cut(steps: int) -> None:
    state, _ = chain()
    even = replace(state, angle=np.arange(FRAMES)[:, None] * np.array([0.1, -0.2, 0.3]))
    begun = extrapolate_to(even, 3, steps)
    assert np.array_equal(begun.angle, even.angle[:4])
    assert np.allclose(extrapolate_to(begun, FRAMES - 1, steps).angle, even.angle)


def test_a_stage_refines_the_best_that_differ() -> None:
    found = [hypothesis(cost, label) for cost, label in ((3.0, 1), (1.0, 2), (2.0, 2), (4.0, 3))]
    select = partial(select_distinct, differ=lambda one, two: label_difference(one, two) > 0.5)

    def refine(h: Hypothesis[Clouds]) -> Hypothesis[Clouds]:
        return replace(h, cost=5.0 - h.cost)

    assert [h.cost for h in refine_in_stages(found, select, (0, refine))] == [2.0, 4.0, 3.0, 1.0]
    assert [h.cost for h in refine_in_stages(found, select, (2, refine))] == [4.0, 2.0]
    assert [h.cost for h in refine_in_stages(found, select, (2, refine), (1, refine))] == [3.0]


def test_errors_that_go_together_widen_the_deviation() -> None:
    """n equal measurements of each displacement: 1 / sqrt(n) if independent, 1 if they are one."""
    one, n = hypothesis(0.0, 1), 16.0
    eye = np.eye(one.state.angle[1:].size)
    alone, likewise, together = (
        replace(one, equations=BundleEquations(n * eye, eye[0], scatter)).deviation()
        for scatter in (None, n * eye, n**2 * eye))
    assert np.allclose(alone, 1 / np.sqrt(n)) and np.allclose(likewise, alone)
    assert np.allclose(together, 1.0)
