"""Evidence in a video from a still camera: what moves, its flow, and how reliable the flow is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Observation
from ...robots.geometry import Array
from ..numerics import Image, thread_map
from .depth import Depth
from .flow import Flow, for_cuts_of
from .foreground import Foreground
from .regions import bounding_box
from .settings import ImageSettings
from .sharp_outline import sharp_outlines
from .still_texture import leave_out_still_texture


@dataclass(frozen=True)
class VideoEvidence:
    """Evidence in T frames, cropped to the h x w pixels around what moves."""

    corner: tuple[int, int]
    """(u, v) of the crop's first pixel"""
    intrinsics: Array
    """[3 3] px, of the crop"""
    moving: NDArray[np.bool_]
    """[T h w] foreground: what is not static background"""
    gray: Image
    """[T h w] brightness, 0 to 255"""
    appearance: Image
    """[T h w 2] brightness, and outline of the foreground, both blurred"""
    flow: Image
    """[T-1 h w 2] px, to the next frame"""
    flow_backward: Image | None
    """[T-1 h w 2] px, from the next frame to this one; None where nothing asks for it"""
    texture_confidence: Image
    """[T h w 3] uu, uv, vv: 1 in the direction of a strong gradient, 0 of none"""
    flow_confidence: Image
    """[T h w 3] the same; 1 in all directions where the flow is the true one"""
    settings: ImageSettings
    inverse_depth: Image | None = None
    """[T h w] a network's or measured, about 1"""
    distance: float | None = None
    """The unit of length of `inverse_depth`, m, where it was measured"""
    part: NDArray[np.uint8] | None = None
    """[T h w] true parts, for an oracle"""
    sharp: NDArray[np.bool_] | None = None
    """[T h w] where an outline of the foreground is sharp; None: everywhere"""
    true_flow: bool = False
    """Whether the flow is the true one, for an oracle"""
    second: VideoEvidence | None = None
    """The evidence in the same video by a second flow"""
    with_shadows: NDArray[np.bool_] | None = None
    """[T h w] `moving`, and what a shadow passes over; None: the same"""

    @property
    def frames(self) -> int:
        """T."""
        return len(self.moving)

    @property
    def has_shadows(self) -> bool:
        """Whether what stays under a shadow was left out of `moving`."""
        return self.with_shadows is not None and bool((self.with_shadows & ~self.moving).any())

    @property
    def edge_area(self) -> NDArray[np.bool_]:
        """Where edges [T h w] may be of what moves: those at rest are told by their places."""
        return self.moving if self.with_shadows is None else self.with_shadows


@dataclass(frozen=True)
class FrontEnd:
    """The estimators of evidence in images."""

    flow: Flow
    foreground: Foreground
    depth: Depth | None = None
    """None: without depth."""
    bidirectional: bool = False
    """Whether flow is also estimated from each frame to the one before."""
    averages_depth: bool = False
    """Whether noisy depth is averaged over what moves."""
    drops_still_texture: bool = False
    """Whether what stays under a shadow is left out of one part that turns, without depth."""
    second_flow: Flow | None = None
    """Another flow, of which evidence is made as well."""


def video_evidence(
    observation: Observation, front_end: FrontEnd, settings: ImageSettings
) -> VideoEvidence | None:
    """Return the evidence in the images of an observation; None if nothing moves.

    Flow, depth, parts and a mask that the observation has replace those of the estimators.
    """
    rgb, part = observation.rgb, observation.part
    assert rgb is not None
    estimated = part is None and observation.mask is None
    moving, with_shadows = _find_moving(observation, front_end, settings)
    if not moving.any():
        return None
    box = bounding_box(np.asarray(with_shadows.any(axis=0)), settings.crop_margin)
    crop = np.ascontiguousarray(rgb[:, box[0], box[1]])
    inside = np.ascontiguousarray(moving[:, box[0], box[1]])
    k = observation.intrinsics.astype(np.float64).copy()
    k[0, 2] -= box[1].start
    k[1, 2] -= box[0].start
    sized = for_cuts_of(front_end.flow, *rgb.shape[1:3])
    flow, back = observation.flow, observation.flow_backward
    flow = _estimate_flow(sized, crop) if flow is None else _cut_flow(flow, box)
    if back is not None:
        back = _cut_flow(back, box)
    elif front_end.bidirectional:
        back = _backward_flow(sized, crop)
    gray = np.stack([np.asarray(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), np.float32) for i in crop])
    inverse_depth, distance, depth = None, None, observation.depth
    if depth is None and front_end.depth is not None:
        depth = np.stack([front_end.depth(i) for i in rgb])
    if depth is not None:
        if observation.depth_noise > 0 and front_end.averages_depth:
            depth = average_depth(depth, moving, settings)
        inverse_depth, unit = _relative_inverse_depth(depth[:, box[0], box[1]], inside, settings)
        distance = None if observation.depth is None else unit
    texture = np.stack([texture_confidence(g, settings) for g in gray])
    sure = np.array([1, 0, 1], np.float32)
    evidence = VideoEvidence(
        (box[1].start, box[0].start), k, inside, gray,
        np.stack([appearance(g, m, settings) for g, m in zip(gray, inside, strict=True)]),
        flow, back, texture,
        texture if observation.flow is None else np.full_like(texture, sure),
        settings, inverse_depth, distance, None if part is None else part[:, box[0], box[1]],
        sharp_outlines(crop, inside, settings) if estimated else None,
        observation.flow is not None,
        with_shadows=np.ascontiguousarray(with_shadows[:, box[0], box[1]]),
    )
    if front_end.second_flow is None or evidence.true_flow:
        return evidence
    sized = for_cuts_of(front_end.second_flow, *rgb.shape[1:3])
    back = _backward_flow(sized, crop) if front_end.bidirectional else None
    second = replace(evidence, flow=_estimate_flow(sized, crop), flow_backward=back)
    return replace(evidence, second=second)


