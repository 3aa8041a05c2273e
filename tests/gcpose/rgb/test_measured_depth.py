"""Images with noisy depth: its mean is the prior of every point's depth, and gives the scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain.kinematics import part_motions
from gcbench.gcpose.chain.settings import ChainSettings
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import average_depth
from gcbench.gcpose.images.surfaces import Surfaces
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.rgbd.pipeline import DepthVideo
from gcbench.gcpose.settings import Settings
from gcbench.renderer.types.observation import Observation
from gcbench.robots.geometry import pinhole

from ...support.ray_scenes import door

CORNERS = np.array([[-0.15, -0.16, 1.2], [0.2, -0.16, 1.1], [0.2, 0.16, 1.1], [-0.15, 0.16, 1.2]])
"""Of the panel of `door`, which turns about a line through the first and the last side's middle"""
NOISE, WALL = 0.03, 2.0


def door_with_depth(turn: float) -> Observation:
    """`door`, before a wall, with noisy depth."""
    observation = door(turn)
    assert observation.axis_direction is not None
    axis = observation.axis_direction[0]
    line = np.concatenate([axis, np.cross([-0.15, 0.0, 1.2], axis)])
    motion = part_motions(line[None], turn * observation.times[:, None], np.array([-1]))[:, 1]
    v, u = np.mgrid[:180, :240]
    ray = pinhole.pixel_rays(observation.intrinsics, np.stack([u, v], axis=2).reshape(-1, 2))
    depth = np.full((len(motion), 180 * 240), WALL)
    for t, m in enumerate(motion):
        corner = CORNERS @ m[:3, :3].T + m[:3, 3]
        sides = np.cross(corner, np.roll(corner, -1, axis=0))  # planes through the camera
        inside = (ray @ sides.T > 0).all(axis=1) | (ray @ sides.T < 0).all(axis=1)
        normal = np.cross(corner[1] - corner[0], corner[3] - corner[0])
        depth[t, inside] = (normal @ corner[0]) / (ray[inside] @ normal)
    noise = np.random.default_rng(3).normal(0, NOISE, depth.shape)
    return replace(observation, depth=(depth + noise).reshape(-1, 180, 240).astype(np.float32),
                   depth_noise=NOISE)


def by_images(most: float = 1e-9) -> GCPose:
    settings = Settings()
    return GCPose("dis", foreground="background", settings=replace(
        settings, rgbd=replace(settings.rgbd, max_noise_share=most)))


@pytest.mark.parametrize("knowledge", ["axes", "kinematics"])
def test_noisy_depth_gives_the_scale_of_images(knowledge: str) -> None:
    observation = door_with_depth(0.5)
    assert observation.axis_direction is not None
    axis = observation.axis_direction[0]
    foot = np.array([-0.15, 0.0, 1.2])
    if knowledge == "kinematics":
        observation = replace(observation, axis_line=np.r_[axis, np.cross(foot, axis)][None])
    found = by_images().estimate(observation)
    assert np.degrees(abs(found.displacement[-1, 0] - 0.5)) < 1.0
    assert found.screw is not None and found.reliable is not None and found.reliable.all()
    away = foot - np.cross(found.screw[0, :3], found.screw[0, 3:])
    assert np.linalg.norm(away - axis * (axis @ away)) < 0.03


def test_the_size_of_a_part_decides_whether_depth_or_images_count() -> None:
    depth = np.full((2, 60, 80), 1.0, np.float32)
    k = np.array([[100.0, 0, 40], [0, 100.0, 30], [0, 0, 1]])
    surfaces = Surfaces(depth, np.zeros((2, 60, 80, 3), np.float32), k, 0.01, ImageSettings())
    moving = np.zeros((2, 60, 80), bool)
    moving[:, 10:50, 20:60] = True  # 0.4 m
    video = DepthVideo(np.zeros((2, 60, 80, 3), np.uint8), surfaces, moving)
    assert video.noise_share(1, ChainSettings()) == pytest.approx(0.01 / 0.4, rel=0.15)
    assert video.noise_share(3, ChainSettings()) == pytest.approx(0.03 / 0.4, rel=0.15)
    observation = door_with_depth(0.5)
    one, other = (by_images(most).estimate(observation) for most in (1e-9, 1e9))
    assert (one.displacement != other.displacement).any()
    wide = replace(observation, intrinsics=observation.intrinsics * [[1.1], [1.0], [1.0]])
    assert np.isfinite(by_images().estimate(wide).displacement).all()  # not square: by depth


def test_depth_is_averaged_inside_of_what_moves() -> None:
    inside = np.zeros((1, 60, 80), bool)
    inside[0, 20:40, 30:50] = True
    depth = np.where(inside, 1.0, 3.0) + np.random.default_rng(1).normal(0, 0.05, inside.shape)
    depth[0, 25:28, 30:50] = 0.0  # not measured
    found = average_depth(depth.astype(np.float32), inside, ImageSettings())
    assert np.abs(found[inside] - 1.0).max() < 0.03 < np.abs(depth[inside] - 1.0).max()
    assert (found[0, :10] == 0).all()
    assert (average_depth(0 * depth.astype(np.float32), inside, ImageSettings()) == 0).all()
