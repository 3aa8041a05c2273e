"""Reads a URDF into an articulated model. Models are untrusted: see `references.py`."""

# yourdfpy has no types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportUnknownArgumentType=false, reportMissingTypeStubs=false

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import ModelError
from ..files import asset_finder, read_file
from ..geometry import Array, apply, prismatic_motion, revolute_motion
from ..meshes import MeshLibrary, quiet
from ..model import (
    FIXED,
    PRISMATIC,
    REVOLUTE,
    ArticulatedModel,
    forward_kinematics,
    parts_in_order,
    resolve_mimics,
)
from .document import Document, read_document
from .visuals import pose_or_identity, visuals_of_document

if TYPE_CHECKING:
    from yourdfpy.urdf import Joint

MAX_URDF_BYTES = 32 * 2**20
UNLIMITED = 1000.0
"""rad or m: files that mean "no limit" write numbers beyond this."""
SMALLEST, LARGEST = 1e-4, 1e3
"""m: a model whose bounding box is outside was written in another unit."""


def load_urdf(
    path: str | Path,
    packages: Mapping[str, Path] | None = None,
    allow_missing: bool = False,
    asset_root: Path | None = None,
) -> ArticulatedModel:
    """Read the URDF at `path` with its meshes and textures.

    `packages` maps names of `package://name/...` to folders; `asset_root` is the folder that the
    model's files must not leave (by default the surroundings of the URDF, see `references.py`).
    With `allow_missing` a mesh that is nowhere is recorded in the model's notes instead of
    stopping the load. Raises ModelError (a GcbenchError) in one line for everything that a file
    can have wrong.
    """
    path = Path(path)
    if not path.is_file():
        raise ModelError(f"{path}: no such file")
    data = read_file(path, MAX_URDF_BYTES)
    finder = asset_finder(path, packages, asset_root)
    try:
        with quiet():
            document = read_document(data, path.stem, allow_missing)
            model = _kinematics(document, path.stem)
        library = MeshLibrary(finder)
        visuals, notes = visuals_of_document(document, model, library, allow_missing)
    except ModelError as error:
        text = str(error)
        raise type(error)(text if text.startswith(str(path)) else f"{path}: {text}") from error
    except (Exception, RecursionError) as error:
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise ModelError(f"{path}: cannot be read as a URDF ({why})") from error
    model = replace(
        model, visuals=tuple(visuals), source=path.name, sha256=hashlib.sha256(data).hexdigest(),
        notes=tuple(dict.fromkeys([*document.notes, *model.notes, *notes, *library.notes])))
    _check_size(path, model)
    return model


@dataclass(frozen=True)
class _Motion:
    """How one part moves against its parent."""

    kind: int
    axis: Array
    limits: tuple[float, float]
    name: str


