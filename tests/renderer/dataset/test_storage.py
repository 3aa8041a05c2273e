"""What is written comes back within the encodings' bounds; what is broken says where."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import pickle
import re
import struct
import subprocess
import sys
import time
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.renderer.dataset import codec, codes
from gcbench.renderer.dataset.png_reader import read_png
from gcbench.renderer.dataset.png_writer import PngFilter, write_png
from gcbench.renderer.dataset.state_arrays import dump_state, parse_state
from gcbench.renderer.dataset.storage import SequenceWriter, open_sequence
from gcbench.renderer.types.sequence import Frame, Meta, State

T, H, W = 4, 24, 32


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "support"))
    import fake_source

    return fake_source


@pytest.fixture
def content(fake: ModuleType) -> tuple[list[Frame], Meta, State]:
    rng = np.random.default_rng(0)
    return fake.make_frames(rng, T, H, W), fake.make_meta(T, H, W), fake.make_state(rng, T)


def write(folder: Path, content: tuple[list[Frame], Meta, State]) -> Path:
    frames, meta, state = content
    with SequenceWriter(folder, meta.index, meta.depth_unit) as writer:
        for frame in frames:
            writer.add(frame)
        return writer.finish(meta, state)


@pytest.fixture
def path(tmp_path: Path, content: tuple[list[Frame], Meta, State]) -> Path:
    return write(tmp_path, content)


# -- round trips ------------------------------------------------------------------------------


def same_sequence(path: Path, content: tuple[list[Frame], Meta, State]) -> None:
    frames, meta, state = content
    sequence = open_sequence(path)
    assert len(sequence) == T
    for field in fields(Meta):
        if field.name != "units":
            assert getattr(sequence.meta, field.name) == getattr(meta, field.name), field.name
    for field in fields(State):
        assert np.array_equal(getattr(sequence.state, field.name), getattr(state, field.name))
    for t, (a, b) in enumerate(zip(sequence, frames, strict=True)):
        assert np.array_equal(a.rgb, b.rgb)
        assert np.array_equal(a.part, b.part)
        assert a.part.dtype == np.uint16
        assert np.abs(a.depth - b.depth).max() <= 0.5 * meta.depth_unit * (1 + 1e-2)
        for mine, its in ((a.flow, b.flow), (a.flow_backward, b.flow_backward)):
            assert (mine is None) == (its is None)
            if mine is not None and its is not None:
                assert mine.dtype == np.float32
                assert np.array_equal(np.isnan(mine), np.isnan(its))
                assert np.nanmax(np.abs(mine - its)) <= 0.5 / 64
        assert (a.visibility is None) == (t == T - 1)
        if a.visibility is not None and b.visibility is not None:
            assert np.array_equal(a.visibility, b.visibility)


def test_a_sequence_comes_back(path: Path, content: tuple[list[Frame], Meta, State]) -> None:
    assert path.name == "000000.zip"
    same_sequence(path, content)


def test_an_unpacked_folder_is_the_same(
    path: Path, tmp_path: Path, content: tuple[list[Frame], Meta, State]
) -> None:
    with zipfile.ZipFile(path) as archive:
        assert {i.compress_type for i in archive.infolist()} == {zipfile.ZIP_STORED}
        archive.extractall(tmp_path / "unpacked")
    same_sequence(tmp_path / "unpacked", content)


def test_numpy_alone_reads_the_state(path: Path, content: tuple[list[Frame], Meta, State]) -> None:
    with zipfile.ZipFile(path) as archive, archive.open("state.npz") as file:
        arrays = np.load(file, allow_pickle=False)
        assert np.array_equal(arrays["joint_screw"], content[2].joint_screw)
        assert arrays["part_pixels"].dtype == np.int64
        assert json.loads(archive.read("meta.json"))["units"]["length"] == "m"


def test_equal_sequences_are_equal_bytes(
    tmp_path: Path, content: tuple[list[Frame], Meta, State]
) -> None:
    a, b = write(tmp_path / "a", content), write(tmp_path / "b", content)
    assert a.read_bytes() == b.read_bytes()


def test_a_stack_is_indexed_like_an_array(path: Path) -> None:
    flow = open_sequence(path).flow
    stacked = np.asarray(flow)
    assert stacked.shape == (T - 1, H, W, 2)
    assert np.array_equal(flow[-1], stacked[-1], equal_nan=True)
    assert np.array_equal(flow[::2], stacked[::2], equal_nan=True)
    assert flow[5:].shape == (0, H, W, 2)
    assert np.array_equal(np.stack(list(flow)), stacked, equal_nan=True)
    with pytest.raises(IndexError):
        flow[T - 1]
    again = pickle.loads(pickle.dumps(open_sequence(path)))
    assert np.array_equal(again.flow[0], stacked[0], equal_nan=True)


def test_one_frame_has_no_flow(tmp_path: Path, fake: ModuleType) -> None:
    rng = np.random.default_rng(0)
    content = fake.make_frames(rng, 1, H, W), fake.make_meta(1, H, W), fake.make_state(rng, 1)
    sequence = open_sequence(write(tmp_path, content))
    assert len(sequence.flow) == len(sequence.visibility) == 0
    assert sequence.frame(0).flow is None


# -- the encodings ----------------------------------------------------------------------------


def parse_png(png: bytes) -> np.ndarray[Any, Any]:
    """An independent PNG decoder: [H W channels], in the file's own channel order."""
    width, height, bits, kind = struct.unpack(">IIBB", png[16:26])
    channels, stride = (3 if kind == 2 else 1), bits // 8
    at, packed = 8, b""
    while at < len(png):
        length, name = struct.unpack_from(">I4s", png, at)
        packed += png[at + 8 : at + 8 + length] if name == b"IDAT" else b""
        at += 12 + length
    step = channels * stride
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + width * step)
    out = np.zeros((height + 1, (width + 1) * step), np.int64)
    for y, row in enumerate(rows):
        for x in range(width * step):
            left, up, corner = out[y + 1, x], out[y, x + step], out[y, x]
            p = left + up - corner
            paeth = min((left, up, corner), key=lambda v: abs(int(p) - int(v)))
            guess = (0, left, up, (left + up) // 2, paeth)[row[0]]
            out[y + 1, x + step] = (int(row[1 + x]) + int(guess)) % 256
    plain = out[1:, step:].astype(np.uint8).reshape(height, width, channels, stride)
    return plain.view(f">u{stride}")[..., 0].astype(np.uint16)


def test_flow_is_kitti_in_the_order_of_the_file() -> None:
    flow = np.full((3, 4, 2), np.nan, np.float32)
    flow[0] = [3.0, -2.0]
    flow[1, 0] = [511.98, -511.98]
    flow[1, 1] = [512.0, 0.0]
    flow[1, 2] = [0.0, -600.0]
    flow[1, 3] = [np.inf, 1.0]
    raw = parse_png(codec.encode_flow(flow))
    assert raw[0, 0].tolist() == [64 * 3 + 32768, -64 * 2 + 32768, 1]  # red u, green v, blue valid
    assert raw[1, 0].tolist() == [32768 + 32767, 32768 - 32767, 1]
    assert not raw[1, 1:].any()
    assert not raw[2].any()
    decoded = codec.decode_flow(codec.encode_flow(flow), (4, 3), "here")
    assert np.isnan(decoded[2]).all()
    assert decoded[0, 0].tolist() == [3.0, -2.0]


def test_flow_is_rounded_not_truncated() -> None:
    values = np.linspace(-511.98, 511.98, 24 * 64, dtype=np.float32)
    flow = np.stack([values, -values], -1).reshape(24, 64, 2)
    raw = parse_png(codec.encode_flow(flow))
    assert np.array_equal(raw[..., 0], np.rint(64.0 * flow[..., 0].astype(float)) + 32768)
    assert np.abs(codec.decode_flow(codec.encode_flow(flow), (64, 24), "") - flow).max() <= 0.5 / 64


def test_images_are_in_the_order_of_the_file() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    assert np.array_equal(parse_png(codec.encode_rgb(rgb)), rgb)
    depth = np.array([[0, 0.00014, 0.00016, 6.5535]], np.float32)
    assert parse_png(codec.encode_depth(depth))[..., 0].tolist() == [[0, 1, 2, 65535]]


@pytest.mark.parametrize("kind", PngFilter)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (1, 9, 3), (9, 1), (1, 1, 3)])
def test_every_filter_comes_back(
    kind: PngFilter, dtype: type[np.generic], shape: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(0)
    most = 256**dtype().itemsize
    for image in (rng.integers(0, most, shape), rng.integers(most - 3, most, shape)):
        png = write_png(image.astype(dtype), kind)
        size, channels = (shape[1], shape[0]), 3 if len(shape) == 3 else 1
        mine = read_png(png, size, "here", channels, dtype().itemsize * 8)
        assert np.array_equal(parse_png(png).reshape(shape), image)
        decoded = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
        assert decoded.dtype == mine.dtype == dtype
        assert np.array_equal(decoded, mine)
        assert np.array_equal(decoded[..., ::-1] if len(shape) == 3 else decoded, image)


def test_a_real_image_is_as_small_as_with_zlib() -> None:
    """Smooth depth and flow of a turning sphere, against OpenCV's encoder at its default."""
    v, u = np.mgrid[-1:1:240j, -1:1:320j]
    inside = u**2 + v**2 < 0.6
    depth = np.where(inside, 2 - np.sqrt(np.maximum(1 - u**2 - v**2, 0)), 0).astype(np.float32)
    flow = np.where(inside[..., None], np.stack([9 * v * depth, -9 * u * depth], -1), 0)
    for coded, ours in ((codes.depth_codes(depth, 1e-4), codec.encode_depth(depth)),
                        (codes.flow_codes(flow.astype(np.float32)),
                         codec.encode_flow(flow.astype(np.float32)))):
        assert len(ours) < 1.1 * len(png(coded))


@pytest.mark.parametrize("bad", [6.5537, -0.001, np.nan, np.inf])
def test_depth_never_wraps(bad: float) -> None:
    with pytest.raises(GcbenchError, match="depth_unit"):
        codec.encode_depth(np.array([[1.0, bad]], np.float32))


@pytest.mark.parametrize(("parts", "bits"), [(255, 8), (256, 16)])
def test_part_images_widen_above_255_parts(
    tmp_path: Path, fake: ModuleType, parts: int, bits: int
) -> None:
    rng = np.random.default_rng(0)
    names = tuple(map(str, range(parts)))
    state = fake.make_state(rng, T)
    state = State(
        **{f.name: getattr(state, f.name) for f in fields(State)}
        | {"world_from_part": np.zeros((T, parts, 4, 4)), "part_pixels": np.zeros((T, parts), int)}
    )
    frames = fake.make_frames(rng, T, H, W)
    frames[1].part[0, 0] = parts
    path = write(tmp_path, (frames, fake.make_meta(T, H, W, part_names=names), state))
    with zipfile.ZipFile(path) as archive:
        assert {archive.read(f"part/{t:06d}.png")[24] for t in range(T)} == {bits}
    part = open_sequence(path).part
    assert all(np.array_equal(part[t], frames[t].part) for t in range(T))


# -- writing ----------------------------------------------------------------------------------


def test_nothing_is_there_until_it_is_whole(
    tmp_path: Path, content: tuple[list[Frame], Meta, State]
) -> None:
    frames, meta, state = content
    with SequenceWriter(tmp_path, 0) as writer:
        for frame in frames:
            writer.add(frame)
            assert not list(tmp_path.rglob("*.zip"))
        writer.finish(meta, state)
    assert [p.name for p in (tmp_path / "sequences").iterdir()] == ["000000.zip"]


def test_a_writer_that_fails_leaves_nothing(
    tmp_path: Path, content: tuple[list[Frame], Meta, State]
) -> None:
    frames, meta, state = content
    deep = Frame(frames[0].rgb, frames[0].depth + 100, frames[0].part, None, None, None)
    with pytest.raises(GcbenchError, match="depth"), SequenceWriter(tmp_path, 0) as writer:
        writer.add(deep)
        writer.finish(meta, state)
    with pytest.raises(ValueError, match="missing"), SequenceWriter(tmp_path, 0) as writer:
        for frame in frames[:-1]:
            writer.add(frame)
        writer.add(frames[0])
        writer.finish(meta, state)
    assert not list((tmp_path / "sequences").iterdir())


def test_leftovers_of_the_dead_go_and_those_of_the_living_stay(tmp_path: Path) -> None:
    from gcbench.robots.files.atomic import remove_leftovers, temporary_name

    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    dead = tmp_path / f".000001.zip.{child.pid}.tmp"
    alive = tmp_path / f".000002.zip.{os.getpid()}.tmp"
    mine, other = temporary_name(tmp_path / "3.zip"), ".4.zip.0123456789abcdef"
    gone = tmp_path / mine.name.replace(f".{os.getpid()}.", f".{child.pid}.")
    elsewhere, old = tmp_path / f"{other}.{child.pid}.tmp", tmp_path / f"{other}.1.tmp"
    for leftover in (dead, alive, mine, gone, elsewhere, old):
        leftover.touch()
    os.utime(old, (0, 0))
    remove_leftovers(tmp_path)
    assert {*tmp_path.iterdir()} == {alive, mine, elsewhere}


# -- hostile and broken files -----------------------------------------------------------------


def remake(path: Path, change: Callable[[dict[str, bytes]], None], **options: Any) -> None:
    """The same ZIP with other members."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    with zipfile.ZipFile(path, "w", **options) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def refused(path: Path, *says: str) -> None:
    """Reading it all is one line that names the file and says what is wrong."""
    with pytest.raises(GcbenchError) as caught:
        for frame in open_sequence(path):
            assert frame
    message = str(caught.value)
    assert "\n" not in message
    for text in (path.name, *says):
        assert text in message


def png(image: Any) -> bytes:
    return cv2.imencode(".png", np.asarray(image))[1].tobytes()


def chunked(*chunks: tuple[bytes, bytes]) -> bytes:
    out = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        out += struct.pack(">I", len(data)) + kind + data
        out += struct.pack(">I", zlib.crc32(kind + data))
    return out


IMAGES = {
    "another size": png(np.zeros((H, W + 1, 3), np.uint8)),
    "with alpha": png(np.zeros((H, W, 4), np.uint8)),
    "grey": png(np.zeros((H, W), np.uint8)),
    "16 bits": png(np.zeros((H, W, 3), np.uint16)),
    "no PNG": cv2.imencode(".jpg", np.zeros((H, W, 3), np.uint8))[1].tobytes(),
    "empty": b"",
    "cut": png(np.ones((H, W, 3), np.uint8))[:-20],
    "bomb": chunked(
        (b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)), (b"IEND", b"")
    ),
    "longer": png(np.ones((H, W, 3), np.uint8)) + b"more",
}


def test_a_damaged_image_prints_nothing(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Chunks that do not concern pixels are ignored; OpenCV prints complaints about others."""
    whole = png(np.ones((H, W, 3), np.uint8))
    start, (_, *rest) = whole[:8], re.split(b"(?=....IHDR|....IDAT|....IEND)", whole, flags=re.S)
    header, *others = rest
    profile = chunked((b"iCCP", b"x\0\0y"), (b"tEXt", b"a\0b"))[8:]
    image = start + header + profile + b"".join(others)
    remake(path, lambda m: m.update({"rgb/000002.png": image}))
    assert (open_sequence(path).rgb[2] == 1).all()
    info = struct.pack(">IIBBBBB", W, H, 8, 2, 0, 0, 0)
    for chunks in (
        [(b"IHDR", info), (b"IDAT", b"no zlib"), (b"IEND", b"")],
        [(b"IHDR", info[:-2] + b"\1\0"), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")],
        [(b"IHDR", info[:-1] + b"\7"), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")],
        [(b"IHDR", info), (b"IEND", b"")],
    ):
        remake(path, lambda m, c=chunks: m.update({"rgb/000002.png": chunked(*c)}))
        refused(path, "rgb/000002.png", "damaged")
    assert capfd.readouterr().err == ""


def test_a_member_that_leads_out_of_its_folder_is_refused(path: Path, tmp_path: Path) -> None:
    """An export would copy the file."""
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    image, outside = folder / "rgb/000001.png", tmp_path / "secret.png"
    image.rename(outside)
    image.symlink_to(outside)
    refused(folder, "rgb/000001.png", "leaves the folder")


@pytest.mark.parametrize("kind", IMAGES)
def test_an_image_of_another_kind_is_refused(path: Path, kind: str) -> None:
    remake(path, lambda members: members.update({"rgb/000002.png": IMAGES[kind]}))
    refused(path, "rgb/000002.png")


def test_labels_without_meaning_are_refused(path: Path) -> None:
    remake(path, lambda m: m.update({"part/000001.png": png(np.full((H, W), 4, np.uint8))}))
    refused(path, "part/000001.png", "3 parts")
    remake(path, lambda m: m.update({"part/000001.png": png(np.full((H, W), 3, np.uint8))}))
    remake(path, lambda m: m.update({"visibility/000001.png": png(np.full((H, W), 4, np.uint8))}))
    refused(path, "visibility/000001.png")


def test_a_damaged_zip_is_refused(path: Path) -> None:
    data = path.read_bytes()
    at = data.index(b"rgb/000001.png") + 500
    path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    refused(path, "rgb/000001.png", "damaged")
    path.write_bytes(data[:-30])
    refused(path, "not a whole ZIP")
    path.write_bytes(data[: len(data) // 2])
    refused(path, "not a whole ZIP")
    path.write_bytes(b"")
    refused(path, "not a whole ZIP")
    path.unlink()
    refused(path, "No such file")


@pytest.mark.parametrize("name", ["../outside.png", "/etc/passwd", "rgb\\..\\x", "a\nb"])
def test_a_member_with_a_hostile_name_is_refused(path: Path, name: str) -> None:
    remake(path, lambda members: members.update({name: b"x"}))
    refused(path, "not a name")


def test_compressed_members_are_refused(path: Path) -> None:
    remake(
        path,
        lambda members: members.update({"state.npz": bytes(10**7)}),
        compression=zipfile.ZIP_DEFLATED,
    )
    refused(path, "compressed")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_twice_is_refused(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("meta.json", "{}")
    refused(path, "meta.json", "twice")


@pytest.mark.parametrize("member", ["meta.json", "state.npz", "flow/000002.png"])
def test_a_missing_member_is_named(path: Path, member: str) -> None:
    remake(path, lambda members: members.pop(member) and None)
    refused(path, member, "missing")


def test_an_unknown_member_or_key_is_ignored(path: Path) -> None:
    def extend(members: dict[str, bytes]) -> None:
        meta = json.loads(members["meta.json"])
        members["meta.json"] = json.dumps(meta | {"new": 1}).encode()
        members["normals/000000.png"] = b"of a later version"

    remake(path, extend)
    assert len(open_sequence(path)) == T


META = [
    ("format", "gcbench/2"),
    ("frames", 0),
    ("frames", 4.0),
    ("frames", True),
    ("frames", 10**12),
    ("width", -1),
    ("width", 60000),
    ("height", 2**26),
    ("depth_unit", 0),
    ("depth_unit", "x"),
    ("joint_names", "elbow"),
    ("joint_names", ["elbow"]),
    ("joint_types", ["revolute", "magic"]),
    ("joint_limits", [None, [0, "1"]]),
    ("joint_limits", [None, [0, 1, 2]]),
    ("scored_joints", ["knee"]),
    ("camera_model", "fisheye"),
    ("observability", []),
    ("seed", -1),
]


@pytest.mark.parametrize(("key", "value"), META)
def test_meta_is_checked(path: Path, key: str, value: Any) -> None:
    def change(members: dict[str, bytes]) -> None:
        meta = json.loads(members["meta.json"])
        members["meta.json"] = json.dumps(meta | {key: value}).encode()

    remake(path, change)
    refused(path, "meta.json" if (key, value) != ("width", 60000) else "")


@pytest.mark.parametrize("text", ["", "[]", "{", '{"a": NaN}', "[" * 100000, "\xff", "1" * 5000])
def test_meta_that_is_no_json_is_refused(path: Path, text: str) -> None:
    remake(path, lambda members: members.update({"meta.json": text.encode("latin-1")}))
    refused(path, "meta.json")


def with_array(
    key: str, data: bytes, compression: int = zipfile.ZIP_STORED
) -> Callable[[dict[str, bytes]], None]:
    def change(members: dict[str, bytes]) -> None:
        with zipfile.ZipFile(io.BytesIO(members["state.npz"])) as archive:
            arrays = {name: archive.read(name) for name in archive.namelist()}
        arrays[f"{key}.npy"] = data
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", compression) as archive:
            for name, array in arrays.items():
                archive.writestr(name, array)
        members["state.npz"] = buffer.getvalue()

    return change


def npy(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def claims(shape: tuple[int, ...]) -> bytes:
    """An NPY file whose header promises more than there is."""
    buffer = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue()


STATES = {
    "pickled": npy(np.array([print] * T, object)),
    "another shape": npy(np.zeros(T + 1)),
    "text": npy(np.array(["a"] * T)),
    "not finite": npy(np.full(T, np.nan)),
    "no array": b"x",
    "huge claim": claims((10**15,)),
    "no data": claims((T,)),
    "bomb": bytes(10**8),
}


@pytest.mark.parametrize("kind", STATES)
def test_state_is_checked(path: Path, kind: str) -> None:
    remake(path, with_array("times", STATES[kind]))
    refused(path, "state.npz", "times")


@pytest.mark.parametrize(("key", "number"), [
    ("times", 1e13), ("joint_positions", 1e10), ("intrinsics", 1e10), ("intrinsics", 0.0),
    ("intrinsics", -1.0), ("cam_from_world", -1e200), ("world_from_part", 1e200),
    ("joint_screw", 1e300)])
def test_numbers_of_unusual_size_are_refused(
    path: Path, content: tuple[list[Frame], Meta, State], key: str, number: float
) -> None:
    """Computations with them overflow."""
    array = np.full_like(getattr(content[2], key), number)
    remake(path, with_array(key, npy(array)))
    refused(path, "state.npz", key)


def test_a_state_may_be_unknown_but_not_infinite(
    path: Path, content: tuple[list[Frame], Meta, State]
) -> None:
    """Points behind the camera have no image; JSON has no infinity."""
    layers = {"track_part": np.ones(2, int), "track_query": np.zeros(2, int),
              "track_world": np.zeros((T, 2, 3)), "track_image": np.full((T, 2, 2), np.nan),
              "track_visible": np.zeros((T, 2), bool)}
    meta = dataclasses.replace(content[1], layers=("tracks",), tracks=2)
    state = dataclasses.replace(content[2], **layers)
    assert np.isnan(parse_state(dump_state(state, meta), meta, "").track_image).all()
    far = dataclasses.replace(content[1], layers=("coordinates",))
    box = np.full((len(meta.part_names), 2, 3), 1e30)
    boxes = dataclasses.replace(content[2], coordinate_box=box)
    with pytest.raises(GcbenchError, match="coordinate_box is not within"):
        parse_state(dump_state(boxes, far), far, "here")
    layers["track_image"][1, 1] = np.inf
    with pytest.raises(GcbenchError, match="track_image is not finite"):
        parse_state(dump_state(dataclasses.replace(state, **layers), meta), meta, "here")


def test_part_numbers_of_the_state_are_checked(path: Path) -> None:
    remake(path, with_array("joint_child_part", npy(np.array([1, 4]))))
    refused(path, "state.npz", "joint_child_part")


def test_a_compressed_state_is_refused(path: Path) -> None:
    """What is stored is as large as the file; what is compressed can be a bomb."""
    remake(path, with_array("times", npy(np.zeros(T)), zipfile.ZIP_DEFLATED))
    refused(path, "state.npz", "compressed")


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"part_names": ["p"] * 4_000_000}, "larger than"),
        ({"part_names": ["p"] * 70_000}, "part_names"),
        ({"joint_names": ["j"] * 70_000}, "joint_names"),
        ({"part_names": ["p"] * 65_535, "frames": 1_000}, "missing"),
        ({"frames": 1_000_000}, "missing"),
        ({"asset": {"notes": "x" * 2**24}}, "larger than"),
    ],
)
def test_what_meta_claims_is_bounded(path: Path, fields: dict[str, Any], says: str) -> None:
    def change(members: dict[str, bytes]) -> None:
        meta = json.loads(members["meta.json"])
        members["meta.json"] = json.dumps(meta | fields).encode()

    remake(path, change)
    tracemalloc.start()
    started = time.monotonic()
    refused(path, says)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 400 * 2**20
    assert time.monotonic() - started < 10


def test_a_state_larger_than_its_bound_is_refused(tmp_path: Path, fake: ModuleType) -> None:
    """Frames, parts and joints are in bounds, but not their product."""
    meta = fake.make_meta(100_000, H, W, part_names=tuple(map(str, range(1000))))
    with pytest.raises(GcbenchError, match="larger than"):
        parse_state(b"", meta, "state.npz")
    with pytest.raises(GcbenchError, match="fewer frames"):
        dump_state(fake.make_state(np.random.default_rng(0), 1), meta)
