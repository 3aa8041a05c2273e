"""What the pictures of `gcbench show` say is what the data say."""

from __future__ import annotations

import colorsys
import dataclasses
import io
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.__main__ import main
from gcbench.renderer.dataset.provenance import new_provenance, write_provenance
from gcbench.renderer.dataset.storage import SequenceWriter
from gcbench.renderer.scene.config import RenderConfig
from gcbench.renderer.show import colors as pictures
from gcbench.renderer.show import page, render_page
from gcbench.renderer.show import video as film
from gcbench.renderer.show.annotations import draw_axes, joint_axes
from gcbench.renderer.show.descriptions import joint_ranges, joint_table, sections
from gcbench.renderer.show.driver import show
from gcbench.renderer.show.labels import Labels, overlap
from gcbench.renderer.types.sequence import Sequence
from gcbench.robots.geometry.pinhole import project

from ...support.analytic import render
from ...test_cli import Lines, one_line
from ...test_cli_render import rendered


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    return shaded(render(width=160, height=120, frames=4))


def shaded(sequence: Sequence, **changes: object) -> Sequence:
    """With an RGB stack that is not black: parts in their colours, darker where they are far."""
    parts = len(sequence.meta.part_names)
    rgb = [(pictures.color_parts(p, parts) * np.clip(1.2 / np.maximum(z, 0.1), 0, 1)[..., None])
           .astype(np.uint8) for p, z in zip(sequence.part, sequence.depth, strict=True)]
    meta = dataclasses.replace(sequence.meta, **changes)
    return dataclasses.replace(sequence, rgb=rgb, meta=meta)


# ---- colours


def test_zero_flow_is_white_unknown_is_not() -> None:
    flow = np.zeros((2, 3, 2), np.float32)
    flow[1, 1] = np.nan
    image = pictures.color_flow(flow, 5.0)
    assert (image[0] == 255).all()
    assert tuple(image[1, 1]) == pictures.NO_VALUE


def test_flow_hue_is_direction_and_opposites_differ() -> None:
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    flow = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
    one, other = (pictures.color_flow(f, 1.0)[0] / 255.0 for f in (flow, -flow))
    hues = [[colorsys.rgb_to_hsv(*c)[0] for c in side] for side in (one, other)]
    apart = np.abs(np.subtract(*hues))
    assert np.minimum(apart, 1 - apart).min() > 0.25, "a quarter of the colour circle at least"
    weaker = pictures.color_flow(0.5 * flow, 1.0)[0] / 255.0
    hue = np.array([colorsys.rgb_to_hsv(*c)[0] for c in weaker])
    assert np.abs((hue - hues[0] + 0.5) % 1 - 0.5).max() < 0.01
    assert weaker.min() > one.min() - 1e-9, "weaker is paler"


@pytest.mark.parametrize(("u", "v", "color"), [
    (1, 0, (255, 0, 0)),  # Baker et al., figure 7: rightward is red,
    (0, 1, (255, 230, 0)),  # downward yellow,
])
def test_flow_colours_are_those_of_middlebury(u: int, v: int, color: tuple[int, ...]) -> None:
    got = pictures.color_flow(np.array([[[u, v]]], np.float32), 1.0)[0, 0]
    assert np.abs(got.astype(int) - color).max() < 25


def test_flow_wheel_agrees_with_flow_image() -> None:
    wheel = pictures.flow_wheel(65)
    assert tuple(wheel[32, 32]) == (255, 255, 255)
    right = pictures.color_flow(np.array([[[1.0, 0.0]]]), 1.0)[0, 0]
    assert tuple(wheel[32, 64]) == tuple(right)


def test_palette_colours_are_distinct_and_stable() -> None:
    colors = pictures.palette(40).astype(np.float32) / 255
    lab = cv2.cvtColor(colors[None], cv2.COLOR_RGB2Lab)[0]
    worst = min(np.linalg.norm(a - b) for a, b in itertools.combinations(lab, 2))
    assert worst > 10, "about four just noticeable differences"
    assert np.array_equal(pictures.palette(5), pictures.palette(40)[:6])
    assert pictures.palette(3000).shape == (3001, 3)
    assert pictures.palette(0).shape == (1, 3)


