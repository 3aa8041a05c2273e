"""GC-Pose from plain video: the stages of the paper (Fig. 2) without depth.

Parts and motion come from flow under the chain, first between few frames, then over all of them
(Sec. 3.2 and 3.3). Bundle adjustment with an unknown depth for every point refines them (Sec. 3.4).
Scale cannot be observed, and nothing here depends on it. Where depth is measured, but with much
noise, it is the prior of the depth of every point, and gives the scale.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ...errors import MethodError
from ...renderer.types import Estimate, Observation
from ...robots.geometry import Array, pinhole
from ..chain import Articulation, JointPriors, scale_axes, scale_twists, screws_of
from ..estimator import calibrate_deviation, spread_of_motions
from ..images import FrontEnd, ImageSettings, VideoEvidence, video_evidence
from .evidence import RgbEvidence, VideoHypothesis
from .points import motions_from_frames, predict_places
from .relocalization import find_doubtful_frames
from .scores import score_hypothesis
from .search import SearchResult, search_video
from .settings import RgbSettings, for_one_joint, with_measured_depth, with_two_flows

_DEPTH_DEVIATION = 0.1
"""Relative standard deviation of a depth that the images tell."""


def estimate_rgb(
    observation: Observation, known: JointPriors, front_end: FrontEnd, settings: RgbSettings,
    image_settings: ImageSettings, object_depth: float | None = None,
) -> Estimate | None:
    """Estimate the motion of one sequence from its images (Sec. 3.2 to 3.4), with their depth as a
    prior if there is any; None where nothing is seen to move.

    `object_depth` is the depth of what moves in frame 0, m. It gives the unit of length, where
    neither measured depth nor the axes do.
    """
    seen = see_video(observation, known, front_end, settings, image_settings)
    if seen is None:
        return None
    seen, found = search_any_direction(seen)
    if found is None:
        return None
    settings, best = seen.settings, found.best
    if seen.edges:
        settings = replace(settings, deviation=settings.deviation_edges)
    metres, line = seen.video.distance or length_unit(known, best.state), known.line
    by_object = object_depth if metres is None else None
    if by_object is not None:
        metres = by_object / depth_at_start(best, float(observation.intrinsics[0, 0]))
    if line is None and metres is not None:
        line = scale_twists(best.state.twist, known.prismatic, metres)
    unit = np.where(known.prismatic, metres or 1.0, 1.0)
    angle, sigma = best.state.angle, reported_deviation(found, settings)
    if len(unit) == 1:
        doubtful = find_doubtful_frames(seen, best)
        sigma[doubtful] = np.hypot(sigma[doubtful], settings.lost_deviation)
    angle, sigma = unit * angle, unit * sigma
    sigma = add_deviations(angle, sigma, seen, by_object is not None)
    if metres is None:
        sigma[1:, known.prismatic] = settings.sigma_unknown
    screw = None if line is None else screws_of(line, known.prismatic)
    assert observation.rgb is not None
    part = label_video(seen.video, best, observation.rgb.shape[:3], settings.part_stride)
    return Estimate(angle, screw, part, sigma)


def see_video(
    observation: Observation, known: JointPriors, front_end: FrontEnd, settings: RgbSettings,
    image_settings: ImageSettings,
) -> RgbEvidence | None:
    """Return what the images of an observation show, with their depth as a prior if there is any;
    None where nothing is seen to move.

    Its unit of length is the distance of the object: the measured one, or that by known axes.

    Raises:
        MethodError: If pixels are not square.
    """
    rgb, k = observation.rgb, observation.intrinsics
    if rgb is None or len(rgb) < 2:
        return None
    if not has_square_pixels(k):
        raise MethodError(f"gcpose on rgb needs square pixels, not focal lengths {k[0, 0]:g} and "
                          f"{k[1, 1]:g} px; resize the images first")
    video = video_evidence(observation, front_end, image_settings)
    if video is None:
        return None
    distance = video.distance or object_distance(known, video)
    known = scale_axes(replace(known, base=base_from_world(observation, video)), 1 / distance)
    return RgbEvidence(video, known, settings_of_video(video, known, settings)).with_axis_by_edges()


def search_any_direction(evidence: RgbEvidence) -> tuple[RgbEvidence, SearchResult | None]:
    """Return the best motion with its evidence.

    What slides in a direction that is not known moves along straight edges, unless another
    direction explains the images better by `settings.box_lead`.
    """
    s, found = evidence.settings, search_video(evidence)
    if found is None:
        return evidence, None
    most = score_hypothesis(found.best, s) + s.box_lead
    for each in evidence.along_box(found.best.state.directions[0]):
        other = search_video(each)
        if other is not None and score_hypothesis(other.best, s) <= most:
            return each, other
    return evidence, found


def has_square_pixels(intrinsics: Array) -> bool:
    """Return whether both focal lengths are alike, as this estimator needs."""
    return bool(np.isclose(intrinsics[0, 0], intrinsics[1, 1], rtol=1e-3))


def settings_of_video(
    evidence: VideoEvidence, known: JointPriors, settings: RgbSettings
) -> RgbSettings:
    """Return the settings for what a video has and what is known of the axes."""
    if evidence.distance is not None:
        settings = with_measured_depth(settings)
    if evidence.second:
        settings = with_two_flows(settings)
    elif known.axis_dof == 4 and len(known.prismatic) > 1:
        settings = replace(settings, deviation=settings.deviation_free)
    if evidence.distance is None and len(known.prismatic) == 1:
        settings = for_one_joint(settings, bool(known.prismatic[0]))
    return settings


def reported_deviation(found: SearchResult, settings: RgbSettings) -> Array:
    """Return standard deviations [T J] within which two thirds of the errors lie.

    Errors are seldom noise: parts or the foreground are wrong, or another motion explains the
    images nearly as well. So the deviation by the residuals, which shows how well each joint is
    seen, grows with the misfit of the patches, and the spread of other motions is added. After
    several searches, it grows where no other search has found the motion, instead.
    """
    s, best = settings.deviation, found.best
    formal = s.formal * (best.deviation() / s.formal) ** s.power
    factor = s.factor * np.exp(s.misfit * (best.cost - s.cost))
    rest = np.hypot(s.floor, s.spread * spread_of_motions(best.state, found.others, s.excess))
    alone = s.alone if found.alone else 1.0
    return calibrate_deviation(formal, alone * factor, alone * rest, settings.sigma_unknown)


def add_deviations(
    angle: Array, sigma: Array, seen: RgbEvidence, by_object: bool
) -> Array:
    """Return standard deviations [T J] of displacements with what axes by straight edges add,
    shadows, and a unit of length by the depth of the object."""
    s, slide = seen.settings, np.abs(np.where(seen.priors.prismatic, angle, 0.0))
    if seen.axis_by_edges is not None:
        by_axis = s.axis_deviation * seen.axis_by_edges.turn_deviation()
        sigma = np.hypot(sigma, by_axis[:, None])
    if seen.box is not None:
        sigma = np.hypot(sigma, s.box_deviation * seen.box.deviation * slide)
    if by_object:
        sigma = np.hypot(sigma, s.object_depth_deviation * slide)
    if seen.video.has_shadows:
        sigma[1:] = np.hypot(sigma[1:], s.shadow_deviation)
    return np.asarray(sigma, np.float64)


def object_distance(known: JointPriors, evidence: VideoEvidence) -> float:
    """Return the distance of the object by its known axes, m; 1 if none is known."""
    if known.line is None or known.prismatic.all():
        return 1.0
    v, u = np.nonzero(evidence.moving[0])
    if not len(u):
        return 1.0
    ray = pinhole.pixel_rays(evidence.intrinsics, [u.mean(), v.mean()])
    found: list[float] = []
    for line in known.line[~known.prismatic]:  # where each axis passes the line of sight
        l, foot = line[:3], np.cross(line[:3], line[3:])
        across = ray - l * (l @ ray)
        found.append(float(across @ foot / max(1e-6, across @ across)))
    return float(np.clip(np.median(found), 0.05, 100.0))


def length_unit(known: JointPriors, state: Articulation) -> float | None:
    """Return the unit of length of a motion by its known axes, m; None if no axis tells it."""
    turns = ~known.prismatic
    if known.line is None or not turns.any():
        return None
    in_metres, in_units = (max(1e-9, float(np.linalg.norm(twist[turns, 3:])))
                           for twist in (known.line, state.twist))
    return in_metres / in_units


def depth_at_start(hypothesis: VideoHypothesis, focal: float) -> float:
    """Return the median depth in frame 0 of what moves, in units of the motion.

    The points are those of the first key frame in which the images tell the depth of most of them:
    where a video begins with a rest, those of frame 0 only have their prior depth.
    """
    points, state = hypothesis.points, hypothesis.state
    keys, index = np.unique(points.frame, return_inverse=True)
    motion = motions_from_frames(state, keys)[index, :, points.label]  # [N T 4 4]
    step = motion[..., :3, 3]
    place = points.ray / points.inverse_depth[:, None]
    seen = np.einsum("ntij,nj->nti", motion[..., :3, :3], place) + step
    by_depth = focal * (
        step[..., :2] - step[..., 2:] * seen[..., :2] / seen[..., 2:]) / seen[..., 2:]
    information = np.einsum("nti,ntij,ntj->n", by_depth, points.place_information, by_depth)
    told = information > _DEPTH_DEVIATION**-2
    first = next((k for k in range(len(keys)) if told[index == k].mean() > 0.5), 0)
    return float(np.median(seen[index == first, 0, 2]))


def base_from_world(observation: Observation, evidence: VideoEvidence) -> Array | None:
    """Return the base point [3] of a serial chain of several joints, at depth 1 if no depth is
    measured, or None.

    It is the world's origin, if that is known and near what moves.
    """
    world, parent = observation.cam_from_world, observation.parents
    if world is None or len(parent) < 2 or np.any(parent != np.arange(-1, len(parent) - 1)):
        return None
    origin = world[:3, 3]
    if origin[2] <= 0:
        return None
    v, u = np.nonzero(evidence.moving.any(axis=0))
    at = pinhole.project(evidence.intrinsics, origin)[:2]
    away = np.hypot(u - at[0], v - at[1]).min()
    unit = evidence.distance or origin[2]
    return origin / unit if away < max(np.ptp(u), np.ptp(v)) else None


def label_video(
    evidence: VideoEvidence, hypothesis: VideoHypothesis, shape: tuple[int, ...], stride: int
) -> NDArray[np.uint8]:
    """Return the parts [T H W] of all images: those of the nearest points, moved from the nearest
    key frame."""
    out = np.zeros(shape, np.uint8)
    points = hypothesis.points
    at = predict_places(hypothesis.state, points, evidence.intrinsics)
    left, top = evidence.corner
    height, width = evidence.moving.shape[1:]
    keys = np.unique(points.frame)
    for t in range(evidence.frames):
        key = keys[np.abs(keys - t).argmin()]
        mine = points.frame == key
        v, u = np.nonzero(evidence.moving[t, ::stride, ::stride])
        if not (mine.any() and len(u)):
            continue
        _, nearest = KDTree(at[mine, t]).query(np.stack([u, v], axis=1) * stride)
        small = np.zeros((height // stride + 1, width // stride + 1), np.uint8)
        small[v, u] = points.label[mine][nearest]
        full = small.repeat(stride, axis=0).repeat(stride, axis=1)[:height, :width]
        out[t, top : top + height, left : left + width] = full * evidence.moving[t]
    return out
