"""Other views of depth videos: images and labels still show one and the same motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gcbench.robots.geometry import pinhole, se3

from ...support.one_joint import dataset, moved

pytest.importorskip("torch", reason="training needs PyTorch")

from gcbench.gcpose.learned.abbatematteo import camera_screw
from gcbench.gcpose.networks.abbatematteo import CONFIGURATION, GEOMETRY, RADIUS
from gcbench.gcpose.training.config import ViewConfig
from gcbench.gcpose.training.depth_views import View, draw_view, view_depth, view_screws
from gcbench.gcpose.training.joint_images import JointImages, joint_numbers, view_numbers
from gcbench.gcpose.training.screws import DepthVideos, relative_screws
from gcbench.robots.geometry.depth_images import fit_depth, fit_intrinsics

K = np.array([[150.0, 0.0, 95.5], [0.0, 150.0, 53.5], [0.0, 0.0, 1.0]])
VIEWS = [draw_view(np.random.default_rng(seed), ViewConfig(8.0, (0.7, 1.4), seed % 2))
         for seed in range(4)]


def plane_depth(plane: np.ndarray, shape: tuple[int, int] = (108, 192)) -> np.ndarray:
    """The image [H W] m of the plane n . x = 1."""
    return (1 / (pinhole.pixel_rays(K, pinhole.pixel_grid(*shape)) @ plane)).astype(np.float32)


def fitted_plane(depth: np.ndarray) -> np.ndarray:
    rays = pinhole.pixel_rays(K, pinhole.pixel_grid(*depth.shape))[depth > 0]
    return np.linalg.lstsq(rays, 1 / depth[depth > 0], rcond=None)[0]


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("slides", [False, True])
def test_planes_of_a_video_move_by_its_screw(view: View, slides: bool) -> None:
    assert view.mirrors == (np.linalg.det(view.turn) < 0)
    l = np.array([0.3, 0.8, -0.5]) / np.linalg.norm([0.3, 0.8, -0.5])
    m = np.zeros(3) if slides else np.cross([0.2, -0.1, 2.0], l)
    row = np.array([*l, *m, 0.0 if slides else 0.2, 0.15 if slides else 0.0])

    def motion(screw: np.ndarray) -> np.ndarray:
        return (se3.prismatic_motion(screw[:6], screw[7]) if slides
                else se3.revolute_motion(screw[:6], screw[6]))

    other = motion(view_screws(row[None], view, slides)[0])
    for plane in ([0.1, 0.05, 0.5], [-0.15, 0.1, 0.4], [0.05, -0.2, 0.6]):
        moved_plane = np.append(plane, -1.0) @ np.linalg.inv(motion(row))
        both = np.stack([plane_depth(np.array(plane)), plane_depth(
            moved_plane[:3] / -moved_plane[3])])
        before, after = map(fitted_plane, view_depth(both, K, view))
        expected = np.append(before, -1.0) @ np.linalg.inv(other)
        assert after == pytest.approx(expected[:3] / -expected[3], abs=1e-3)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("joint", ["pan", "slide"])
def test_numbers_describe_the_object_in_the_other_view(view: View, joint: str) -> None:
    slides = joint == "slide"
    sequence = moved(joint, [0.0, 0.1, 0.3])
    screw = view_screws(relative_screws(sequence, 0, 2), view, slides)[-1, :6]
    for before in joint_numbers(sequence):
        after = view_numbers(before, view, slides)
        length = view.scale if slides else 1.0
        assert after[CONFIGURATION] == pytest.approx(length * before[CONFIGURATION])
        assert after[GEOMETRY] == pytest.approx(view.scale * before[GEOMETRY])
        assert np.linalg.norm(after[RADIUS]) == pytest.approx(
            view.scale * np.linalg.norm(before[RADIUS]))
        assert camera_screw(after, slides) == pytest.approx(screw, abs=1e-9)


def test_intrinsics_follow_the_reduced_image() -> None:
    k = np.array([[300.0, 0.0, 143.5], [0.0, 300.0, 107.5], [0.0, 0.0, 1.0]])
    point = np.array([0.3, -0.2, 1.5])
    depth = np.zeros((1, 216, 288), np.float32)
    u, v = np.rint(pinhole.project(k, point)[:2]).astype(int)
    depth[0, v // 2 * 2 : v // 2 * 2 + 2, u // 2 * 2 : u // 2 * 2 + 2] = 1.5
    row, column = np.argwhere(fit_depth(depth)[0] > 0)[0]
    at = pinhole.project(fit_intrinsics(k, 288, 216), point)[:2]
    assert at == pytest.approx([column, row], abs=0.5)


def test_samples_differ_by_their_views_and_repeat(tmp_path: Path) -> None:
    data, views = dataset(tmp_path / "d"), ViewConfig(5.0, (0.8, 1.25), 0.5)
    videos, plain = DepthVideos([data], 4, 1, views=views), DepthVideos([data], 4, 1)
    images, same = JointImages([data], 1, 0.0, views), JointImages([data], 1, 0.0)
    for number in range(3):
        one, other = videos.sample(number), plain.sample(number)
        assert np.array_equal(one.depth, videos.sample(number).depth)
        assert not np.array_equal(one.depth, other.depth)
        assert np.allclose(one.screw[:, 6], other.screw[:, 6])
        assert not np.allclose(one.screw[:, :3], other.screw[:, :3])
        assert not np.array_equal(images.sample(number).numbers, same.sample(number).numbers)
