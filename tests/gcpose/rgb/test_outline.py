"""Points on the outline, and how the outline of a round link and the edges of a door move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gcbench.gcpose.chain.articulation import Articulation
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.still_camera import VideoEvidence, appearance
from gcbench.gcpose.rgb.labels import sample_pixels
from gcbench.gcpose.rgb.measurements import measure_patches
from gcbench.gcpose.rgb.outline import (
    Outline,
    edges_near_outline,
    sample_outline,
    slide_of_edges,
    slide_of_outline,
    surfaces_at_outline,
)
from gcbench.gcpose.rgb.points import InverseDepthPoints, predict_places
from gcbench.gcpose.rgb.settings import RgbSettings
from gcbench.robots.geometry import pinhole

FOCAL = 600.0
INTRINSICS = np.array([[FOCAL, 0, 160], [0, FOCAL, 120], [0, 0, 1]], np.float64)


def bar(top: int, bottom: int) -> np.ndarray:
    """A foreground [240 320]: a bar across the image, rows `top` to `bottom` - 1."""
    rows = np.arange(240)[:, None] + np.zeros((1, 320), int)
    return (rows >= top) & (rows < bottom)


def test_outline_points_are_on_the_rim_one_for_each_cell() -> None:
    v, u = np.mgrid[:240, :320]
    disk = (u - 150) ** 2 + (v - 110) ** 2 < 60**2
    at = sample_outline(disk, 8)
    away = np.hypot(at[:, 0] - 150, at[:, 1] - 110)
    assert (np.abs(away - 59) < 1.5).all()
    assert 0.6 < len(at) * 8 / (2 * np.pi * 60) < 1.6
    assert len(np.unique(at // 8, axis=0)) == len(at)


def test_no_outline_where_the_foreground_leaves_the_image_or_is_empty() -> None:
    at = sample_outline(bar(100, 140), 10)
    assert set(at[:, 1]) == {100, 139}
    assert not len(sample_outline(np.zeros((40, 40), bool), 10))
    assert not len(sample_outline(np.ones((40, 40), bool), 10))


def test_surfaces_at_the_outline_face_outward_and_are_as_thick_as_the_link() -> None:
    moving = np.stack([bar(100, 140), bar(90, 150)])
    pixel = np.array([[80, 100], [200, 139], [120, 90], [120, 120]])
    on = np.array([True, True, True, False])
    outline = surfaces_at_outline(moving, INTRINSICS, np.array([0, 0, 1, 1]), pixel, on)
    ray = pinhole.pixel_rays(INTRINSICS, pixel)
    assert np.abs((outline.normal * ray)[on].sum(axis=1)).max() < 1e-9
    assert np.allclose(outline.normal[on, 1], [-1, 1, -1], atol=0.05)
    assert np.allclose(outline.radius[on] * FOCAL, [20, 20, 30], atol=1.5)
    assert not outline.normal[3].any()
    assert outline.radius[3] == 0


def turn_about(center: np.ndarray, angle: float) -> np.ndarray:
    """A turn [4 4] about a vertical axis through a point."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.eye(4)
    out[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    out[:3, 3] = center - out[:3, :3] @ center
    return out


def test_the_edges_of_a_door_are_apart_from_its_face() -> None:
    settings = RgbSettings()
    mixed, apart = (sample_pixels(upright_bar(2), (0, 1), 60, settings, outline=kind)
                    for kind in ("round", "edge"))
    assert mixed.outline.is_round and not apart.outline.is_round
    on = apart.outline.on
    assert on.any() and not on.all()
    assert not mixed.outline.edge_radius.any() and (apart.outline.edge_radius[on] > 0).all()
    for sampled, meet in ((mixed, True), (apart, False)):
        pair, on = sampled.neighbors.tocoo(), sampled.outline.on
        assert (on[pair.row] != on[pair.col]).any() == meet
        assert (sampled.frame[pair.row] == sampled.frame[pair.col]).all()
        assert (sampled.neighbors.diagonal() == 1).all()
    least = [s.pixel[~s.outline.on, 0].min() for s in (mixed, apart)]
    assert least == [144, 142]  # a face is followed nearer to its edge


@pytest.mark.parametrize("pivot", [(0.1, 0.0, 2.0), (-0.4, 0.0, 2.3)])
def test_the_outline_of_a_cylinder_stays_tangent_to_it(pivot: tuple[float, float, float]) -> None:
    center, radius = np.array([0.1, 0.0, 2.0]), 0.06

    def tangent(at: np.ndarray) -> float:  # column of the right outline of an upright cylinder
        return FOCAL * np.tan(np.arctan2(at[0], at[2]) + np.arcsin(radius / np.hypot(*at[[0, 2]])))

    motion = np.stack([turn_about(np.array(pivot), a) for a in np.radians([0, 10, 20, 40])])
    x = tangent(center) / FOCAL
    normal = np.array([1, 0, -x]) / np.hypot(1, x)
    surface = center + radius * normal
    ray, inverse_depth = surface / surface[2], np.array([1 / surface[2]])
    outline = Outline(
        np.ones(1, bool), normal[None], np.array([radius / surface[2]]), np.zeros(1))
    slide = slide_of_outline(outline, motion[None], ray[None], inverse_depth, INTRINSICS)
    moved = motion[:, :3, :3] @ surface + motion[:, :3, 3]
    carried = FOCAL * moved[:, 0] / moved[:, 2]
    exact = np.array([tangent(m[:3, :3] @ center + m[:3, 3]) for m in motion])
    assert np.abs(carried - exact)[2:].min() > 1.0  # the surface's own point leaves the outline
    assert np.abs(carried + slide[0, :, 0] - exact).max() < 0.05


def test_only_outlines_of_links_slide_as_those_of_a_cylinder() -> None:
    motion = np.stack([turn_about(np.array([0, 0, 2.0]), a) for a in (0.0, 0.5)])[None]
    ray, depth = np.array([[0.1, 0.0, 1.0]]), np.array([0.5])
    normal = np.array([[1, 0, -0.1]]) / np.hypot(1, 0.1)
    outline = replace(Outline.none(2), on=np.array([True, False]), normal=normal.repeat(2, axis=0),
                      radius=np.full(2, 0.03), edge_radius=np.full(2, 0.01))
    slide = slide_of_outline(outline, motion.repeat(2, axis=0), ray.repeat(2, axis=0),
                             depth.repeat(2), INTRINSICS)
    assert np.abs(slide[0, 1]).max() > 0.5 and not slide[1].any()


def test_edges_are_rounded_near_the_outline_only() -> None:
    pixel = np.array([[80, 100], [80, 104], [80, 119], [80, 95]])
    on = np.array([True, False, False, False])
    edges = edges_near_outline(np.stack([bar(100, 140), bar(90, 150)]), np.array([0, 0, 0, 1]),
                               pixel, on, 0.005, 15.0)
    away = np.array([1, 5, 20, 6])  # px, to the nearest pixel outside
    assert np.allclose(edges.edge_radius, 0.005 * np.maximum(0, 1 - away / 15), atol=2e-4)
    assert (edges.on == on).all() and not edges.is_round


@pytest.mark.parametrize("heading", [0.7, -1.2, 1.6])
def test_a_rounded_edge_moves_as_the_center_of_its_rounding(heading: float) -> None:
    """What is seen of the edge that is farthest from the hinge has a fixed normal."""
    hinge, width, radius = np.array([-0.1, 0.0, 1.5]), 0.4, 0.01
    outward = np.array([np.cos(heading), 0.0, np.sin(heading)])
    motion = np.stack([turn_about(hinge, a) for a in np.radians([0.0, 5.0, -8.0])])

    def column(at: np.ndarray) -> np.ndarray:
        return FOCAL * at[..., 0] / at[..., 2] + INTRINSICS[0, 2]

    edge = hinge + width * outward
    moved = [(motion @ np.append(at, 1.0))[:, :3] for at in (edge, edge - radius * outward)]
    rigid, seen = column(moved[0]), column(moved[1] + radius * outward)
    axis = np.array([0.0, 1.0, 0.0])
    place = np.stack([rigid, 0 * rigid], axis=1)[None]
    door = replace(Outline.none(1), edge_radius=np.array([radius]))
    slide = slide_of_edges(
        door, np.concatenate([axis, np.cross(hinge, axis)]), place, np.zeros(1, int), edge[None])
    assert np.abs(rigid - seen)[1:].max() > 0.2
    assert np.abs(rigid + slide[0, :, 0] - seen).max() < 0.2 * np.abs(rigid - seen).max()


def upright_bar(frames: int) -> VideoEvidence:
    """A plain bar in columns 140 to 179 of all frames."""
    columns = np.arange(320) + np.zeros((240, 1), int)
    moving = np.stack([(columns >= 140) & (columns < 180)] * frames)
    gray, image = np.full(moving.shape[1:], 128, np.float32), ImageSettings()
    none = np.zeros((*moving.shape, 3), np.float32)
    return VideoEvidence(
        (0, 0), INTRINSICS, moving, np.stack([gray] * frames),
        np.stack([appearance(gray, m, image) for m in moving]),
        none[1:, ..., :2], None, none, none, image)


def test_what_is_seen_of_a_rounded_edge_is_taken_for_more_motion() -> None:
    settings, video = RgbSettings(edge_radius=0.03), upright_bar(3)
    sampled = sample_pixels(video, (0,), 60, settings, outline="edge")
    on, one = sampled.outline.on, np.ones(len(sampled.frame))
    hinge, axis = np.array([0.0, 0.0, 1.4]), np.array([0.0, 1.0, 0.0])
    state = Articulation(
        np.concatenate([axis, np.cross(hinge, axis)])[None],
        np.array([[0.0], [0.02], [0.03]]), np.zeros(1, bool), np.array([-1]))
    points = replace(
        InverseDepthPoints.without_measurements(
            sampled.frame, sampled.ray, one.astype(np.int64), one), outline=sampled.outline)
    sharp = replace(points, outline=replace(sampled.outline, edge_radius=0 * one))
    places, seen = [], on[:, None] & np.array([False, True, True])
    for p in (points, sharp):
        found = measure_patches(video, state, p, 9.0, 2, settings)
        seen = seen & (found.place_information[..., 0, 0] > 1)
        places.append(found.place[..., 0])
    motion = predict_places(state, points, INTRINSICS)[..., 0]
    motion = motion - motion[:, :1]
    share = 0.03 * (1 - 1 / settings.edge_reach) / 0.4  # about: all points are 0.4 from the hinge
    assert seen.sum() > 20 and np.abs(share * motion[seen]).min() > 0.2
    assert np.abs((places[0] - places[1] - share * motion)[seen]).max() < 0.05


def test_a_round_bar_that_rolls_keeps_its_outline() -> None:
    """An upright bar turns about its own axis: the outline stays, the surface does not."""
    settings, video = RgbSettings(), upright_bar(3)
    sampled = sample_pixels(video, (0,), 60, settings, outline="round")
    on = sampled.outline.on
    column = sampled.pixel[:, 0]
    assert set(column[on]) == {140, 179}
    assert ((column[~on] >= 144) & (column[~on] <= 175)).all()  # no brightness at the rim
    middle, axis = np.array([-0.5 / FOCAL, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    before = 1 + (20 / FOCAL) ** 2  # inverse depth of the outline: it is nearer than the axis
    state = Articulation(
        np.concatenate([axis, np.cross(middle, axis)])[None],
        np.radians([[0.0], [15.0], [30.0]]), np.zeros(1, bool), np.array([-1]))
    one = np.ones(len(on))
    points = replace(
        InverseDepthPoints.without_measurements(
            sampled.frame, sampled.ray, one.astype(np.int64), before * one),
        outline=sampled.outline)
    flat = replace(points, outline=replace(sampled.outline, radius=0 * one))
    away = []
    for p in (points, flat):
        found = measure_patches(video, state, p, 6.0, 2, settings)
        assert (found.place_information[on, 1:, 0, 0] > 1).mean() > 0.5
        seen = found.place_information[..., 0, 0] > 1
        away.append(np.abs((found.place - predict_places(state, p, INTRINSICS))[seen][:, 0]))
    assert away[0].max() < 0.2
    assert away[1].max() > 2.0


def test_a_vague_outline_counts_less() -> None:
    """In the key frame or in the other one; brightness counts as before."""
    settings, video = RgbSettings(), upright_bar(3)
    sampled = sample_pixels(video, (0,), 60, settings, outline="round")
    on, column = sampled.outline.on, sampled.pixel[:, 0]
    still = Articulation(np.array([[0.0, 1.0, 0.0, -1.0, 0.0, 0.0]]), np.zeros((3, 1)),
                         np.zeros(1, bool), np.array([-1]))
    one = np.ones(len(on))
    points = replace(
        InverseDepthPoints.without_measurements(
            sampled.frame, sampled.ray, one.astype(np.int64), one), outline=sampled.outline)
    left = np.arange(320) < 160
    sharp = np.stack([np.broadcast_to(left | (t == 1), (240, 320)) for t in range(3)])
    sharp[0, :, 179] = True
    before, after = (
        measure_patches(v, still, points, 6.0, 2, settings).place_information[..., 0, 0]
        for v in (video, replace(video, sharp=sharp)))
    assert (before[on, 1:] > 1).mean() > 0.5
    vague = on & (column == 179)
    share = ImageSettings().vague_outline_share
    assert np.allclose(after[vague, 2], share * before[vague, 2])
    assert np.allclose(after[vague, 1], before[vague, 1])
    assert np.allclose(after[~vague], before[~vague])
    hidden = replace(video, sharp=sharp & (np.arange(320) != 179))
    start = measure_patches(hidden, still, points, 6.0, 2, settings).place_information[..., 0, 0]
    assert np.allclose(start[vague, 1:], share * before[vague, 1:])
