"""Known axes on plain video: their unit of length follows the points, and the images stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gcbench.gcpose.chain.priors import JointPriors
from gcbench.gcpose.images.flow import dis_flow
from gcbench.gcpose.images.foreground import subtract_background
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import FrontEnd, video_evidence
from gcbench.gcpose.rgb.evidence import RgbEvidence, VideoHypothesis, center_depths
from gcbench.gcpose.rgb.pipeline import length_unit
from gcbench.gcpose.rgb.points import predict_places
from gcbench.gcpose.rgb.search import sweep_hypotheses
from gcbench.gcpose.rgb.settings import RgbSettings

from ...support.ray_scenes import INTRINSICS, chain, door, measured

FOOT = np.array([-0.15, 0.0, 1.2])
"""On the axis of `door`"""


def known_door(lines: bool = True) -> RgbEvidence:
    observation = door(0.5)
    direction = observation.axis_direction
    front = FrontEnd(dis_flow, lambda rgb: subtract_background(rgb, ImageSettings()))
    video = video_evidence(observation, front, ImageSettings())
    assert direction is not None and video is not None
    line = np.concatenate([direction, np.cross(FOOT, direction)], axis=1)
    priors = JointPriors(np.zeros(1, bool), np.array([-1]), direction, line if lines else None)
    return RgbEvidence(video, priors, RgbSettings())


def moment(hypothesis: VideoHypothesis) -> float:
    return float(np.linalg.norm(hypothesis.state.twist[:, 3:]))


def test_depths_about_1_show_the_same_images() -> None:
    state, at = chain()
    slides = np.array([False, False, True])
    twist = np.where(slides[:, None], np.roll(state.twist, 3, axis=1) * np.repeat([0, 1], 3),
                     state.twist)
    state = replace(state, twist=twist, prismatic=slides)
    start = VideoHypothesis(state, measured(state, 2.5, 0.0, False), at[0], 1.0)
    start = replace(start, points=replace(
        start.points, inverse_depth=start.points.inverse_depth * np.linspace(0.3, 0.5, 240)))
    found = center_depths(start)
    assert np.isclose(np.median(found.points.inverse_depth), 1.0)
    assert abs(np.median(start.points.inverse_depth) - 1.0) > 0.5
    before, after = (predict_places(h.state, h.points, INTRINSICS) for h in (start, found))
    assert np.allclose(before, after)
    known = JointPriors(slides, state.parent, None, state.twist)
    unit = length_unit(known, found.state)
    assert unit is not None
    assert np.allclose(unit * found.state.angle[:, 2], state.angle[:, 2])
    assert length_unit(replace(known, line=None), found.state) is None


def test_the_unit_of_known_axes_follows_the_points() -> None:
    for lines in (True, False):
        evidence = known_door(lines)
        points = evidence.sample((0, 4), 60)
        swept = sweep_hypotheses(evidence, evidence.sample((0,), 60), 2)[0]
        far = replace(swept, state=replace(
            swept.state, twist=swept.state.twist * np.repeat([1.0, 1.5], 3)))
        found = evidence.label(evidence.track(far, 5), points)
        depth = float(np.median(found.points.inverse_depth))
        assert np.isclose(depth, 1.0, rtol=1e-9) == lines


def test_several_units_of_known_axes_are_tried() -> None:
    evidence = known_door()
    line = evidence.priors.line
    assert line is not None
    found = sweep_hypotheses(evidence, evidence.sample((0,), 60), 2)
    scale = np.array([moment(h) * np.median(h.points.inverse_depth) for h in found])
    assert np.ptp(scale) > 0.1 * scale.mean()
    assert np.allclose(found[0].state.twist[:, :3], line[:, :3])
