"""Reads a URDF into an articulated model. Models are untrusted: see `files.paths`."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ModelError
from ..files import asset_finder, read_bounded
from ..geometry import apply
from ..meshes import explain, quiet
from ..model import (
    ArticulatedModel,
    Link,
    forward_kinematics,
    list_names,
    scale_model,
)
from .document import UrdfDocument, read_urdf_document
from .library import MeshLibrary
from .visuals import visuals_of_document

_MAX_URDF_BYTES = 32 * 2**20
_SMALLEST, _LARGEST = 1e-4, 1e3
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
    try:
        with quiet():
            document = read_urdf_document(data, path.stem, allow_missing)
            model = ArticulatedModel.from_links(document.name, _links(document))
        library = MeshLibrary(finder)
        visuals, notes = visuals_of_document(document, model, library, allow_missing)
    except ModelError as error:
        text = str(error)
        raise type(error)(text if text.startswith(str(path)) else f"{path}: {text}") from error
    except (Exception, RecursionError) as error:
        raise ModelError(f"{path}: cannot be read as a URDF ({explain(error)})") from error
    model = replace(
        model, visuals=tuple(visuals), source=path.name, sha256=hashlib.sha256(data).hexdigest(),
        notes=tuple(dict.fromkeys([*document.notes, *model.notes, *notes, *library.notes])))
    model = model if scale == 1.0 else scale_model(model, scale)
    _check_size(path, model)
    return model


def _links(document: UrdfDocument) -> list[Link]:
    """The links of the document without their surfaces; the joints give the order."""
    by_child: dict[str, str] = {}
    for link in document.joints:
        joint = link.joint.name
        if link.name not in document.visuals:
            raise ModelError(f"joint {joint!r}: there is no link {link.name!r}; "
                             f"there are {list_names(document.visuals)}")
        if link.name in by_child:
            raise ModelError(f"link {link.name!r} is the child of two joints, "
                             f"{by_child[link.name]!r} and {joint!r}; a link has one parent")
        by_child[link.name] = joint
    return [*(Link(name) for name in document.visuals if name not in by_child), *document.joints]


def _check_size(path: Path, model: ArticulatedModel) -> None:
    """Refuse a model whose bounding box at joint value zero tells of a wrong unit."""
    if not model.visuals:
        return
    world_from_part = forward_kinematics(model, np.zeros(len(model.joint_names)))
    points = [apply(world_from_part[v.part], v.vertices) for v in model.visuals]
    low = np.min([p.min(axis=0) for p in points], axis=0)
    high = np.max([p.max(axis=0) for p in points], axis=0)
    size = float(np.linalg.norm(high - low))
    if not _SMALLEST <= size <= _LARGEST:
        raise ModelError(f"{path}: is {size:g} m large, outside {_SMALLEST:g} to {_LARGEST:g} m; "
                         "add --scale FACTOR, or set the `scale` of its meshes")
