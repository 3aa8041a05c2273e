"""Optional truth: normals, coordinates, keypoints and tracks, each by its own law."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.renderer.dataset import codec, codes
from gcbench.renderer.dataset.reader import open_dataset
from gcbench.renderer.dataset.storage import SequenceWriter, open_sequence
from gcbench.renderer.generate.driver import render_dataset
from gcbench.renderer.generate.sequence_renderer import SequenceRenderer
from gcbench.renderer.scene.config import LAYERS, RenderConfig, resolve
from gcbench.renderer.show import annotations
from gcbench.renderer.show import colors as pictures
from gcbench.renderer.show.page import page_data
from gcbench.renderer.show.video import contact_sheet, write_gif
from gcbench.renderer.types.sequence import Sequence
from gcbench.renderer.verify.driver import verify_dataset, verify_sequence
from gcbench.robots.geometry import apply

from ...support import bent_bar
from ...support.gltf_maker import Maker
from ...support.gltf_maker import bent_bar as bend_gltf
from ..generate.test_render import CRANE, SMALL, write
from .test_deforming import angles, project, renderer

ALL = {"layers": LAYERS, "track_points": 60}
HALVES = {"foot": (0.15, 0.15, 0.05), "mast": (0.05, 0.05, 0.25), "boom": (0.3, 0.04, 0.04),
          "jib": (0.15, 0.025, 0.025)}
CENTERS = {"foot": (0, 0, 0.05), "mast": (0, 0, 0.3), "boom": (0.35, 0, 0), "jib": (0.2, 0, 0)}


def stored(opened: SequenceRenderer, folder: Path, index: int = 0) -> Sequence:
    """A sequence on disk and read back."""
    rendered = opened.render(index)
    box = rendered.coordinate_box
    with SequenceWriter(folder, index, rendered.depth_unit, box) as writer:
        for frame in rendered.frames:
            writer.add(frame)
        return open_sequence(writer.finish(*rendered.finish()))


def in_memory(s: Sequence) -> Sequence:
    """With arrays for stacks, to be changed."""
    names = ("rgb", "depth", "part", "flow", "flow_backward", "visibility", "normal", "coordinates")
    return replace(s, **{name: [*getattr(s, name)] for name in names})


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> Sequence:
    folder = tmp_path_factory.mktemp("crane")
    ranges = SMALL.randomization
    room = replace(ranges, background=replace(ranges.background, room=1.0))
    opened = SequenceRenderer(replace(SMALL, robot=write(folder, CRANE), randomization=room, **ALL))
    try:
        return in_memory(stored(opened, folder))
    finally:
        opened.close()


@pytest.fixture(scope="module")
def bar(tmp_path_factory: pytest.TempPathFactory) -> Sequence:
    model, ranges = bent_bar.bar(block=True), SMALL.randomization
    bare = replace(ranges, background=replace(ranges.background, room=0.0))
    with (pytest.MonkeyPatch.context() as patch,
          renderer(model, patch, randomization=bare, **ALL) as opened):
        return in_memory(stored(opened, tmp_path_factory.mktemp("bar")))


# -- what can be asked for --------------------------------------------------------------------


def test_an_unknown_layer_is_told_those_that_exist() -> None:
    with pytest.raises(GcbenchError, match="albedo: there are normal, coordinates, keypoints, tra"):
        resolve(RenderConfig(layers=("normal", "albedo")))
    with pytest.raises(GcbenchError, match="--track-points 0: give 1 to"):
        resolve(RenderConfig(track_points=0))


def test_the_order_of_layers_does_not_matter() -> None:
    config = RenderConfig(layers=("tracks", "normal", "tracks"))
    assert resolve(config) == resolve(replace(config, layers=("normal", "tracks")))


@pytest.mark.gl
def test_without_layers_nothing_is_stored_of_them(tmp_path: Path) -> None:
    opened = SequenceRenderer(replace(SMALL, robot=write(tmp_path, CRANE)))
    s = stored(opened, tmp_path)
    opened.close()
    assert s.normal is s.coordinates is s.state.track_world is s.state.keypoint_world is None
    assert s.meta.layers == () and s.frame(0).normal is None


# -- encodings --------------------------------------------------------------------------------


def test_normals_survive_their_encoding() -> None:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(20, 30, 3))
    normal = (normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32)
    normal[:2, :3] = np.eye(3)[:, None].repeat(2, 1).transpose(1, 0, 2) * [[[1]], [[-1]]]
    normal[3, 4:6] = np.nan
    back = codec.decode_normal(codec.encode_normal(normal), (30, 20), "here")
    np.testing.assert_array_equal(np.isnan(back), np.isnan(normal))
    assert np.nanmax(np.abs(back - normal)) <= 1 / 65534 + 1e-7


def test_coordinates_survive_their_encoding_within_half_a_step_of_the_box() -> None:
    rng = np.random.default_rng(0)
    box = np.array([[[-1, -2, 0.0], [1, 2, 0]], [[0.1, 0, 5], [0.2, 1, 6]]])
    part = rng.integers(0, 3, (20, 30)).astype(np.uint16)
    boxes = np.concatenate([np.full((1, 2, 3), np.nan), box])[part]
    share = rng.random((20, 30, 3))
    metres = (boxes[..., 0, :] + share * (boxes[..., 1, :] - boxes[..., 0, :])).astype(np.float32)
    png = codec.encode_coordinates(metres, part, box)
    back = codes.coordinates_in_boxes(codec.decode_shares(png, (30, 20), "here"), part, box)
    np.testing.assert_array_equal(np.isnan(back), np.isnan(metres))
    step = (boxes[..., 1, :] - boxes[..., 0, :]) / 65534
    assert np.nanmax(np.abs(back - metres) - step / 2) <= 1e-6


# -- laws -------------------------------------------------------------------------------------


@pytest.mark.gl
def test_normals_of_boxes_are_their_axes(crane: Sequence) -> None:
    for t in range(len(crane)):
        rotation = crane.state.world_from_part[t, :, :3, :3]
        rotation = crane.state.cam_from_world[t, :3, :3] @ rotation
        on = crane.part[t] > 0
        local = np.einsum("nji,nj->ni", rotation[crane.part[t][on] - 1], crane.normal[t][on])
        assert np.abs(np.sort(np.abs(local), axis=1) - [0, 0, 1]).max() < 1e-4
        room = (crane.part[t] == 0) & (crane.depth[t] > 0)  # its floor and walls, upright
        up = crane.normal[t][room] @ crane.state.cam_from_world[t, :3, 2]
        assert (np.minimum(np.abs(up), np.abs(np.abs(up) - 1)) < 1e-4).mean() > 0.9


@pytest.mark.gl
def test_coordinates_of_boxes_are_on_their_sides(crane: Sequence) -> None:
    names = crane.meta.part_names
    half, center = (np.array([d[n] for n in names], float) for d in (HALVES, CENTERS))
    np.testing.assert_allclose(crane.state.coordinate_box,
                               np.stack([center - half, center + half], axis=1), atol=1e-9)
    for t in range(len(crane)):
        on = crane.part[t] > 0
        p = crane.part[t][on] - 1
        side = np.abs(crane.coordinates[t][on] - center[p]) / half[p]
        np.testing.assert_allclose(side.max(axis=1), 1, atol=5e-5)
        assert np.isnan(crane.coordinates[t][~on]).all()


@pytest.mark.gl
def test_coordinates_of_what_bends_are_those_of_the_straight_bar(bar: Sequence) -> None:
    for t in range(len(bar)):
        v, u = np.nonzero(bar.part[t] > 0)
        local = bar.coordinates[t][v, u].astype(float)
        high = bar.part[t][v, u] == 2
        straight = local + np.where(high[:, None], bent_bar.HINGE, 0)
        skin = (np.abs(straight[:, 1:]) <= 0.0501).all(axis=1)  # the rigid block is above
        assert skin.sum() > 900 and (~skin).sum() > 100
        pixel, z = project(bar, t, bent_bar.bent(straight[skin], angles(bar)[t]))
        # A triangle of the bent bar is flat: its inside is off the closed form by the sagitta.
        error = np.linalg.norm(pixel - np.stack([u, v], 1)[skin], axis=1)
        assert np.quantile(error, 0.99) < 0.1 and error.max() < 0.5
        np.testing.assert_allclose(z, bar.depth[t][v, u][skin], atol=3e-3)


@pytest.mark.gl
def test_tracks_follow_the_bend(bar: Sequence) -> None:
    s, angle = bar.state, angles(bar)
    assert s.track_world.shape == (4, 60, 3)
    np.testing.assert_array_equal(np.bincount(s.track_query), [15] * 4)
    assert set(s.track_part) == {1, 2}
    checked = 0
    for n in range(60):
        t = int(s.track_query[n])
        u, v = np.rint(s.track_image[t, n]).astype(int)
        assert np.abs(s.track_image[t, n] - [u, v]).max() < 1e-6 and s.track_visible[t, n]
        straight = bar.coordinates[t][v, u] + (s.track_part[n] == 2) * bent_bar.HINGE
        if np.abs(straight[1:]).max() > 0.0501:
            continue
        checked += 1
        for other in range(4):
            there = bent_bar.bent(straight[None].astype(float), angle[other])
            world = apply(s.world_from_part[other, 0], there)[0]
            assert np.linalg.norm(world - s.track_world[other, n]) < 1e-3  # the sagitta
    assert checked > 40


@pytest.mark.gl
def test_keypoints_are_where_the_model_has_them(bar: Sequence) -> None:
    s, model = bar.state, bent_bar.bar()
    assert bar.meta.keypoint_names == ("foot", "tip")
    for t in range(4):
        expected = [apply(s.world_from_part[t, p], k[None])[0]
                    for p, k in zip(model.keypoint_part, model.keypoint, strict=True)]
        np.testing.assert_allclose(s.keypoint_world[t], expected, atol=1e-12)
        # They are on the upper side: seen if that is, and where nothing is before it.
        cam = apply(s.cam_from_world[t], s.keypoint_world[t])
        np.testing.assert_allclose(
            s.keypoint_image[t], (cam @ s.intrinsics.T)[:, :2] / cam[:, 2:], atol=1e-9)
    assert s.keypoint_visible.dtype == bool
    assert 0 < bar.meta.keypoint_tolerance < 0.05


@pytest.mark.gl
@pytest.mark.parametrize("name", ["crane", "bar"])
def test_layers_pass_verify_and_cover_what_they_say(
    name: str, request: pytest.FixtureRequest
) -> None:
    sequence = request.getfixturevalue(name)
    report = verify_sequence(sequence, bent_bar.bar(block=True) if name == "bar" else None)
    assert report.ok, report.table()
    samples = {c.name: c.samples for c in report.checks}
    for check in ("normal: unit", "normal: of the plane that depth makes",
                  "coordinates: kept where the flow leads"):
        assert samples[check] > 1000, check
    assert samples["track: visible"] == 60 * 4
    assert samples["track: goes with the flow"] > 60
    if name == "bar":
        assert samples["coordinates: of a triangle that is seen there"] > 1000
    if name == "crane":
        assert samples["normal: kept where the flow leads"] > 500
        assert samples["coordinates: of the point that depth tells"] > 1000
        assert samples["track: rides on its part"] == 60 * 4
        assert sequence.meta.asset["notes"][-1] == "the model has no keypoints: that layer is empty"
        assert sequence.state.keypoint_world.shape == (4, 0, 3)


@pytest.mark.gl
def test_layers_change_nothing_else(crane: Sequence, tmp_path: Path) -> None:
    ranges = SMALL.randomization
    room = replace(ranges, background=replace(ranges.background, room=1.0))
    opened = SequenceRenderer(replace(SMALL, robot=write(tmp_path, CRANE), randomization=room))
    plain = stored(opened, tmp_path)
    opened.close()
    for name in ("rgb", "depth", "part", "flow", "flow_backward", "visibility"):
        for a, b in zip(getattr(plain, name), getattr(crane, name), strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.gl
@pytest.mark.ci
def test_two_workers_write_what_one_writes(tmp_path: Path) -> None:
    config = replace(SMALL, robot=write(tmp_path, CRANE), frames=2, width=96, height=72, **ALL)
    for workers in (1, 2):
        render_dataset(config, 2, tmp_path / str(workers), workers, progress=False)
    for index in range(2):
        one, two = ((tmp_path / w / "sequences" / f"{index:06d}.zip").read_bytes() for w in "12")
        assert one == two
    dataset = open_dataset(tmp_path / "2")
    assert dataset[0].normal is not None and dataset[0].coordinates[0:1].shape == (1, 72, 96, 3)
    assert len(dataset[1].state.track_part) == 60


# -- what verify must find --------------------------------------------------------------------


def images(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Sequence], Sequence]:
    return lambda s: replace(s, **{name: [change(x.copy()) for x in getattr(s, name)]})


def state(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Sequence], Sequence]:
    return lambda s: replace(s, state=replace(s.state, **{
        name: change(getattr(s.state, name).copy()) for name, change in changes.items()}))


def tilted(normal: np.ndarray) -> np.ndarray:
    c, s = np.cos(0.15), np.sin(0.15)
    return normal @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])


def put(where: tuple[int, ...], value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(x: np.ndarray) -> np.ndarray:
        x[where] += value
        return x
    return change


CORRUPTIONS = {
    "normals turned": (images("normal", tilted), "normal: of the plane that depth makes"),
    "normals of OpenGL": (images("normal", lambda n: n * [1, -1, -1]),
                          "normal: towards the camera"),
    "normals of the world": (
        lambda s: images("normal", lambda n: n @ s.state.cam_from_world[0, :3, :3])(s),
        "normal: of the plane that depth makes"),
    "normals of the frame before": (
        lambda s: replace(s, normal=[s.normal[0], s.normal[2], s.normal[1], s.normal[3]]),
        "normal: kept where the flow leads"),
    "normals of parts turned, before a room": (
        lambda s: replace(s, normal=[np.where(part[..., None] > 0, tilted(normal), normal)
                                     for normal, part in zip(s.normal, s.part, strict=True)]),
        "normal: of the plane that depth makes on parts"),
    "normals not unit": (images("normal", lambda n: n * 1.001), "normal: unit"),
    "a normal lost": (images("normal", put((60, 80, 0), np.nan)),
                      "normal: known where it should be"),
    "coordinates shifted": (images("coordinates", lambda c: c + np.float32(1e-4)),
                            "coordinates: of the point that depth tells"),
    "coordinates of another frame": (
        lambda s: replace(s, coordinates=[*s.coordinates[1:], s.coordinates[0]]),
        "coordinates: known where it should be"),
    "coordinates of the background": (images("coordinates", np.nan_to_num),
                                      "coordinates: known where it should be"),
    "coordinates of another size": (images("coordinates", lambda c: c[:-1]), "image shapes"),
    "layer missing": (lambda s: replace(s, normal=None), "shapes"),
    "track in another part": (state(track_part=lambda p: p % 4 + 1), "track: begins on its part"),
    "track slides": (state(track_world=put((1, 5, 0), 1e-4)), "track: rides on its part"),
    "track image": (state(track_image=put((1, 5, 0), 1e-3)), "track: image of the world"),
    "all visible": (state(track_visible=np.ones_like), "track: visible"),
    "none visible": (state(track_visible=np.zeros_like), "track: visible"),
    "query frame": (state(track_query=lambda q: (q + 1) % 4), "track: begins at a pixel"),
    "track begins outside": (state(track_image=lambda x: x + 2.0**31),
                             "track: begins in the image"),
    "query beyond": (state(track_query=lambda q: q + 4), "track: query frames"),
    "track of no part": (state(track_part=put((5,), 99)), "track: part numbers"),
    "track unknown": (state(track_image=put((1, 5, 0), np.nan)), "track: known where it should be"),
    "track under the surface": (images("depth", lambda d: d - np.float32(2e-3)),
                                "track: begins on the surface"),
}


def in_pose_of_part(s: Sequence, t: int) -> np.ndarray:
    """Coordinates [H W 3] as if the parts were rigid: smooth, and right where nothing bends."""
    v, u = np.indices(s.depth[t].shape)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(s.state.intrinsics).T
    out = np.full(rays.shape, np.nan, np.float32)
    for p, pose in enumerate(s.state.cam_from_world[t] @ s.state.world_from_part[t]):
        mine = s.part[t] == p + 1
        out[mine] = apply(np.linalg.inv(pose), (rays * s.depth[t][..., None])[mine])
    return out


ON_THE_BAR = {
    "normals zero": (images("normal", np.nan_to_num), "normal: known where it should be"),
    "coordinates late": (
        lambda s: replace(s, coordinates=[s.coordinates[0], *s.coordinates[:-1]]),
        "coordinates: kept where the flow leads"),
    "coordinates shifted": (images("coordinates", lambda c: c + np.float32(2e-3)),
                            "coordinates: of a triangle that is seen there"),
    "coordinates of the bent bar": (
        lambda s: replace(s, coordinates=[in_pose_of_part(s, t) for t in range(4)]),
        "coordinates: of a triangle that is seen there"),
    "coordinates mirrored": (images("coordinates", lambda c: c * np.float32([1, -1, 1])),
                             "coordinates: of a triangle that is seen there"),
    "flow of the part": (
        lambda s: replace(s, flow=[f * np.float32(1.05) for f in s.flow]),
        "track: goes with the flow"),
    "flow back of the part": (
        lambda s: replace(s, flow_backward=[f * np.float32(1.05) for f in s.flow_backward]),
        "track: goes with the flow"),
    "keypoint slides": (state(keypoint_world=put((2, 1, 1), 1e-4)), "keypoint: rides on its part"),
    "keypoint elsewhere": (
        lambda s: state(keypoint_world=lambda w: w + 0.01 * np.take(
            s.state.world_from_part[..., :3, 0], s.state.keypoint_part - 1, 1))(s),
        "keypoint: where the model has it"),
    "keypoint image": (state(keypoint_image=put((2, 0, 1), 0.01)), "keypoint: image of the world"),
    "keypoint visibility": (state(keypoint_visible=np.logical_not), "keypoint: visible"),
    "keypoint unknown": (state(keypoint_image=put((2, 0, 1), np.nan)),
                         "keypoint: known where it should be"),
    "keypoint of no part": (state(keypoint_part=put((0,), -9)), "keypoint: part numbers"),
    "keypoint names": (
        lambda s: replace(s, meta=replace(s.meta, keypoint_names=("tip", "foot"))),
        "keypoints of the model"),
}


@pytest.mark.gl
@pytest.mark.parametrize("name", CORRUPTIONS)
def test_corruption_fails_its_check(crane: Sequence, name: str) -> None:
    corrupt, expected = CORRUPTIONS[name]
    report = verify_sequence(corrupt(crane))
    assert expected in report.failures, report.table()


@pytest.mark.gl
@pytest.mark.parametrize("name", ON_THE_BAR)
def test_corruption_of_what_deforms_fails_its_check(bar: Sequence, name: str) -> None:
    corrupt, expected = ON_THE_BAR[name]
    report = verify_sequence(corrupt(bar), bent_bar.bar(block=True))
    assert expected in report.failures, report.table()


@pytest.mark.gl
def test_verify_finds_wrong_coordinates_of_a_skin_on_disk(tmp_path: Path) -> None:
    """With nothing but the dataset and the model's file, which it poses itself."""
    maker = Maker()
    bend_gltf(maker)
    config = RenderConfig(robot=str(maker.save(tmp_path)), frames=3, width=160, height=120, seed=2,
                          layers=("coordinates",), keep_unobservable=True)
    render_dataset(config, 1, tmp_path / "d", workers=1, progress=False)
    name = "coordinates: of a triangle that is seen there"
    report = verify_dataset(tmp_path / "d", progress=False, allow_model=True)
    assert report.ok, report.table()
    assert {c.name: c.samples for c in report.checks}[name] > 1000
    path = tmp_path / "d" / "sequences" / "000000.zip"
    with zipfile.ZipFile(path) as archive:
        members = {member: archive.read(member) for member in archive.namelist()}
    image = cv2.imdecode(np.frombuffer(members["coordinates/000001.png"], np.uint8), -1)
    image[image > 0] = np.clip(image[image > 0].astype(int) + 400, 1, 65535)  # 0.6 % of the box
    members["coordinates/000001.png"] = cv2.imencode(".png", image)[1].tobytes()
    with zipfile.ZipFile(path, "w") as archive:
        for member, data in members.items():
            archive.writestr(member, data)
    assert name in verify_dataset(tmp_path / "d", progress=False, allow_model=True).failures


