"""Writes an articulated object as a folder in the layout of PartNet-Mobility.

Meshes are in the object's frame (y up, z to the front); the root `base` turns them upright. The
bytes depend on the object alone.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from .finish import Shape
from .fittings import Appliance
from .shapes import Solid, join
from .textures import encode_png

Indices = NDArray[np.int64]
_WORDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slider", "fixed": "static"}
_DIGITS = 5
"""Of a metre: a hundredth of a millimetre."""


def write_partnet(thing: Appliance, folder: Path) -> None:
    """Write all files of the object into an empty folder."""
    for name in ("textured_objs", "images"):
        (folder / name).mkdir(parents=True)
    pictures: dict[bytes, int] = {}
    files: list[list[tuple[str, int]]] = []  # of each link: (name of the visual, number of its OBJ)
    count = 0
    for link in thing.links:
        mine: list[tuple[str, int]] = []
        for name in dict.fromkeys(shape.name for shape in link.shapes):
            shapes = [shape for shape in link.shapes if shape.name == name]
            _write_mesh(folder, count, shapes, pictures)
            mine.append((name, count))
            count += 1
        files.append(mine)
    for data, number in pictures.items():
        (folder / "images" / f"texture_{number}.png").write_bytes(data)
    _write(folder / "mobility.urdf", _urdf(thing, files))
    _write(folder / "semantics.txt", "\n".join(
        f"link_{k} {_WORDS[link.joint] if k else 'heavy'} {link.role}"
        for k, link in enumerate(thing.links)) + "\n")
    points = np.concatenate([s.solid.vertices for link in thing.links for s in link.shapes])
    _write_json(folder / "bounding_box.json", {"min": _rounded(points.min(0)).tolist(),
                                               "max": _rounded(points.max(0)).tolist()})
    _write_json(folder / "meta.json", {
        "model_id": f"{thing.category.lower()}-{thing.number}", "anno_id": str(thing.number),
        "user_id": "gcbench", "time_in_sec": 0, "version": "1", "model_cat": thing.category})
    _write_json(folder / "mobility_v2.json", _mobility(thing, files))
    tree = _part_tree(thing, files)
    _write_json(folder / "result.json", tree)
    _write_json(folder / "result_after_merging.json", tree)


def _write_mesh(
    folder: Path, number: int, shapes: Sequence[Shape], pictures: dict[bytes, int]
) -> None:
    """An OBJ with a group a paint, and its MTL; new pictures are numbered."""
    lines, materials = [f"mtllib original-{number}.mtl"], list[str]()
    counts = np.zeros(3, np.int64)
    for k, paint in enumerate(dict.fromkeys(shape.finish.name for shape in shapes)):
        group = [shape for shape in shapes if shape.finish.name == paint]
        solid, finish = join([shape.solid for shape in group]), group[0].finish
        name = f"material_{number}_{k}"
        red, green, blue = (value / 255.0 for value in finish.color)
        materials += [f"newmtl {name}", f"Kd {red:.4f} {green:.4f} {blue:.4f}", "Ka 0 0 0",
                      "Ks 0.2 0.2 0.2", "Ns 40", f"d {finish.opacity:.3g}"]
        uv, uv_index = None, solid.faces
        if finish.image is not None:
            image = pictures.setdefault(encode_png(finish.image), len(pictures))
            materials.append(f"map_Kd ../images/texture_{image}.png")
            uv, uv_index = _texture_coordinates(solid, finish.tile)
        lines += [f"g {group[0].name}-{k}", f"usemtl {name}"]
        lines += _obj_group(solid, uv, uv_index, counts)
    _write(folder / "textured_objs" / f"original-{number}.obj", "\n".join(lines) + "\n")
    _write(folder / "textured_objs" / f"original-{number}.mtl", "\n".join(materials) + "\n")


def _obj_group(
    solid: Solid, uv: Array | None, uv_index: Indices, counts: Indices
) -> list[str]:
    """Lines of a group; `counts` [3] of v, vt, vn so far goes on."""
    def unique(values: Array, digits: int, tag: str) -> tuple[list[str], Indices]:
        known, index = np.unique(np.round(values, digits) + 0.0, axis=0, return_inverse=True)
        text = [f"{tag} " + " ".join(f"{x:.{digits}f}" for x in row) for row in known.tolist()]
        return text, index.reshape(-1).astype(np.int64)

    lines, v = unique(solid.vertices, _DIGITS, "v")
    place = v[solid.faces]
    kept = (place != np.roll(place, 1, axis=1)).all(1)  # corners of no radius have flat triangles
    corners = [place + 1 + counts[0]]
    counts[0] += len(lines)
    if uv is not None:
        text, t = unique(uv, 4, "vt")
        corners.append(t[uv_index] + 1 + counts[1])
        counts[1] += len(text)
        lines += text
    text, n = unique(solid.normals, 3, "vn")
    corners.append(n[solid.faces] + 1 + counts[2])
    counts[2] += len(text)
    separator = "/" if uv is not None else "//"
    table = np.stack(corners, axis=-1)[kept].tolist()
    return [*lines, *text, *("f " + " ".join(separator.join(map(str, c)) for c in face)
                             for face in table)]


def _texture_coordinates(solid: Solid, tile: float) -> tuple[Array, Indices]:
    """Coordinates [K 2] and their index [F 3]: the solid's own, else a projection of each face
    along the axis that it looks along most."""
    if solid.uv is not None:
        return solid.uv, solid.faces
    p = solid.vertices[solid.faces]
    axis = np.abs(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])).argmax(1)
    kept = np.array([[2, 1], [0, 2], [0, 1]])[axis]  # (u, v) of each face
    uv = np.take_along_axis(p, np.repeat(kept[:, None], 3, axis=1), axis=2) / tile
    return uv.reshape(-1, 2), np.arange(3 * len(p), dtype=np.int64).reshape(-1, 3)


def _urdf(thing: Appliance, files: Sequence[Sequence[tuple[str, int]]]) -> str:
    name = hashlib.sha256(f"{thing.category} {thing.number}".encode()).hexdigest()[:32]
    out = ['<?xml version="1.0" ?>', f'<robot name="partnet_{name}">', '\t<link name="base"/>']
    for k, (link, visuals) in enumerate(zip(thing.links, files, strict=True)):
        out.append(f'\t<link name="link_{k}">')
        place = _vector(-np.array(link.origin))
        for tag in ("visual", "collision"):
            for role, number in visuals:
                named = f' name="{role}-{number}"' if tag == "visual" else ""
                out += [f"\t\t<{tag}{named}>", f'\t\t\t<origin xyz="{place}"/>', "\t\t\t<geometry>",
                        f'\t\t\t\t<mesh filename="textured_objs/original-{number}.obj"/>',
                        "\t\t\t</geometry>", f"\t\t</{tag}>"]
        out.append("\t</link>")
    for k, link in enumerate(thing.links[1:], 1):
        shift = np.array(link.origin) - np.array(thing.links[link.parent].origin)
        out += [f'\t<joint name="joint_{k}" type="{link.joint}">',
                f'\t\t<origin xyz="{_vector(shift)}"/>']
        if link.joint != "fixed":
            out.append(f'\t\t<axis xyz="{_vector(np.array(link.axis))}"/>')
        out += [f'\t\t<child link="link_{k}"/>', f'\t\t<parent link="link_{link.parent}"/>']
        if link.joint in ("revolute", "prismatic"):
            low, high = link.limits
            out.append(f'\t\t<limit lower="{low:g}" upper="{high:g}"/>')
        out.append("\t</joint>")
    out += ['\t<joint name="joint_0" type="fixed">',
            '\t\t<origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/>',
            '\t\t<child link="link_0"/>', '\t\t<parent link="base"/>', "\t</joint>", "</robot>"]
    return "\n".join(out) + "\n"


def _mobility(thing: Appliance, files: Sequence[Sequence[tuple[str, int]]]) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for k, (link, visuals) in enumerate(zip(thing.links, files, strict=True)):
        data: dict[str, Any] = {}
        if link.joint != "fixed":
            low, high = link.limits
            if link.joint != "prismatic":
                low, high = (round(math.degrees(x), 4) for x in link.limits)
            data = {"axis": {"origin": _rounded(np.array(link.origin)).tolist(),
                             "direction": list(link.axis)},
                    "limit": {"a": low, "b": high, "noLimit": link.joint == "continuous"}}
        out.append({
            "id": k, "parent": link.parent if k else -1,
            "joint": _WORDS[link.joint] if k else "heavy", "name": link.role,
            "parts": [{"id": n, "name": role, "children": []} for role, n in visuals],
            "jointData": data})
    return out


def _part_tree(
    thing: Appliance, files: Sequence[Sequence[tuple[str, int]]]
) -> list[dict[str, Any]]:
    number = sum(map(len, files)) + 1  # leaves have the numbers of their files
    children: list[dict[str, Any]] = []
    for link, visuals in zip(thing.links, files, strict=True):
        leaves = [{"id": n, "name": role, "text": role.replace("_", " ").title(),
                   "objs": [f"original-{n}"]} for role, n in visuals]
        children.append({"id": number, "name": link.role, "text": link.role.title(),
                         "children": leaves})
        number += 1
    name = thing.category.lower()
    return [{"id": number, "name": name, "text": thing.category, "children": children}]


def _rounded(values: Array) -> Array:
    return np.round(values, _DIGITS) + 0.0


def _vector(values: Array) -> str:
    return " ".join(f"{x:.{_DIGITS}f}" for x in _rounded(values).tolist())


def _write(path: Path, text: str) -> None:
    path.write_bytes(text.encode())  # the same line ends everywhere


def _write_json(path: Path, tree: Any) -> None:
    _write(path, json.dumps(tree, indent=1) + "\n")
