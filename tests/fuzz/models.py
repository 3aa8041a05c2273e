"""Fuzzed URDFs, meshes and glTF files, which are rendered and then verified."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..support.gltf_maker import CORNERS, CUBE, Maker, bent_bar
from .binary import change_bytes, change_png, png
from .cases import VERIFY, Case, Special, render
from .mutations import Element, change_tree, change_xml, dump_tree, dump_xml
from .rng import REFERENCES, CaseRng

Content = dict[str, "bytes | Special"]
_SHAPES = ("box", "box", "sphere", "cylinder", "capsule", "mesh")
_OPTIONS = (
    (),
    (),
    ("--allow-missing",),
    ("--background.room", "1"),
    ("--keep-unobservable",),
    ("--layers", "normal", "coordinates"),
    ("--layers", "tracks", "--track-points", "8"),
    ("--vary", "lights"),
    ("--randomize", "none"),
    ("--samples", "4"),
)


def urdf(rng: CaseRng) -> Case:
    """A random robot with its meshes; some places of its URDF are changed."""
    root = _robot(rng)
    for _ in rng.few(4):
        change_xml(rng, root, "m.urdf", lambda: _extra(rng))
    files: Content = {"m/m.urdf": dump_xml(rng, root, "m.urdf"), **files_of_meshes()}
    if rng.chance(0.1):
        name = rng.choice([*files])
        files[name] = (
            change_bytes(rng, data, name) if isinstance(data := files[name], bytes) else data
        )
    return Case(files, [render("../input/m/m.urdf", *rng.choice(_OPTIONS)), VERIFY], rng.steps)


def mesh(rng: CaseRng) -> Case:
    """A robot of one mesh, whose file, materials or textures are changed."""
    name, change = rng.choice([*MESHES.items()])
    files: Content = dict(files_of_meshes())
    for path in change(rng, files):
        rng.note(f"changes {path}")
    scale = rng.choice(["1 1 1", "1 1 1", "0.001 0.001 0.001", "-1 1 1", "2 1 0.5"])
    hand = f'<geometry><mesh filename="{name}" scale="{scale}"/></geometry>'
    files["m/m.urdf"] = POINTER.replace("HAND", hand).encode()
    return Case(files, [render("../input/m/m.urdf", *rng.choice(_OPTIONS)), VERIFY], rng.steps)


def gltf(rng: CaseRng) -> Case:
    """A glTF or GLB file with skins, morph targets, animations and textures, changed."""
    maker = rng.choice([*GLTF.values()])()
    text = rng.chance(0.4)
    tree = maker.tree
    for _ in rng.few(4):
        if rng.chance(0.2) and maker.data:
            maker.data = bytearray(change_bytes(rng, bytes(maker.data), "buffer"))
        else:
            change_tree(rng, tree, "m.gltf")
    name = "m.gltf" if text else "m.glb"
    files: Content = {
        "m/link.bin": Special("link", "../../secret/secret.bin"),
        "m/image.png": png(4, 4),
        "m/data.bin": bytes(maker.data),
    }
    data = _dump_gltf(rng, maker, text)
    files[f"m/{name}"] = change_bytes(rng, data, name) if rng.chance(0.08) else data
    more = rng.choice([*_OPTIONS, ("--animation", "none"), ("--animation", "walk")])
    return Case(files, [render(f"../input/m/{name}", *more), VERIFY], rng.steps)


# -- URDF -----------------------------------------------------------------------------------------

POINTER = """<robot name="pointer">
<link name="base"><visual><geometry><box size="0.3 0.3 0.1"/></geometry></visual></link>
<link name="hand"><visual><origin xyz="0.3 0 0.1"/>HAND</visual></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
<origin xyz="0 0 0.1"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
</joint></robot>"""
BOX = '<geometry><box size="0.6 0.1 0.05"/></geometry>'


def _element(tag: str, children: list[Element] | None = None, **attributes: str) -> Element:
    made = ElementTree.Element(tag, attributes)
    made.extend(children or [])
    return made


def _numbers(rng: CaseRng, count: int, low: float, high: float) -> str:
    return " ".join(f"{rng.uniform(low, high):.3g}" for _ in range(count))


def _geometry(rng: CaseRng) -> Element:
    kind = rng.choice(_SHAPES)
    attributes = {
        "box": {"size": _numbers(rng, 3, 0.05, 0.4)},
        "sphere": {"radius": _numbers(rng, 1, 0.05, 0.2)},
        "cylinder": {"radius": _numbers(rng, 1, 0.05, 0.2), "length": _numbers(rng, 1, 0.1, 0.5)},
        "capsule": {"radius": _numbers(rng, 1, 0.05, 0.1), "length": _numbers(rng, 1, 0.1, 0.5)},
        "mesh": {
            "filename": rng.choice(
                [
                    "cube.obj",
                    "cube.stl",
                    "cube.ply",
                    "cube.dae",
                    "cube.glb",
                    "package://m/cube.obj",
                    "./cube.stl",
                ]
            ),
            "scale": _numbers(rng, 3, 0.1, 0.4),
        },
    }[kind]
    return _element("geometry", [_element(kind, **attributes)])


def _visual(rng: CaseRng, tag: str = "visual") -> Element:
    parts = [
        _element("origin", xyz=_numbers(rng, 3, -0.2, 0.3), rpy=_numbers(rng, 3, -3, 3)),
        _geometry(rng),
    ]
    if rng.chance(0.4):
        parts.append(
            rng.choice(
                [
                    lambda: _element(
                        "material", [_element("color", rgba=_numbers(rng, 4, 0, 1))], name="c"
                    ),
                    lambda: _element(
                        "material", [_element("texture", filename="image.png")], name="t"
                    ),
                    lambda: _element("material", name="shared"),
                ]
            )()
        )
    return _element(tag, parts)


def _joint(rng: CaseRng, k: int, joints: int) -> Element:
    kind = rng.choice(["revolute", "revolute", "continuous", "prismatic", "fixed", "floating"])
    parts = [
        _element("parent", link=f"link{rng.randrange(k)}"),
        _element("child", link=f"link{k}"),
        _element("origin", xyz=_numbers(rng, 3, -0.3, 0.5), rpy=_numbers(rng, 3, -1, 1)),
        _element("axis", xyz=rng.choice(["0 0 1", "0 1 0", "1 0 0", _numbers(rng, 3, -1, 1)])),
    ]
    if kind in ("revolute", "prismatic"):
        parts.append(
            _element(
                "limit",
                lower=_numbers(rng, 1, -2, 0),
                upper=_numbers(rng, 1, 0, 2),
                effort="1",
                velocity="1",
            )
        )
    if joints > 2 and rng.chance(0.15):
        parts.append(
            _element(
                "mimic",
                joint=f"joint{rng.randrange(1, joints)}",
                multiplier=_numbers(rng, 1, -1, 1),
                offset="0",
            )
        )
    return _element("joint", parts, name=f"joint{k}", type=kind)


def _robot(rng: CaseRng) -> Element:
    """A robot that most often is right: a tree of 1 to 6 links."""
    count = rng.choice([1, 2, 2, 3, 4, 6])
    root = _element(
        "robot",
        [_element("material", [_element("color", rgba="0.8 0.2 0.1 1")], name="shared")],
        name="m",
    )
    for k in range(count):
        parts = [_visual(rng) for _ in range(rng.choice([0, 1, 1, 2]) if k else 1)]
        if rng.chance(0.5):
            parts.append(_visual(rng, "collision"))
        if rng.chance(0.5):
            parts.append(
                _element(
                    "inertial",
                    [
                        _element("mass", value="1"),
                        _element("origin", xyz="0 0 0", rpy="0 0 0"),
                        _element("inertia", ixx="1", ixy="0", ixz="0", iyy="1", iyz="0", izz="1"),
                    ],
                )
            )
        root.append(_element("link", parts, name=f"link{k}"))
    root.extend([_joint(rng, k, count) for k in range(1, count)])
    return root


def _extra(rng: CaseRng) -> Element:
    """An element that URDFs in the wild hold."""
    return rng.choice(
        [
            lambda: _element("collision"),
            lambda: _element("visual"),
            lambda: _visual(rng),
            lambda: _visual(rng, "collision"),
            lambda: _joint(rng, 1, 3),
            lambda: _element("link", [_visual(rng)], name="more"),
            lambda: _element("geometry"),
            lambda: _element(
                "collision", [_element("geometry", [_element("plane", normal="0 0 1")])]
            ),
            lambda: _element("visual", [_element("geometry", [_element("plane", normal="0 0 1")])]),
            lambda: _element("inertia", ixx="n/a"),
            lambda: _element("limit", velocity="${v}"),
            lambda: _element("mesh", filename=rng.choice(REFERENCES)),
            lambda: _element("texture", filename=rng.choice(REFERENCES)),
            lambda: _element("transmission", [_element("type")], name="t"),
            lambda: _element("gazebo", [_element("plugin", filename="x.so")], reference="link0"),
            lambda: _element("xacro:if", value="1"),
            lambda: _element("mimic", joint="joint1"),
            lambda: _element("safety_controller", k_velocity="x"),
            lambda: _element("ros2_control"),
            lambda: _element("box", size="0 0 0"),
            lambda: _element("sphere", radius="0"),
            lambda: _element("dynamics", damping="nan"),
            lambda: _element("calibration", rising="x"),
        ]
    )()


# -- meshes ---------------------------------------------------------------------------------------

_OBJ = (
    "mtllib cube.mtl\nusemtl a\n"
    + "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
    + ("vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n")
    + "".join(f"f {a + 1}/1/1 {b + 1}/2/1 {c + 1}/3/1\n" for a, b, c in CUBE)
)
_MTL = "newmtl a\nKd 0.8 0.2 0.1\nKa 0 0 0\nNs 10\nd 1\nmap_Kd image.png\n"


def _stl() -> bytes:
    corners = CORNERS[CUBE].astype("<f4")
    body = b"".join(struct.pack("<3f", 0, 0, 0) + c.tobytes() + b"\0\0" for c in corners)
    return bytes(80) + struct.pack("<I", len(CUBE)) + body


def _ascii_stl() -> bytes:
    lines = ["solid x"]
    for corners in CORNERS[CUBE]:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in corners] + ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid x\n"]).encode()


def _ply() -> bytes:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        f"property uchar blue\nelement face {len(CUBE)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    return (
        head
        + "".join(f"{x} {y} {z} 200 10 10\n" for x, y, z in CORNERS)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in CUBE)
    ).encode()


def _dae() -> bytes:
    points = " ".join(f"{x:g}" for x in CORNERS.ravel())
    index = " ".join(map(str, CUBE.ravel()))
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_images><image id="i"><init_from>image.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><newparam sid="s"><surface type="2D">
<init_from>i</init_from></surface></newparam><newparam sid="t"><sampler2D><source>s</source>
</sampler2D></newparam><technique sid="c"><phong><diffuse><texture texture="t" texcoord="UV"/>
</diffuse><transparency><float>1</float></transparency></phong></technique></profile_COMMON>
</effect></library_effects>
<library_materials><material id="m" name="m"><instance_effect url="#e"/></material>
</library_materials>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="24">{points}
</float_array><technique_common><accessor source="#pa" count="8" stride="3"><param name="X"
type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
</technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="12" material="s"><input semantic="VERTEX" source="#v" offset="0"/><p>{index}</p>
</triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="n"><matrix>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1
</matrix><instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="s"
target="#m"/></technique_common></bind_material></instance_geometry></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>""".encode()