def test_depth_orders_and_marks_holes() -> None:
    image = pictures.color_depth(np.array([[0.0, 0.5, 1.0, 4.0, 9.0, np.nan]]), 0.5, 4.0)
    ramp = pictures.depth_colors()
    assert tuple(image[0, 0]) == tuple(image[0, 5]) == pictures.NO_VALUE
    assert np.array_equal(image[0, 1], ramp[255])
    assert np.array_equal(image[0, 3], ramp[0])
    assert np.array_equal(image[0, 4], ramp[0])


# ---- axes


def test_axis_projects_to_the_line_of_its_joint(sequence: Sequence) -> None:
    state = sequence.state
    for t in range(len(sequence)):
        axes = joint_axes(sequence.meta, state, t)
        assert [a.joint for a in axes] == [0, 1, 2]
        for axis in axes[:2]:
            # Independent: two points of the axis in the world, found from the moving part's motion
            # between two frames (the points that the motion leaves in place).
            parent, child = state.joint_parent_part[axis.joint], state.joint_child_part[axis.joint]
            relative = [np.linalg.inv(state.world_from_part[i, parent - 1])
                        @ state.world_from_part[i, child - 1] for i in (0, 1)]
            move = relative[1] @ np.linalg.inv(relative[0])
            point = np.linalg.lstsq(np.eye(3) - move[:3, :3], move[:3, 3], rcond=None)[0]
            turn = move[:3, :3] - move[:3, :3].T
            direction = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
            direction *= np.sign(state.joint_positions[1, axis.joint]
                                 - state.joint_positions[0, axis.joint])
            direction /= np.linalg.norm(direction)
            ends = np.stack([point, point + 0.1 * direction])
            cam = state.cam_from_world[t] @ state.world_from_part[t, parent - 1]
            a, b = project(state.intrinsics, ends @ cam[:3, :3].T + cam[:3, 3])[:, :2]
            along = (b - a) / np.linalg.norm(b - a)
            normal = np.array([-along[1], along[0]])
            for uv in (axis.tail, axis.point, axis.head):
                assert abs((np.array(uv) - a) @ normal) < 1e-6
            assert (np.array(axis.head) - axis.tail) @ along > 0


def test_prismatic_axis_passes_through_its_child(sequence: Sequence) -> None:
    state, axis = sequence.state, joint_axes(sequence.meta, sequence.state, 1)[2]
    origin = (state.cam_from_world[1] @ state.world_from_part[1, 3])[:3, 3]
    assert np.allclose(axis.point, project(state.intrinsics, origin)[:2])


def test_axis_is_cut_in_front_of_the_camera(sequence: Sequence) -> None:
    screw = sequence.state.joint_screw.copy()
    screw[:, 2, :3] = (0.02, 0, 1)  # straight through the camera's plane
    child = sequence.state.world_from_part.copy()
    child[1, 3] = np.linalg.inv(sequence.state.cam_from_world[1])
    child[1, 3, :3, 3] += child[1, 3, :3, 2] * 0.05  # 5 cm in front of the camera
    child[2, 3] = np.linalg.inv(sequence.state.cam_from_world[2])
    child[2, 3, :3, 3] -= child[2, 3, :3, 2]  # behind it
    state = dataclasses.replace(sequence.state, joint_screw=screw, world_from_part=child)
    axis = joint_axes(sequence.meta, state, 1)[2]
    assert np.isfinite([axis.tail, axis.head, axis.point]).all()
    assert [a.joint for a in joint_axes(sequence.meta, state, 2)] == [0, 1]
    assert draw_axes(sequence.rgb[1], sequence.meta, state, 1).shape == sequence.rgb[1].shape


@pytest.mark.parametrize("zoom", [1, 3])
def test_drawn_axis_is_where_it_projects_to(sequence: Sequence, zoom: int) -> None:
    paper = np.zeros((120 * zoom, 160 * zoom, 3), np.uint8)
    image = draw_axes(paper, sequence.meta, sequence.state, 0, scored_only=True)
    assert not paper.any(), "the argument is not drawn on"
    for axis in joint_axes(sequence.meta, sequence.state, 0)[:2]:
        color = pictures.palette(5)[sequence.state.joint_child_part[axis.joint]].astype(int)
        middle = 0.4 * np.array(axis.tail) + 0.6 * np.array(axis.point)
        u, v = np.rint((middle + 0.5) * zoom - 0.5).astype(int)
        assert np.abs(image[v, u] - color).max() < 60


