"""Streams, ranges and records of what is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.renderer.scene.config import (
    FACTORS,
    BackgroundConfig,
    CameraConfig,
    LightsConfig,
    MaterialsConfig,
    RenderConfig,
    TexturesConfig,
    resolve,
)
from gcbench.renderer.scene.sampling import (
    Streams,
    draw_background,
    draw_camera,
    draw_lights,
    draw_materials,
    draw_textures,
)
from gcbench.renderer.types.camera import Camera
from gcbench.robots.model import ArticulatedModel, Link, Material, Visual

WIDTH, HEIGHT = 320, 200
CUBE = np.array([[x, y, z] for x in (-0.2, 0.3) for y in (-0.1, 0.4) for z in (0.0, 1.2)])


def first_numbers(config: RenderConfig, index: int, attempt: int = 0) -> dict[str, float]:
    """What each factor draws first."""
    streams = Streams(config, index)
    return {factor: streams.rng(factor, attempt).random() for factor in FACTORS}


def two_parts() -> ArticulatedModel:
    """Three visuals with two materials on two parts."""
    steel, blue = Material("steel", (0.6, 0.6, 0.6, 1.0)), Material("blue", (0.1, 0.2, 0.9, 0.5))
    faces, normals = np.array([[0, 1, 2]], np.int32), np.tile([0, 0, 1.0], (8, 1))
    model = ArticulatedModel.from_links("two", [Link("base"), Link("arm", "base")])
    return replace(model, visuals=tuple(
        Visual(part, CUBE, faces, normals, None, material)
        for part, material in ((0, steel), (1, blue), (1, steel))))


def camera(seed: int, config: CameraConfig | None = None, floor: float = 0.0) -> Camera:
    rng = np.random.default_rng(seed)
    return draw_camera(rng, config or CameraConfig(), WIDTH, HEIGHT, CUBE, floor)


# -- streams ----------------------------------------------------------------------------------


def test_factors_draw_from_streams_of_their_own() -> None:
    drawn = first_numbers(RenderConfig(), 3)
    assert len(set(drawn.values())) == len(FACTORS)
    assert drawn == first_numbers(RenderConfig(), 3)
    for other in (RenderConfig(seed=1), RenderConfig(stream="train")):
        assert not set(first_numbers(other, 3).values()) & set(drawn.values())
    assert not set(first_numbers(RenderConfig(), 4).values()) & set(drawn.values())
    assert not set(first_numbers(RenderConfig(), 3, attempt=1).values()) & set(drawn.values())


def test_a_factor_that_does_not_vary_keeps_the_draw_of_sequence_0() -> None:
    every, lights = RenderConfig(), RenderConfig(vary=("lights",))
    zero = first_numbers(every, 0)
    for index in (1, 7):
        drawn = first_numbers(lights, index)
        assert drawn["lights"] == first_numbers(every, index)["lights"]
        assert all(drawn[f] == zero[f] for f in FACTORS if f != "lights")


def test_robots_share_draws_only_if_they_are_twins() -> None:
    def drawn(robot: str, **fields: str) -> dict[str, float]:
        config = resolve(RenderConfig(robot, **fields))  # type: ignore[arg-type]
        tracks = Streams(config, 3).tracks_rng().random()
        return first_numbers(config, 3) | {"tracks": tracks}

    robots = ("ur5", "iiwa14", "microwave", "oven", "oven:3", "random:1", "here/arm.urdf")
    every = [number for robot in robots for number in drawn(robot).values()]
    assert len(set(every)) == len(robots) * (len(FACTORS) + 1)
    assert drawn("ur5-textured") == drawn("ur5") == drawn("iiwa14", twin_of="ur5")
    assert drawn("there/arm.urdf") == drawn("here/arm.urdf")  # a copy, or another machine
    assert drawn("ur5", twin_of="here/arm.urdf") == drawn("here/arm.urdf")


def test_the_draws_of_earlier_versions_stay() -> None:
    before = {"motion": 0.4638912284139929, "camera": 0.7342030537796193,
              "lights": 0.6593259072129033, "materials": 0.7158272874791846,
              "textures": 0.08714038259089152, "background": 0.941111416186641,
              "image": 0.11711010050756954, "instance": 0.8943024022923174}
    for robot in ("ur5", "iiwa14"):
        assert first_numbers(resolve(RenderConfig(robot, seed=7, twin_of="")), 3, 1) == before


# -- camera -----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(25))
def test_the_robot_fills_the_share_that_was_drawn_and_lies_inside(seed: int) -> None:
    found = camera(seed)
    u, v, z = found.project(CUBE).T
    fill = max(np.ptp(u), np.ptp(v)) / min(WIDTH, HEIGHT)
    assert 0.499 < fill < 0.901
    assert z.min() > 0
    assert u.min() >= 0
    assert u.max() <= WIDTH - 1
    assert v.min() >= 0
    assert v.max() <= HEIGHT - 1
    assert found.world_from_cam[2, 3] > 0  # above the floor


@pytest.mark.parametrize("seed", range(5))
def test_the_camera_stands_where_the_ranges_say(seed: int) -> None:
    ranges = CameraConfig(azimuth=(30, 30), elevation=(40, 40), jitter=0.0, roll=(0, 0),
                          fov=(45, 45))
    found = camera(seed, ranges)
    center = (CUBE.min(0) + CUBE.max(0)) / 2
    x, y, z = found.world_from_cam[:3, 3] - center
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(30)
    assert np.degrees(np.arctan2(z, np.hypot(x, y))) == pytest.approx(40)
    np.testing.assert_allclose(found.project(center[None])[0, :2],
                               [(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
    assert 2 * np.degrees(np.arctan(HEIGHT / 2 / found.intrinsics[1, 1])) == pytest.approx(45)


def test_the_camera_is_never_below_the_floor() -> None:
    found = camera(0, CameraConfig(elevation=(-60, -60)), floor=0.0)
    assert found.world_from_cam[2, 3] > 0


def test_a_fill_above_one_crops_the_robot() -> None:
    found = camera(1, CameraConfig(fill=(1.5, 1.5), jitter=0.0))
    u, v, _ = found.project(CUBE).T
    assert max(np.ptp(u), np.ptp(v)) == pytest.approx(1.5 * HEIGHT, rel=1e-3)


# -- lights, materials, textures, background --------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_lights_keep_to_their_ranges(seed: int) -> None:
    lights, ambient = draw_lights(np.random.default_rng(seed), LightsConfig())
    assert 1 <= len(lights) <= 3
    assert 2.0 <= sum(light.intensity for light in lights) <= 5.0
    assert 0.15 <= ambient <= 0.4
    for light in lights:
        assert np.linalg.norm(light.direction) == pytest.approx(1)
        assert 20 - 1e-9 <= np.degrees(np.arcsin(-light.direction[2])) <= 80 + 1e-9
        assert all(0.85 - 1e-9 <= c <= 1 for c in light.color)


def test_equal_streams_draw_equal_lights_and_materials() -> None:
    def twice(draw):
        return [draw(np.random.default_rng(5)) for _ in range(2)]

    (a, ambient), (b, other) = twice(lambda rng: draw_lights(rng, LightsConfig()))
    assert ambient == other
    for one, two in zip(a, b, strict=True):
        np.testing.assert_array_equal(one.direction, two.direction)
        assert (one.color, one.intensity) == (two.color, two.intensity)
    one, two = twice(lambda rng: draw_materials(rng, MaterialsConfig(), two_parts()))
    assert one == two


def test_visuals_that_share_a_material_share_its_draw() -> None:
    ranges = MaterialsConfig()
    steel, blue, again = draw_materials(np.random.default_rng(2), ranges, two_parts())
    assert steel == again
    assert steel != blue
    for drawn in (steel, blue):
        assert ranges.roughness[0] <= drawn.roughness <= ranges.roughness[1]
        assert ranges.metallic[0] <= drawn.metallic <= ranges.metallic[1]
    assert blue.base_color[3] == 0.5  # what is transparent stays so
    assert steel.base_color[0] == pytest.approx(steel.base_color[1])  # grey has no hue


def test_a_shared_draw_changes_the_colour_alone() -> None:
    model, rng = two_parts(), np.random.default_rng
    plain = draw_materials(rng(2), MaterialsConfig(), model)
    first, second, third = model.visuals
    lamp = replace(third.material, emission=(1.0, 0.5, 0.0), unlit=True)
    model = replace(model, visuals=(first, second, replace(third, material=lamp)))
    drawn = draw_materials(rng(2), MaterialsConfig(), model)
    assert drawn == (*plain[:2], replace(plain[2], emission=(1.0, 0.5, 0.0), unlit=True))


def test_materials_may_be_left_alone() -> None:
    model = two_parts()
    drawn = draw_materials(np.random.default_rng(2), MaterialsConfig(probability=0.0), model)
    assert drawn == tuple(v.material for v in model.visuals)


def test_textures_clothe_whole_parts() -> None:
    model = two_parts()
    own = tuple(v.material for v in model.visuals)
    config = TexturesConfig(probability=1.0, size=32)
    rng = np.random.default_rng(0)
    drawn, tile, kinds = draw_textures(rng, config, model, own, size=2.0)
    assert set(kinds) == {"base", "arm"}
    assert drawn[1].texture is drawn[2].texture
    assert drawn[0].texture is not drawn[1].texture
    assert all(m.texture.shape == (32, 32, 3) for m in drawn)
    assert ((tile >= 0.15 * 2) & (tile <= 0.4 * 2)).all()
    bare, tile, kinds = draw_textures(rng, TexturesConfig(), model, own, size=2.0)
    assert bare == own
    assert not tile.any()
    assert not kinds


def test_a_part_draws_the_same_texture_whether_or_not_others_have_one() -> None:
    model = two_parts()
    own = tuple(v.material for v in model.visuals)
    config = TexturesConfig(probability=1.0, size=32)
    all_drawn = draw_textures(np.random.default_rng(4), config, model, own, 1.0)[0]
    for chance in (0.2, 0.4, 0.6, 0.8):
        some = draw_textures(
            np.random.default_rng(4), replace(config, probability=chance), model, own, 1.0)[0]
        for one, two, plain in zip(some, all_drawn, own, strict=True):
            assert one is plain or np.array_equal(one.texture, two.texture)


def test_a_background_is_a_picture_or_a_room() -> None:
    view = camera(0)
    center, names = CUBE.mean(0), set()
    for seed in range(12):
        picture, room, name = draw_background(
            np.random.default_rng(seed), BackgroundConfig(), view, 0.0, center, 0.5)
        names.add(name)
        assert (picture is None) == bool(room) == (name == "room")
        if picture is not None:
            assert picture.shape == (HEIGHT, WIDTH, 3)
            assert picture.dtype == np.uint8
    assert {"room"} < names
    plain = BackgroundConfig(room=0.0, kinds=("plain",), color=(1.0, 0.5, 0.0))
    picture, _, name = draw_background(np.random.default_rng(0), plain, view, 0.0, center, 0.5)
    assert name == "plain"
    assert np.unique(picture.reshape(-1, 3), axis=0).tolist() == [[255, 128, 0]]
