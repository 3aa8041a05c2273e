"""Generated microwaves, dishwashers, ovens and chests of drawers.

An instance is a function of its category and its number. It is the same on every machine.
"""

from __future__ import annotations

import hashlib
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..files import cache_folder, create_folder_atomically
from ..geometry import transform
from ..model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Material,
    TriangleSurface,
    base_color,
    clean_surface,
    move_surface,
)
from .dishwasher import dishwasher
from .drawers import chest_of_drawers
from .fittings import Appliance, Part
from .microwave import microwave
from .oven import oven
from .partnet_export import (
    Mesh,
    MeshGroup,
    appliance_meshes,
    round_lengths,
    urdf_text,
    write_partnet,
)
from .textures import SeededRng

VERSION = 3
"""Version of the generator. A change of any instance is a new version."""
CATEGORIES = ("microwave", "dishwasher", "oven")
"""The categories of the paper. The suites hold them, and flow networks are trained on them."""
GENERATED = (*CATEGORIES, "drawer")
IDS: Mapping[str, range] = MappingProxyType({
    "test": range(100_000), "train": range(100_000, 1_000_000)})
"""Instances by stream. The streams share none, so that a method that was trained on one is tested
on unseen instances."""
LAST_ID = IDS["train"].stop - 1
APPLIANCE_SOURCE = f"gcbench appliance generator, version {VERSION}"
APPLIANCE_LICENCE = "MIT"

DESIGNS: Mapping[str, Callable[[SeededRng, int], Appliance]] = MappingProxyType({
    "microwave": microwave, "dishwasher": dishwasher, "oven": oven, "drawer": chest_of_drawers})
"""What draws an instance of each category from a generator that its number seeds."""

_QUARTER = math.cos(1.570796326794897)  # of the angle that PartNet-Mobility writes for 90 deg
_BASE_FROM_BODY = transform(
    [[_QUARTER, _QUARTER, -1.0], [-1.0, _QUARTER**2, -_QUARTER], [0.0, 1.0, _QUARTER]])
"""Rz(-90 deg) Rx(90 deg): from y up and z to the front, to z up and -x to the front."""


def design_appliance(category: str, number: int) -> Appliance:
    """Return the design of an instance: its parts, joints, shapes and finishes."""
    generator = np.random.Generator(np.random.PCG64([zlib.crc32(category.encode()), number]))
    return DESIGNS[category](SeededRng(generator), number)


def appliance_model(category: str, number: int) -> ArticulatedModel:
    """Build the model of an instance in memory; z is up, the front looks along -x.

    It equals the model that `robots.urdf` reads from the files of `write_appliance`, to the last
    bit: numbers have the digits of the files. Its `sha256` is that of the URDF.
    """
    appliance = design_appliance(category, number)
    names, meshes = _part_names(appliance), appliance_meshes(appliance)
    links = [Link("base")]
    for k, part in enumerate(appliance.parts):
        parent, pose, joint = "base", _BASE_FROM_BODY, Joint()
        if k:
            above = appliance.parts[part.parent]
            shift = np.array(part.origin) - np.array(above.origin)
            parent, pose = names[part.parent], transform(translation=round_lengths(shift))
            if part.joint is not JointType.FIXED:
                low, high = (float(f"{limit:g}") for limit in part.limits)
                axis = round_lengths(np.array(part.axis))
                joint = Joint(names[k], part.joint, axis, limits=(low, high))
        links.append(Link(names[k], parent, pose, joint, _part_surfaces(part, meshes[k])))
    model = ArticulatedModel.from_links(f"{category}:{number}", links)
    said = ", ".join(f"link_{k} is {name}" for k, name in enumerate(names))
    return replace(model, source=APPLIANCE_SOURCE, licence=APPLIANCE_LICENCE,
                   sha256=hashlib.sha256(urdf_text(appliance, meshes).encode()).hexdigest(),
                   notes=(f"named by semantics.txt: {said}",))


def write_appliance(category: str, number: int, folder: Path) -> None:
    """Write an instance in the layout of PartNet-Mobility, in m, into an empty folder."""
    write_partnet(design_appliance(category, number), folder)


def appliance_folder(category: str, number: int) -> Path:
    """Return the folder of an instance's files in the cache; write it first if it is not there."""
    target = cache_folder() / "appliances" / f"{category}-v{VERSION}" / f"{number:06d}"
    return create_folder_atomically(
        target, f"{category}:{number}", lambda folder: write_appliance(category, number, folder))


def _part_names(appliance: Appliance) -> list[str]:
    """The roles of the parts; further parts of one role are "rack_2", "rack_3"."""
    names = list[str]()
    for part in appliance.parts:
        count = sum(name.partition("_")[0] == part.role for name in names)
        names.append(f"{part.role}_{count + 1}" if count else part.role)
    return names


def _part_surfaces(part: Part, meshes: Sequence[Mesh]) -> tuple[TriangleSurface, ...]:
    """Surfaces of a part in its own frame, in the order in which trimesh reads an OBJ's groups."""
    pose = transform(translation=round_lengths(-np.array(part.origin)))
    found = [_surface(group) for mesh in meshes for group in reversed(mesh.groups)]
    # the reader of URDFs moves a surface by its scale, then by its origin; each step rounds
    return tuple(move_surface(move_surface(s, np.eye(4)), pose) for s in found if s is not None)


def _surface(group: MeshGroup) -> TriangleSurface | None:
    """The surface of a group, its vertices in the order in which trimesh reads them."""
    corners = group.corners.reshape(-1, group.corners.shape[2])
    rows, index = np.unique(corners[:, ::-1], axis=0, return_inverse=True)
    order = rows[:, -1].argsort()
    rows, faces = rows[order, ::-1], order.argsort()[index.reshape(-1, 3)]
    return clean_surface(group.vertices[rows[:, 0]], faces, group.normals[rows[:, -1]],
                   None if group.uv is None else group.uv[rows[:, 1]], _material(group))


def _material(group: MeshGroup) -> Material:
    finish, color, texture = group.finish, [1.0] * 3, None
    if finish.image is None:
        color = [round(value / 255.0, 4) for value in finish.color]
    else:
        texture = np.array(finish.image.palette, np.uint8)[finish.image.pixels]
    return Material(group.material, base_color([*color, float(f"{finish.opacity:.3g}")]),
                    texture=texture)