def test_labels_cover_neither_each_other_nor_the_border() -> None:
    image = np.zeros((240, 320, 3), np.uint8)
    labels = Labels(image)
    for k in range(20):
        labels.write(f"vertebra_{k}_joint", (160 + k, 120 + k), (200, 0, 0))
    assert len(labels.taken) >= 12, "most find a place"
    assert not any(overlap(a, b) for a, b in itertools.combinations(labels.taken, 2))
    for left, top, right, bottom in labels.taken:
        assert 0 <= left < right <= 320
        assert 0 <= top < bottom <= 240
        assert (image[top + 1 : bottom - 1, left + 1 : right - 1] > 0).mean() > 0.6, "white paper"
    far = Labels(np.zeros((60, 80, 3), np.uint8))
    far.write("x" * 40, (500, -100))
    assert not far.taken, "a label that is wider than the picture"
    far.write("x", (500, -100))
    assert len(far.taken) == 1


# ---- page


def read_data(html: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    return json.loads(found[1])


def page_of(sequence: Sequence) -> str:
    return render_page(page.TEMPLATE, page.page_data(sequence))


def decoded(uri: str) -> np.ndarray:
    import base64

    code = np.frombuffer(base64.b64decode(uri.split(",", 1)[1]), np.uint8)
    return cv2.imdecode(code, cv2.IMREAD_UNCHANGED)


def test_page_holds_the_values_of_every_pixel(sequence: Sequence) -> None:
    data = read_data(page_of(sequence))
    assert data["grid"] == [160, 120]
    for t in range(len(sequence)):
        planes = decoded(data["values"][t]).reshape(13, 120, 160).astype(int)
        words = planes[1::2] * 256 + planes[2::2]
        frame = sequence.frame(t)
        assert np.abs(words[0] * data["depth"]["unit"] - frame.depth).max() \
            < data["depth"]["unit"]
        assert np.array_equal(words[1], frame.part)
        for k, flow in ((2, frame.flow), (4, frame.flow_backward)):
            if flow is None:
                assert not words[k:k + 2].any()
            else:
                got = np.moveaxis(words[k:k + 2] - 32768, 0, -1) * data["flow"]["unit"]
                assert np.nanmax(np.abs(got - flow)) <= data["flow"]["unit"] / 2 + 1e-4
        if frame.visibility is not None:
            assert np.array_equal(planes[0], frame.visibility)


def test_page_pictures_are_the_frames(sequence: Sequence) -> None:
    data = read_data(page_of(sequence))
    for t in range(len(sequence)):
        part = decoded(data["images"]["part"][t])[..., ::-1]
        assert np.array_equal(part, pictures.color_parts(sequence.part[t], 5))
        rgb = decoded(data["images"]["rgb"][t])[..., ::-1]
        assert np.abs(rgb.astype(int) - sequence.rgb[t]).mean() < 6
    assert data["images"]["flow"][-1] is None
    assert data["images"]["flow_backward"][0] is None


def test_hostile_names_stay_data(sequence: Sequence) -> None:
    bad = "</script><script>alert(1)</script><!-- & \u2028 \ud800"
    meta = dataclasses.replace(sequence.meta, name=bad, asset={bad: bad, "x": [float("nan")]},
                               part_names=(bad, *sequence.meta.part_names[1:]))
    html = page_of(dataclasses.replace(sequence, meta=meta))
    html.encode()
    assert html.count("</script>") == 2
    assert "alert(1)</" not in html
    data = read_data(html)
    assert data["name"] == bad
    assert data["parts"][0]["name"] == bad


def test_page_is_bounded_and_says_so() -> None:
    assert page.picture_size(320, 240, 15) == (320, 240)
    assert page.picture_size(1280, 960, 15) == (640, 480)
    assert page.picture_size(480, 1280, 15) == (240, 640)
    for width, height, frames in ((640, 480, 120), (4000, 3000, 90)):
        w, h = page.picture_size(width, height, frames)
        assert w * h * frames <= 1.02 * page.PAGE_PIXELS
    frames = page.select_frames(5000)
    assert len(frames) == page.PAGE_FRAMES
    assert frames[0] == 0
    assert frames[-1] == 4999
    assert list(page.select_frames(1)) == [0]


def test_sampling_picks_pixels_and_never_mixes() -> None:
    part = np.arange(12).reshape(3, 4)
    assert np.array_equal(page.resample(part, 4, 3), part)
    assert np.array_equal(page.resample(part, 2, 1), [[5, 7]])


def test_one_frame_without_surface_or_joint(sequence: Sequence) -> None:
    meta = dataclasses.replace(
        sequence.meta, frames=1, joint_names=(), joint_types=(), joint_limits=(),
        scored_joints=(), observability={})
    s = sequence.state
    none = np.zeros(0, np.int64)
    state = dataclasses.replace(
        s, times=s.times[:1], joint_positions=np.zeros((1, 0)), cam_from_world=s.cam_from_world[:1],
        world_from_part=s.world_from_part[:1], joint_screw=np.zeros((1, 0, 6)),
        joint_parent_part=none, joint_child_part=none, part_pixels=s.part_pixels[:1] * 0)
    lone = Sequence(meta, state, sequence.rgb[:1], [np.zeros((120, 160), np.float32)],
                    [np.zeros((120, 160), np.uint16)], [], [], [])
    data = read_data(page_of(lone))
    assert data["depth"]["near"] < data["depth"]["far"]
    assert set(data["images"]) == {"rgb", "depth", "part"}, "no pane that is always empty"
    assert next(film.film_frames(lone)).ndim == 3


# ---- tables


def test_tables_tell_units_and_observability(sequence: Sequence) -> None:
    table = joint_table(sequence.meta, sequence.state)
    rows = {row[0]: dict(zip(table["head"], row, strict=True)) for row in table["rows"]}
    assert list(rows) == ["pan", "lift", "slide"]
    assert rows["pan"]["total"] == f"{np.degrees(0.3):.1f}°"
    assert rows["slide"]["limits"] == "-0.1000 m … 0.3000 m"
    assert rows["pan"]["limits"] == "none"
    assert rows["lift"]["parent → child"] == "turret → upper"
    assert rows["lift"]["least unoccluded share"] == "0.8"
    assert rows["slide"]["fewest pixels"] == "–"
    by_title = {s["title"]: s for s in sections(sequence.meta, sequence.state)}
    assert ("observable", "yes") in by_title["Observability"]["rows"]
    assert dict(by_title["Camera"]["rows"])["moves"] == "no"


# ---- files


def test_sheet_gif_and_mp4_can_be_read_back(sequence: Sequence, tmp_path: Path) -> None:
    sheet = cv2.imread(str(film.contact_sheet(sequence, tmp_path / "one.png")))
    assert sheet is not None
    title = 20  # one line: robot, seed and the ranges of two joints
    assert sheet.shape == (title + 10 + 4 * 150, 10 + 3 * 170, 3), "the last frame has no flow"
    many = cv2.imread(str(film.contact_sheet([sequence] * 120, tmp_path / "many.png")))
    assert many is not None
    assert many.shape[:2] == (10 + 10 * 190, 10 + 10 * 170), "a hundred of them"

    pillow = pytest.importorskip("PIL.Image")
    gif = film.write_gif(sequence, tmp_path / "film.gif")
    with pillow.open(io.BytesIO(gif.read_bytes())) as image:
        assert image.n_frames == len(sequence)
        assert image.info["duration"] == 500
        first = np.asarray(image.convert("RGB")).astype(int)
    wanted = next(film.film_frames(sequence)).astype(int)
    assert np.abs(first - wanted).mean() < 6

    video = cv2.VideoCapture(str(film.write_mp4(sequence, tmp_path / "film.mp4")))
    shapes = []
    while (got := video.read())[0]:
        shapes.append(got[1].shape)
    assert shapes == [wanted.shape] * len(sequence)
    assert sorted(p.name for p in tmp_path.iterdir()) \
        == ["film.gif", "film.mp4", "many.png", "one.png"], "no temporary file is left"


@pytest.mark.parametrize("spacing", [1e3, 1e11])
def test_films_of_slow_videos_are_shortened(
    sequence: Sequence, tmp_path: Path, spacing: float
) -> None:
    """A GIF counts hundredths of a second in 16 bits, and OpenCV refuses less than 0.002 fps."""
    times = np.arange(len(sequence)) * spacing
    slow = dataclasses.replace(sequence, state=dataclasses.replace(sequence.state, times=times))
    pillow = pytest.importorskip("PIL.Image")
    with pillow.open(film.write_gif(slow, tmp_path / "film.gif")) as image:
        assert image.info["duration"] == 500_000
    video = cv2.VideoCapture(str(film.write_mp4(slow, tmp_path / "film.mp4")))
    assert video.get(cv2.CAP_PROP_FPS) == 0.002


@pytest.fixture
def dataset(sequence: Sequence, tmp_path: Path) -> Path:
    """With sequences 0 and 2."""
    folder = tmp_path / "dataset"
    for index in (0, 2):
        with SequenceWriter(folder, index) as writer:
            for frame in sequence:
                writer.add(frame)
            name = f"{index:06d}"
            writer.finish(dataclasses.replace(sequence.meta, name=name, index=index),
                          sequence.state)
    write_provenance(
        folder, dataclasses.replace(new_provenance(RenderConfig()), counts={"sequences": 2}))
    return folder


def test_show_of_a_dataset_and_of_a_file(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert show(dataset, index=2) == [Path("000002.html")]
    assert read_data(Path("000002.html").read_text())["name"] == "000002"
    assert show(dataset / "sequences" / "000000.zip", gif="a.gif") == [Path("a.gif")]
    assert not Path("000000.html").exists(), "only what was asked for"
    written = show(dataset, out="a.html", contact_sheet="a.png", mp4="a.mp4")
    assert written == [Path("a.html"), Path("a.png"), Path("a.mp4")]
    sheet = cv2.imread("a.png")
    assert sheet is not None
    assert sheet.shape[1] == 10 + 2 * 170, "two sequences side by side"
    for absent in (1, "1", "3-9"):
        with pytest.raises(GcbenchError, match=r"no sequence .*; there are 2 from 000000 to"):
            show(dataset, index=absent)


def test_pages_of_the_current_folder_are_beside_it(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_provenance(dataset, new_provenance(RenderConfig()))
    monkeypatch.chdir(dataset)
    assert show(".") == [tmp_path / "dataset-show" / "index.html"]
    assert show(".", index=2) == [tmp_path / "000002.html"]
    assert sorted(p.name for p in dataset.iterdir()) == ["dataset.json", "sequences"]
    warning = "is not finished (its run has not ended); run the same gcbench render command again\n"
    assert capsys.readouterr().err.count(warning) == 2


def test_show_of_some_sequences(dataset: Path, tmp_path: Path) -> None:
    sheet, page_file = tmp_path / "a.png", tmp_path / "a.html"
    show(dataset, page_file, sheet, index="1-2")
    assert read_data(page_file.read_text())["name"] == "000002", "the first of them"
    picture = cv2.imread(str(sheet))
    assert picture is not None
    assert picture.shape[1] == 10 + 170, "one sequence"
    with pytest.raises(GcbenchError, match="no dataset"):
        show(dataset / "sequences/000000.zip", page_file, index="0")


def test_captions_tell_robot_seed_and_joint_ranges(sequence: Sequence, tmp_path: Path) -> None:
    assert joint_ranges(sequence.meta, sequence.state) == [
        f"pan {np.degrees(sequence.state.joint_positions[0, 0]):.1f} to "
        f"{np.degrees(sequence.state.joint_positions[-1, 0]):.1f} deg",
        f"lift {np.degrees(sequence.state.joint_positions[-1, 1]):.1f} to "
        f"{np.degrees(sequence.state.joint_positions[0, 1]):.1f} deg"]

    def sheet(**changes: Any) -> bytes:
        meta = dataclasses.replace(sequence.meta, **changes)
        shown = dataclasses.replace(sequence, meta=meta)
        return b"".join(film.contact_sheet(chosen, tmp_path / "a.png").read_bytes()
                        for chosen in (shown, [shown]))

    variants = [{}, {"seed": 5}, {"asset": {"name": "other"}}, {"asset": {"instance": "oven:3"}},
                {"scored_joints": ()}, {"scored_joints": ("slide",)}]
    assert len({sheet(**changes) for changes in variants}) == len(variants)


@pytest.mark.parametrize(("suffix", "start"), [
    (".png", b"\x89PNG"), (".JPG", b"\xff\xd8"), (".jpeg", b"\xff\xd8"), (".webp", b"RIFF")])
def test_a_sheet_has_the_format_of_its_suffix(
    sequence: Sequence, tmp_path: Path, suffix: str, start: bytes
) -> None:
    assert film.contact_sheet(sequence, tmp_path / f"a{suffix}").read_bytes().startswith(start)


@pytest.mark.ci
def test_a_full_disk_leaves_no_part_of_a_file(dataset: Path, tmp_path: Path) -> None:
    """The limit of a file's size stands for the disk."""
    code = """
import resource, sys
from gcbench.__main__ import main
resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))
sys.exit(main(sys.argv[1:]))
"""
    out = tmp_path / "new"
    out.mkdir()
    for option in ("--out=a.html", "--out=pages", "--contact-sheet=a.png", "--gif=a.gif",
                   "--mp4=a.mp4"):
        command = [sys.executable, "-c", code, "show", str(dataset), option]
        done = subprocess.run(command, cwd=out, capture_output=True, text=True)
        assert done.returncode == 2, option
        (line,) = [x for x in done.stderr.splitlines() if x.startswith("gcbench: ")]
        assert re.match("gcbench: cannot write (a[.]|pages/0)", line), line
        assert "Traceback" not in done.stderr
        assert not list(out.iterdir())


def test_failures_name_what_to_mend(sequence: Sequence, tmp_path: Path) -> None:
    with pytest.raises(GcbenchError, match="cannot write"):
        page.write_page(sequence, tmp_path / "none" / "page.html")
    with pytest.raises(GcbenchError, match="cannot write"):
        film.write_mp4(sequence, tmp_path / "none" / "film.mp4")
    with pytest.raises(GcbenchError, match=r"ends in \.mp4"):
        film.write_mp4(sequence, tmp_path / "film.avi")
    for write, name in ((film.contact_sheet, "sheet.bmp"), (film.write_gif, "film.mp4")):
        with pytest.raises(GcbenchError, match=r"give a name that ends in \.(png|gif)"):
            write(sequence, tmp_path / name)
    with pytest.raises(GcbenchError, match="no sequence yet"):
        film.contact_sheet([], tmp_path / "sheet.png")
    with pytest.raises(GcbenchError):
        show(tmp_path / "nothing.zip")
    assert not list(tmp_path.iterdir())


def test_page_replaces_a_file_whole(sequence: Sequence, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    out.write_text("old")
    assert page.write_page(sequence, out) == out
    assert out.read_text().startswith("<!doctype html>")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]


# ---- the command


@pytest.mark.gl
def test_show_writes_what_is_asked_for(
    tmp_path: Path, capsys: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered(tmp_path / "out")
    capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    args = ["show", "out", "--index", "1", "--out", "a.html", "--contact-sheet", "a.png"]
    assert main([*args, "--gif", "a.gif", "--mp4", "a.mp4", "--open"]) == 0
    assert capsys.readouterr().out.split() == ["a.html", "a.png", "a.gif", "a.mp4"]
    assert Path("a.gif").read_bytes()[:3] == b"GIF"
    assert Path("a.mp4").read_bytes()[4:8] == b"ftyp"
    assert opened == [(tmp_path / "a.html").as_uri()]
    assert main(["show", "out", "--index", "0"]) == 0
    assert capsys.readouterr().out.split() == ["ur5_7_000000.html"]
    assert main(["show", "out"]) == 0
    assert capsys.readouterr().out.split() == ["out-show/index.html"]
    data = read_data(Path("out-show/000001.html").read_text())
    assert len(data["space"]["meshes"]) > 5, "the surfaces of the arm"
    assert data["space"]["reason"] == ""
    assert main(["show", "out", "--index", "9"]) == 2
    assert "000000 to 000001" in one_line(capsys)


@pytest.mark.parametrize(("options", "message"), [
    (("--index", "3", "--sequences", "0-9"), "--index and --sequences exclude each other"),
    (("--index", "0", "--sequences", "0"), "--index and --sequences exclude each other"),
    (("--index", "-1"), "--index -1: give the number of a sequence"),
])
def test_options_that_name_no_sequence_are_refused(
    dataset: Path, options: tuple[str, ...], message: str, capsys: Lines
) -> None:
    assert main(["show", str(dataset), *options]) == 2
    assert message in one_line(capsys)
