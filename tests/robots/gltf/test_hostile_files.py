"""glTF files that are broken or mean harm: each is refused in one line that names it."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench.errors import ModelError
from gcbench.robots.gltf.reader import load_gltf

from ...support.gltf_maker import CUBE, Maker, bent_bar

Tree = dict[str, Any]


def refuse(path: Path, reason: str, content: bytes | None = None) -> None:
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelError, match=reason) as caught:
        load_gltf(path)
    text = str(caught.value)
    assert path.name in text and "\n" not in text and len(text) < 2000
    assert "cannot be read as glTF" not in text  # each has a reason of its own


def walker() -> Maker:
    """A skinned, morphing, animated file for tests to break."""
    maker = Maker()
    _, tip, body = bent_bar(maker)
    count = maker.tree["accessors"][0]["count"]
    maker.tree["meshes"][0]["primitives"][0]["targets"] = [
        {"POSITION": maker.accessor(np.zeros((count, 3)))}]
    maker.animate([(tip, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]], "LINEAR"),
                   (body, "weights", [0, 1], [0.0, 1.0], "LINEAR")])
    return maker


def put(*path: Any) -> Callable[[Tree], None]:
    """Puts the last of `path` where the others lead; `...` deletes what is there."""
    def change(tree: Tree) -> None:
        at: Any = tree
        for step in path[:-2]:
            at = at[step]
        if path[-1] is ...:
            del at[path[-2]]
        else:
            at[path[-2]] = path[-1]
    return change


def test_what_is_broken_below_is_whole_before(tmp_path: Path) -> None:
    assert load_gltf(walker().save(tmp_path)).animations


@pytest.mark.parametrize(("change", "reason"), [
    (put("asset", ...), "no asset"),
    (put("asset", "version", "1.0"), "export it as glTF 2.0"),
    (put("asset", "version", 2), "export it as glTF 2.0"),
    (put("asset", "minVersion", "2.1"), "needs glTF of version '2.1'"),
    (put("extensionsRequired", ["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
    (put("extensionsRequired", ["EXT_meshopt_compression", "KHR_texture_basisu"]),
     "EXT_meshopt_compression, KHR_texture_basisu"),
    (put("extensionsRequired", ["VENDOR_unheard_of"]), "VENDOR_unheard_of"),
    (put("scene", 5), "scene: index 5 of 1 scenes"),
    (put("scene", "x"), "scene: expected an index"),
    (put("scenes", 0, "nodes", [99]), r"scenes\[0\].nodes\[0\]: index 99 of 3 nodes"),
    (put("scenes", 0, "nodes", []), "nothing to draw"),
    (put("samplers", {}), "samplers: expected array, got object"),
    (put("nodes", 1, "children", [0]), "its own ancestor"),
    (put("nodes", 1, "children", [1]), "two parents"),
    (put("nodes", 2, "children", [1]), "two parents"),
    (put("nodes", 0, "mesh", -1), "mesh: index -1 of 1 meshes"),
    (put("nodes", 0, "mesh", True), "expected an index"),
    (put("nodes", 0, "matrix", [1.0] * 16), "not affine"),
    (put("nodes", 1, "matrix", np.eye(4).ravel().tolist()), "too"),
    (put("nodes", 0, "rotation", [0, 0, 0, 0]), "zero length"),
    (put("nodes", 0, "translation", [0, 1e300, 0]), r"translation\[1\]: expected float <= 1e\+30"),
    (put("nodes", 0, "scale", [1, 2]), "expected array of length 3"),
    (put("nodes", 2, "skin", 3), "index 3 of 1 skins"),
    (put("nodes", 2, "weights", [1.0, 2.0]), "2 weights for 1"),
    (put("skins", 0, "joints", []), "expected array of length >= 1"),
    (put("skins", 0, "joints", [0]), "joint 1 of a skin that has 1"),
    (put("skins", 0, "inverseBindMatrices", 0), "inverse bind"),
    (put("meshes", 0, "primitives", []), "expected array of length >= 1"),
    (put("meshes", 0, "primitives", 0, "attributes", "POSITION", ...), "nothing to draw"),
    (put("meshes", 0, "primitives", 0, "attributes", "WEIGHTS_0", ...), "no WEIGHTS_0"),
    (put("meshes", 0, "primitives", 0, "attributes", "JOINTS_0", ...), "no JOINTS_0"),
    (put("meshes", 0, "primitives", 0, "attributes", "NORMAL", 1), "NORMAL is VEC4"),
    (put("meshes", 0, "primitives", 0, "mode", 7), "mode: expected int <= 6"),
    (put("meshes", 0, "primitives", 0, "mode", 0), "nothing to draw"),
    (put("meshes", 0, "primitives", 0, "indices", 0), "not scalars"),
    (put("accessors", 0, "count", 3), "WEIGHTS|JOINTS|index"),
    (put("accessors", 0, "count", 0), "count: expected int >= 1"),
    (put("accessors", 2, "count", 10**6), "needs"),
    (put("accessors", 2, "count", 10**9), "more than"),
    (put("accessors", 0, "count", 10**30), "count: expected int"),
    (put("accessors", 0, "byteOffset", 10**6), "needs"),
    (put("accessors", 0, "componentType", 5124), "componentType: invalid enum value 5124"),
    (put("accessors", 0, "type", "VEC9"), "type: invalid enum value 'VEC9'"),
    (put("accessors", 0, "sparse", {"count": 999, "indices": {}, "values": {}}),
     "missing required field bufferView"),
    (put("bufferViews", 0, "byteLength", 2**40), "ends at byte"),
    (put("bufferViews", 0, "byteStride", 4), "overlap"),
    (put("bufferViews", 0, "buffer", 1), "index 1 of 1 buffers"),
    (put("animations", 0, "channels", 0, "sampler", 9), "there are 2 samplers"),
    (put("animations", 0, "channels", 0, "target", "path", "color"), "moves 'color'"),
    (put("animations", 0, "channels", 0, "target", "path", "scale"), "wrong type"),
    (put("animations", 0, "channels", 1, "target", {"node": 1, "path": "rotation"}), "once more"),
    (put("animations", 0, "samplers", 0, "interpolation", "BEZIER"), "invalid enum value 'BEZIER'"),
    (put("animations", 0, "samplers", 0, "interpolation", "CUBICSPLINE"), "2 values for 2 keys"),
    (put("animations", 0, "samplers", 0, "output", 3), "wrong type"),
])
def test_broken_documents(tmp_path: Path, change: Callable[[Tree], None], reason: str) -> None:
    maker = walker()
    maker.tree["buffers"] = [{"byteLength": len(maker.data)}]
    change(maker.tree)
    refuse(maker.save(tmp_path), reason)


@pytest.mark.parametrize(("accessor", "value", "reason"), [
    (2, float("nan"), "not finite"), (2, float("inf"), "not finite"), (2, 1e20, "1e9 units"),
    (1, float("nan"), "not finite"),
])
def test_numbers_that_are_none(tmp_path: Path, accessor: int, value: float, reason: str) -> None:
    maker = walker()
    view = maker.tree["bufferViews"][maker.tree["accessors"][accessor]["bufferView"]]
    struct.pack_into("<f", maker.data, view["byteOffset"], value)
    refuse(maker.save(tmp_path), reason)


def test_indices_beyond_the_vertices(tmp_path: Path) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(faces=CUBE + 1))
    refuse(maker.save(tmp_path), "index 8 of 8")


def test_a_circle_of_nodes(tmp_path: Path) -> None:
    maker = walker()
    maker.tree["nodes"] += [{"children": [4]}, {"children": [3]}]
    refuse(maker.save(tmp_path), "its own ancestor")


def test_key_times_must_rise(tmp_path: Path) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh())
    maker.animate([(node, "translation", [1, 1], [[0, 0, 0], [1, 0, 0]], "LINEAR")])
    refuse(maker.save(tmp_path), "do not rise")


def test_broken_glb(tmp_path: Path) -> None:
    whole = walker().glb()
    path = tmp_path / "m.glb"
    for length in (4, 11, 19, 100, len(whole) - 1):
        refuse(path, "whole GLB file", whole[:length])
    refuse(path, "version 1", b"glTF" + struct.pack("<I", 1) + whole[8:])
    refuse(path, "first chunk", whole[:16] + b"BAD!" + whole[20:])
    refuse(path, "reaches beyond", whole[:12] + struct.pack("<I", 2**31) + whole[16:])
    refuse(path, "JSON", b"")
    refuse(path, "JSON", b"\xff\xfe\x00")
    refuse(path, "JSON is not UTF-8", b'{"asset": {"version": "2.0"}, "extras": "\xf6"}')
    refuse(path, "expected object, got array", b"[1]")
    refuse(path, "broken", b"[" * 200_000)
    refuse(path, "JSON is broken", b'{"asset": {"version": "2.0"}, "scene": NaN}')
    refuse(path, "no such file|no asset", b'{"a": ' + b"9" * 4000 + b"}")


@pytest.mark.parametrize(("uri", "reason"), [
    ("/etc/passwd", "absolute"), ("../secret.bin", "folder"), ("a/../../secret.bin", "folder"),
    ("%2e%2e/secret.bin", "folder"), ("http://example.com/a.bin", "network"),
    ("file:///etc/passwd", "absolute"), ("C:\\a.bin", "absolute"), ("nowhere.bin", "missing"),
    ("data:application/octet-stream;base64,!!!!", "base64"), ("data:nothing", "without data"),
    ("data:;base64,AAAA", "3 bytes of"), ("", "empty"), ("link.bin", "folder"),
])
def test_buffers_stay_in_their_folder(tmp_path: Path, uri: str, reason: str) -> None:
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    maker = walker()
    maker.tree["buffers"] = [{"byteLength": len(maker.data), "uri": uri}]
    (folder / "m.gltf").write_text(json.dumps(maker.tree))
    refuse(folder / "m.gltf", reason)


def test_buffers_beside_the_file_are_read(tmp_path: Path) -> None:
    maker = walker()
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "data.bin").write_bytes(maker.data)
    maker.tree["buffers"] = [{"byteLength": len(maker.data), "uri": "sub%20dir/data.bin"}]
    (tmp_path / "m.gltf").write_text(json.dumps(maker.tree))
    assert load_gltf(tmp_path / "m.gltf").joint_names == ("tip",)


def test_a_small_file_cannot_ask_for_much(tmp_path: Path) -> None:
    zeros = {"componentType": 5126, "count": 2**26, "type": "VEC4"}
    tree: Tree = {"asset": {"version": "2.0"}, "accessors": [zeros], "nodes": [{"mesh": 0}],
                  "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
    (tmp_path / "m.gltf").write_text(json.dumps(tree))
    refuse(tmp_path / "m.gltf", "POSITION is VEC4|more than")
    maker = Maker()  # many instances of many triangles
    mesh = maker.mesh(faces=np.tile(CUBE, (1000, 1)))
    for _ in range(1000):
        maker.node(mesh=mesh)
    refuse(maker.save(tmp_path), "more than .* triangles")
    maker = Maker()
    mesh = maker.mesh()
    maker.tree["nodes"] = [{"mesh": mesh}] * 20_001
    refuse(maker.save(tmp_path), "nodes")
    maker = Maker()  # one accessor of many vertices, looked at by many primitives
    points = maker.accessor(np.zeros((100_000, 3)))
    primitive = {"attributes": {"POSITION": points}, "indices": maker.accessor([0, 1, 2], "B")}
    maker.node(mesh=maker.add("meshes", primitives=[primitive] * 2000))
    refuse(maker.save(tmp_path), "more than")


def test_channels_that_share_keys_share_memory_and_are_counted(tmp_path: Path) -> None:
    def file(keys: int, nodes: int) -> Path:
        maker = Maker()
        mesh = maker.mesh()
        sampler = {"input": maker.accessor(np.arange(keys, dtype=float)),
                   "output": maker.accessor(np.zeros((keys, 3)))}
        moved = [maker.node(mesh=mesh) for _ in range(nodes)]
        maker.add("animations", samplers=[sampler], channels=[
            {"sampler": 0, "target": {"node": n, "path": "translation"}} for n in moved])
        return maker.save(tmp_path)

    first, second = load_gltf(file(100, 2)).animations[0].tracks
    assert first.values is second.values and first.times is second.times
    refuse(file(100_000, 340), "too many keys")


def test_a_deep_tree_is_no_problem(tmp_path: Path) -> None:
    maker = Maker()
    mesh, above = maker.mesh(), None
    for _ in range(3000):
        above = maker.node(above)
    maker.node(above, mesh=mesh)
    maker.scene(0)
    assert len(load_gltf(maker.save(tmp_path)).part_names) == 3002
