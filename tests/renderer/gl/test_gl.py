"""What OpenGL draws, against closed forms: every number of the truth, and laws of the colours."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from gcbench.renderer.gl import NoRendererError
from gcbench.renderer.gl.context import _load_egl
from gcbench.renderer.gl.culling import outward_faces
from gcbench.renderer.gl.devices import EglDevice, choose_devices, is_drawn_by_software
from gcbench.renderer.gl.rasterizer import Rasterizer
from gcbench.renderer.scene import pose_parts, rest
from gcbench.renderer.scene.room import RoomSurface
from gcbench.renderer.scene.scene import Light, Scene
from gcbench.renderer.types.camera import Camera, intrinsics_from_fov, look_at
from gcbench.robots.geometry import inverse, rotation_from_rpy, transform
from gcbench.robots.model import ArticulatedModel, Link, Material, Visual
from gcbench.robots.motion.trajectory import JointTrajectory

pytestmark = pytest.mark.gl

WIDTH, HEIGHT = 96, 72
GREY = Material("grey", (0.5, 0.5, 0.5, 1.0))
QUAD = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
EYE = transform(rotation_from_rpy([np.pi, 0, 0]), [0, 0, 2.0])
"""Looks down from z = 2: x to the right, y up in the image."""


@pytest.fixture(scope="module")
def rasterizer() -> Iterator[Rasterizer]:
    drawn = Rasterizer(WIDTH, HEIGHT)
    yield drawn
    drawn.close()


def camera(world_from_cam: np.ndarray = EYE, fov: float = 60.0) -> Camera:
    k = intrinsics_from_fov(WIDTH, HEIGHT, np.radians(fov))
    k[0, 2] += 3.3  # nothing may depend on a centered principal point
    k[1, 2] -= 2.6
    return Camera(WIDTH, HEIGHT, k, world_from_cam)


def quad(part: int, z: float, size: float = 0.5, material: Material = GREY, flip: bool = False,
         at: tuple[float, float] = (0, 0)) -> Visual:
    """A square of side 2 * size facing up at height z."""
    vertices = QUAD * size + [*at, z]
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Visual(part, vertices, faces[:, ::-1] if flip else faces,
                  np.tile([0, 0, 1.0], (4, 1)), (QUAD[:, :2] + 1) / 2, material)


def box(part: int, low: tuple[float, ...], high: tuple[float, ...]) -> Visual:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
    vertices = np.array(low) + corners * (np.array(high) - np.array(low))
    return Visual(part, vertices, np.array(faces, np.int32), np.tile([0, 0, 1.0], (8, 1)), None,
                  GREY)


def model(*visuals: Visual) -> ArticulatedModel:
    n = max(v.part for v in visuals) + 1
    names = "abcdefgh"[:n]
    links = [Link(name, parent) for name, parent in zip(names, (None, *names), strict=False)]
    return replace(ArticulatedModel.from_links("things", links), visuals=visuals)


def poses(things: ArticulatedModel, frames: int = 1) -> np.ndarray:
    return np.tile(np.eye(4), (frames, len(things.parent), 1, 1))


def truth(r: Rasterizer, things: ArticulatedModel, view: Camera | None = None):
    """Depth and parts of a model at rest."""
    drawn = r.draw_truth(rest(things), view or camera())
    return drawn.depth, drawn.part


def scene(things: ArticulatedModel, **changes: object) -> Scene:
    n = len(things.visuals)
    plain = Scene(
        model=things, trajectory=JointTrajectory(np.zeros(1), np.zeros((1, 0))),
        cameras=(camera(),) * 3,
        lights=(Light(np.array([0, 0, -1.0]), (1.0, 1.0, 1.0), 2.0),), ambient=0.2,
        shadows=False, materials=tuple(v.material for v in things.visuals),
        texture_size=np.zeros(n), backdrop=np.zeros((HEIGHT, WIDTH, 3), np.uint8), room=(),
        noise=0.0, noise_seed=0, blur=0.0, exposure=np.zeros(1))
    return replace(plain, **changes)


def color(r: Rasterizer, drawn: Scene) -> np.ndarray:
    """RGB [H W 3] as int."""
    return r.draw_color(drawn, rest(drawn.model)).rgb.astype(int)


def project(view: Camera, points: np.ndarray) -> np.ndarray:
    return view.project(points)[:, :2]


# -- truth ------------------------------------------------------------------------------------


def test_depth_of_a_tilted_plane_at_every_pixel_center(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 10.0))
    view = camera(look_at([0.3, -1.0, 1.5], [0.1, 0.2, 0.0], 0.2))
    depth, part = truth(rasterizer, things, view)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(view.intrinsics).T
    rays = rays @ view.world_from_cam[:3, :3].T
    expected = -view.world_from_cam[2, 3] / rays[..., 2]  # z along the ray, in the camera frame
    assert (part == 1).all()
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_a_quad_covers_the_pixels_whose_centers_it_covers(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.3, 0.41))
    depth, part = truth(rasterizer, things)
    low, high = np.sort(project(camera(), QUAD[[0, 2]] * 0.41 + [0, 0, 0.3]), axis=0)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    inside = (u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1])
    np.testing.assert_array_equal(part > 0, inside)
    np.testing.assert_array_equal(depth > 0, inside)


def test_the_nearer_part_wins_and_numbers_start_at_one(rasterizer: Rasterizer) -> None:
    things = model(quad(2, 0.5, 0.2), quad(1, 0.0, 0.5), quad(0, -0.5, 9.0))
    depth, part = truth(rasterizer, things)
    center = np.round(project(camera(), np.zeros((1, 3)))[0]).astype(int)
    assert part[center[1], center[0]] == 3
    assert set(np.unique(part)) == {1, 2, 3}
    for number, z in ((1, 2.5), (2, 2.0), (3, 1.5)):
        np.testing.assert_allclose(depth[part == number], z, rtol=1e-6)


def test_what_moves_and_what_stands_meet_as_if_drawn_at_once(rasterizer: Rasterizer) -> None:
    things = model(box(0, (-0.4, -0.4, 0), (0.1, 0.1, 0.3)),
                   box(1, (-0.1, -0.1, 0.1), (0.5, 0.5, 0.2)))
    path = poses(things, 3)
    path[:, 1, 0, 3] = [0.0, 0.1, -0.2]
    posed, view = pose_parts(things, path), camera()
    moving = [rasterizer.draw_truth(posed, view, t) for t in (2, 0, 1)]
    for t, drawn in zip((2, 0, 1), moving, strict=True):
        # nothing moves in one frame
        once = rasterizer.draw_truth(pose_parts(things, path[[t]]), view)
        np.testing.assert_array_equal(drawn.part, once.part)
        np.testing.assert_allclose(drawn.depth, once.depth, rtol=1e-6)


def test_images_do_not_depend_on_the_order_of_draws_and_reads(rasterizer: Rasterizer) -> None:
    things = model(box(0, (-0.4, -0.4, 0), (0.1, 0.1, 0.3)), quad(1, 0.4, 0.2))
    path = poses(things, 3)
    path[:, 1, 0, 3] = [0.0, 0.1, -0.2]
    posed, view, drawn = pose_parts(things, path), camera(), scene(things)

    def images(t: int, *, at_once: bool) -> list[np.ndarray]:
        color, truth = rasterizer.draw_color(drawn, posed, t), None
        if at_once:
            _ = color.rgb
        truth = rasterizer.draw_truth(posed, view, t)
        if not at_once:
            later = rasterizer.draw_truth(posed, view, (t + 1) % 3)
            rasterizer.draw_color(drawn, posed, (t + 2) % 3)
            assert later.part.any()
        return [color.rgb, truth.depth, truth.part]

    expected = [images(t, at_once=True) for t in range(3)]
    for t in (1, 2, 0, 0):
        for one, two in zip(images(t, at_once=False), expected[t], strict=True):
            np.testing.assert_array_equal(one, two)


def test_coverage_sees_through_what_is_in_front(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.5, 0.5), quad(1, 0.0, 0.3), quad(2, -0.2, 0.3, at=(0.4, 0)))
    posed, view = rest(things), camera()
    drawn = rasterizer.draw_truth(posed, view)
    where = np.tile([0, 0, WIDTH, HEIGHT], (3, 1))
    bits = rasterizer.draw_coverage(posed, view, 0, np.array([-1, 0, 9]), where)
    part = drawn.part
    assert not (part == 2).any()  # hidden by the first
    for visual, bit in ((things.visuals[1], 0), (things.visuals[2], 9)):
        _, alone = truth(rasterizer, model(replace(visual, part=0)))
        np.testing.assert_array_equal((bits >> bit) & 1, alone)
    assert not (bits & ~np.uint32(1 | 1 << 9)).any()


def test_coverage_keeps_to_each_part_s_box(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.5), quad(1, 0.1, 0.5))
    where = np.array([[40, 30, 50, 33], [10, 20, 10, 60]])
    bits = rasterizer.draw_coverage(rest(things), camera(), 0, np.array([0, 1]), where)
    assert (bits[30:33, 40:50] == 1).all()
    assert (bits > 0).sum() == 30
    assert truth(rasterizer, things)[1].astype(bool).sum() > 500  # nothing of it is left


def test_an_outline_holds_a_part_tightly(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.3), quad(2, 0.2, 0.2, at=(0.1, 0.2)))
    view = camera()
    _, part = truth(rasterizer, things, view)
    boxes = rasterizer.outlines(rest(things), view)
    assert boxes[1].tolist() == [0, 0, 0, 0]
    for number in (1, 3):
        v, u = np.nonzero(part == number)
        assert (boxes[number - 1][:2] <= [u.min(), v.min()]).all()
        assert (boxes[number - 1][2:] > [u.max(), v.max()]).all()
        assert np.ptp(boxes[number - 1].reshape(2, 2), axis=0).max() < 40
    behind = replace(view, world_from_cam=transform(None, [0, 0, 0.1]))
    assert rasterizer.outlines(rest(things), behind)[0].tolist() == [0, 0, WIDTH, HEIGHT]


def test_no_part_number_is_too_large_for_the_mask(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0))
    n = 700
    many = replace(
        things, part_names=tuple(map(str, range(n))), parent=np.arange(n) - 1,
        visuals=(replace(things.visuals[0], part=n - 1),))
    part = rasterizer.draw_truth(
        pose_parts(many, np.tile(np.eye(4), (1, n, 1, 1))), camera()).part
    assert set(np.unique(part)) == {0, n}


# -- culling ----------------------------------------------------------------------------------

BOX = box(0, (-0.3, -0.2, -0.1), (0.3, 0.2, 0.4))


def join(a: Visual, b: Visual) -> Visual:
    """Two visuals as one, with the look of the first."""
    return replace(a, vertices=np.concatenate([a.vertices, b.vertices]),
                   faces=np.concatenate([a.faces, b.faces + np.int32(len(a.vertices))]),
                   normals=np.concatenate([a.normals, b.normals]))


CLOSED = {
    "outward": (BOX, True),
    "inside out": (replace(BOX, faces=BOX.faces[:, ::-1]), False),
    "mirrored": (replace(BOX, vertices=BOX.vertices * [-1, 1, 1]), False),
    "mirrored and turned": (
        replace(BOX, vertices=BOX.vertices * [-1, 1, 1], faces=BOX.faces[:, ::-1]), True),
    "open": (replace(BOX, faces=BOX.faces[2:]), False),
    "touching at a corner": (join(BOX, box(0, (0.3, 0.2, 0.4), (0.4, 0.3, 0.5))), True),
    "touching at an edge": (join(BOX, box(0, (0.3, 0.2, -0.1), (0.5, 0.4, 0.4))), True),
    "touching at a face": (join(BOX, box(0, (0.3, -0.2, -0.1), (0.6, 0.2, 0.4))), True),
    "twice": (join(BOX, BOX), True),
    "one face turned": (
        replace(BOX, faces=np.concatenate([BOX.faces[:1, ::-1], BOX.faces[1:]])), False),
}


@pytest.mark.parametrize("name", CLOSED)
def test_which_meshes_are_drawn_one_sided(name: str) -> None:
    visual, expected = CLOSED[name]
    found = outward_faces([visual.vertices], [visual.faces], [0])[0]
    assert found.all() if expected else not found.any()


def test_a_closed_surface_may_be_cut_into_meshes_with_split_vertices() -> None:
    triangles = BOX.vertices[BOX.faces]
    pieces = [t.reshape(-1, 3) for t in np.split(triangles, [5])]
    faces = [np.arange(len(p), dtype=np.int32).reshape(-1, 3) for p in pieces]
    assert all(found.all() for found in outward_faces(pieces, faces, [4, 4]))


INVERTED = {
    "at a corner": box(0, (0.3, 0.2, 0.4), (0.5, 0.4, 0.6)),
    "at an edge": box(0, (0.3, 0.2, -0.1), (0.5, 0.4, 0.4)),
}
"""Solids that touch BOX."""


@pytest.mark.parametrize("name", INVERTED)
def test_an_inverted_solid_that_touches_a_larger_one_is_drawn_from_both_sides(name: str) -> None:
    small = replace(INVERTED[name], faces=INVERTED[name].faces[:, ::-1])
    for first, second in ((BOX, small), (small, BOX)):
        joined = join(first, second)
        found = outward_faces([joined.vertices], [joined.faces], [0])[0]
        assert found[:12].all() == (first is BOX) and found[12:].all() == (second is BOX)
        assert found.sum() == 12


@pytest.mark.parametrize("name", [*CLOSED, *INVERTED])
def test_culling_changes_no_pixel(
    name: str, rasterizer: Rasterizer, monkeypatch: pytest.MonkeyPatch
) -> None:
    visual = CLOSED[name][0] if name in CLOSED else join(
        BOX, replace(INVERTED[name], faces=INVERTED[name].faces[:, ::-1]))
    views = [camera(look_at(eye, [0, 0, 0.1])) for eye in ([1, 1, 1], [-1, 0.4, -0.5], [0, -1, 2])]
    drawn = [truth(rasterizer, model(visual), view) for view in views]
    colors = color(rasterizer, scene(model(visual)))
    monkeypatch.setattr("gcbench.renderer.gl.culling.outward_faces",
                        lambda v, f, p: [np.zeros(len(x), bool) for x in f])
    both = [truth(rasterizer, model(visual), view) for view in views]
    for one, two in zip(drawn, both, strict=True):
        np.testing.assert_array_equal(one[0], two[0])
        np.testing.assert_array_equal(one[1], two[1])
    np.testing.assert_array_equal(colors, color(rasterizer, scene(model(visual))))


# -- colours ----------------------------------------------------------------------------------


def test_the_backdrop_is_the_picture_itself(rasterizer: Rasterizer) -> None:
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    rows = np.linspace(0, 255, HEIGHT).astype(np.uint8)[:, None]
    picture[..., 0], picture[..., 1] = rows, 40  # red grows downwards, green is constant
    picture[..., 2] = np.linspace(255, 0, WIDTH).astype(np.uint8)
    far = model(quad(0, 0.0, 0.01, at=(0.5, 0.5)))
    drawn = color(rasterizer, scene(far, backdrop=picture))
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    at = project(camera(), np.array([[0.5, 0.5, 0.0]]))[0]
    away = np.hypot(u - at[0], v - at[1]) > 3
    assert np.abs(drawn - picture)[away].max() <= 2  # the samples are interpolated


def test_an_edge_is_a_mixture_of_four_samples(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.5))
    dark = Light(np.array([0, 0, -1.0]), (1.0, 1.0, 1.0), 0.0)
    drawn = color(rasterizer, scene(things, ambient=1.0, lights=(dark,)))[..., 0]
    _, part = truth(rasterizer, things)
    full = drawn[HEIGHT // 2, WIDTH // 2]
    shares = np.unique(drawn[drawn < full])
    assert set(shares) <= {0, *(round(full * s / 4) + d for s in (1, 2, 3) for d in (-1, 0, 1))}
    assert len(shares) > 1
    inner = part[1:-1, 1:-1] & part[:-2, 1:-1] & part[2:, 1:-1] & part[1:-1, :-2] & part[1:-1, 2:]
    assert (drawn[1:-1, 1:-1][inner > 0] == full).all()


def test_row_zero_of_a_texture_is_at_v_one(rasterizer: Rasterizer) -> None:
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:32, :, 0] = 255  # red above
    picture[32:, :, 1] = 255  # green below
    painted = Material("painted", (1.0, 1.0, 1.0, 1.0), 0.0, 1.0, picture)
    drawn = color(rasterizer, scene(model(quad(0, 0.0, 0.5, painted))))
    (u, low), (_, high) = np.round(project(camera(), np.array([[0, -0.25, 0], [0, 0.25, 0]])))
    above, below = drawn[int(high), int(u)], drawn[int(low), int(u)]
    assert high < low  # v = 1 is at +y, which is up in the image
    assert above[0] > 5 * above[1]
    assert below[1] > 5 * below[0]


def test_light_from_behind_leaves_the_ambient(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.5))
    lit = scene(things)
    below = replace(lit, lights=(Light(np.array([0, 0, 1.0]), (1, 1, 1), 2.0),))
    dark = replace(lit, lights=(Light(np.array([0, 0, -1.0]), (1, 1, 1), 0.0),))
    center = HEIGHT // 2, WIDTH // 2
    values = [color(rasterizer, s)[center][0] for s in (lit, below, dark)]
    ambient = 255 * (0.5 * 0.2) ** (1 / 2.2)
    assert values[2] == pytest.approx(ambient, abs=1)
    assert abs(values[1] - values[2]) < 5 < values[0] - values[1]


def test_a_transparent_surface_shows_what_is_behind(rasterizer: Rasterizer) -> None:
    red = Material("red", (1.0, 0.0, 0.0, 1.0))
    glass = Material("glass", (0.0, 0.0, 1.0, 0.3))
    things = model(quad(0, 0.5, 0.3, glass), quad(1, 0.0, 0.9, red))
    center = HEIGHT // 2, WIDTH // 2
    through = color(rasterizer, scene(things))[center]
    opaque = color(rasterizer, scene(things, materials=(
        replace(glass, base_color=(0.0, 0.0, 1.0, 1.0)), red)))[center]
    alone = color(rasterizer, scene(model(quad(0, 0.0, 0.9, red))))[center]
    np.testing.assert_allclose(through, 0.3 * opaque + 0.7 * alone, atol=2)
    assert truth(rasterizer, things)[1][center] == 1  # a surface all the same


def test_a_shadow_darkens_what_lies_behind_an_occluder(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 2.0), quad(1, 0.4, 0.15, at=(0.3, 0.0)))
    light = (Light(np.array([0.6, 0, -0.8]), (1.0, 1.0, 1.0), 3.0),)
    without = color(rasterizer, scene(things, lights=light))
    drawn = color(rasterizer, scene(things, lights=light, shadows=True))
    _, part = truth(rasterizer, things)
    # Where the light that passes the middle of the small square arrives on the floor.
    spot = np.round(project(camera(), np.array([[0.3 + 0.4 * 0.75, 0, 0]]))[0]).astype(int)
    assert part[spot[1], spot[0]] == 1
    assert drawn[spot[1], spot[0], 0] < 0.8 * without[spot[1], spot[0], 0]
    changed = np.abs(drawn - without).max(-1) > 8
    assert 0.2 < changed.sum() / (part == 2).sum() < 2  # the shadow, and nothing else


def floor(texture: np.ndarray) -> RoomSurface:
    return RoomSurface("floor", QUAD * 5 - [0, 0, 0.5], np.array([[0, 1, 2], [0, 2, 3]], np.int32),
                       np.tile([0, 0, 1.0], (4, 1)), QUAD[:, :2] * 3, texture, (1.0, 1.0, 1.0), 0.9)


def test_a_room_has_depth_and_hides_the_backdrop(rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.3))
    texture = np.full((8, 8, 3), 200, np.uint8)
    drawn = scene(things, backdrop=None, room=(floor(texture),))
    image = color(rasterizer, drawn)
    room = rasterizer.draw_room(drawn, rest(things))
    assert room is not None
    np.testing.assert_allclose(room.depth, 2.5, rtol=1e-6)
    assert image.min() > 60
    assert rasterizer.draw_room(scene(things), rest(things)) is None


# -- state ------------------------------------------------------------------------------------


def test_scenes_leave_nothing_behind(rasterizer: Rasterizer) -> None:
    texture = np.random.default_rng(1).integers(0, 256, (32, 32, 3), np.uint8)
    first = model(quad(0, 0.0, 0.5))
    second = model(quad(1, 0.2, 0.3, Material("glass", (0, 1, 0, 0.5))), BOX)
    scenes = [
        scene(first),
        scene(second, shadows=True),
        scene(first, backdrop=None, room=(floor(texture),)),
        scene(second, texture_size=np.array([0.2, 0.0]),
              materials=(Material("t", (1, 1, 1, 1), texture=texture), GREY)),
        scene(first, lights=scene(first).lights * 3),
    ]
    alone = []
    for drawn in scenes:
        fresh = Rasterizer(WIDTH, HEIGHT)
        alone.append((color(fresh, drawn), *truth(fresh, drawn.model)))
        fresh.close()
    rasterizer.context._platform.make_current()
    for i in (0, 1, 2, 3, 4, 3, 0, 2, 1):
        for a, b in zip((color(rasterizer, scenes[i]), *truth(rasterizer, scenes[i].model)),
                        alone[i], strict=True):
            np.testing.assert_array_equal(a, b)


def test_images_that_are_copied_ahead_are_the_same(rasterizer: Rasterizer) -> None:
    """GPUs copy what they have drawn while the caller works; images may stay unread."""
    things, glass = model(quad(0, 0.0, 0.5)), model(quad(1, 0.2, 0.3), BOX)
    room = scene(things, backdrop=None, room=(floor(np.full((8, 8, 3), 200, np.uint8)),))
    found: list[list[np.ndarray]] = []
    for ahead in (False, True):
        drawing = Rasterizer(WIDTH, HEIGHT, faces=True, copies_ahead=ahead)
        images = found.append([]) or found[-1]
        for drawn, posed in ((room, rest(things)), (scene(glass), rest(glass))):
            first = drawing.draw_truth(posed, camera())
            later, shown = drawing.draw_truth(posed, camera()), drawing.draw_color(drawn, posed)
            images += [first.part]  # the next draw has read it
            before = drawing.draw_room(drawn, posed)
            images += [later.part, later.depth, later.face, shown.rgb]
            images += [before.depth, before.face] if before else []
            for _ in range(2):  # what is never read does no harm
                shown, later = drawing.draw_color(drawn, posed), drawing.draw_truth(posed, camera())
            images += [shown.rgb, later.part]
        drawing.close()
    rasterizer.context.make_current()
    for plain, copied in zip(*found, strict=True):
        assert plain.any()
        np.testing.assert_array_equal(plain, copied)


def test_objects_of_opengl_do_not_pile_up(rasterizer: Rasterizer) -> None:
    gl = rasterizer.context.gl
    texture = np.zeros((8, 8, 3), np.uint8)

    def alive() -> list[int]:
        kinds = (gl.glIsTexture, gl.glIsBuffer, gl.glIsVertexArray, gl.glIsFramebuffer,
                 gl.glIsRenderbuffer)
        return [sum(bool(kind(name)) for name in range(1, 3000)) for kind in kinds]

    def one(i: int) -> None:
        things = model(quad(0, 0.01 * i, 0.5))
        drawn = scene(things, shadows=i % 2 == 0, backdrop=None, room=(floor(texture),),
                      texture_size=np.full(1, 0.1 * (i % 3)),
                      materials=(Material("t", (1, 1, 1, 1), texture=texture),))
        truth(rasterizer, things)
        color(rasterizer, drawn)

    for i in range(6):
        one(i)
    before = alive()
    for i in range(60):
        one(i)
    assert alive() == before


@pytest.mark.parametrize("finer", [1, 3])
def test_more_samples_change_edges_only(finer: int, rasterizer: Rasterizer) -> None:
    things = model(quad(0, 0.0, 0.393, at=(0.011, 0.023)))
    four = color(rasterizer, scene(things))
    other = Rasterizer(WIDTH, HEIGHT, finer)
    drawn = color(other, scene(things))
    assert drawn.shape == (HEIGHT, WIDTH, 3)
    _, part = truth(other, things)
    other.close()
    rasterizer.context._platform.make_current()
    np.testing.assert_array_equal(part, truth(rasterizer, things)[1])
    edge = np.zeros(part.shape, bool)
    edge[1:-1, 1:-1] = (part[1:-1, 1:-1] != part[:-2, 1:-1]) | (part[1:-1, 1:-1] != part[2:, 1:-1])
    edge[1:-1, 1:-1] |= (part[1:-1, 1:-1] != part[1:-1, :-2]) | (part[1:-1, 1:-1] != part[1:-1, 2:])
    apart = np.abs(drawn.astype(int) - four)
    assert apart[~edge].max() <= 2 and apart[edge].max() > 10


def test_projection_agrees_with_the_camera(rasterizer: Rasterizer) -> None:
    """The centroid of a tiny square is where `Camera.project` puts it: no half pixel is lost."""
    view = camera(look_at([0.9, -0.7, 1.1], [0, 0, 0]))
    for at in ((0.0, 0.0), (0.2, -0.1), (-0.3, 0.25)):
        things = model(quad(0, 0.0, 0.06, at=at))
        _, part = truth(rasterizer, things, view)
        v, u = np.nonzero(part)
        center = np.array([u.mean(), v.mean()])
        corner = view.project(QUAD * 0.06 + [*at, 0.0])[:, :2]
        assert np.abs(center - corner.mean(0)).max() < 0.35
        assert inverse(view.world_from_cam) == pytest.approx(view.cam_from_world)


# -- the device -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variable", "message"),
    [
        ("EGL_DEVICE_ID=99", "no EGL device is '99'; there are: device 0: "),
        ("EGL_DEVICE_ID=cuda:99", "(or EGL_DEVICE_ID) a number, cuda:N, a PCI address, gpu or "),
        ("LIBGL_DRIVERS_PATH=/nowhere", "no EGL device draws OpenGL 4.1 (device 0: eglInitialize "
         "fails with EGL_NOT_INITIALIZED); update its driver, or "),
        ("PYOPENGL_PLATFORM=osmesa", ""),
    ],
)
def test_the_cause_is_named_where_nothing_draws(variable: str, message: str) -> None:
    code = "from gcbench.renderer.gl import Rasterizer; Rasterizer(64, 48).close()"
    name, _, value = variable.partition("=")
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, name: value},
                          capture_output=True, text=True)
    said = done.stderr.strip().splitlines() or [""]
    assert message in said[-1] and (done.returncode == 0) == (not message)


DEVICES = [
    EglDevice(2, None, "/dev/dri/card1", False, 1, "0000:65:00.0"),
    EglDevice(1, None, "/dev/dri/card0", False, None, "0001:0a:00.1"),
    EglDevice(3, None, None, False, 0),
    EglDevice(0, None, None, True),
]


@pytest.mark.parametrize(
    ("wanted", "numbers"),
    [("", [2, 1, 3, 0]), ("0", [0]), ("3", [3]), ("gpu", [2, 1, 3]), ("software", [0]),
     ("cuda:1", [2]), ("cuda:0", [3]), ("0000:65:00.0", [2]), ("65:00.0", [2]),
     ("0001:0A:00.1", [1]), ("0a:00.1", []), ("5:00.0", []), ("cuda:2", []), ("cuda", []),
     ("4", []), (".*", [])],
)
def test_a_device_is_chosen_by_any_of_its_names(wanted: str, numbers: list[int]) -> None:
    if numbers:
        assert [device.number for device in choose_devices(DEVICES, wanted)] == numbers
    else:
        with pytest.raises(NoRendererError, match="device 2: /dev/dri/card1, cuda:1, 0000:65:00"):
            choose_devices(DEVICES, wanted)


@pytest.mark.parametrize("wanted", ["gpu", "software", "0"])
def test_what_draws_is_what_was_chosen(wanted: str) -> None:
    devices = _load_egl()[1]
    assert [d.is_software for d in devices] == sorted(d.is_software for d in devices)
    code = "from gcbench.renderer.gl.context import GLContext; print(GLContext().renderer)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          env={**os.environ, "EGL_DEVICE_ID": wanted})
    meant = {d.is_software for d in devices if wanted in ("gpu", "software", str(d.number))
             and (wanted == "0" or d.is_software == (wanted == "software"))}
    if meant:
        assert {is_drawn_by_software(done.stdout)} == meant, done.stderr
    else:
        assert f"no EGL device is {wanted!r}" in done.stderr