@cache
def files_of_meshes() -> Content:
    maker = _textured()
    return {
        "m/cube.obj": _OBJ.encode(),
        "m/cube.mtl": _MTL.encode(),
        "m/image.png": png(8, 8),
        "m/cube.stl": _stl(),
        "m/ascii.stl": _ascii_stl(),
        "m/cube.ply": _ply(),
        "m/cube.dae": _dae(),
        "m/cube.glb": maker.glb(),
        "m/cube.gltf": maker.gltf().encode(),
        "m/link.obj": Special("link", "../../secret/secret.obj"),
        "m/pipe.obj": Special("fifo"),
        "m/folder.obj": Special("folder"),
    }


def _change_lines(rng: CaseRng, data: bytes, name: str) -> bytes:
    """Change lines and words of a text format."""
    from .rng import NAMES, NUMBERS

    lines = data.decode().split("\n")
    for _ in range(1 + len(rng.few(3))):
        k = rng.randrange(len(lines))
        words = lines[k].split(" ")
        how = rng.choice(["number", "name", "reference", "delete", "copy", "word", "long"])
        if how == "delete":
            del lines[k]
        elif how == "copy":
            lines[k:k] = [lines[k]] * rng.choice([1, 2, 1000])
        elif how == "word":
            del words[rng.randrange(len(words))]
            lines[k] = " ".join(words)
        elif how == "long":
            lines[k] += " " + " ".join(["1"] * rng.choice([1, 10, 10_000]))
        else:
            pool = {"number": NUMBERS, "name": NAMES, "reference": REFERENCES}[how]
            words[rng.randrange(len(words))] = rng.choice(pool)
            lines[k] = " ".join(words)
        rng.note(f"{name}: line {k} {how} {lines[min(k, len(lines) - 1)][:40]!a}")
        lines = lines or [""]
    return "\n".join(lines).encode(errors="replace")