def _find_moving(
    observation: Observation, front_end: FrontEnd, settings: ImageSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return what moves [T H W], and the same with what a shadow passes over."""
    rgb, part, mask = observation.rgb, observation.part, observation.mask
    assert rgb is not None
    if part is not None or mask is not None:
        moving = part > 0 if part is not None else np.asarray(mask)
        return moving, moving
    found = front_end.foreground(rgb)
    kinds = observation.joint_types
    turns = observation.depth is None and len(kinds) == 1 and kinds != ("prismatic",)
    if not (front_end.drops_still_texture and turns):
        return found, found
    return leave_out_still_texture(rgb, found, settings), found


def _estimate_flow(flow: Flow, images: NDArray[np.uint8]) -> Image:
    """Flow [T-1 h w 2] from each image to the next."""
    pairs = itertools.pairwise(images)
    return np.stack(thread_map(lambda pair: flow(*pair), pairs)).astype(np.float32)


def _backward_flow(flow: Flow, images: NDArray[np.uint8]) -> Image:
    """Flow [T-1 h w 2] to each image from the next."""
    return np.ascontiguousarray(_estimate_flow(flow, images[::-1])[::-1])


def _cut_flow(flow: NDArray[np.float32], box: tuple[slice, slice]) -> Image:
    """The same of whole images, in a box; 0 where it is unknown."""
    return np.ascontiguousarray(np.nan_to_num(flow[:, box[0], box[1]]), np.float32)


def average_depth(
    depth: NDArray[np.float32], inside: NDArray[np.bool_], settings: ImageSettings
) -> NDArray[np.float32]:
    """Return the mean depth [T H W] around each pixel, of pixels inside of what moves [T H W]; 0
    where there are none. Those at its rim, which may be of the background, hardly count."""
    s, out = settings, np.zeros(depth.shape, np.float32)
    window, rim = (2 * s.noisy_depth_radius + 1,) * 2, np.ones((2 * s.noisy_depth_rim + 1,) * 2)
    for t, mask in enumerate(inside & (depth > 0)):
        inner = cv2.erode(mask.astype(np.float32), rim)
        weight = inner + np.float32(s.noisy_depth_rim_weight) * mask
        total, count = (cv2.boxFilter(image, -1, window, normalize=False,
                                      borderType=cv2.BORDER_CONSTANT)
                        for image in (weight * depth[t], weight))
        np.divide(total, count, out=out[t], where=count > s.noisy_depth_rim_weight / 2)
    return out


def _relative_inverse_depth(
    depth: NDArray[np.float32], inside: NDArray[np.bool_], settings: ImageSettings
) -> tuple[Image, float]:
    """Inverse depth about 1, and the depth that is 1: the median of what moves."""
    known = inside & (depth > 0)
    middle = float(np.median(depth[known])) if known.any() else 1.0
    out = (middle / np.where(depth > 0, depth, middle)).clip(
        settings.min_relative_depth, settings.max_relative_depth)
    return out.astype(np.float32), middle


def appearance(gray: Image, moving: NDArray[np.bool_], settings: ImageSettings) -> Image:
    """Return brightness and outline [h w 2] of a frame, slightly blurred."""
    outline = cv2.GaussianBlur(
        moving.astype(np.float32) * settings.outline_contrast, (0, 0), settings.outline_blur)
    bright = cv2.GaussianBlur(gray, (0, 0), settings.brightness_blur)
    return np.stack([bright, outline], axis=2).astype(np.float32)


def texture_confidence(gray: Image, settings: ImageSettings) -> Image:
    """Return uu, uv, vv [h w 3]: 1 in the direction of a strong gradient, 0 of none.

    The eigenvalues l of the structure tensor (Foerstner and Guelch, 1987) become
    l / (l + texture scale): flow is known across an edge and undetermined along it.
    """
    smooth = cv2.GaussianBlur(gray, (0, 0), settings.texture_blur)
    du = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125)
    dv = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
    window = settings.texture_window
    uu, uv, vv = (cv2.GaussianBlur(x, (0, 0), window) for x in (du * du, du * dv, dv * dv))
    apart = np.sqrt((uu - vv) ** 2 + 4 * uv * uv)
    most, least = (uu + vv + apart) / 2, np.maximum(uu + vv - apart, 0) / 2
    first = most / (most + settings.texture_scale)
    second = least / (least + settings.texture_scale)
    slope = (first - second) / np.maximum(apart, 1e-6)
    return np.stack(
        [second + slope * (uu - least), slope * uv, second + slope * (vv - least)], axis=2
    ).astype(np.float32)
