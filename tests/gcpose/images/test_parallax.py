"""A camera's rotation and translation by features, some of which move in themselves."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from gcbench.gcpose.images.features import FeatureTracks, follow_features
from gcbench.gcpose.images.parallax import find_parallax
from scipy.spatial.transform import Rotation

INTRINSICS = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])


def tracks(moving: int, far: int, near: int) -> tuple[FeatureTracks, np.ndarray, np.ndarray]:
    """Features that move, are far away, and stand near; rotations and translations of a hand."""
    rng = np.random.default_rng(2)
    count = moving + far + near
    start = rng.uniform([40, 40], [600, 440], (count, 2))
    ray = np.concatenate([start, np.ones((count, 1))], axis=1) @ np.linalg.inv(INTRINSICS).T
    depth = np.where(np.arange(count) < moving + far, 1e6, rng.uniform(1.5, 2.0, count))
    time = np.linspace(0, 5, 13)[1:, None]
    turn = Rotation.from_rotvec(0.006 * np.sin(time * [1.0, 1.4, 0.6])).as_matrix()
    step = 0.012 * np.sin(time * [1.7, 0.9, 1.2])
    at = np.einsum("tij,nj->tni", turn, ray * depth[:, None]) + step[:, None]
    at = at @ INTRINSICS.T
    end = at[..., :2] / at[..., 2:] + 0.1 * rng.standard_normal((12, count, 2))
    path = np.linspace(0, 1, 12)[:, None, None] ** 2
    end[:, :moving] += path * rng.uniform(-20, 20, (moving, 2))
    found = rng.random((12, count)) < 0.8
    return FeatureTracks(start, end, found, np.full(count, 0.15)), turn, step


def test_rotation_translation_and_depth_are_found_in_spite_of_what_moves() -> None:
    features, turn, step = tracks(moving=20, far=200, near=50)
    far = INTRINSICS @ turn @ np.linalg.inv(INTRINSICS)
    found = find_parallax(features, far + 1e-4 * np.eye(3), INTRINSICS)
    assert found is not None
    angle = Rotation.from_matrix(found.rotation @ turn.swapaxes(1, 2)).magnitude()
    assert np.degrees(angle).max() < 0.02
    scale = (found.translation * step).sum() / (step**2).sum()
    assert scale > 0  # what is near is before the camera
    assert np.linalg.norm(found.translation / scale - step) < 0.05 * np.linalg.norm(step)
    depth = 1 / (found.inverse_depth * scale)[220:][found.still[220:]]
    assert depth.min() > 1.4
    assert depth.max() < 2.1
    assert found.still[:20].mean() < 0.2
    assert found.still[20:].mean() > 0.95
    assert found.explained > 20


def test_there_is_no_parallax_where_all_is_far_away() -> None:
    features, turn, _ = tracks(moving=0, far=200, near=0)
    far = INTRINSICS @ turn @ np.linalg.inv(INTRINSICS)
    assert find_parallax(features, far, INTRINSICS) is None


def test_what_moves_steadily_is_no_parallax() -> None:
    features, turn, _ = tracks(moving=0, far=200, near=0)
    end = features.end.copy()
    radius = np.linspace(5, 20, 40)[:, None]
    end[:, :40] += np.linspace(0, 1, 12)[:, None, None] * radius * [0.8, 0.6]
    far = INTRINSICS @ turn @ np.linalg.inv(INTRINSICS)
    assert find_parallax(replace(features, end=end), far, INTRINSICS) is None


def test_a_feature_is_followed_only_where_its_motion_is_seen() -> None:
    rng = np.random.default_rng(1)
    grain = rng.integers(60, 140, (1, 240, 1)).repeat(160, 0).astype(np.float64)
    weak = 12 * cv2.GaussianBlur(rng.standard_normal((160, 240, 1)), (0, 0), 4.0)[..., None]
    image = cv2.GaussianBlur((grain + weak).clip(0, 255), (0, 0), 1.0)[..., None].repeat(3, 2)
    image[60:100, 150:190] = 250
    video = np.stack([image, np.roll(image, 4, axis=0)]).astype(np.uint8)
    found = follow_features(video, np.eye(3)[None].repeat(2, 0))
    corner = (np.abs(np.abs(found.start - [169.5, 79.5]) - 20) < 4).all(axis=1)
    seen = corner & found.found[0]
    assert seen.any()
    assert np.abs((found.end[0] - found.start)[seen] - [0, 4]).max() < 0.5
    on_grain = (np.abs(found.start - [169.5, 79.5]) > 35).any(axis=1)
    assert on_grain.sum() > 10
    assert found.found[0, on_grain].mean() < 0.1
