"""Write an appliance as a folder in the layout of PartNet-Mobility.

Meshes are in the object's frame (y up, z to the front); the root `base` turns them upright. The
files depend on the appliance alone.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from ..model import JointType
from .finish import Finish, Shape
from .fittings import Appliance
from .shapes import Solid, join
from .textures import encode_png

_WORDS = {JointType.REVOLUTE: "hinge", JointType.PRISMATIC: "slider", JointType.FIXED: "static"}
_DIGITS = 5
"""Decimals of lengths in m."""


@dataclass(frozen=True)
class MeshGroup:
    """Triangles of one finish, with the digits that the files have."""

    material: str
    finish: Finish
    vertices: Array
    """[V 3] m, sorted."""
    normals: Array
    """[N 3] unit up to rounding, sorted."""
    uv: Array | None
    """[T 2] texture coordinates, sorted; None without an image."""
    corners: NDArray[np.int64]
    """[F 3 2] indices (vertex, normal), or [F 3 3] (vertex, uv, normal)."""


@dataclass(frozen=True)
class Mesh:
    """The shapes of one name of a part, in one group per finish."""

    name: str
    number: int
    """Of the OBJ: counted over all parts."""
    groups: tuple[MeshGroup, ...]


def appliance_meshes(appliance: Appliance) -> list[list[Mesh]]:
    """Return the meshes of each part."""
    out, number = list[list[Mesh]](), 0
    for part in appliance.parts:
        out.append([])
        for name in dict.fromkeys(shape.name for shape in part.shapes):
            finishes: dict[str, list[Shape]] = {}
            for shape in part.shapes:
                if shape.name == name:
                    finishes.setdefault(shape.finish.name, []).append(shape)
            out[-1].append(Mesh(name, number, tuple(
                _mesh_group(shapes, f"material_{number}_{k}")
                for k, shapes in enumerate(finishes.values()))))
            number += 1
    return out


def urdf_text(appliance: Appliance, meshes: Sequence[Sequence[Mesh]]) -> str:
    """Return the URDF of an appliance."""
    name = hashlib.sha256(f"{appliance.category} {appliance.number}".encode()).hexdigest()[:32]
    out = ['<?xml version="1.0" ?>', f'<robot name="partnet_{name}">', '\t<link name="base"/>']
    for k, part in enumerate(appliance.parts):
        out.append(f'\t<link name="link_{k}">')
        place = _vector(-np.array(part.origin))
        for tag in ("visual", "collision"):
            for mesh in meshes[k]:
                named = f' name="{mesh.name}-{mesh.number}"' if tag == "visual" else ""
                out += [f"\t\t<{tag}{named}>", f'\t\t\t<origin xyz="{place}"/>', "\t\t\t<geometry>",
                        f'\t\t\t\t<mesh filename="textured_objs/original-{mesh.number}.obj"/>',
                        "\t\t\t</geometry>", f"\t\t</{tag}>"]
        out.append("\t</link>")
    for k, part in enumerate(appliance.parts[1:], 1):
        shift = np.array(part.origin) - np.array(appliance.parts[part.parent].origin)
        out += [f'\t<joint name="joint_{k}" type="{part.joint}">',
                f'\t\t<origin xyz="{_vector(shift)}"/>']
        if part.joint is not JointType.FIXED:
            out.append(f'\t\t<axis xyz="{_vector(np.array(part.axis))}"/>')
        out += [f'\t\t<child link="link_{k}"/>', f'\t\t<parent link="link_{part.parent}"/>']
        if part.joint is not JointType.FIXED:
            low, high = part.limits
            out.append(f'\t\t<limit lower="{low:g}" upper="{high:g}"/>')
        out.append("\t</joint>")
    out += ['\t<joint name="joint_0" type="fixed">',
            '\t\t<origin rpy="1.570796326794897 0 -1.570796326794897" xyz="0 0 0"/>',
            '\t\t<child link="link_0"/>', '\t\t<parent link="base"/>', "\t</joint>", "</robot>"]
    return "\n".join(out) + "\n"


def write_partnet(appliance: Appliance, folder: Path) -> None:
    """Write all files of an appliance into an empty folder."""
    for name in ("textured_objs", "images"):
        (folder / name).mkdir(parents=True)
    images: dict[bytes, int] = {}
    meshes = appliance_meshes(appliance)
    for mesh in chain.from_iterable(meshes):
        _write_mesh(folder, mesh, images)
    for data, number in images.items():
        (folder / "images" / f"texture_{number}.png").write_bytes(data)
    _write(folder / "mobility.urdf", urdf_text(appliance, meshes))
    _write(folder / "semantics.txt", "\n".join(
        f"link_{k} {_WORDS[part.joint] if k else 'heavy'} {part.role}"
        for k, part in enumerate(appliance.parts)) + "\n")
    points = np.concatenate([s.solid.vertices for part in appliance.parts for s in part.shapes])
    _write_json(folder / "bounding_box.json", {
        "min": round_lengths(points.min(0)).tolist(), "max": round_lengths(points.max(0)).tolist()})
    _write_json(folder / "meta.json", {
        "model_id": f"{appliance.category.lower()}-{appliance.number}",
        "anno_id": str(appliance.number), "user_id": "gcbench", "time_in_sec": 0, "version": "1",
        "model_cat": appliance.category})
    _write_json(folder / "mobility_v2.json", _mobility(appliance, meshes))
    for name in ("result.json", "result_after_merging.json"):
        _write_json(folder / name, _part_tree(appliance, meshes))


def round_lengths(values: Array) -> Array:
    """Return lengths in m with the digits of the files; minus zero becomes zero."""
    return np.round(values, _DIGITS) + 0.0


def _mesh_group(shapes: Sequence[Shape], material: str) -> MeshGroup:
    solid, finish = join([shape.solid for shape in shapes]), shapes[0].finish
    vertices, vertex = _unique(solid.vertices, _DIGITS)
    normals, normal = _unique(solid.normals, 3)
    corners, uv = [vertex[solid.faces]], None
    if finish.image is not None:
        values, faces = _texture_coordinates(solid, finish.tile)
        uv, index = _unique(values, 4)
        corners.append(index[faces])
    corners.append(normal[solid.faces])
    # corners without radius have triangles without area
    kept = (corners[0] != np.roll(corners[0], 1, axis=1)).all(1)
    return MeshGroup(material, finish, vertices, normals, uv, np.stack(corners, axis=-1)[kept])


def _unique(values: Array, digits: int) -> tuple[Array, NDArray[np.int64]]:
    """Unique rows of rounded values, and the index of each value among them."""
    rows, index = np.unique(np.round(values, digits) + 0.0, axis=0, return_inverse=True)
    return rows, index.reshape(-1).astype(np.int64)


def _texture_coordinates(solid: Solid, tile: float) -> tuple[Array, NDArray[np.int64]]:
    """Coordinates [K 2] and their index [F 3]: the solid's own, else a projection of each face
    along the axis that its normal is nearest to."""
    if solid.uv is not None:
        return solid.uv, solid.faces
    p = solid.vertices[solid.faces]
    axis = np.abs(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])).argmax(1)
    kept = np.array([[2, 1], [0, 2], [0, 1]])[axis]  # (u, v) of each face
    uv = np.take_along_axis(p, np.repeat(kept[:, None], 3, axis=1), axis=2) / tile
    return uv.reshape(-1, 2), np.arange(3 * len(p), dtype=np.int64).reshape(-1, 3)


def _write_mesh(folder: Path, mesh: Mesh, images: dict[bytes, int]) -> None:
    """Write an OBJ and its MTL; new images are numbered."""
    path = folder / "textured_objs" / f"original-{mesh.number}.obj"
    lines, materials = [f"mtllib {path.stem}.mtl"], list[str]()
    counts = {"v": 1, "vt": 1, "vn": 1}  # OBJ numbers from 1
    for k, group in enumerate(mesh.groups):
        red, green, blue = (value / 255.0 for value in group.finish.color)
        materials += [f"newmtl {group.material}", f"Kd {red:.4f} {green:.4f} {blue:.4f}",
                      "Ka 0 0 0", "Ks 0.2 0.2 0.2", "Ns 40", f"d {group.finish.opacity:.3g}"]
        if group.finish.image is not None:
            image = images.setdefault(encode_png(group.finish.image), len(images))
            materials.append(f"map_Kd ../images/texture_{image}.png")
        lines += [f"g {mesh.name}-{k}", f"usemtl {group.material}", *_obj_lines(group, counts)]
    _write(path, "\n".join(lines) + "\n")
    _write(path.with_suffix(".mtl"), "\n".join(materials) + "\n")


def _obj_lines(group: MeshGroup, counts: dict[str, int]) -> list[str]:
    """Lines of a group; `counts`, the next number of each kind of row, goes on."""
    tables: dict[str, tuple[Array, int]] = {"v": (group.vertices, _DIGITS)}
    if group.uv is not None:
        tables["vt"] = group.uv, 4
    tables["vn"] = group.normals, 3
    lines = [f"{tag} " + " ".join(f"{x:.{digits}f}" for x in row)
             for tag, (rows, digits) in tables.items() for row in rows.tolist()]
    separator = "//" if group.uv is None else "/"
    corners = group.corners + [counts[tag] for tag in tables]
    for tag, (rows, _) in tables.items():
        counts[tag] += len(rows)
    return [*lines, *("f " + " ".join(separator.join(map(str, c)) for c in face)
                      for face in corners.tolist())]


def _mobility(appliance: Appliance, meshes: Sequence[Sequence[Mesh]]) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for k, part in enumerate(appliance.parts):
        data: dict[str, Any] = {}
        if part.joint is not JointType.FIXED:
            low, high = part.limits
            if part.joint is not JointType.PRISMATIC:
                low, high = (round(math.degrees(x), 4) for x in part.limits)
            data = {"axis": {"origin": round_lengths(np.array(part.origin)).tolist(),
                             "direction": list(part.axis)},
                    "limit": {"a": low, "b": high, "noLimit": False}}
        out.append({
            "id": k, "parent": part.parent if k else -1,
            "joint": _WORDS[part.joint] if k else "heavy", "name": part.role,
            "parts": [{"id": m.number, "name": m.name, "children": []} for m in meshes[k]],
            "jointData": data})
    return out


def _part_tree(appliance: Appliance, meshes: Sequence[Sequence[Mesh]]) -> list[dict[str, Any]]:
    first = sum(map(len, meshes)) + 1  # leaves have the numbers of their meshes
    children = [
        {"id": first + k, "name": part.role, "text": part.role.title(), "children": [
            {"id": m.number, "name": m.name, "text": m.name.replace("_", " ").title(),
             "objs": [f"original-{m.number}"]} for m in meshes[k]]}
        for k, part in enumerate(appliance.parts)]
    return [{"id": first + len(children), "name": appliance.category.lower(),
             "text": appliance.category, "children": children}]


def _vector(values: Array) -> str:
    return " ".join(f"{x:.{_DIGITS}f}" for x in round_lengths(values).tolist())


def _write(path: Path, text: str) -> None:
    path.write_bytes(text.encode())  # the same line ends everywhere


def _write_json(path: Path, tree: Any) -> None:
    _write(path, json.dumps(tree, indent=1) + "\n")
