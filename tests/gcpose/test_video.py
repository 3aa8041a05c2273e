"""GC-Pose on a video file: frames, errors in one line, and a table that is right."""

from __future__ import annotations

import csv
import json
import struct
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from gcbench.__main__ import main
from gcbench.errors import ConfigError
from gcbench.gcpose.images import ImageSettings
from gcbench.gcpose.method import GCPose
from gcbench.gcpose.video import (
    VideoFrames,
    check_outputs,
    describe_joints,
    doubt_still_texture,
    draw_parts,
    explain_doubts,
    observe_video,
    read_frames,
    reliability,
    summarize_estimate,
    write_table,
)
from gcbench.renderer.types.observation import Estimate
from numpy.typing import NDArray

from ..support.moving_panel import with_shake
from ..support.ray_scenes import door, drawer, texture, with_passing_shadow


def write_video(path: Path, rgb: NDArray[np.uint8], fps: float = 10.0) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps,
                             (rgb.shape[2], rgb.shape[1]))
    for image in rgb:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path


def read_picture(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, np.uint8)


@pytest.fixture
def ramp(tmp_path: Path) -> Path:
    """A video of 30 frames that grow brighter by 8 grey levels each."""
    level = (10 + 8 * np.arange(30))[:, None, None, None]
    rgb = np.broadcast_to(level, (30, 960, 640, 3)).astype(np.uint8)
    return write_video(tmp_path / "ramp.mp4", rgb)


def opening_door() -> tuple[NDArray[np.uint8], list[str]]:
    """Images of a door that opens by 0.5 rad, and the options that tell its camera and axis."""
    seen = door(0.5)
    assert seen.rgb is not None and seen.axis_direction is not None
    large = [cv2.resize(i, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC) for i in seen.rgb]
    fov = 2 * np.degrees(np.arctan(seen.rgb.shape[1] / 2 / seen.intrinsics[1, 1]))
    axes = [f"{x:.5f}" for x in seen.axis_direction.ravel()]
    return np.stack(large).astype(np.uint8), ["--fov", f"{fov:.4f}", "--axes", *axes]