def _text(*names: str) -> Callable[[CaseRng, Content], list[str]]:
    """Changes one of some text files, or a texture."""

    def change(rng: CaseRng, files: Content) -> list[str]:
        changed = (
            [rng.choice([n for n in names if not n.endswith(".png")])] if rng.chance(0.9) else []
        )
        for name in changed:
            data = files[f"m/{name}"]
            assert isinstance(data, bytes)
            files[f"m/{name}"] = (
                change_bytes(rng, data, name)
                if rng.chance(0.15)
                else _change_lines(rng, data, name)
            )
        if any(n.endswith(".png") for n in names) and rng.chance(0.3):
            files["m/image.png"] = change_png(rng, png(8, 8), "image.png")
        return changed

    return change


def _binary_stl(rng: CaseRng, files: Content) -> list[str]:
    count, corners = rng.choice([12, 12, 0, 1, 13, 2**31, 2**32 - 1]), CORNERS[CUBE].astype("<f4")
    odd = rng.choice([0.0, 1.0, np.nan, np.inf, 1e30, 1e-30, -1e9])
    corners[rng.randrange(12), rng.randrange(3), rng.randrange(3)] = odd
    head = rng.choice([bytes(80), b"solid ".ljust(80), b"\xff" * 80])
    body = b"".join(struct.pack("<3f", 0, 0, odd) + c.tobytes() + b"\0\0" for c in corners)
    data = head + struct.pack("<I", count) + body
    files["m/cube.stl"] = change_bytes(rng, data, "cube.stl") if rng.chance(0.4) else data
    return [f"cube.stl with {count} triangles, {odd}"]


