"""Generated appliances: the same everywhere, no two alike, and doors that open."""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench import GcbenchError
from gcbench.robots.appliances import generator as appliances
from gcbench.robots.appliances.fittings import Appliance
from gcbench.robots.appliances.generator import (
    CATEGORIES,
    DESIGNS,
    GENERATED,
    IDS,
    appliance_model,
    write_appliance,
)
from gcbench.robots.appliances.shapes import (
    Hole,
    cavity,
    disc,
    frame,
    rounded_rectangle,
    slab,
    tube,
)
from gcbench.robots.appliances.textures import (
    PaletteImage,
    SeededRng,
    encode_png,
    keypad_image,
    text_image,
)
from gcbench.robots.catalog import load_robot
from gcbench.robots.files.download import create_folder_atomically
from gcbench.robots.geometry import apply
from gcbench.robots.model import ArticulatedModel, forward_kinematics, joint_screws
from gcbench.robots.motion.collision import CollisionChecker
from gcbench.robots.urdf.partnet import load_object, part_names, scored_joints
from PIL import Image

SIZES = {
    "microwave": ((0.32, 0.56), (0.44, 0.56), (0.26, 0.36)),
    "dishwasher": ((0.55, 0.72), (0.448, 0.61), (0.80, 0.90)),
    "oven": ((0.30, 0.69), (0.40, 0.62), (0.24, 0.80)),
}
"""m: depth (with handle), width, height."""
OPENING = {"microwave": (1.57, 2.10), "dishwasher": (1.40, 1.57), "oven": (1.40, 1.57)}
VERSIONED = {3: "1132d7799412ec6b197b006f7a4071ee2733283010e93cd5d46aaf9cb020b0fa"}
"""`contents` of four instances by version of the generator: datasets name instances by it."""


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("GCBENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def digest(folder: Path) -> str:
    """Of the names and bytes of all files."""
    total = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def written(category: str, number: int, folder: Path) -> Path:
    folder.mkdir(parents=True)
    write_appliance(category, number, folder)
    return folder


def designed(category: str, number: int) -> Appliance:
    rng = np.random.Generator(np.random.PCG64([7, number]))
    return DESIGNS[category](SeededRng(rng), number)


def looks(thing: Appliance) -> str:
    """Of everything that decides how an object looks and moves."""
    total = hashlib.sha256()
    for link in thing.parts:
        total.update(repr((link.role, link.joint, link.origin, link.axis, link.limits)).encode())
        for shape in link.shapes:
            total.update(np.round(shape.solid.vertices, 5).tobytes())
            total.update(repr(shape.finish.color).encode())
    return total.hexdigest()


def sweep(model: ArticulatedModel) -> tuple[np.ndarray, int]:
    """Poses while the door opens, all else at rest; and the door's joint."""
    (door,) = scored_joints(model)
    j = model.joint_names.index(door)
    q = np.tile(np.clip(0.0, *model.limits.T), (10, 1))
    q[:, j] = np.linspace(*model.limits[j], 10)
    return forward_kinematics(model, q), j


def test_files_are_the_same_bytes_in_every_process(tmp_path: Path) -> None:
    here = [digest(written(c, 17, tmp_path / c)) for c in GENERATED]
    code = "\n".join([
        "import sys; from pathlib import Path",
        "from gcbench.robots.appliances.generator import GENERATED, write_appliance",
        "for c in reversed(GENERATED):",
        "    folder = Path(sys.argv[1]) / c; folder.mkdir(); write_appliance(c, 17, folder)"])
    there = tmp_path / "there"
    there.mkdir()
    subprocess.run([sys.executable, "-c", code, str(there)], check=True,
                   env={**os.environ, "PYTHONHASHSEED": "5"})
    assert [digest(there / c) for c in GENERATED] == here
    assert len({*here, digest(written("oven", 18, tmp_path / "18"))}) == 5


def contents(model: ArticulatedModel) -> str:
    """Digest of geometry, textures and joints; not of how a file encodes them."""
    total = hashlib.sha256()
    for values in (model.parent, model.joint_child, np.round(model.limits * 1e6),
                   np.round(model.screw * 1e6), np.round(model.parent_from_part_at_zero * 1e5)):
        total.update((values + 0.0).tobytes())
    total.update(repr((model.part_names, model.joint_names)).encode())
    for visual in model.visuals:
        triangles = np.round(visual.vertices[visual.faces] * 1e5).astype(np.int64)
        total.update(triangles.tobytes() + bytes([visual.part]))
        color, texture = visual.material.base_color, visual.material.texture
        total.update(np.round(np.array(color) * 1e4).astype(np.int64).tobytes())
        total.update(b"" if texture is None else texture.tobytes())
    return total.hexdigest()


def test_a_change_of_the_generator_is_a_new_version() -> None:
    found = " ".join(contents(appliance_model(category, 3)) for category in GENERATED)
    assert hashlib.sha256(found.encode()).hexdigest() == VERSIONED[appliances.VERSION]


@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", [4, pytest.param(50, marks=pytest.mark.slow)])
def test_the_files_hold_the_model_to_the_last_bit(
    category: str, count: int, tmp_path: Path
) -> None:
    for number in range(count):
        made, read = (appliance_model(category, number),
                      load_object(written(category, number, tmp_path / str(number))))
        assert (made.part_names, made.joint_names, made.joint_types, made.sha256, made.notes) == (
            read.part_names, read.joint_names, read.joint_types, read.sha256, read.notes)
        for name in ("parent", "parent_from_part_at_zero", "screw", "joint", "multiplier",
                     "offset", "joint_child", "limits"):
            np.testing.assert_array_equal(getattr(made, name), getattr(read, name), err_msg=name)
        for a, b in zip(made.visuals, read.visuals, strict=True):
            assert (a.part, a.material.name) == (b.part, b.material.name)
            assert a.material.base_color == b.material.base_color
            for name in ("vertices", "faces", "normals", "uv"):
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
            np.testing.assert_array_equal(a.material.texture, b.material.texture)


def test_streams_share_no_instance() -> None:
    assert not set(IDS["test"]) & set(IDS["train"])
    assert min(map(len, IDS.values())) >= 10_000


@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_two_instances_look_alike(category: str, count: int) -> None:
    assert len({looks(designed(category, number)) for number in range(count)}) == count


@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_nothing_covers_what_is_printed_on_the_front(category: str, count: int) -> None:
    """Names, displays, keys and gauges do not reach under each other or under what stands out."""
    for number in range(count):
        shapes = [s for link in designed(category, number).parts for s in link.shapes]
        corners = [s.solid.vertices[s.solid.faces] for s in shapes]  # [F 3 3]
        for k, printed in enumerate(shapes):
            if printed.name not in ("logo", "display", "keypad", "gauge"):
                continue
            low, high = corners[k].min((0, 1)), corners[k].max((0, 1))
            for j, other in enumerate(shapes):
                if j == k or (printed.name == "gauge" and other.name in ("knob", "mark")):
                    continue
                least, most = corners[j].min(1), corners[j].max(1)  # [F 3]
                shared = np.minimum(high, most)[:, :2] - np.maximum(low, least)[:, :2]
                covers = (shared > 5e-4).all(1) & (most[:, 2] > low[2] - 1e-6)
                assert not covers.any(), (number, printed.name, other.name)


@pytest.mark.parametrize("category", CATEGORIES)
@pytest.mark.parametrize("count", [4, pytest.param(100, marks=pytest.mark.slow)])
def test_a_door_opens_from_limit_to_limit_and_touches_nothing(category: str, count: int) -> None:
    for number in range(count):
        model = load_robot(f"{category}:{number}")
        poses, j = sweep(model)
        checker = CollisionChecker(model)
        assert checker.first_contact(poses, checker.groups.ground_height(poses)) is None, number
        low, high = OPENING[category]
        assert model.limits[j, 0] == 0.0
        assert low <= model.limits[j, 1] <= high
        door = [v for v in model.visuals if model.part_names[v.part] == "door"]
        reach = [min(apply(p[v.part], v.vertices)[:, 0].min() for v in door) for p in poses]
        assert reach[-1] < reach[0] - 0.1  # to the front, which is -x
        axis = joint_screws(model, poses[0])[j, :3]
        upright = category == "microwave"
        np.testing.assert_allclose(np.abs(axis), [0, not upright, upright], atol=1e-9)


@pytest.mark.parametrize("category", GENERATED)
@pytest.mark.parametrize("count", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_no_two_colours_lie_in_one_plane(category: str, count: int) -> None:
    """Of faces at least 5 mm wide that look along an axis: the depth test could not choose."""
    for number in range(count):
        shapes = [s for link in designed(category, number).parts for s in link.shapes]
        corners = np.concatenate([s.solid.vertices[s.solid.faces] for s in shapes])  # [F 3 3]
        who = np.repeat(np.arange(len(shapes)), [len(s.solid.faces) for s in shapes])
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=1)
        for axis in range(3):
            others = [k for k in range(3) if k != axis]
            wide = (np.ptp(corners[:, :, others], axis=1) > 0.005).all(1)
            for sign in (-1, 1):
                flat = np.flatnonzero(wide & (sign * across[:, axis] > (1 - 1e-9) * length))
                height = np.round(corners[flat, 0, axis], 5)
                for level in np.unique(height):
                    faces = flat[height == level]
                    inside = center_inside(corners[faces][:, :, others])
                    for i, j in np.argwhere(inside & (who[faces] != who[faces][:, None])):
                        a, b = shapes[who[faces[i]]], shapes[who[faces[j]]]
                        assert a.finish.color == b.finish.color, (number, a.name, b.name)


def center_inside(triangles: np.ndarray) -> np.ndarray:
    """[N N] whether the center of triangle i is inside of triangle j, of triangles [N 3 2]."""
    center, turns = triangles.mean(1)[:, None], list[np.ndarray]()
    for k in range(3):
        a, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        arm = center - a
        turns.append(edge[:, 0] * arm[..., 1] - edge[:, 1] * arm[..., 0])
    return (np.min(turns, axis=0) > 1e-7) | (np.max(turns, axis=0) < -1e-7)


@pytest.mark.parametrize("count", [4, pytest.param(100, marks=pytest.mark.slow)])
def test_each_drawer_slides_out_to_the_front_and_touches_nothing(count: int) -> None:
    numbers = set[int]()
    for number in range(count):
        model = load_robot(f"drawer:{number}")
        joints = len(model.joint_names)
        numbers.add(joints)
        assert set(model.joint_types) == {"prismatic"} and scored_joints(model) == ("drawer",)
        assert (model.limits[:, 0] == 0).all() and (model.limits[:, 1] > 0.15).all()
        checker = CollisionChecker(model)
        q = np.concatenate([model.limits[:, 1] * np.eye(joints)[[j]] * share[:, None]
                            for j in range(joints)
                            for share in [np.linspace(0, 1, 6)]])
        poses = forward_kinematics(model, q)
        assert checker.first_contact(poses, checker.groups.ground_height(poses)) is None, number
        for j, child in enumerate(model.joint_child):
            moved = poses[6 * j + 5, child, :3, 3] - poses[6 * j, child, :3, 3]
            np.testing.assert_allclose(moved, [-model.limits[j, 1], 0, 0], atol=1e-6)
    assert len(numbers) > 1


@pytest.mark.parametrize("category", CATEGORIES)
def test_sizes_and_parts_are_those_of_the_products(category: str) -> None:
    for number in range(6):
        model = load_robot(f"{category}:{number}")
        assert (model.name, model.source) == (f"{category}:{number}", appliances.APPLIANCE_SOURCE)
        poses, _ = sweep(model)
        points = np.concatenate([apply(poses[0, v.part], v.vertices) for v in model.visuals])
        size = np.ptp(points, axis=0)
        for extent, (low, high) in zip(size, SIZES[category], strict=True):
            assert low - 1e-6 <= extent <= high + 0.07, (number, size)
        assert {"body", "door"} <= set(model.part_names)
        known = ("base", "body", "door", "handle", "rack", "knob")
        assert all(name.split("_")[0] in known for name in model.part_names)
        assert scored_joints(model) == ("door",)
        if category == "dishwasher":
            assert [n for n in model.joint_names if n.startswith("rack")] == ["rack", "rack_2"]
            slides = [model.joint_names.index(n) for n in ("rack", "rack_2")]
            assert (model.limits[slides, 1] > 0.25).all() and (model.limits[slides] <= 0.45).all()


def test_the_folder_is_laid_out_as_partnet_mobility(tmp_path: Path) -> None:
    folder = written("oven", 5, tmp_path / "5")
    links = [line.split() for line in (folder / "semantics.txt").read_text().splitlines()]
    mobility = json.loads((folder / "mobility_v2.json").read_text())
    assert [words[0] for words in links] == [f"link_{k}" for k in range(len(links))]
    assert [(m["joint"], m["name"]) for m in mobility] == [(w[1], w[2]) for w in links]
    assert links[0][1:] == ["heavy", "body"] and ["hinge", "door"] in [w[1:] for w in links]
    assert json.loads((folder / "meta.json").read_text())["model_cat"] == "Oven"
    box = json.loads((folder / "bounding_box.json").read_text())
    np.testing.assert_allclose(np.add(box["min"], box["max"]), 0, atol=2e-4)
    tree = json.loads((folder / "result.json").read_text())
    leaves = [leaf for child in tree[0]["children"] for leaf in child["children"]]
    named = {name for leaf in leaves for name in leaf["objs"]}
    assert named == {p.stem for p in (folder / "textured_objs").glob("*.obj")}
    urdf = (folder / "mobility.urdf").read_text()
    assert "inertia" not in urdf and urdf.index('type="revolute"') < urdf.index('type="fixed"')
    assert urdf.rindex('type="fixed"') == urdf.rindex("type=")  # the root's, last


@pytest.mark.parametrize("category", GENERATED)
def test_yourdfpy_loads_an_instance_unchanged(category: str, tmp_path: Path) -> None:
    yourdfpy: Any = pytest.importorskip("yourdfpy")
    folder = written(category, 9, tmp_path / "9")
    other = yourdfpy.URDF.load(str(folder / "mobility.urdf"))
    model = load_robot(f"{category}:9")
    assert len(other.scene.geometry) >= len(list((folder / "textured_objs").glob("*.obj")))
    triangles = sum(len(g.faces) for g in other.scene.geometry.values())
    assert triangles == sum(len(v.faces) for v in model.visuals)
    q = 0.5 * np.clip(model.limits[:, 0] + model.limits[:, 1], -3, 3)
    assert len(other.actuated_joint_names) == len(q)
    other.update_cfg(q)  # both list joints in the order of the file
    poses = forward_kinematics(model, q)
    for link, part in part_names(folder).items():
        if part in model.part_names:
            pose = other.get_transform(link)
            np.testing.assert_allclose(poses[model.part_names.index(part)], pose, atol=1e-6)


def test_pictures_are_pngs_of_their_pixels() -> None:
    for picture in (text_image("AZ:09", (250, 1, 2), (3, 4, 5)),
                    keypad_image([["STOP", "GO"], ["1"]], (0, 0, 0), (9, 9, 9), (5, 200, 5), True),
                    PaletteImage((np.arange(200 * 400) % 64).reshape(200, 400).astype(np.uint8),
                                 tuple((k, 2 * k, 3 * k) for k in range(64)))):
        image = np.asarray(Image.open(io.BytesIO(encode_png(picture))).convert("RGB"))
        np.testing.assert_array_equal(image, np.array(picture.palette, np.uint8)[picture.pixels])


@pytest.mark.parametrize("solid", [
    slab(0.4, 0.3, (0.0, 0.05), 0.02, 0.01, 0.01), slab(0.4, 0.3, (0.0, 0.05)),
    frame(0.4, 0.3, Hole(0.02, 0.01, 0.2, 0.1, 0.03), (0.0, 0.05), 0.02, 0.01),
    disc(0.1, (0.0, 0.05), 0.01), tube([[0, 0, 0], [1, 0, 0], [1, 0, 1]], 0.01, [0, 1, 0]),
], ids=["slab", "box", "frame", "disc", "tube"])
def test_solids_are_closed_and_their_normals_face_outward(solid: Any) -> None:
    p = np.round(solid.vertices, 7)
    _, place = np.unique(p, axis=0, return_inverse=True)
    tri = place.reshape(-1)[solid.faces]
    tri = tri[(tri[:, 0] != tri[:, 1]) & (tri[:, 1] != tri[:, 2]) & (tri[:, 2] != tri[:, 0])]
    edges = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    ways = {tuple(e) for e in edges.tolist()}
    assert len(ways) == len(edges) and all((b, a) in ways for a, b in ways)
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0
    for k in range(3):
        assert (np.einsum("ij,ij->i", face, solid.normals[solid.faces[:, k]]) >= -1e-12).all()
    np.testing.assert_allclose(np.linalg.norm(solid.normals, axis=1), 1, atol=1e-6)


def test_volumes_are_those_of_the_formulas() -> None:
    def volume(solid: Any) -> float:
        a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    assert volume(slab(0.4, 0.3, (0.1, 0.2))) == pytest.approx(0.4 * 0.3 * 0.1)
    hole = frame(0.4, 0.3, Hole(0.05, 0.0, 0.2, 0.1), (0.0, 0.1))
    assert volume(hole) == pytest.approx((0.4 * 0.3 - 0.2 * 0.1) * 0.1)
    outline, _ = rounded_rectangle(0.4, 0.3, 0.1)
    x, y = outline.T
    area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
    assert area == pytest.approx(0.4 * 0.3 - (4 - np.pi) * 0.01, rel=0.01)
    inside = cavity((0.4, 0.3), (0.0, 0.1), 0.0)
    middle = inside.vertices[inside.faces].mean(1)
    facing = np.einsum("ij,ij->i", np.array([0.0, 0.0, 0.05]) - middle,
                       inside.normals[inside.faces[:, 0]])
    assert (facing > 0).all()


def test_what_fails_halfway_leaves_nothing(tmp_path: Path) -> None:
    def fill(folder: Path) -> None:
        (folder / "half").write_text("x")
        raise OSError(28, "No space left on device")

    with pytest.raises(GcbenchError, match=r"cannot write it into .*No space left"):
        create_folder_atomically(tmp_path / "a" / "b", "it", fill)
    assert list((tmp_path / "a").iterdir()) == []


@pytest.mark.parametrize(("name", "message"), [
    ("microwave:", "microwave:NUMBER"), ("oven:x", "names no object; write oven:NUMBER"),
    ("dishwasher:1000000", "0 to 999999"), ("oven:-1", "names no object"),
    ("partnet:7310x", "partnet:NUMBER"),
    ("toaster", "there are ur5.*microwave, dishwasher, oven, drawer"),
    ("oven:../1", "names no object"),
])
def test_a_name_that_means_nothing_is_refused(name: str, message: str) -> None:
    with pytest.raises(GcbenchError, match=message):
        load_robot(name)
