"""A camera inside a room sees surfaces only, and always sees the robot past the furniture."""

from typing import Any

import numpy as np
import pytest
from gcbench.renderer.scene.config import BackgroundConfig
from gcbench.renderer.scene.room import RoomSurface, draw_room

CENTER = np.array([0.3, -0.2, 0.5])
# Walls as near as the margin allows, and the cheapest texture: these are laws of shape.
TIGHT = BackgroundConfig(kinds=("checker",), room_size=(0.1, 0.3))


def _direction(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.normal(size=(n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _setting(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng([seed, 1])
    distance, azimuth, elevation = rng.uniform(0.5, 3), rng.uniform(-3, 3), rng.uniform(0.1, 0.9)
    eye = CENTER + distance * np.array([np.cos(elevation) * np.cos(azimuth),
                                        np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    # At times the robot reaches farther than the camera is away.
    return {"floor": rng.uniform(-0.3, 0.0), "middle": CENTER, "eye": eye,
            "reach": distance * rng.uniform(0.2, 1.3)}


def _room(seed: int, config: BackgroundConfig = TIGHT, **changes: Any) -> tuple[RoomSurface, ...]:
    return draw_room(np.random.default_rng(seed), config, **{**_setting(seed), **changes})


def _hits(surfaces: tuple[RoomSurface, ...], eye: np.ndarray,
          rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [N] of the nearest triangle along each ray, and cosine against its normal."""
    a, b, c = (np.concatenate([s.vertices[s.faces[:, i]] for s in surfaces]) for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cosine = rays @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("ij,ij->i", normal, a - eye) / cosine
        point = eye + t[..., None] * rays[:, None]
        inside = np.ones(t.shape, bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("nfj,fj->nf", point - p, np.cross(normal, q - p)) >= -1e-9
    t = np.where(inside & (t > 0), t, np.inf)
    nearest = t.argmin(1)
    return t.min(1), cosine[np.arange(len(rays)), nearest]


@pytest.mark.parametrize("seed", range(12))
def test_every_ray_hits_the_inside_of_the_room(seed: int) -> None:
    rng, setting, surfaces = np.random.default_rng(seed), _setting(seed), _room(seed)
    near_robot = CENTER + 0.1 * setting["reach"] * _direction(rng, 1)
    for eye in (setting["eye"], *near_robot):
        shell = surfaces if eye is setting["eye"] else surfaces[:3]
        t, cosine = _hits(shell, eye, _direction(rng, 300))
        assert np.isfinite(t).all()
        assert (cosine < 0).all()  # triangles face the camera


@pytest.mark.parametrize("seed", range(12))
def test_walls_keep_a_margin(seed: int) -> None:
    setting, (floor, walls, ceiling, *_) = _setting(seed), _room(seed)
    assert np.allclose(floor.vertices[:, 2], setting["floor"])
    for inside, needed in ((CENTER, 1.1 * setting["reach"]), (setting["eye"], 0.0)):
        assert ceiling.vertices[:, 2].min() > inside[2] + needed
        gap = np.einsum("ij,ij->i", walls.normals, inside - walls.vertices)
        assert gap.min() > needed


@pytest.mark.parametrize("seed", range(12))
def test_a_room_is_no_larger_than_it_must_be(seed: int) -> None:
    """What is far costs depth images the precision of what is near."""
    setting, (_, walls, *_) = _setting(seed), _room(seed)
    across = np.einsum("ij,ij->i", walls.normals, CENTER - walls.vertices)
    reach = setting["reach"]
    distance = float(np.linalg.norm(setting["eye"] - CENTER))
    assert across.max() < 1.15 * max(distance, reach) + 0.3 * reach + 1e-9


@pytest.mark.parametrize("seed", range(40))
def test_furniture_hides_neither_robot_nor_camera(seed: int) -> None:
    setting = _setting(seed)
    pieces = [s for s in _room(seed) if s.name == "furniture"]
    assert 2 <= len(pieces) <= 6
    eye, reach = setting["eye"], setting["reach"]
    # Lines of sight, seen from above, to the rim of the cylinder that the robot can reach.
    rim = np.linspace(0, 2 * np.pi, 40)
    target = CENTER[:2] + reach * np.stack([np.cos(rim), np.sin(rim)], -1)
    share = np.linspace(0, 1, 40)[:, None, None]
    sight = ((1 - share) * target + share * eye[:2]).reshape(-1, 2)
    for piece in pieces:
        corners = piece.vertices[:, :2]
        assert np.linalg.norm(corners - CENTER[:2], axis=1).min() > reach
        # A side's normal separates what is outside of a convex footprint.
        upright = np.abs(piece.normals[:, 2]) < 0.5
        n, p = piece.normals[upright, :2], corners[upright]
        outside = ((sight @ n.T - (n * p).sum(1)) > 0).any(1)
        assert outside.all()


@pytest.mark.parametrize("seed", range(6))
def test_surfaces_are_sound(seed: int) -> None:
    surfaces = _room(seed, BackgroundConfig())
    assert [s.name for s in surfaces[:3]] == ["floor", "walls", "ceiling"]
    assert sum(len(s.faces) for s in surfaces) < 300
    for s in surfaces:
        assert len(s.vertices) == len(s.normals) == len(s.uv)
        a, b, c = (s.vertices[s.faces[:, i]] for i in range(3))
        assert np.allclose(np.linalg.norm(s.normals, axis=1), 1)
        winding = np.einsum("ij,ikj->ik", np.cross(b - a, c - a), s.normals[s.faces])
        assert (winding > 0).all()  # normals agree with counter-clockwise order
        assert all(0 <= x <= 1 for x in (*s.base_color, s.roughness))
        assert s.texture.shape[0] in (256, 512)
        assert np.isfinite(s.uv).all()


def test_surfaces_of_the_kind_plain_have_one_color() -> None:
    surfaces = _room(0, BackgroundConfig(kinds=("plain",), color=(1.0, 0.5, 0.0)))
    assert {tuple(np.unique(s.texture.reshape(-1, 3), axis=0).ravel()) for s in surfaces} == {
        (255, 128, 0)}


def test_the_room_is_a_function_of_the_generator() -> None:
    for s, t in zip(_room(3), _room(3), strict=True):
        assert s.vertices.tobytes() == t.vertices.tobytes()
        assert s.uv.tobytes() == t.uv.tobytes()
        assert s.texture.tobytes() == t.texture.tobytes()


def test_a_camera_below_the_floor_lowers_it() -> None:
    eye = CENTER + np.array([1.0, 0.0, -1.0])
    floor, *_ = _room(0, eye=eye, reach=0.5, floor=0.0)
    assert floor.vertices[:, 2].max() < eye[2]