@pytest.mark.gl
def test_a_point_of_a_rigid_part_keeps_its_coordinates(crane: Sequence) -> None:
    """Coordinates in the pose of another frame are where the flow leads."""
    k, s = crane.state.intrinsics, crane.state
    cam_from_part = s.cam_from_world[:, None] @ s.world_from_part
    v, u = np.nonzero(crane.part[0] > 0)
    pose = cam_from_part[1][crane.part[0][v, u] - 1]
    there = np.einsum("nij,nj->ni", pose[:, :3, :3], crane.coordinates[0][v, u]) + pose[:, :3, 3]
    pixel = (there @ k.T)[:, :2] / there[:, 2:]
    error = np.linalg.norm(pixel - np.stack([u, v], 1) - crane.flow[0][v, u], axis=1)
    assert error.max() < 0.03


# -- what is shown ----------------------------------------------------------------------------


@pytest.mark.gl
def test_layers_are_shown(bar: Sequence, tmp_path: Path) -> None:
    data = page_data(bar)
    assert list(data["images"])[6:] == ["normal", "coordinates", "points"]
    for images in data["images"].values():
        assert len(images) == 4 and all(images[1:3])
    sheet = cv2.imread(str(contact_sheet(bar, tmp_path / "sheet.png")))
    plain = replace(bar, normal=None, coordinates=None, state=replace(
        bar.state, track_image=None, keypoint_image=None))
    assert list(page_data(plain)["images"]) == list(data["images"])[:6]
    less = cv2.imread(str(contact_sheet(plain, tmp_path / "plain.png")))
    assert sheet.shape[0] > 1.5 * less.shape[0] and sheet.shape[1] == less.shape[1]
    assert write_gif(bar, tmp_path / "film.gif").stat().st_size > 1000


