"""Measurements of a hypothesis' points: flow at their places, and patches found again.

Flow is dense and drifts. Patches are few and do not drift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array
from ..chain import Articulation
from ..images import PatchSearch, PredictedPatches, VideoEvidence, find_patches
from ..numerics import geman_mcclure_cost
from .points import InverseDepthPoints, predict_places, predict_warps
from .settings import RgbSettings


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
    confidence = evidence.texture_confidence[t, v, u].astype(np.float64)
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
    at = predict_places(state, points, evidence.intrinsics)
    n, frames = at.shape[:2]
    wanted = frames_nearby(points, frames, span)
    wanted &= moving_pixels(evidence, at, np.arange(frames)[None])[2]
    place, information = find_patches(
        evidence.appearance,
        PredictedPatches(at[np.arange(n), points.frame], points.frame, at,
                         predict_warps(state, points, settings), wanted),
        PatchSearch(settings.patch_radius, reach, settings.patch_sigma, settings.patch_rate),
        evidence.settings,
    )
    return replace(
        points, flow=np.zeros((n, frames - 1, 2)), place=place, place_information=information,
        flow_information=np.zeros((n, frames - 1, 2, 2)))


def patch_misfit(
    evidence: VideoEvidence, state: Articulation, points: InverseDepthPoints,
    settings: RgbSettings,
) -> float:
    """Return the mean cost of the patches, including those that are not found."""
    span = settings.patch_span
    points = measure_patches(evidence, state, points, settings.patch_reach, span, settings)
    away = points.place - predict_places(state, points, evidence.intrinsics)
    square = np.einsum("nti,ntij,ntj->nt", away, points.place_information, away)
    found = points.place_information[..., 0, 0] + points.place_information[..., 1, 1] > 0
    limit = settings.patch_outlier_cost
    robust = limit * geman_mcclure_cost(square / limit)
    cost = np.where(found, robust, settings.patch_missing_cost)
    return float(cost[frames_nearby(points, cost.shape[1], span)].mean())


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
