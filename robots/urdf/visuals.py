"""Geometry and materials of the links of a URDF."""

# yourdfpy has no types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportMissingTypeStubs=false

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ModelError
from ..files import MissingAssetError, OutsideAssetError, show_progress
from ..geometry import Array
from ..meshes import box, capsule, cylinder, sphere
from ..model import (
    INVISIBLE,
    ArticulatedModel,
    Material,
    TriangleSurface,
    Visual,
    base_color,
    mean_color,
    move_surface,
    visuals_of_part,
)
from .document import UrdfDocument
from .library import MeshLibrary

if TYPE_CHECKING:
    from yourdfpy.urdf import Link

_THIN = 1e-4
"""Thickness, m, of a box or cylinder of thickness zero."""


def visuals_of_document(
    document: UrdfDocument, model: ArticulatedModel, library: MeshLibrary, allow_missing: bool
) -> tuple[list[Visual], list[str]]:
    """Return the visuals of all parts of a model, and notes; raise ModelError."""
    robot, notes = document.robot, list[str]()
    materials = _named_materials(robot.materials, robot.links)
    links: dict[str, Link] = {link.name: link for link in robot.links}
    visuals: list[Visual] = []
    digests: dict[int, bytes] = {}
    triangles = 0
    for part, name in enumerate(show_progress(model.part_names, "reading links")):
        surfaces: list[TriangleSurface] = []
        for visual in links[name].visuals:
            mesh = visual.geometry and visual.geometry.mesh
            reference = mesh.filename if mesh else ""
            try:
                found = _surfaces(visual, library, notes, name)
            except (MissingAssetError, OutsideAssetError) as error:
                if not allow_missing or isinstance(error, OutsideAssetError):
                    advice = _advice(error, reference, library, robot)
                    raise type(error)(f"link {name!r}: mesh {error}; {advice}") from error
                notes.append(f"link {name!r}: mesh {reference!r} is missing and left out")
                continue
            except ModelError as error:
                raise ModelError(f"link {name!r}: {error}") from error
            triangles += sum(len(s.faces) for s in found)
            if triangles > library.limits.triangles:
                raise ModelError(f"has more than {library.limits.triangles} triangles")
            own = _material(visual.material, materials, library, notes, name)
            pose = pose_or_identity(visual.origin)
            surfaces.extend(move_surface(_assign_material(s, own), pose) for s in found)
        visuals.extend(visuals_of_part(part, surfaces, digests))
    if not visuals:
        notes.append("the model has no visuals: there is nothing to see")
    return visuals, notes


def _advice(error: ModelError, reference: str, library: MeshLibrary, robot: Any) -> str:
    """Return which options make the meshes of a robot readable."""
    meshes = (v.geometry and v.geometry.mesh for link in robot.links for v in link.visuals)
    root = library.finder.root_for(mesh.filename for mesh in meshes if mesh)
    options: list[str] = []
    if root is not None or isinstance(error, OutsideAssetError):
        where = "DIR, a folder that holds both" if root is None else shlex.quote(str(root))
        options.append(f"if you trust the model, add --root {where}")
    if reference.startswith(("package:", "model:")):
        options.append("name its package by --package NAME=DIR")
    if isinstance(error, MissingAssetError):
        options.append("add --allow-missing to leave it out")
    return ", or ".join(options)


def _surfaces(
    visual: Any, library: MeshLibrary, notes: list[str], link: str
) -> list[TriangleSurface]:
    """Return the surfaces of one <visual> in its own frame."""
    shape = visual.geometry
    if shape.mesh is None:
        solid = _solid(shape, visual.name)
        if solid is None:
            notes.append(f"link {link!r}: a {visual.name} without size is left out")
        return [] if solid is None else [solid]
    scale = np.broadcast_to(1.0 if shape.mesh.scale is None else shape.mesh.scale, 3)
    if (np.abs(scale) < 1e-12).any():
        raise ModelError(f"mesh {shape.mesh.filename!r} has a scale of zero")
    return [move_surface(s, np.eye(4), scale) for s in library.surfaces(shape.mesh.filename)]


def _solid(shape: Any, kind: str) -> TriangleSurface | None:
    """Return a primitive, with a thickness of at least _THIN; None without an area."""
    if shape.box is not None:
        sizes = shape.box.size.tolist()
        return box([size or _THIN for size in sizes]) if np.count_nonzero(sizes) > 1 else None
    if shape.sphere is not None:
        return sphere(shape.sphere.radius) if shape.sphere.radius else None
    radius, length = shape.cylinder.radius, shape.cylinder.length
    if not radius:
        return None
    return capsule(radius, length) if kind == "capsule" else cylinder(radius, length or _THIN)


def _named_materials(top: list[Any], links: list[Any]) -> dict[str, Any]:
    """Return materials by name; those of the robot precede definitions inside links."""
    inline = [v.material for link in links for v in link.visuals if v.material is not None]
    named: dict[str, Any] = {}
    for m in [*top, *inline]:
        if m.name and (m.color is not None or m.texture is not None):
            named.setdefault(m.name, m)
    return named


def _material(
    given: Any, named: dict[str, Any], library: MeshLibrary, notes: list[str], link: str
) -> Material | None:
    """Return the material that the URDF gives a visual, or None."""
    if given is None:
        return None
    if given.color is None and given.texture is None:
        if given.name not in named:
            if given.name:
                notes.append(f"link {link!r}: material {given.name!r} is not defined")
            return None
        given = named[given.name]
    color, texture = (1.0, 1.0, 1.0, 1.0), None
    if given.color is not None:
        rgba = np.asarray(given.color.rgba, np.float64)
        if rgba.min() < 0.0 or rgba.max() > 1.0:
            notes.append(f"material {given.name!r}: colour outside 0..1 is clipped")
        color = base_color(rgba)
    if given.texture is not None:
        try:
            texture = library.texture(given.texture.filename)
        except (MissingAssetError, OutsideAssetError) as error:
            why = "is missing" if isinstance(error, MissingAssetError) else "may not be read"
            notes.append(f"material {given.name!r}: texture {given.texture.filename!r} {why}")
            if given.color is None:
                return None
    cutoff = INVISIBLE if color[3] < INVISIBLE else None
    return Material(str(given.name or ""), color, texture=texture, alpha_cutoff=cutoff)


def _assign_material(s: TriangleSurface, own: Material | None) -> TriangleSurface:
    """Assign the final material: that of the mesh, else of the URDF, else the vertex colour."""
    if s.material is not None:
        material = s.material
    elif own is not None:
        material = own
    else:
        material = Material() if s.vertex_color is None else Material(base_color=s.vertex_color)
    if material.texture is not None and s.uv is None:  # use the mean colour
        mean = np.multiply(mean_color(material.texture), material.base_color).tolist()
        material = replace(material, texture=None, base_color=(mean[0], mean[1], mean[2], mean[3]))
    return replace(s, material=material)


def pose_or_identity(matrix: Array | None) -> Array:
    """Return the pose [4 4] of an <origin>; identity for None."""
    return np.eye(4) if matrix is None else np.asarray(matrix, np.float64)
