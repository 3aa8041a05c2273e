"""Inputs that once did harm, by name; each must now be refused in one line, or be accepted.

A builder returns a case, and `named` says how its last command must end.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..support.gltf_maker import Maker
from .binary import make_zip, npy
from .cases import VERIFY, Case, Special, render
from .data import EVALUATE, READERS, bomb, dataset_files, members_of, read_dataset, results_files
from .models import BOX, GLTF, MESHES, POINTER, files_of_meshes
from .sandbox import Command

Content = dict[str, "bytes | Special"]


@dataclass(frozen=True)
class Named:
    """A case of the corpus."""

    build: Callable[[], Case]
    refused: str
    """Regular expression for the message of the refusal; empty: it must be accepted."""
    accepted: bool
    """Whether it may be accepted."""
    harm: str = ""
    """Regular expression for the harm that the fuzzers must see."""


CORPUS: dict[str, Named] = {}


def named(
    refused: str = "", accepted: bool = False
) -> Callable[[Callable[[], Case]], Callable[[], Case]]:
    """Enter a builder into the corpus under its name."""

    def enter(build: Callable[[], Case]) -> Callable[[], Case]:
        CORPUS[build.__name__] = Named(build, refused, accepted or not refused)
        return build

    return enter


def _urdf(text: str, files: Content | None = None, *options: str) -> Case:
    """Render and verify a URDF."""
    return Case(
        {"m/m.urdf": text.encode(), **(files or {})},
        [render("../input/m/m.urdf", *options), VERIFY],
    )


def _pointer(visual: str = BOX, more: str = "", name: str = 'name="pointer"') -> str:
    """A robot of two links; `visual` is below the second, `more` beside its visual."""
    text = POINTER.replace("HAND", visual).replace('name="pointer"', name)
    return text.replace("</visual></link>\n<joint", f"</visual>{more}</link>\n<joint")


# -- images that inflate --------------------------------------------------------------------------


@cache
def _large_png(side: int = 4096) -> bytes:
    """A black image of side x side pixels in some kB."""
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes((3 * side + 1) * side), 9)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, body) for kind, body in chunks)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _different(png: bytes, number: int) -> bytes:
    """The same picture with other bytes."""
    return png[:-12] + _chunk(b"tEXt", b"n\0" + str(number).encode()) + png[-12:]


_TOO_MUCH = "pixels|bytes|budget|larger"


@named(_TOO_MUCH)
def many_large_textures() -> Case:
    files: Content = {f"m/{k}.png": _different(_large_png(), k) for k in range(60)}
    links = "".join(
        f'<link name="l{k}"><visual><geometry><box size="0.1 0.1 0.1"/></geometry><material '
        f'name="m{k}"><texture filename="{k}.png"/></material></visual></link>'
        f'<joint name="j{k}" type="fixed"><parent link="base"/><child link="l{k}"/></joint>'
        for k in range(60)
    )
    return _urdf(f'<robot name="r"><link name="base"/>{links}</robot>', files)


@named(_TOO_MUCH, accepted=True)
def large_textures_of_materials() -> Case:
    count = 60
    files: Content = {f"m/{k}.png": _different(_large_png(), k) for k in range(count)}
    files["m/a.mtl"] = "".join(f"newmtl m{k}\nmap_Kd {k}.png\n" for k in range(count)).encode()
    files["m/a.obj"] = (
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        + "".join(f"usemtl m{k}\nf 1/1 2/2 3/3\n" for k in range(count))
    ).encode()
    return Case(
        {**files, "m/m.urdf": _pointer(_MESH.format("a.obj")).encode()},
        [render("../input/m/m.urdf")],
    )


def _shared_view() -> Maker:
    maker = Maker()
    view = maker.view(_large_png())
    uv = maker.accessor(np.zeros((8, 2)))
    for k in range(100):
        maker.add("images", bufferView=view, mimeType="image/png")
        maker.add("textures", source=k)
        maker.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": k}})
        made = maker.mesh(primitive={"material": k}, TEXCOORD_0=uv)
        maker.node(mesh=made)
    maker.scene(*range(100))
    return maker


@named(_TOO_MUCH, accepted=True)
def one_view_of_a_hundred_images() -> Case:
    return Case({"m/m.glb": _shared_view().glb()}, [render("../input/m/m.glb")])


@named(_TOO_MUCH, accepted=True)
def one_view_of_a_hundred_images_in_a_urdf() -> Case:
    return Case(
        {"m/a.glb": _shared_view().glb(), "m/m.urdf": _pointer(_MESH.format("a.glb")).encode()},
        [render("../input/m/m.urdf")],
    )


_MESH = '<geometry><mesh filename="{}"/></geometry>'


# -- what a second reader stumbled over -----------------------------------------------------------


@named()
def a_collision_without_geometry() -> Case:
    return _urdf(_pointer(more="<collision/>"))


@named()
def a_plane_to_collide_with() -> Case:
    plane = '<collision><geometry><plane normal="0 0 1"/></geometry></collision>'
    return _urdf(_pointer(more=plane))


@named()
def an_inertia_that_is_no_number() -> Case:
    return _urdf(_pointer(more='<inertial><mass value="x"/><inertia ixx="n/a"/></inertial>'))


@named()
def a_velocity_of_xacro() -> Case:
    return _urdf(_pointer().replace('velocity="1"', 'velocity="${v}"'))


@named()
def a_robot_without_a_name() -> Case:
    return _urdf(_pointer(name=""))


@named()
def boxes_and_spheres_of_size_zero() -> Case:
    return _urdf(
        _pointer(
            more='<visual><geometry><box size="0 0 0"/></geometry></visual>'
            '<visual><geometry><sphere radius="0"/></geometry></visual>'
        )
    )


@named()
def stray_elements_of_xacro() -> Case:
    return _urdf(_pointer(more='<xacro:unless value="1"/>'))


@named()
def a_child_among_the_nodes_of_a_scene() -> Case:
    maker = Maker()
    made = maker.mesh()
    top = maker.node(mesh=made)
    arm = maker.node(top, mesh=made, translation=[0, 2, 0])
    maker.scene(top, arm)
    return Case({"m/m.glb": maker.glb()}, [render("../input/m/m.glb"), VERIFY])


@named("leads out")
def a_mesh_two_folders_above_the_model() -> Case:
    files: Content = {
        "m/a/b/m.urdf": _pointer(_MESH.format("../../cube.obj")).encode(),
        "m/cube.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    }
    return Case(files, [render("../input/m/a/b/m.urdf")])


@named("leads out")
def a_mesh_behind_a_link() -> Case:
    files: Content = {
        "m/m.urdf": _pointer(_MESH.format("cube.stl")).encode(),
        "m/cube.stl": Special("link", "../../secret/secret.stl"),
    }
    return Case(files, [render("../input/m/m.urdf")])


# -- what takes long ------------------------------------------------------------------------------


def _chain(links: int) -> str:
    parts = "".join(
        f'<link name="l{k}"><visual><geometry><box size=".01 .01 .01"/></geometry></visual></link>'
        for k in range(links)
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<origin xyz="0.012 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" '
        f'velocity="1"/></joint>'
        for k in range(1, links)
    )
    return f'<robot name="chain">{parts}{joints}</robot>'


@named()
def a_chain_of_a_thousand_links() -> Case:
    return Case({"m/m.urdf": _chain(1000).encode()}, [render("../input/m/m.urdf")])


@named("links")
def a_chain_of_three_thousand_links() -> Case:
    return Case({"m/m.urdf": _chain(3000).encode()}, [render("../input/m/m.urdf")])


@named()
def three_thousand_instances() -> Case:
    maker = Maker()
    made = maker.mesh()
    top = maker.node()
    for k in range(3000):
        maker.node(top, mesh=made, translation=[2 * (k % 50), 2 * (k // 50), 0])
    maker.scene(top)
    return Case({"m/m.glb": maker.glb()}, [render("../input/m/m.glb", "--allow-missing")])


@named()
def five_thousand_primitives() -> Case:
    maker = Maker()
    points, faces = maker.accessor(np.eye(3)), maker.accessor([0, 1, 2], "H")
    primitives = [{"attributes": {"POSITION": points}, "indices": faces}] * 5000
    maker.scene(maker.node(mesh=maker.add("meshes", primitives=primitives)))
    return Case({"m/m.glb": maker.glb()}, [render("../input/m/m.glb")])


# -- datasets -------------------------------------------------------------------------------------

_SHOW = Command(("show", "../input/d", "--index", "1", "--out", "page.html"))


def _dataset(change: Callable[[dict[str, bytes]], None], *commands: Command) -> Case:
    """The dataset with changed members of its second sequence."""
    files = dict(dataset_files())
    members = members_of(files["d/sequences/000001.zip"])
    change(members)
    files["d/sequences/000001.zip"] = make_zip(None, members)
    return Case(files, list(commands or (_SHOW,)))


def _meta(**changes: Any) -> Callable[[dict[str, bytes]], None]:
    def change(members: dict[str, bytes]) -> None:
        members["meta.json"] = json.dumps(json.loads(members["meta.json"]) | changes).encode()

    return change


def _meta_text(field: str, text: str) -> Callable[[dict[str, bytes]], None]:
    """The text of a field as it stands."""

    def change(members: dict[str, bytes]) -> None:
        _meta(**{field: "@"})(members)
        members["meta.json"] = members["meta.json"].replace(b'"@"', text.encode())

    return change


def _state(name: str, data: bytes) -> Callable[[dict[str, bytes]], None]:
    def change(members: dict[str, bytes]) -> None:
        arrays = members_of(members["state.npz"])
        arrays[name] = data
        members["state.npz"] = make_zip(None, arrays)

    return change


@named("parts|larger|part_names|length")
def four_million_parts() -> Case:
    return _dataset(_meta(part_names=["p"] * 4_000_000))


@named("state.npz")
def a_state_that_inflates() -> Case:
    def change(members: dict[str, bytes]) -> None:
        members["state.npz"] = bomb("world_from_part", (2**20, 3, 4, 4))

    return _dataset(change)


@named("state.npz.*header|damaged")
def a_header_of_parentheses() -> Case:
    header = b"\x93NUMPY\x01\x00" + struct.pack("<H", 4) + b"(((("
    return _dataset(_state("times.npy", header))


@named("seed|integer|int", accepted=True)
def an_integer_of_four_hundred_digits() -> Case:
    return _dataset(_meta_text("seed", "1" + "0" * 400))


@named("not JSON|depth_unit|range|finite")
def a_number_beyond_all() -> Case:
    return _dataset(_meta_text("depth_unit", "1e999"))


@named("not JSON|name|surrogate")
def half_a_character() -> Case:
    return _dataset(_meta_text("name", '"\\ud800"'))


@named("not JSON|nest|deep|randomization")
def six_hundred_levels() -> Case:
    return _dataset(_meta_text("randomization", "[" * 600 + "]" * 600))


@named("name")
def a_member_without_a_name() -> Case:
    return _dataset(lambda members: members.update({"": b"x"}))


@named("000001.zip|damaged|stored")
def a_damaged_member_of_lzma() -> Case:
    files = dict(dataset_files())
    files["d/sequences/000001.zip"] = _damaged_lzma()
    return Case(files, [_SHOW])


def _damaged_lzma() -> bytes:
    import io
    import zipfile

    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("meta.json", b"{}" * 100)
    data = bytearray(out.getvalue())
    data[60:70] = b"\xff" * 10
    return bytes(data)


@named("estimate|predictions|p.npz")
def predictions_of_damaged_lzma() -> Case:
    return Case(
        {**dataset_files(), "p.npz": _damaged_lzma()},
        [
            Command(
                ("score", "--predictions", "../input/p.npz", "--data", "../input/d"), quiet=False
            )
        ],
    )


@named("is not within")
def tracks_far_outside() -> Case:
    far = np.full((3, 8, 2), 1e300)
    return _dataset(
        _state("track_image.npy", npy(far)),
        Command(("show", "../input/d", "--index", "1", "--gif", "x.gif")),
    )


def _counts(text: Any) -> Case:
    files = dict(dataset_files())
    tree = json.loads(_bytes(files["d/dataset.json"]))
    tree["counts"]["sequences"] = text
    files["d/dataset.json"] = json.dumps(tree).encode()
    return Case(files, [Command(("verify", "../input/d", "--workers", "1"), (1, 2))])


@named("counts")
def counts_in_words() -> Case:
    return _counts("two")


@named("robot|model")
def a_dataset_of_a_robot_to_download() -> Case:
    return _of_robot("ur5")


@named("robot|model")
def a_dataset_that_names_a_file() -> Case:
    return _of_robot("../../secret/secret.urdf")


def _of_robot(robot: str) -> Case:
    files = dict(dataset_files())
    tree = json.loads(_bytes(files["d/dataset.json"]))
    tree["config"]["robot"] = robot
    files["d/dataset.json"] = json.dumps(tree).encode()
    argv = (
        "eval",
        "--method",
        "icp",
        "--data",
        "../input/d",
        "--keep-unobservable",
        "--inputs",
        "rgbd",
        "--knowledge",
        "model",
    )
    return Case(files, [Command(argv, quiet=False)])


def _bytes(data: bytes | Special) -> bytes:
    assert isinstance(data, bytes)
    return data


# -- files that are none --------------------------------------------------------------------------


def _pipe(name: str, *argv: str) -> Case:
    files = {**dataset_files(), **results_files(), name: Special("fifo")}
    return Case(files, [Command(argv)])


@named("regular file|not a dataset")
def a_pipe_as_dataset() -> Case:
    return _pipe("d/dataset.json", "verify", "../input/d", "--workers", "1")


@named("regular file|neither")
def a_pipe_as_sequence() -> Case:
    return _pipe("d/sequences/000001.zip", *_SHOW.argv)


@named("regular file")
def a_pipe_as_run() -> Case:
    return _pipe(f"{_RUN}/run.json", "report", "results", "--no-pictures")


@named("regular file")
def a_pipe_as_scores() -> Case:
    return _pipe(f"{_RUN}/scores.csv", "report", "results", "--no-pictures")


@named("regular file")
def a_pipe_as_configuration() -> Case:
    return _pipe("c.toml", "render", "--config", "../input/c.toml")


_RUN = "work/results/hold-still_none_none/d"


# -- results --------------------------------------------------------------------------------------


@named("../secret: cannot be read")
def a_folder_as_configuration() -> Case:
    return Case({}, [render("../input/m.urdf", "--config", "../secret")])


@named("cannot write to /dev/zero/")
def results_in_a_device() -> Case:
    return Case(dict(dataset_files()), [Command((*EVALUATE, "--results=/dev/zero"))])


@named("cannot write to /etc/passwd/")
def results_in_a_file_of_the_system() -> Case:
    return Case(dict(dataset_files()), [Command((*EVALUATE, "--results", "/etc/passwd"))])


def _scores(change: Callable[[list[str]], None]) -> Case:
    files = {**dataset_files(), **results_files()}
    lines = [line.split(",") for line in _bytes(files[f"{_RUN}/scores.csv"]).decode().split("\n")]
    for cells in lines[1:]:
        if len(cells) > 1:
            change(cells)
    files[f"{_RUN}/scores.csv"] = "\n".join(map(",".join, lines)).encode()
    return Case(files, [Command(("report", "results", "--no-pictures"))])


@named("unit|scores.csv")
def a_unit_that_nobody_knows() -> Case:
    def change(cells: list[str]) -> None:
        cells[16] = "furlong" if cells[16] in ("deg", "m") else cells[16]

    return _scores(change)


@named("scores.csv|value|nan")
def errors_that_are_no_numbers() -> Case:
    return _scores(lambda cells: cells.__setitem__(15, "nan"))


@named("scores.csv|name|printable", accepted=True)
def a_robot_that_clears_the_screen() -> Case:
    return _scores(lambda cells: cells.__setitem__(7, "\x1b[2Jx"))


# -- configurations -------------------------------------------------------------------------------


@named("TOML|nest|c.toml")
def lists_of_six_hundred_levels() -> Case:
    return Case(
        {"c.toml": b"a = " + b"[" * 600 + b"]" * 600},
        [Command(("render", "--config", "../input/c.toml"))],
    )


@named("c.toml")
def keys_of_six_hundred_levels() -> Case:
    return Case(
        {"c.toml": b".".join([b"a"] * 3000) + b" = 1"},
        [Command(("render", "--config", "../input/c.toml"))],
    )


@named("seed|c.json|JSON")
def a_seed_of_five_thousand_digits() -> Case:
    return Case(
        {"c.json": b'{"seed": 1' + b"0" * 5000 + b"}"},
        [Command(("render", "--config", "../input/c.json"))],
    )


@named("File name too long")
def a_name_that_is_too_long() -> Case:
    argv = ("score", "--predictions", "x" * 5000, "--data", "../input/d")
    return Case(dict(dataset_files()), [Command(argv, quiet=False)])


# -- methods that misbehave -----------------------------------------------------------------------

_METHOD = """import os, signal, subprocess, sys, time
import numpy as np
from gcbench import Estimate
class Method:
    name, version, training = NAME, "1", "none"
    inputs, knowledge = ("none",), ("none",)
    def __init__(self):
        BEGIN
    def estimate(self, observation):
        BODY
        return Estimate(np.zeros((len(observation.times), observation.n_joints)))