def test_a_door_in_a_video_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    write_video(tmp_path / "door.mp4", rgb)
    assert main(["estimate", "door.mp4", *options, "--picture", "door.png", "--quiet",
                 "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["table"] == "door.csv"
    true = np.degrees(0.5)
    assert found["joints"][0]["displacement"] == pytest.approx(true, abs=2.5)
    with Path("door.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == [str(t) for t in range(8)]
    assert float(rows[-1]["time"]) == pytest.approx(0.7)
    angle = [float(row["displacement"]) for row in rows]
    assert angle == pytest.approx(list(np.linspace(0, true, 8)), abs=2.5)
    assert read_picture(Path("door.png")).shape == (360, 720, 3)


@pytest.mark.ci
def test_the_command_asks_to_look_at_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    write_video(tmp_path / "door.mp4", rgb)
    assert main(["estimate", "door.mp4", *options]) == 0
    assert "door.mp4: look at door.png" in capsys.readouterr().err
    assert Path("door.png").exists()
    Path("door.png").unlink()
    assert main(["estimate", "door.mp4", *options, "--no-picture"]) == 0
    assert "look at" not in capsys.readouterr().err and not Path("door.png").exists()


def test_a_line_names_the_last_and_the_largest_displacement_and_the_reason() -> None:
    turn = np.radians([[0.0], [-31.3], [-0.13]])
    found = Estimate(turn, sigma=np.radians([[0], [1], [4]]), reliable=np.array([False]))
    joints = summarize_estimate(frames(), found, np.array([[0.0, 1, 0]]), ["revolute"], ["dark"])
    assert json.loads(json.dumps(joints))[0]["reason"] == "dark"
    assert describe_joints(joints) == [
        "joint 1: -0.13 deg at the last frame (largest: -31.30 deg at 1.00 s), standard deviation "
        "4.00 deg, not reliable: dark"]


@pytest.mark.ci
def test_a_drawer_in_a_video_slides_towards_the_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = drawer(0.2)
    assert seen.rgb is not None and seen.axis_direction is not None
    large = [cv2.resize(i, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC) for i in seen.rgb]
    write_video(tmp_path / "drawer.mp4", np.stack(large).astype(np.uint8))
    fov = 2 * np.degrees(np.arctan(seen.rgb.shape[1] / 2 / seen.intrinsics[1, 1]))
    assert main(["estimate", "drawer.mp4", "--fov", f"{fov:.4f}", "--types", "prismatic",
                 "--distance", "1.15", "--quiet", "--json"]) == 0
    joint = json.loads(capsys.readouterr().out)["joints"][0]
    assert joint["unit"] == "m" and joint["displacement"] == pytest.approx(0.2, abs=0.008)
    assert np.dot(joint["axis"], seen.axis_direction[0]) > np.cos(np.radians(3))
    with Path("drawer.csv").open() as file:
        rows = list(csv.DictReader(file))
    moved = [float(row["displacement"]) for row in rows]
    assert moved == pytest.approx(list(np.linspace(0, 0.2, 8)), abs=0.008)
    assert {row["unit"] for row in rows} == {"m"}


def test_a_video_in_which_nothing_moves_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    seen = drawer(0.0)
    assert seen.rgb is not None
    write_video(tmp_path / "still.mp4", np.repeat(seen.rgb[:1], 6, axis=0))
    for options in (["--fov", "40", "--types", "prismatic", "--distance", "1"],
                    ["--fov", "40", "--axes", "0", "1", "0"], ["--fov", "40"], []):
        assert main(["estimate", "still.mp4", *options, "--quiet"]) == 2
        assert "gcbench: nothing is seen to move; choose " in capsys.readouterr().err
        assert not Path("still.csv").exists()


@pytest.mark.ci
def test_a_camera_that_is_held_by_hand_is_told_and_its_motion_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    for name, largest in (("hand", 8.0), ("walk", 200.0)):
        write_video(tmp_path / f"{name}.mp4", with_shake(rgb, largest)[0])
    assert main(["estimate", "hand.mp4", *options, "--json"]) == 0
    said = capsys.readouterr()
    assert "hand.mp4: the camera moves, by up to " in said.err
    turn = json.loads(said.out)["joints"][0]["displacement"]
    assert turn == pytest.approx(np.degrees(0.5), abs=2.5)
    for quiet in ([], ["--quiet"]):
        assert main(["estimate", "walk.mp4", *options, *quiet]) == 2
        assert "the camera moves too much; put it on a stand" in capsys.readouterr().err
        assert not Path("walk.csv").exists()


@pytest.mark.ci
def test_what_no_straight_edges_show_must_be_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, (_, fov, *axes) = opening_door()
    write_video(tmp_path / "door.mp4", rgb)
    another = "--axes, or another --fov (without --fov, the edges may show it)"
    for options, missing in ((["--fov", fov], another), (axes, "--fov"), ([], "--fov")):
        assert main(["estimate", "door.mp4", *options]) == 2
        *_, last = capsys.readouterr().err.splitlines()
        assert last.startswith("gcbench: no straight edges show ")
        assert last.endswith(f"; give {missing}")
        assert not Path("door.csv").exists()


@pytest.mark.ci
def test_what_moves_beside_the_region_does_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    height, width = rgb.shape[1:3]
    rgb = np.pad(rgb, ((0, 0), (0, 0), (160, 160), (0, 0)), constant_values=90)
    pattern = texture(np.random.default_rng(4), height, 150)
    for t, image in enumerate(rgb):  # comes nearer
        grown = cv2.resize(pattern, None, fx=1 + 0.12 * t, fy=1 + 0.12 * t)
        top, left = (grown.shape[0] - height) // 2, (grown.shape[1] - 150) // 2
        image[10:-10, 5:155] = grown[top : top + height, left : left + 150][10:-10]
    write_video(tmp_path / "door.mp4", rgb)
    region = ["--region", "160", "0", str(width), str(height)]
    for used, reliable in (([], False), (region, True)):
        assert main(["estimate", "door.mp4", *options, *used, "--json"]) == 0
        joint = json.loads(capsys.readouterr().out)["joints"][0]
        assert joint["reliable"] == reliable and (joint["reason"] is None) == reliable
        assert joint["displacement"] == pytest.approx(np.degrees(0.5), abs=2.5)


@pytest.mark.ci
def test_a_still_camera_need_not_be_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The images show hardly more than the door: it looks as if the camera moved."""
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    write_video(tmp_path / "walk.mp4", with_shake(rgb, 200.0)[0])
    assert main(["estimate", "walk.mp4", *options, "--quiet"]) == 2
    assert "say so (--still)" in capsys.readouterr().err
    assert main(["estimate", "walk.mp4", *options, "--quiet", "--still"]) == 0


@pytest.mark.ci
def test_a_shadow_that_is_left_out_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, options = opening_door()
    write_video(tmp_path / "door.mp4", with_passing_shadow(rgb))
    assert main(["estimate", "door.mp4", *options, "--foreground", "network"]) == 0
    reason = "texture that stays where it is, as in a shadow, was left out of what seems to move"
    assert f", not reliable: {reason}" in capsys.readouterr().out
    assert main(["estimate", "door.mp4", *options, "--foreground", "network", "--quiet",
                 "--json"]) == 0
    assert reason in json.loads(capsys.readouterr().out)["joints"][0]["reason"]


def test_a_joint_that_is_not_reliable_has_one_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    method, seen = GCPose(foreground="background"), observe_video(frames(), 50)
    found = Estimate(np.zeros((3, 1)), reliable=np.array([False]))

    def reason(still_share: float = 0.0) -> str | None:
        return explain_doubts(method, seen, found, still_share)[0]

    assert explain_doubts(method, seen, replace(found, reliable=np.array([True])), 0.5) == [None]
    assert str(reason(0.5)).startswith("50% of the texture of what seems to move stays")
    assert reason() == "its standard deviation is large"
    motion = SimpleNamespace(is_sure=lambda _: False)
    monkeypatch.setattr(reliability, "find_camera_motion", lambda *_: motion)
    assert str(reason(0.5)).startswith("the camera moves, and its motion is not known well")


@pytest.mark.parametrize("dark", [1.0, 0.6])
def test_a_shadow_is_not_a_motion(dark: float) -> None:
    """A texture that keeps its place is told from one that moves, whatever the light."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (60, 160)), (0, 0), 2)
    texture = 128 + 40 * (texture - texture.mean()) / texture.std()
    wall, board = texture[:, :80], texture[:, 80:]
    light = np.linspace(1, dark, 8)
    rgb = np.stack([np.vstack([light[t] * wall, np.roll(board, 3 * t, axis=1)])
                    for t in range(8)]).clip(0, 255).astype(np.uint8)[..., None].repeat(3, -1)
    video = VideoFrames(rgb, np.arange(8), np.arange(8) / 10, (80, 120), (0, 0, 80, 120))
    moving, both = np.zeros((8, 120, 80), np.uint8), np.ones((8, 120, 80), np.uint8)
    moving[:, 64:] = 1
    for part, least, most in ((moving, 0.0, 0.05), (both, 0.4, 0.6)):
        found = Estimate(np.zeros((8, 1)), part=part, reliable=np.array([True]))
        doubted, share = doubt_still_texture(video, found, ImageSettings())
        assert least <= share <= most
        assert doubted.reliable is not None
        assert doubted.reliable.tolist() == [part is moving]


def test_black_bars_are_left_out(tmp_path: Path) -> None:
    rgb = np.full((6, 480, 1280, 3), 90, np.uint8)
    rgb[:, :40], rgb[:, 444:], rgb[:, :, :8] = 0, 0, 0
    video = read_frames(write_video(tmp_path / "film.mp4", rgb), 6, side=240)
    assert video.region == (8, 40, 1272, 404)
    assert video.rgb.shape == (6, 202, 636, 3) and (video.rgb > 60).all()
    whole = observe_video(replace(video, rgb=np.zeros((6, 240, 640, 3), np.uint8),
                                  region=(0, 0, 1280, 480)), 40.0)
    moved = whole.intrinsics - observe_video(video, 40.0).intrinsics
    assert moved[:2, 2] == pytest.approx([4, 20]) and moved[:, :2] == pytest.approx(0)
    chosen = read_frames(tmp_path / "film.mp4", 6, region=(0, 0, 1280, 480), side=240)
    assert chosen.rgb.shape == (6, 240, 640, 3)
    write_video(tmp_path / "black.mp4", np.zeros((4, 48, 64, 3), np.uint8))
    assert read_frames(tmp_path / "black.mp4", 4).rgb.shape == (4, 48, 64, 3)


def test_frames_are_evenly_spaced_and_reduced(ramp: Path) -> None:
    video = read_frames(ramp, 4)
    assert video.number.tolist() == [0, 10, 19, 29]
    assert video.times == pytest.approx([0, 1.0, 1.9, 2.9])
    assert video.rgb.shape == (4, 720, 480, 3)
    assert video.scale == pytest.approx([3 / 4, 3 / 4])
    assert video.rgb.mean(axis=(1, 2, 3)) == pytest.approx([10, 90, 162, 242], abs=4)
    assert read_frames(ramp, 100, 0.5, 1.0).number.tolist() == [5, 6, 7, 8, 9, 10]


def grow_box(data: bytes, names: str, more: bytes) -> bytes:
    """Return an MP4 file with more bytes at the end of the last of these nested boxes."""
    start, size, outermost = 0, 0, data.rindex(b"moov")
    for name in names.split():
        start = data.index(name.encode(), outermost) - 4
        size = struct.unpack_from(">I", data, start)[0]
        data = data[:start] + struct.pack(">I", size + len(more)) + data[start + 4 :]
    return data[: start + size] + more + data[start + size :]


def test_times_are_those_of_the_file(ramp: Path) -> None:
    """The first 10 frames of 30 last 0.1 s each, the others 0.05 s."""
    data = grow_box(ramp.read_bytes(), "moov trak mdia minf stbl stts", bytes(8))
    start = data.index(b"stts") + 4
    _, number, count, ticks = struct.unpack_from(">4I", data, start)
    assert (number, count) == (1, 30)
    varied = struct.pack(">6I", 0, 2, 10, ticks, 20, ticks // 2)
    ramp.write_bytes(data[:start] + varied + data[start + len(varied) :])
    video = read_frames(ramp, 30)
    assert video.times == pytest.approx(np.r_[np.arange(10) / 10, 1 + np.arange(20) / 20])
    part = read_frames(ramp, 30, 0.85, 1.2)
    assert part.number.tolist() == [9, 10, 11, 12, 13, 14]
    assert part.times == pytest.approx([0.9, 1.0, 1.05, 1.1, 1.15, 1.2])


@pytest.mark.parametrize(("wide", "high", "size"), [(2, 1, (1280, 960)), (1, 2, (320, 960))])
def test_pixels_are_made_square(ramp: Path, wide: int, high: int, size: tuple[int, int]) -> None:
    shape = struct.pack(">I4s2I", 16, b"pasp", wide, high)
    data = grow_box(ramp.read_bytes(), "moov trak mdia minf stbl stsd mp4v", shape)
    ramp.write_bytes(data)
    video = read_frames(ramp, 3, side=240)
    assert video.size == size
    assert video.scale == pytest.approx([240 / min(size)] * 2)


def test_what_cannot_be_read_is_an_error_of_one_line(ramp: Path, tmp_path: Path) -> None:
    text = tmp_path / "text.mp4"
    text.write_text("no video")
    for path, problem in ((tmp_path / "no.mp4", "no such file"), (text, "convert it to MP4"),
                          (tmp_path, r"is a folder; make a video of its images, .*ffmpeg -i %03d"),
                          (Path("https://example.org/door.mp4"), "download the video first"),
                          (write_video(tmp_path / "one.mp4", np.zeros((1, 48, 64, 3), np.uint8)),
                           "one.mp4: the video has one frame; two are needed")):
        with pytest.raises(ConfigError, match=problem):
            read_frames(path, 4)
    for start, end in ((np.nan, 1.0), (0.0, np.nan), (-1.0, 1.0), (2.0, 1.0), (np.inf, np.inf)):
        with pytest.raises(ConfigError, match="give 0 or more, the smaller one first"):
            read_frames(ramp, 4, start, end)
    with pytest.raises(ConfigError, match=r"has 1 frames between 2\.9 and 3 s; .* --start"):
        read_frames(ramp, 4, start=2.9)


@pytest.mark.parametrize(("options", "problem"), [
    (["--out", "no/a.csv"], "no/a.csv: its folder does not exist"),
    (["--picture", "no/a.png"], "no/a.png: its folder does not exist"),
    (["--out", "ramp.mp4"], "ramp.mp4: is the video"),
    (["--frames", "1"], "--frames 1: give 2 to 1000"),
    (["--types", "prismatic"], "a joint that slides needs --distance"),
    (["--types", "prismatic", "--distance", "0"], "--distance 0: give 0.01 to 1000 m"),
    (["--distance", "1"], "--distance is for joints that slide"),
    (["--types", "revolute", "revolute"], "--types names 2 joints; --axes has 1"),
    (["--out", "one.csv", "--picture", "./one.csv"], "one.csv: is named for two outputs"),
    (["--out", ".."], "..: is a folder; name a file"),
    (["--out", "/proc/a.csv"], "/proc/a.csv: cannot be written"),
    (["--out", "/dev/null"], "/dev/null: is no file that can be replaced"),
    (["--out", "own.csv"], "own.csv: exists, and is not of `gcbench estimate`; name another file ("
                           "--out)"),
    (["--picture", "own.png"], "own.png: exists, and is not of `gcbench estimate`"),
    (["--picture", "x.jpg"], "--picture x.jpg: give a name that ends in .png"),
    (["--picture", "x.png", "--no-picture"], "--picture and --no-picture: give one"),
    (["--region", "0", "0", "900"], "--region needs 4 numbers: U V WIDTH HEIGHT"),
    (["--axes", "0,1,0"], "--axes: give numbers with spaces and no commas: 0 1 0")])
def test_a_command_that_cannot_end_well_does_not_begin(
    ramp: Path, options: list[str], problem: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(ramp.parent)
    for name in ("own.csv", "own.png"):
        Path(name).write_text("mine")
    assert main(["estimate", ramp.name, "--fov", "40", "--axes", "0", "1", "0", *options]) == 2
    assert problem in capsys.readouterr().err
    assert not Path("ramp.csv").exists() and not Path("ramp.png").exists()
    assert Path("own.csv").read_text() == Path("own.png").read_text() == "mine"


@pytest.mark.parametrize(("options", "problem"), [
    (["--axes", "0", "1", "0", "1", "0", "0"], "several joints need --fov"),
    (["--types", "revolute", "revolute"], "give three numbers of --axes for each joint")])
def test_several_joints_need_their_axes_and_a_field_of_view(
    ramp: Path, options: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["estimate", str(ramp), *options]) == 2
    assert problem in capsys.readouterr().err


def test_outputs_of_an_earlier_estimate_are_replaced(tmp_path: Path) -> None:
    estimate = Estimate(np.zeros((3, 1)), part=np.zeros((3, 480, 640), np.uint8),
                        sigma=np.zeros((3, 1)))
    table, picture = tmp_path / "door.csv", tmp_path / "door.png"
    write_table(table, frames(), estimate, ["revolute"])
    draw_parts(picture, frames(), estimate)
    check_outputs(tmp_path / "door.mp4", table, picture)


@pytest.mark.parametrize("playlist", [
    "ffconcat version 1.0\nfile ramp.mp4\n",
    "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:2,\nramp.mp4\n#EXT-X-ENDLIST\n"])
def test_a_playlist_that_names_other_files_is_refused(ramp: Path, playlist: str) -> None:
    path = ramp.with_name("list.mp4")
    path.write_text(playlist)
    with pytest.raises(ConfigError, match="is not a video"):
        read_frames(path, 4)


def frames() -> VideoFrames:
    """Images of 1280 x 960 px that are reduced by two."""
    return VideoFrames(np.zeros((3, 480, 640, 3), np.uint8), np.arange(3), np.arange(3.0),
                       (1280, 960), (0, 0, 1280, 960))


def test_the_camera_and_the_base_are_those_of_the_reduced_images() -> None:
    seen = observe_video(frames(), 90, [0, -2, 0, 3, 0, 0], base=(800, 900))
    assert seen.intrinsics == pytest.approx(
        np.array([[240, 0, 319.5], [0, 240, 239.5], [0, 0, 1]]))
    assert seen.axis_direction == pytest.approx(np.array([[0, -1, 0], [1, 0, 0]]))
    assert seen.joint_types == ("revolute",) * 2
    assert seen.cam_from_world is not None
    pixel = seen.intrinsics @ seen.cam_from_world[:3, 3]
    assert pixel == pytest.approx([400, 450, 1])


def test_a_region_is_seen_by_the_camera_of_the_whole_images(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rgb = np.repeat(rng.integers(0, 255, (3, 60, 80, 3)), 16, axis=1).repeat(16, axis=2)
    path = write_video(tmp_path / "large.mp4", rgb.astype(np.uint8))
    whole = read_frames(path, 3)
    part = read_frames(path, 3, region=(320, 160, 640, 480), side=480)
    assert whole.rgb.shape == (3, 480, 640, 3) and part.rgb.shape == (3, 480, 640, 3)
    assert np.abs(part.rgb[:, ::2, ::2].astype(int) - whole.rgb[:, 80:320, 160:480]).mean() < 12
    one, two = (observe_video(v, 50, [0, -1, 0], base=(700, 300)) for v in (whole, part))
    ray = np.array([0.05, -0.04, 1.0])
    at, there = (o.intrinsics @ ray for o in (one, two))
    assert (at[:2] + 0.5) / whole.scale == pytest.approx(
        (there[:2] + 0.5) / part.scale + part.region[:2])
    assert one.cam_from_world is not None and two.cam_from_world is not None
    base = [o.intrinsics @ o.cam_from_world[:3, 3] for o in (one, two)]
    assert base[0][:2] / whole.scale == pytest.approx(base[1][:2] / part.scale + part.region[:2])
    for region in ((-1, 0, 64, 64), (0, 0, 1300, 64), (0, 0, 64, 8), (1270, 0, 64, 64)):
        with pytest.raises(ConfigError, match=r"--region .*, 1280 x 960 px"):
            read_frames(path, 3, region=region)


@pytest.mark.parametrize(("fov", "axes", "base", "problem"), [
    (0.0, [0, 1, 0], None, "--fov 0: "), (40, [0, 1], None, "--axes has 2 numbers"),
    (40, [0, 0, 0], None, "not 0 0 0"),
    (40, [0, np.nan, 0], None, "finite"), (40, [0, 1, 0], (1300, 5), "--base 1300 5 is outside"),
    (40, [0, 1, 0], (np.nan, 5), "--base nan 5")])
def test_values_out_of_range_are_errors(
    fov: float, axes: list[float], base: tuple[float, float] | None, problem: str
) -> None:
    with pytest.raises(ConfigError, match=problem):
        observe_video(frames(), fov, axes, base=base)


def test_a_picture_shows_each_part_in_its_color(tmp_path: Path) -> None:
    part = np.zeros((3, 480, 640), np.uint8)
    part[:, :240, :320], part[:, 240:, :320] = 1, 7
    estimate = Estimate(np.zeros((3, 7)), part=part)
    draw_parts(tmp_path / "parts.png", frames(), estimate)
    png = read_picture(tmp_path / "parts.png")
    assert png.shape == (480, 640, 3)
    first, seventh, still = png[60, 80], png[180, 80], png[60, 240]
    assert first.tolist() == [20, 30, 127]  # blue, green, red
    assert seventh.tolist() == [127, 80, 20]  # as the second: there are five colors
    assert still.tolist() == [0, 0, 0]
