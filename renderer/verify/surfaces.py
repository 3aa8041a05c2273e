"""Checks of the coordinates of surfaces that deform, by posing the model's triangles again.

Each triangle of the model is put where its pose has it and projected. Of a pixel that shows a
part which deforms, some triangle must meet its ray at the depth that is stored, at a point whose
place at rest is the one that is stored. Nothing here looks at what the renderer found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply
from ...robots.model import ArticulatedModel
from ..scene import PosedModel, pose_parts, rest_in_part
from ..types import Sequence
from .animations import drawn_animation
from .checks import CheckResult, check_share, merge_checks
from .frames import decode_frame, deforming_numbers

_FEW = 2e-3
"""Share of pixels at silhouettes and folds, where a rasterizer's rounding picks a neighbor."""
_BESIDE = 0.02
"""px that a rasterizer may count as inside of a triangle."""
_PAIRS = 2_000_000
"""Of triangles and pixels that are looked at together."""


def surfaces_to_check(model: ArticulatedModel) -> ArticulatedModel:
    """The model with the surfaces alone that this file asks for."""
    parts = {v.part for v in model.visuals if v.deforms}
    return replace(model, visuals=tuple(v for v in model.visuals if v.part in parts))


def verify_surface(sequence: Sequence, model: ArticulatedModel | None) -> list[CheckResult]:
    """The check of the layer `coordinates` where parts deform and the model is known."""
    numbers, stack = deforming_numbers(sequence), sequence.coordinates
    if not len(numbers) or stack is None or model is None:
        return []
    posed = _pose_as_stored(sequence, model)
    if posed is None:
        return []
    number = np.repeat([v.part + 1 for v in model.visuals], [len(v.faces) for v in model.visuals])
    faces, at_rest, s = posed.faces, rest_in_part(model), sequence.state
    assert s.coordinate_box is not None
    step = (s.coordinate_box[:, 1] - s.coordinate_box[:, 0]) / 65534
    slack = np.append(0.0, np.linalg.norm(step, axis=1) + 2e-4 * 65534 * step.max(axis=1))
    checks: list[CheckResult] = []
    for t in range(sequence.meta.frames):
        stored = np.asarray(stack[t], np.float64).reshape(-1, 3)
        frame = decode_frame(sequence, t)
        part, depth = frame.part, frame.depth
        corners = apply(s.cam_from_world[t], posed.vertices(t))[faces]
        best = np.full(len(part), np.inf)
        for pixel, face, weight, z in _intersect_rays(corners, sequence):
            same = (part[pixel] == number[face]) & (
                np.abs(z - depth[pixel]) <= frame.unit + 2e-3 * z)
            pixel, face, weight = pixel[same], face[same], weight[same]
            expected = np.einsum("nk,nki->ni", weight, at_rest[faces[face]])
            np.minimum.at(best, pixel, np.linalg.norm(expected - stored[pixel], axis=1))
        loose = np.flatnonzero(np.isin(part, numbers))
        wrong = ~(best[loose] <= slack[part[loose]])
        checks.append(check_share("coordinates: of a triangle that is seen there", wrong, _FEW,
                            lambda i, c=loose, f=frame: f.name(int(c[i]))))
    return list(merge_checks(checks))


def _pose_as_stored(sequence: Sequence, model: ArticulatedModel) -> PosedModel | None:
    """The model as the stored poses have it; None if it is another model."""
    meta, poses = sequence.meta, sequence.state.world_from_part
    if model.part_names != meta.part_names or not model.visuals:
        return None
    drawn = drawn_animation(sequence)
    if drawn is None:
        return pose_parts(model, poses)
    found = drawn.find(model)
    if found is None:
        return None
    return PosedModel(model, replace(drawn.state(found, sequence.state.times),
                                     world_from_part=poses))


def _intersect_rays(corners: Array, sequence: Sequence) -> Iterator[
    tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]
]:
    """Pixels, triangles [M], weights of the corners [M 3] and depth [M] m where the pixels' rays
    meet triangles with corners [F 3 3] m, camera frame; those that reach behind it are left out.
    """
    width, height = sequence.meta.width, sequence.meta.height
    front = np.flatnonzero((corners[:, :, 2] > 0).all(1))
    uvw = corners[front] @ sequence.state.intrinsics.T
    uv, z = uvw[..., :2] / uvw[..., 2:], uvw[..., 2]
    most = np.array([width, height]) - 1
    low = np.clip(np.ceil(uv.min(1) - _BESIDE), 0, most + 1).astype(np.int64)
    high = np.clip(np.floor(uv.max(1) + _BESIDE), -1, most).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size.prod(1)
    edge = np.roll(uv, -1, axis=1) - uv
    area = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]
    ends = np.cumsum(count)
    begin = 0
    while begin < len(count):
        before = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, before + _PAIRS, side="right")))
        f = np.repeat(np.arange(begin, end), count[begin:end])
        k = np.arange(len(f)) - np.repeat(ends[begin:end] - count[begin:end] - before,
                                          count[begin:end])
        x, y = low[f, 0] + k % size[f, 0], low[f, 1] + k // size[f, 0]
        begin = end
        arm = np.stack([x, y], axis=1)[:, None] - uv[f]
        turn = (edge[f, :, 0] * arm[..., 1] - edge[f, :, 1] * arm[..., 0]) * np.sign(
            area[f])[:, None]
        inside = (turn >= -_BESIDE * np.linalg.norm(edge[f], axis=2)).all(1) & (area[f] != 0)
        f, x, y = f[inside], x[inside], y[inside]
        share_of = np.maximum(np.roll(turn[inside], -1, axis=1), 0.0) / z[f]  # corner 0: edge 1
        total = share_of.sum(axis=1, keepdims=True)
        weight = share_of / np.where(total > 0, total, 1.0)
        yield y * width + x, front[f], weight, (weight * z[f]).sum(1)
