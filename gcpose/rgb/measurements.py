"""What flow, patches and tracks measure of the points of key frames.

Flow is dense and drifts. Patches are few and do not drift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation
from ..images import PredictedPatches, VideoEvidence, find_patches
from ..numerics import geman_mcclure_cost
from .outline import slide_of_edges, slide_of_outline
from .points import (
    InverseDepthPoints,
    inverse_depth_slopes,
    motions_from_keys,
    predict_places,
    predict_warps,
)
from .settings import RgbSettings
from .tracks import chain_flow


def measure_flow(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints,
    settings: RgbSettings,
) -> InverseDepthPoints:
    """Return the points with the flow at their predicted places, without patches."""
    at = predict_places(state, points, evidence.intrinsics)[:, :-1]
    n, last = at.shape[:2]
    t = np.arange(last)[None]
    u, v, good = moving_pixels(evidence, at, t)
    flow = evidence.flow[t, v, u].astype(np.float64)
    confidence = evidence.flow_confidence[t, v, u].astype(np.float64)
    variance = settings.flow_sigma**2 + settings.flow_rate**2 * (flow**2).sum(axis=2)
    weight = settings.flow_share * good / variance
    information = confidence[..., [0, 1, 1, 2]].reshape(n, last, 2, 2)
    return replace(
        points, flow=flow, flow_information=information * weight[..., None, None],
        place=np.zeros((n, last + 1, 2)), place_information=np.zeros((n, last + 1, 2, 2)))


def measure_patches(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints, reach: float,
    span: int, settings: RgbSettings,
) -> InverseDepthPoints:
    """Return the points with the places of their patches, without flow.

    A patch is searched in the `span` frames before and after its own, within `reach` px of its
    predicted place.
    """
    n, frames = len(points.ray), len(state.angle)
    slope, wanted = inverse_depth_slopes(points, settings), frames_nearby(points, frames, span)
    if settings.revisits:
        wanted |= frames_like_own(state, points, settings.link_reach)
    place, information = _find_patches(evidence, state, points, slope, wanted, reach)
    return replace(
        points, flow=np.zeros((n, frames - 1, 2)), place=place, place_information=information,
        flow_information=np.zeros((n, frames - 1, 2, 2)))


def _find_patches(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints, slope: Array,
    wanted: NDArray[np.bool_], reach: float,
) -> tuple[Array, Array]:
    """Places [N T 2] of points, by their patches in the wanted frames [N T], and their information
    [N T 2 2]; see `predict_warps` for their slopes [N 2]."""
    n, frames = wanted.shape
    on = points.outline.on
    at, slide = predict_places(state, points, evidence.intrinsics), np.zeros(())
    if points.outline.is_round:
        motion, key = motions_from_keys(state, points)
        slide = slide_of_outline(points.outline, motion[key, :, points.label], points.ray,
                                 points.inverse_depth, evidence.intrinsics)
    elif points.outline.edge_radius.any():
        slide = slide_of_edges(points.outline, state.twist[0], at, points.frame,
                               points.ray / points.inverse_depth[:, None])
    at = at + slide
    # inside, a patch that leaves the foreground is hidden; an outline may be on either side
    u, v, inside = moving_pixels(evidence, at, np.arange(frames)[None])
    wanted = wanted & (on[:, None] | inside)
    # where no points follow the outline, patches near it show it as well
    channels = np.stack([~on, on | ~on.any()], axis=1)
    patches = PredictedPatches(
        at[np.arange(n), points.frame], points.frame, at, predict_warps(state, points, slope),
        wanted, channels, reach)
    place, information = find_patches(evidence.appearance, patches, evidence.settings)
    if points.outline.is_round and evidence.sharp is not None:
        sharp = evidence.sharp[np.arange(frames), v, u]
        sharp &= sharp[np.arange(n), points.frame][:, None]
        share = np.where(on[:, None] & ~sharp, evidence.settings.vague_outline_share, 1.0)
        information = information * share[..., None, None]
    return place - slide, information


def drop_points_at_rest(
    state: Articulation, points: InverseDepthPoints, intrinsics: Array, on_base: NDArray[np.bool_],
    settings: RgbSettings,
) -> InverseDepthPoints:
    """Return points without the places of those that are at rest, among those `on_base` [N].

    Shading and outline of a round part that turns about its own axis do not move, and would show
    too small a turn. A point is at rest if its patches are found nearer to its own pixel than to
    the places that the state predicts.
    """
    at, information = predict_places(state, points, intrinsics), points.place_information
    own = at[np.arange(len(at)), points.frame][:, None]
    moving, resting = (_place_costs(points.place - place, information, settings).sum(axis=1)
                       for place in (at, own))
    drop = on_base & (resting < moving)
    return replace(points, place_information=np.where(drop[:, None, None, None], 0.0, information))


def add_tracks(
    evidence: VideoEvidence, points: InverseDepthPoints, settings: RgbSettings
) -> InverseDepthPoints:
    """Return points with their places by chained flow, in the frames where these are more certain
    than those of their patches; the same without flow both ways."""
    if evidence.flow_backward is None:
        return points
    place, information = _track(evidence, points, points.place.shape[1], settings)
    by_flow, by_patch = (np.trace(i, axis1=2, axis2=3)[..., None]
                         for i in (information, points.place_information))
    surer = by_flow > by_patch
    return replace(
        points, place=np.where(surer, place, points.place),
        place_information=np.where(surer[..., None], information, points.place_information))


def _track(
    evidence: VideoEvidence, points: InverseDepthPoints, frames: int, settings: RgbSettings
) -> tuple[Array, Array]:
    """Places [N T 2] of points by chained flow, and their information (see `chain_flow`)."""
    k = evidence.intrinsics
    pixel = points.ray[:, :2] * k[[0, 1], [0, 1]] + k[:2, 2]
    return chain_flow(evidence, pixel, points.frame, frames, settings)


def track_misfit(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints,
    settings: RgbSettings,
) -> float:
    """Return the mean cost of the tracks; 0 without any."""
    if evidence.flow_backward is None:
        return 0.0
    at = predict_places(state, points, evidence.intrinsics)
    place, information = _track(evidence, points, at.shape[1], settings)
    found = _is_found(information)
    cost = _place_costs(place - at, information, settings)[found]
    return float(cost.mean()) if found.any() else 0.0


def _is_found(information: Array) -> NDArray[np.bool_]:
    return information[..., 0, 0] + information[..., 1, 1] > 0


def _place_costs(away: Array, information: Array, settings: RgbSettings) -> Array:
    """Robust costs [N T] of places that are [N T 2] px away from the predicted ones."""
    limit = settings.patch_outlier_cost
    square = np.einsum("nti,ntij,ntj->nt", away, information, away)
    return limit * geman_mcclure_cost(square / limit)


def patch_misfit(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints, span: int,
    settings: RgbSettings,
) -> float:
    """Return the mean cost of the patches in the `span` frames before and after their own,
    including those that are not found."""
    points = measure_patches(evidence, state, points, settings.patch_reach, span, settings)
    away = points.place - predict_places(state, points, evidence.intrinsics)
    cost = _search_costs(away, points.place_information, settings)
    return float(cost[frames_nearby(points, cost.shape[1], span)].mean())


def search_patches(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints,
    wanted: NDArray[np.bool_], settings: RgbSettings,
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Search the patches of points in the wanted frames [N T].

    Return their costs [N T], which count where they are searched and predicted in the foreground
    [N T], and the information [N T] of those that are found, 1/px^2.
    """
    place, information = _find_patches(
        evidence, state, points, inverse_depth_slopes(points, settings), wanted,
        settings.patch_reach)
    at = predict_places(state, points, evidence.intrinsics)
    inside = moving_pixels(evidence, at, np.arange(wanted.shape[1])[None])[2]
    return (_search_costs(place - at, information, settings), wanted & inside,
            np.trace(information, axis1=2, axis2=3))