def _collada(rng: CaseRng, files: Content) -> list[str]:
    root = ElementTree.fromstring(_dae())
    for _ in range(1 + len(rng.few(3))):
        change_xml(
            rng,
            root,
            "cube.dae",
            lambda: ElementTree.Element(
                rng.choice(["node", "extra", "triangles", "polylist", "instance_node", "source"]),
                {"url": "#n", "id": "n", "count": "1"},
            ),
        )
    files["m/cube.dae"] = dump_xml(rng, root, "cube.dae")
    return []


def _gltf_mesh(text: bool) -> Callable[[CaseRng, Content], list[str]]:
    def change(rng: CaseRng, files: Content) -> list[str]:
        maker = rng.choice([_textured, _plain])()
        for _ in range(1 + len(rng.few(3))):
            change_tree(rng, maker.tree, "cube")
        name = "m/cube.gltf" if text else "m/cube.glb"
        data = _dump_gltf(rng, maker, text)
        files[name] = change_bytes(rng, data, name) if rng.chance(0.15) else data
        return []

    return change


MESHES: dict[str, Callable[[CaseRng, Content], list[str]]] = {
    "cube.obj": _text("cube.obj", "cube.obj", "cube.mtl", "image.png"),
    "ascii.stl": _text("ascii.stl"),
    "cube.stl": _binary_stl,
    "cube.ply": _text("cube.ply"),
    "cube.dae": _collada,
    "cube.glb": _gltf_mesh(False),
    "cube.gltf": _gltf_mesh(True),
}


