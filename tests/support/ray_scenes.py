"""A chain of three joints and a door, with what exact images would show of them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import cv2
import numpy as np
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.chain.kinematics import part_motions
from gcbench.gcpose.rgb.outline import Outline
from gcbench.gcpose.rgb.points import InverseDepthPoints, predict_places
from gcbench.renderer.types.observation import Observation

INTRINSICS = np.array([[600.0, 0, 160], [0, 600, 120], [0, 0, 1]])
FRAMES = 9


def chain(scale: float = 1.0) -> tuple[Articulation, np.ndarray]:
    """Three joints, two of them parallel, and where they are."""
    direction = np.array([[0.1, 0.9, 0.42], [0.95, 0.1, 0.3], [0.95, 0.1, 0.3]])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    at = scale * np.array([[0.0, 0.1, 1.0], [0.02, 0.04, 1.0], [0.0, -0.06, 0.95]])
    twist = np.concatenate([direction, np.cross(at, direction)], axis=1)
    time = np.linspace(0, 1, FRAMES)[:, None]
    angle = np.array([0.5, -0.6, 0.8]) * (3 * time**2 - 2 * time**3)
    return Articulation(twist, angle, np.zeros(3, bool), np.arange(-1, 2)), at


def measured(state: Articulation, scale: float, noise: float, steps: bool) -> InverseDepthPoints:
    """Points of two key frames with their places, or steps, in all frames."""
    rng = np.random.default_rng(4)
    n = 240
    label = rng.integers(1, 4, n)
    pixel = rng.uniform([100, 60], [220, 180], (n, 2))
    ray = np.concatenate([(pixel - INTRINSICS[:2, 2]) / 600.0, np.ones((n, 1))], axis=1)
    frame = np.where(np.arange(n) % 2, 0, 4)
    none, empty = np.zeros((n, FRAMES - 1, 2)), np.zeros((n, FRAMES - 1, 2, 2))
    start = np.ones(n)
    points = InverseDepthPoints(
        frame, ray, label, rng.uniform(0.9, 1.1, n) / scale, start, none, empty,
        np.zeros((n, FRAMES, 2)), np.zeros((n, FRAMES, 2, 2)), Outline.none(n))
    at = predict_places(state, points, INTRINSICS)
    at = at + noise * rng.standard_normal(at.shape)
    sure = np.broadcast_to(np.eye(2) / 0.1**2, (*at.shape, 2))
    flat = replace(points, inverse_depth=start)
    if steps:
        return replace(flat, flow=np.diff(at, axis=1), flow_information=sure[:, 1:])
    own = np.arange(FRAMES)[None] == frame[:, None]
    return replace(flat, place=at, place_information=np.where(own[..., None, None], 0.0, sure))


def texture(rng: np.random.Generator, height: int, width: int, sigma: float = 1.5) -> np.ndarray:
    noise = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), sigma)
    return (127 + 60 * noise / noise.std()).clip(0, 255).astype(np.uint8)


def door(
    total: float, true_flow: bool = False, pace: np.ndarray | None = None
) -> Observation:
    """A textured panel that turns about an upright axis before a textured wall."""
    axis = np.array([0.12, 0.96, 0.25])
    axis /= np.linalg.norm(axis)
    line = np.concatenate([axis, np.cross([-0.15, 0.0, 1.2], axis)])
    return moving_panel(line, total, "revolute", true_flow, pace)


def drawer(total: float, pace: np.ndarray | None = None) -> Observation:
    """The same panel, which slides towards the camera; its middle is at a depth of 1.15 m."""
    axis = np.array([-0.25, 0.1, -1.0])
    line = np.array([0, 0, 0, *axis / np.linalg.norm(axis)])
    return moving_panel(line, total, "prismatic", pace=pace)


def moving_panel(
    line: np.ndarray, total: float, joint_type: str, true_flow: bool = False,
    pace: np.ndarray | None = None,
) -> Observation:
    """A textured panel that moves by a twist before a textured wall; `pace` [T] is the share of the
    motion at each frame."""
    axis = line[3:] if joint_type == "prismatic" else line[:3]
    rng = np.random.default_rng(5)
    wall, panel = texture(rng, 180, 240, 3.0), texture(rng, 100, 100)
    k = np.array([[260.0, 0, 119.5], [0, 260.0, 89.5], [0, 0, 1]])
    time = np.linspace(0, 1, 8) if pace is None else pace
    motion = part_motions(line[None], total * time[:, None], np.array([-1]))[:, 1]
    corner = np.array([[-0.15, -0.16, 1.2], [0.2, -0.16, 1.1],
                       [0.2, 0.16, 1.1], [-0.15, 0.16, 1.2]])
    frames: list[np.ndarray] = []
    views: list[np.ndarray] = []  # of the panel
    for m in motion:
        at = (corner @ m[:3, :3].T + m[:3, 3]) @ k.T
        source = np.array([[0, 0], [99, 0], [99, 99], [0, 99]], np.float32)
        h = cv2.getPerspectiveTransform(source, (at[:, :2] / at[:, 2:]).astype(np.float32))
        mask = cv2.warpPerspective(np.full((100, 100), 255, np.uint8), h, (240, 180)) > 127
        moved = cv2.warpPerspective(panel, h, (240, 180))
        frames.append(np.where(mask[..., None], moved, wall))
        views.append(h)
    given = Observation(np.stack(frames), None, k, np.linspace(0, 1, len(time)), 1, (joint_type,),
                        cam_from_world=np.eye(4), axis_direction=axis[None])
    pairs = list(itertools.pairwise(views))
    return given if not true_flow else replace(
        given, flow=np.stack([plane_flow(a, b) for a, b in pairs]),
        flow_backward=np.stack([plane_flow(b, a) for a, b in pairs]))


def plane_flow(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Flow [180 240 2] of the panel between two of its views, 0 on the wall."""
    pixel = np.stack([*np.meshgrid(np.arange(240.0), np.arange(180.0)), np.ones((180, 240))], 2)
    on = pixel @ np.linalg.inv(here).T
    on /= on[..., 2:]
    at = on @ there.T
    inside = ((on[..., :2] > -0.5) & (on[..., :2] < 99.5)).all(axis=2)
    moved = at[..., :2] / at[..., 2:] - pixel[..., :2]
    return np.where(inside[..., None], moved, 0.0).astype(np.float32)


def with_passing_shadow(rgb: np.ndarray) -> np.ndarray:
    """Return images [T H W 3] over which a soft, upright shadow passes to the right, over a
    quarter of their width or more."""
    video, width = rgb.astype(np.float32), rgb.shape[2]
    for image, left in zip(video, np.linspace(0, 0.58 * width, len(rgb)).astype(int), strict=True):
        shadow = np.zeros(image.shape[:2], np.float32)
        shadow[:, left : left + width // 4] = 0.4
        image *= 1 - cv2.GaussianBlur(shadow, (0, 0), 6.0)[..., None]
    return video.astype(np.uint8)