def _kinematics(document: Document, name: str) -> ArticulatedModel:
    """The model without its visuals."""
    robot, notes = document.robot, list[str]()
    joints: list[Joint] = robot.joints
    ends = [(j.name, j.parent, j.child) for j in joints]
    parts = parts_in_order([link.name for link in robot.links], ends)
    motions = {j.name: _motion(j, notes) for j in joints}
    by_child = {j.child: j for j in joints}
    mimics = resolve_mimics({j.name: (j.mimic.joint, *_gear(j)) for j in joints
                             if j.mimic is not None and motions[j.name].kind != FIXED},
                            [j.name for j in joints])
    free = [j for j in joints if motions[j.name].kind != FIXED and j.name not in mimics]
    number = {j.name: i for i, j in enumerate(free)}

    index = {part: i for i, part in enumerate(parts)}
    count = len(parts)
    parent = np.full(count, -1, np.int64)
    at_zero = np.tile(np.eye(4), (count, 1, 1))
    motion = np.zeros(count, np.int64)
    screw, offset = np.zeros((count, 6)), np.zeros(count)
    joint, multiplier = np.full(count, -1, np.int64), np.ones(count)
    for p, part in enumerate(parts):
        if part not in by_child:
            continue
        j = by_child[part]
        parent[p] = index[j.parent]
        at_zero[p] = pose_or_identity(j.origin)
        move = motions[j.name]
        if move.kind == FIXED:
            continue
        screw[p, :3] = move.axis  # through the part's origin: no moment
        leader, g, o = mimics.get(j.name, (j.name, 1.0, 0.0))
        if g == 0.0 or leader not in number:
            shift = revolute_motion if move.kind == REVOLUTE else prismatic_motion
            at_zero[p] = at_zero[p] @ shift(screw[p], o)
            screw[p] = 0.0
            notes.append(f"joint {j.name!r} mimics {leader!r}, which does not move it: frozen")
        else:
            motion[p], joint[p], multiplier[p], offset[p] = move.kind, number[leader], g, o
    return ArticulatedModel(
        name=str(robot.name or name), part_names=tuple(parts), parent=parent,
        parent_from_part_at_zero=at_zero, motion=motion, screw=screw, joint=joint,
        multiplier=multiplier,
        offset=offset, joint_names=tuple(j.name for j in free),
        joint_child=np.array([index[j.child] for j in free], np.int64),
        joint_types=tuple(_type_name(motions[j.name]) for j in free),
        limits=np.array([motions[j.name].limits for j in free], np.float64).reshape(-1, 2),
        visuals=(), notes=tuple(notes))


def _motion(joint: Joint, notes: list[str]) -> _Motion:
    name = joint.name
    if joint.type in ("floating", "planar", "spherical"):
        notes.append(f"joint {name!r} is {joint.type}: frozen at zero")
    if joint.type not in ("revolute", "continuous", "prismatic"):
        return _Motion(FIXED, np.zeros(3), (0.0, 0.0), name)
    axis = np.asarray(joint.axis, np.float64)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise ModelError(f"joint {name!r}: its axis is zero")
    kind = PRISMATIC if joint.type == "prismatic" else REVOLUTE
    return _Motion(kind, axis / length, _limits(joint, notes), name)


def _limits(joint: Joint, notes: list[str]) -> tuple[float, float]:
    limit, none = joint.limit, (-np.inf, np.inf)
    if joint.type == "continuous":
        return none
    if limit is None or (limit.lower is None and limit.upper is None):
        notes.append(f"joint {joint.name!r} is {joint.type} without limits: taken as unlimited")
        return none
    lower, upper = float(limit.lower or 0.0), float(limit.upper or 0.0)
    if lower > upper:
        notes.append(f"joint {joint.name!r}: lower limit {lower:g} > upper {upper:g}: swapped")
        lower, upper = upper, lower
    if max(-lower, upper) > UNLIMITED:
        notes.append(f"joint {joint.name!r}: limits {lower:g} {upper:g} taken as none")
        return -np.inf if lower < -UNLIMITED else lower, np.inf if upper > UNLIMITED else upper
    return lower, upper


def _type_name(motion: _Motion) -> str:
    if motion.kind == PRISMATIC:
        return "prismatic"
    return "continuous" if motion.limits == (-np.inf, np.inf) else "revolute"


def _gear(joint: Joint) -> tuple[float, float]:
    mimic: Any = joint.mimic
    return (1.0 if mimic.multiplier is None else float(mimic.multiplier),
            0.0 if mimic.offset is None else float(mimic.offset))


def _check_size(path: Path, model: ArticulatedModel) -> None:
    """Refuse a model whose bounding box at joint value zero tells of a wrong unit."""
    if not model.visuals:
        return
    world_from_part = forward_kinematics(model, np.zeros(len(model.joint_names)))
    points = [apply(world_from_part[v.part], v.vertices) for v in model.visuals]
    low = np.min([p.min(axis=0) for p in points], axis=0)
    high = np.max([p.max(axis=0) for p in points], axis=0)
    size = float(np.linalg.norm(high - low))
    if not SMALLEST <= size <= LARGEST:
        raise ModelError(f"{path}: is {size:g} m large, outside {SMALLEST:g} to {LARGEST:g} m; "
                         "its meshes are in another unit: set their `scale`")