def find_points_at_rest(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints,
    settings: RgbSettings,
) -> NDArray[np.bool_]:
    """Return which points [N] are seen at rest: patches of their neighborhood in time are found at
    their own pixels, and much better than where the state predicts them."""
    near = frames_nearby(points, len(state.angle), settings.patch_span)
    resting, moving = (
        (search_patches(evidence, s, points, near, settings)[0] * near).sum(axis=1)
        for s in (replace(state, angle=np.zeros_like(state.angle)), state))
    return np.asarray(resting < settings.max_rest * moving, np.bool_)


def patch_costs_by_point(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints, slope: Array,
    settings: RgbSettings,
) -> Array:
    """Return the mean cost [N] of the patches of each point, whose surroundings have a slope [N 2],
    in the frames that are `patch_span` from its own: these show its depth best."""
    s = settings
    at = predict_places(state, points, evidence.intrinsics)
    frames = at.shape[1]
    wanted = frames_nearby(points, frames, s.patch_span)
    wanted &= ~frames_nearby(points, frames, s.patch_span - 1)
    place, information = _find_patches(evidence, state, points, slope, wanted, s.patch_reach)
    cost = _search_costs(place - at, information, s)
    return np.asarray((cost * wanted).sum(axis=1) / np.maximum(1, wanted.sum(axis=1)), np.float64)


def _search_costs(away: Array, information: Array, settings: RgbSettings) -> Array:
    """Costs [N T] of patches that were searched: found [N T 2] px away, or not found."""
    return np.where(_is_found(information), _place_costs(away, information, settings),
                    settings.patch_missing_cost)


def frames_like_own(
    state: Articulation, points: InverseDepthPoints, reach: float
) -> NDArray[np.bool_]:
    """Return in which frames [N T], but not its own, one part is displaced nearly as in each
    point's own."""
    at = state.angle[:, 0]
    near = np.abs(at[points.frame][:, None] - at) <= reach
    return near & (points.frame[:, None] != np.arange(len(at)))


def frames_nearby(points: InverseDepthPoints, frames: int, span: int) -> NDArray[np.bool_]:
    """Return whether each frame is within `span` of each point's own, but not it [N T]."""
    gap = np.abs(np.arange(frames)[None] - points.frame[:, None])
    return (gap > 0) & (gap <= span)


def moving_pixels(
    evidence: VideoEvidence, at: Array, frame: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return columns and rows [N T] of places [N T 2] px in frames [1 T], and whether they are in
    the moving foreground; 0 and False outside of the image."""
    height, width = evidence.moving.shape[1:]
    pixel = np.rint(np.clip(at, -2, 1e4)).astype(np.int64)
    u, v = pixel[..., 0], pixel[..., 1]
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v = np.where(inside, u, 0), np.where(inside, v, 0)
    return u, v, inside & evidence.moving[frame, v, u]