# -- glTF -----------------------------------------------------------------------------------------


def _plain() -> Maker:
    maker = Maker()
    made = maker.mesh()
    top = maker.node(name="top", mesh=made)
    maker.node(top, name="arm", translation=[0, 1, 0], rotation=[0, 0, 0, 1], mesh=made)
    maker.node(top, name="leg", scale=[1, 2, 1], mesh=made)
    maker.scene(top)
    return maker


def _walker() -> Maker:
    """Skinned, morphing and animated."""
    maker = Maker()
    _, tip, body = bent_bar(maker)
    count = maker.tree["accessors"][0]["count"]
    shift = np.zeros((count, 3))
    shift[:, 1] = 0.1
    maker.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": maker.accessor(shift)}]
    maker.animate(
        [
            (tip, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0.5, 0.5]], "LINEAR"),
            (tip, "translation", [0, 0.5, 1], [[0, 1, 0], [0, 1, 0.2], [0, 1, 0]], "STEP"),
            (body, "weights", [0, 1], [0.0, 1.0], "LINEAR"),
        ],
        name="walk",
    )
    return maker


def _textured() -> Maker:
    maker = Maker()
    maker.add("images", bufferView=maker.view(png(8, 8)), mimeType="image/png")
    maker.add("samplers", magFilter=9729, wrapS=10497)
    maker.add("textures", source=0, sampler=0)
    maker.add(
        "materials",
        name="paint",
        alphaMode="OPAQUE",
        doubleSided=True,
        pbrMetallicRoughness={
            "baseColorTexture": {"index": 0, "texCoord": 0},
            "baseColorFactor": [1, 0.5, 0.5, 1],
            "metallicFactor": 0.1,
            "roughnessFactor": 0.5,
        },
    )
    uv = maker.accessor(CORNERS[:, :2])
    made = maker.mesh(
        primitive={"material": 0}, TEXCOORD_0=uv, COLOR_0=maker.accessor(np.full((8, 3), 0.5))
    )
    maker.scene(maker.node(name="top", mesh=made, children=[maker.node(name="arm", mesh=made)]))
    return maker


GLTF: dict[str, Callable[[], Maker]] = {
    "skinned": _walker,
    "textured": _textured,
    "plain": _plain,
}


def _dump_gltf(rng: CaseRng, maker: Maker, text: bool) -> bytes:
    """Like the maker's own, with values that JSON does not express."""
    blob = bytes(maker.data) + bytes(-len(maker.data) % 4)
    tree: dict[str, Any] = dict(maker.tree)
    if text:
        uri = rng.choice(
            ["data.bin"] * 6
            + [
                "link.bin",
                "../secret/secret.bin",
                "/etc/passwd",
                "data:;base64,AAAA",
                "http://127.0.0.1:9/x.bin",
            ]
        )
        tree.setdefault("buffers", [{"byteLength": len(maker.data), "uri": uri}])
        return dump_tree(tree)
    tree.setdefault("buffers", [{"byteLength": len(blob)}])
    body = dump_tree(tree)
    body += b" " * (-len(body) % 4)
    chunks = struct.pack("<II", len(body), 0x4E4F534A) + body
    chunks += struct.pack("<II", len(blob), 0x004E4942) + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
