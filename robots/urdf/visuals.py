"""Geometry and materials of the links of a URDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import ModelError
from ..files import MissingAssetError, show_progress
from ..meshes import box, capsule, cylinder, sphere
from ..model import (
    ArticulatedModel,
    Material,
    TriangleSurface,
    Visual,
    base_color,
    mean_color,
    move_surface,
    visuals_of_part,
)
from .document import UrdfDocument, UrdfMaterial, UrdfVisual
from .library import MeshLibrary

_THIN = 1e-4
"""Thickness, m, of a box or cylinder of thickness zero."""


def visuals_of_document(
    document: UrdfDocument, model: ArticulatedModel, library: MeshLibrary, allow_missing: bool
) -> tuple[list[Visual], list[str]]:
    """Return the visuals of all parts of a model, and notes; raise ModelError."""
    notes = list[str]()
    materials = _named_materials(document)
    visuals: list[Visual] = []
    digests: dict[int, bytes] = {}
    triangles = 0
    for part, name in enumerate(show_progress(model.part_names, "reading links")):
        surfaces: list[TriangleSurface] = []
        for visual in document.visuals[name]:
            try:
                found = _surfaces(visual, library, notes, name)
            except MissingAssetError as error:
                if not allow_missing:
                    package = "name its package by --package NAME=DIR, or " if (
                        visual.filename.startswith(("package:", "model:"))) else ""
                    raise MissingAssetError(f"link {name!r}: mesh {error}; {package}add "
                                            "--allow-missing to leave it out") from error
                notes.append(f"link {name!r}: mesh {visual.filename!r} is missing and left out")
                continue
            except ModelError as error:
                raise ModelError(f"link {name!r}: {error}") from error
            triangles += sum(len(s.faces) for s in found)
            if triangles > library.limits.triangles:
                raise ModelError(f"has more than {library.limits.triangles} triangles")
            own = _material(visual.material, materials, library, notes, name)
            surfaces.extend(move_surface(_dressed(s, own), visual.link_from_visual)
                            for s in found)
        visuals.extend(visuals_of_part(part, surfaces, digests))
    if not visuals:
        notes.append("the model has no visuals: there is nothing to see")
    return visuals, notes


def _surfaces(
    visual: UrdfVisual, library: MeshLibrary, notes: list[str], link: str
) -> list[TriangleSurface]:
    """Return the surfaces of one <visual> in its own frame."""
    if visual.kind != "mesh":
        solid = _solid(visual.kind, visual.sizes)
        if solid is None:
            notes.append(f"link {link!r}: a {visual.kind} without size is left out")
        return [] if solid is None else [solid]
    scale = np.broadcast_to(visual.sizes, 3)
    if (np.abs(scale) < 1e-12).any():
        raise ModelError(f"mesh {visual.filename!r} has a scale of zero")
    return [move_surface(s, np.eye(4), scale) for s in library.surfaces(visual.filename)]


def _solid(kind: str, sizes: Sequence[float]) -> TriangleSurface | None:
    """Return a primitive, with a thickness of at least _THIN; None without an area."""
    if kind == "box":
        return box([size or _THIN for size in sizes]) if np.count_nonzero(sizes) > 1 else None
    radius, length = sizes[0], sizes[-1]
    if not radius:
        return None
    if kind == "sphere":
        return sphere(radius)
    return capsule(radius, length) if kind == "capsule" else cylinder(radius, length or _THIN)


def _named_materials(document: UrdfDocument) -> dict[str, UrdfMaterial]:
    """Return materials by name; those of the robot precede definitions inside links."""
    inline = [v.material for visuals in document.visuals.values() for v in visuals if v.material]
    named: dict[str, UrdfMaterial] = {}
    for m in [*document.materials, *inline]:
        if m.name and m.defines:
            named.setdefault(m.name, m)
    return named


def _material(
    given: UrdfMaterial | None, named: dict[str, UrdfMaterial], library: MeshLibrary,
    notes: list[str], link: str,
) -> Material | None:
    """Return the material that the URDF gives a visual, or None."""
    if given is None:
        return None
    if not given.defines:
        if given.name not in named:
            if given.name:
                notes.append(f"link {link!r}: material {given.name!r} is not defined")
            return None
        given = named[given.name]
    color, texture = (1.0, 1.0, 1.0, 1.0), None
    if given.rgba is not None:
        if min(given.rgba) < 0.0 or max(given.rgba) > 1.0:
            notes.append(f"material {given.name!r}: colour outside 0..1 is clipped")
        color = base_color(given.rgba)
    if given.texture is not None:
        try:
            texture = library.texture(given.texture)
        except MissingAssetError:
            notes.append(f"material {given.name!r}: texture {given.texture!r} is missing")
            if given.rgba is None:
                return None
    return Material(given.name, color, texture=texture)


def _dressed(s: TriangleSurface, own: Material | None) -> TriangleSurface:
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