def test_colours_of_normals_and_coordinates() -> None:
    normal = np.array([[[0, 0, -1], [1, 0, 0], [0, -1, 0], [np.nan] * 3]], np.float32)
    assert pictures.color_normals(normal)[0].tolist() == [
        [128, 128, 255], [255, 128, 128], [128, 255, 128], list(pictures.NO_VALUE)]
    box = np.array([[[0, 0, 0], [1, 2, 0.0]]])
    at = np.array([[[0, 2, 0], [1, 1, 0], [np.nan] * 3]], np.float32)
    shown = pictures.color_coordinates(at, np.array([[1, 1, 0]], np.uint16), box)
    assert shown[0].tolist() == [[0, 255, 0], [255, 128, 0], list(pictures.NO_VALUE)]


@pytest.mark.gl
def test_visible_points_are_dots_and_hidden_ones_rings(bar: Sequence) -> None:
    rgb = np.full((150, 200, 3), 200, np.uint8)
    state = replace(bar.state, keypoint_image=None, track_part=np.array([2]),
                    track_image=np.full((4, 1, 2), [[[50.0, 60.0]]]),
                    track_visible=np.array([[True], [False]] * 2))
    dot, ring = (annotations.draw_points(rgb, bar.meta, state, t) for t in (0, 1))
    color, pale = np.array(pictures.palette(2)[2], int), np.full(3, 218)

    def near(image: np.ndarray, u: int, to: np.ndarray) -> bool:
        return bool(np.abs(image[60, u] - to).max() < np.abs(color - pale).max() / 2)

    assert near(dot, 50, color) and near(dot, 51, color) and near(dot, 55, pale)
    assert near(ring, 48, color) and near(ring, 52, color) and near(ring, 55, pale)
    assert near(ring, 51, pale)
