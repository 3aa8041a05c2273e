"""Starts by a sweep, their costs, and when two solutions are the same."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from gcbench.gcpose.chain import Articulation, joint_priors
from gcbench.gcpose.chain.kinematics import part_motions, twists_of
from gcbench.gcpose.estimator import Hypothesis
from gcbench.gcpose.images import ImageSettings, surfaces_from_depth
from gcbench.gcpose.rgbd import RgbdSettings
from gcbench.gcpose.rgbd.depth_sweep import depth_step_costs, sweep_depth
from gcbench.gcpose.rgbd.evidence import RgbdEvidence
from gcbench.gcpose.rgbd.kernels import columns
from gcbench.gcpose.rgbd.labels import Clouds, moving_mask
from gcbench.gcpose.rgbd.search import motion_difference, select_by_motion
from gcbench.gcpose.rgbd.settings import LabelSettings

from ...support.boxes import INTRINSICS, scene, told


def test_a_sweep_holds_the_first_steps_without_any_flow() -> None:
    observation, angle, _, _ = scene("arm")
    assert observation.depth is not None
    surfaces = surfaces_from_depth(observation.depth, INTRINSICS, ImageSettings())
    known = joint_priors(told(observation, "axes"))
    blank = np.zeros((*observation.depth.shape, 3), np.uint8)
    where = moving_mask(surfaces, blank, LabelSettings())
    evidence = RgbdEvidence(surfaces, blank, where, known, RgbdSettings(), 500)
    found = sweep_depth(evidence, 3, 12)
    off = [np.abs(h.state.angle[3] - angle[3]).max() for h in found]
    assert len(found) == 12 and min(off) < np.radians(4.0)
    assert all(a.cost <= b.cost for a, b in pairwise(found))
    assert evidence.coarser(100).base_candidates is evidence.base_candidates
    unknown = joint_priors(told(observation, "free"))
    free = sweep_depth(RgbdEvidence(surfaces, blank, where, unknown, RgbdSettings(), 500), 3, 9)
    for h in free:  # upright, then along or across
        first, second = h.state.twist[:, :3]
        assert first[0] == 0 and first[1] < 0
        assert min(abs(first @ second), 1 - first @ second) < 1e-5


def test_the_true_motion_costs_least_and_blocks_change_nothing() -> None:
    observation, angle, screw, part = scene("arm")
    assert observation.depth is not None
    surfaces = surfaces_from_depth(observation.depth, INTRINSICS, ImageSettings())
    v, u = np.nonzero((part[0] == 2) & surfaces.normal[0].any(axis=2))
    column = columns(surfaces.points(0, np.stack([u, v], axis=1)), surfaces.normal[0, v, u])
    some = angle[5] + np.linspace(-0.2, 0.2, 41)[:, None]
    motion = part_motions(twists_of(screw, np.zeros(2, bool)), some, np.array([-1, 0]))[:, 2]
    judge = depth_step_costs(surfaces, 5, column, RgbdSettings())
    cost = judge.costs(motion)
    assert abs(int(cost.mean(axis=1).argmin()) - 20) <= 1  # 0.6 deg from one to the next
    alone = np.stack([judge.costs(m[None])[0] for m in motion])
    assert np.allclose(cost, alone, atol=1e-4)


def test_an_axis_that_points_the_other_way_is_the_same_solution() -> None:
    _, angle, screw, _ = scene("arm")
    twist, kind = twists_of(screw, np.zeros(2, bool)), np.zeros(2, bool)
    none = Clouds(), np.zeros(3)
    one = Hypothesis(Articulation(twist, angle, kind, np.array([-1, 0])), *none, 1.0)
    rotate = Articulation(twist * [[1], [-1]], angle * [1, -1], kind, np.array([-1, 0]))
    two = Hypothesis(rotate, *none, 2.0)
    other = Hypothesis(replace(rotate, twist=twist), *none, 3.0)
    settings = RgbdSettings()
    assert motion_difference(one, two, settings) < 1e-9
    assert motion_difference(one, other, settings) > 0.5
    assert select_by_motion([other, two, one], 3, settings) == [one, other]