class Odd:
    part = screw = sigma = None
    @property
    def displacement(self):
        raise ERROR
class OddArray:
    def __array__(self, *args, **options):
        raise ERROR
"""


def _method(
    body: str = "pass",
    begin: str = "pass",
    name: str = '"odd"',
    error: str = "SystemExit",
    foreign: bool = True,
) -> Case:
    text = _METHOD.replace("BODY", body).replace("BEGIN", begin).replace("NAME", name)
    files: Content = {**dataset_files(), "method.py": text.replace("ERROR", error).encode()}
    argv = ("eval", "--method", "../input/method.py:Method", *EVALUATE[3:])
    return Case(files, [Command(argv, (0, 1, 2), quiet=False, foreign=foreign)])


@named("no sequence was estimated")
def an_estimate_that_exits() -> Case:
    return _method("return Odd()")


@named("no sequence was estimated")
def an_estimate_that_interrupts() -> Case:
    return _method("return Odd()", error="KeyboardInterrupt")


@named("no sequence was estimated")
def an_array_that_exits() -> Case:
    return _method("return Estimate(OddArray())")


@named("no sequence was estimated")
def an_array_that_interrupts() -> Case:
    return _method("return Estimate(OddArray())", error="KeyboardInterrupt")


@named("method.py|exit")
def a_constructor_that_exits() -> Case:
    return _method(begin="sys.exit(3)")


@named("method.py|name")
def a_method_with_half_a_character() -> Case:
    return _method(name='"\\ud800"')


@named("method.py|name|print")
def a_method_that_clears_the_screen() -> Case:
    return _method(name='"\\x1b[2J"')


@named("no sequence was estimated")
def a_method_that_forks_and_exits() -> Case:
    return _method("os.fork() or time.sleep(30); os._exit(1)")


@named()
def a_method_with_a_child_in_its_own_session() -> Case:
    return _method("subprocess.Popen(['sleep', '30'], start_new_session=True)")


@named("no sequence was estimated")
def a_method_that_kills_itself() -> Case:
    return _method("os.kill(os.getpid(), signal.SIGKILL)")


@named()
def a_ply_with_a_colour_too_few() -> Case:
    data = files_of_meshes()["m/cube.ply"]
    assert isinstance(data, bytes)
    short = data.replace(b"0.0 0.0 1.0 200 10 10", b"0 0.0 1.0 200 10 10", 1)
    short = short.replace(b"1.0 1.0 0.0 200 10 10\n", b"", 1)
    return _urdf(_pointer(_MESH.format("cube.ply")), {**files_of_meshes(), "m/cube.ply": short})


# -- what fuzzing starts from is right ------------------------------------------------------------


def _right(name: str, case: Callable[[], Case]) -> None:
    CORPUS[f"right: {name}"] = Named(case, "", True)


for _name in MESHES:
    _right(_name, lambda name=_name: _urdf(_pointer(_MESH.format(name)), files_of_meshes()))
for _name, _make in GLTF.items():
    _right(
        f"a {_name} GLB",
        lambda make=_make: Case({"m/m.glb": make().glb()}, [render("../input/m/m.glb"), VERIFY]),
    )
for _argv in READERS:
    _right(" ".join(_argv[:4]), lambda argv=_argv: read_dataset(dict(dataset_files()), argv, []))


# -- harm that the fuzzers must see ---------------------------------------------------------------


def _harmful(harm: str, body: str) -> None:
    """Enter a method that does harm; the words of what is seen are its name."""
    CORPUS["seen: " + harm] = Named(lambda: _method(body, foreign=False), "", True, harm)


_harmful("reads .*secret", "open(os.environ['HOME'] + '/../secret/secret')")
_harmful("writes .*input/x", "open(os.environ['HOME'] + '/../input/x', 'w')")
_harmful("changes /tmp", "os.mkdir('/tmp/gcbench-fuzz-x/y')")
_harmful("uses the network", "__import__('socket').socket().connect(('127.0.0.1', 9))")
_harmful("starts a program", "subprocess.run(['true'])")
_harmful("left .* temporary", "open(os.environ['HOME'] + '/../tmp/x', 'w')")
_harmful("took|MemoryError", "x = bytearray(3 * 2**30); x[::4096] = b'x' * (len(x) // 4096)")
