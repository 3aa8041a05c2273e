"""Reads a URDF into an articulated model. Models are untrusted: see `files.paths`."""

# yourdfpy has no types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportMissingTypeStubs=false

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ModelError
from ..files import asset_finder, read_bounded
from ..meshes import file_errors
from ..model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Mimic,
    list_names,
    rest_size,
    scale_model,
)
from .document import UrdfDocument, read_urdf_document
from .library import MeshLibrary
from .visuals import pose_or_identity, visuals_of_document

if TYPE_CHECKING:
    from yourdfpy.urdf import Joint as UrdfJoint

_MAX_URDF_BYTES = 32 * 2**20
_LARGEST_LIMIT = 1000.0
"""rad or m; files that mean "no limit" write larger numbers."""
_UNLIMITED = (-np.inf, np.inf)
_SMALLEST, _LARGEST = 1e-4, 1e3
_UNUSUAL = 50.0  # m; larger robots are rare, and files in mm are common
"""m: a model whose bounding box is outside was written in another unit."""


def load_urdf(
    path: str | Path,
    packages: Mapping[str, Path] | None = None,
    allow_missing: bool = False,
    asset_root: Path | None = None,
    scale: float = 1.0,
) -> ArticulatedModel:
    """Read the URDF at `path` with its meshes and textures.

    `packages` maps names of `package://name/...` to folders; `asset_root` is the folder that the
    model's files must not leave (by default the package or folder of the URDF, see `files.paths`).
    All lengths are multiplied by `scale`. With `allow_missing` a missing mesh becomes a note of
    the model instead of an error. Raises ModelError for any invalid file.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"{path}: no such file")
    data = read_bounded(path, _MAX_URDF_BYTES)
    finder = asset_finder(path, packages, asset_root)
    with file_errors(path, "a URDF"):
        document = read_urdf_document(data, path.stem, allow_missing)
        name = str(document.robot.name or path.stem)
        model = ArticulatedModel.from_links(name, _links(document, scale))
        library = MeshLibrary(finder)
        visuals, notes = visuals_of_document(document, model, library, allow_missing)
    model = replace(
        model, visuals=tuple(visuals), source=path.name, sha256=hashlib.sha256(data).hexdigest(),
        notes=tuple(dict.fromkeys([*document.notes, *model.notes, *notes, *library.notes])))
    model = model if scale == 1.0 else scale_model(model, scale)
    size = _checked_size(path, model)
    if size > _UNUSUAL:
        note = f"the model is {size:.3g} m large; if it is not in metres, add --scale FACTOR"
        model = replace(model, notes=(*model.notes, note))
    return model


def _links(document: UrdfDocument, scale: float) -> list[Link]:
    """The links of the document without their surfaces, in its unit of `scale` m; the joints give
    the order.
    """
    joints: list[UrdfJoint] = document.robot.joints
    names = {link.name: None for link in document.robot.links}
    by_child: dict[str, UrdfJoint] = {}
    for j in joints:
        if j.child not in names:
            raise ModelError(f"joint {j.name!r}: there is no link {j.child!r}; "
                             f"there are {list_names(names)}")
        if j.child in by_child:
            raise ModelError(f"link {j.child!r} is the child of two joints, "
                             f"{by_child[j.child].name!r} and {j.name!r}; a link has one parent: "
                             "gcbench reads trees; leave out the joint that closes a chain")
        by_child[j.child] = j
    return [*(Link(name) for name in names if name not in by_child),
            *(Link(j.child, j.parent, pose_or_identity(j.origin), _joint(j, scale, document.notes))
              for j in joints)]


def _joint(joint: UrdfJoint, scale: float, notes: list[str]) -> Joint:
    name = joint.name
    if joint.type in ("floating", "planar", "spherical"):
        notes.append(f"joint {name!r} is {joint.type}: frozen at zero")
    if joint.type not in ("revolute", "continuous", "prismatic"):
        return Joint(name)
    axis = np.asarray(joint.axis, np.float64)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise ModelError(f"joint {name!r}: its axis is zero")
    limits = _limits(joint, scale if joint.type == "prismatic" else 1.0, notes)
    joint_type = JointType(joint.type)
    if joint_type is not JointType.PRISMATIC:
        joint_type = JointType.CONTINUOUS if limits == _UNLIMITED else JointType.REVOLUTE
    return Joint(name, joint_type, axis / length, limits=limits, mimic=_mimic(joint))


def _limits(joint: UrdfJoint, unit: float, notes: list[str]) -> tuple[float, float]:
    """The limits in the unit of the file, `unit` rad or m."""
    limit = joint.limit
    if joint.type == "continuous":
        return _UNLIMITED
    if limit is None or (limit.lower is None and limit.upper is None):
        notes.append(f"joint {joint.name!r} is {joint.type} without limits: taken as unlimited")
        return _UNLIMITED
    lower, upper = float(limit.lower or 0.0), float(limit.upper or 0.0)
    if lower > upper:
        notes.append(f"joint {joint.name!r}: lower limit {lower:g} > upper {upper:g}: swapped")
        lower, upper = upper, lower
    if max(-lower, upper) * unit > _LARGEST_LIMIT:
        notes.append(f"joint {joint.name!r}: limits {lower:g} {upper:g} taken as none")
        lower = lower if lower * unit >= -_LARGEST_LIMIT else -np.inf
        upper = upper if upper * unit <= _LARGEST_LIMIT else np.inf
    return lower, upper


def _mimic(joint: UrdfJoint) -> Mimic | None:
    mimic: Any = joint.mimic
    if mimic is None:
        return None
    return Mimic(mimic.joint, 1.0 if mimic.multiplier is None else float(mimic.multiplier),
                 0.0 if mimic.offset is None else float(mimic.offset))


def _checked_size(path: Path, model: ArticulatedModel) -> float:
    """Return the size, m, of a model's bounding box at joint value zero; 0 if nothing is drawn.

    Raises ModelError if it tells of a wrong unit.
    """
    if not model.visuals:
        return 0.0
    size = rest_size(model)
    if not _SMALLEST <= size <= _LARGEST:
        raise ModelError(f"{path}: is {size:g} m large, outside {_SMALLEST:g} to {_LARGEST:g} m; "
                         "add --scale FACTOR, or set the `scale` of its meshes")
    return size
