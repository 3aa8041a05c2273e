"""Objects of PartNet-Mobility: their location, their part names and their scored joints.

The data set is under research terms: users provide a copy, or download it with their own token;
this package includes none of it. The URDF reader supports the peculiarities of its files (an
empty root, y up, textures in `../images`, several groups per mesh, no inertia, helper links);
all files must be inside the folder of the object.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from ...errors import ModelError
from ..files import read_bounded
from ..model import ArticulatedModel
from .reader import load_urdf

URDF, NAMES = "mobility.urdf", "semantics.txt"
DATASET_VARIABLE = "PARTNET_MOBILITY_DATASET"
TOKEN = "SAPIEN_ACCESS_TOKEN"
"""Environment variables of sapien."""
LICENCE = "PartNet-Mobility: research terms, not to be redistributed"
_LARGEST = 2**20
_DOOR = re.compile(r"(.*_)?door(_\d+)?")
_DRAWER = re.compile(r"(.*_)?drawer(_\d+)?")
_MOST_SCORED = 3


def partnet_folder(number: str, directory: Path | None = None, download: bool = True) -> Path:
    """Return the folder of an object, below `directory`, else $PARTNET_MOBILITY_DATASET, else
    `partnet-mobility-dataset`.

    sapien downloads a missing object if `download` is True and $SAPIEN_ACCESS_TOKEN is set.
    Raises ModelError with instructions if the object is missing.
    """
    own = os.environ.get(DATASET_VARIABLE)
    root = directory or Path(own or "partnet-mobility-dataset").expanduser()
    folder = root / number
    if (folder / URDF).is_file():
        return folder
    token = os.environ.get(TOKEN) if download else None
    missing = f"partnet:{number} is not in {root}"
    if not token:
        raise ModelError(f"{missing}; set {DATASET_VARIABLE} to the folder that holds "
                         f"{number}/{URDF}, or {TOKEN} to your token to download it")
    if find_spec("sapien") is None:
        raise ModelError(f"{missing}, and sapien, which downloads it, is not installed; run "
                         "`pip install '.[sapien]'`")
    try:
        from sapien.asset import download_partnet_mobility  # pyright: ignore

        with redirect_stdout(io.StringIO()):  # it prints a URL that contains the token
            download_partnet_mobility(number, token, str(root))
    except Exception as error:
        why = " ".join(str(error).replace(token, "...").split())[:200]
        raise ModelError(f"{missing}, and sapien cannot download it ({why})") from None
    if not (folder / URDF).is_file():
        raise ModelError(f"{missing}, nor is it there after sapien's download")
    return folder


def load_object(folder: Path, allow_missing: bool = False) -> ArticulatedModel:
    """Load the object in a folder, with the part and joint names of semantics.txt.

    Raises ModelError like `load_urdf`, and MissingAssetError if meshes are missing (as for some
    objects of the published set) and `allow_missing` is False.
    """
    model = load_urdf(folder / URDF, allow_missing=allow_missing, asset_root=folder)
    try:
        return rename_parts(model, part_names(folder))
    except ModelError as error:
        raise ModelError(f"{folder / NAMES}: {error}") from error


def rename_parts(model: ArticulatedModel, names: Mapping[str, str]) -> ArticulatedModel:
    """Rename parts by `names` (old: new); each joint gets the new name of its child part.

    Raises ModelError if two parts or two joints would have the same name.
    """
    parts = tuple(names.get(part, part) for part in model.part_names)
    joints = tuple(
        names.get(model.part_names[child], joint)
        for joint, child in zip(model.joint_names, model.joint_child.tolist(), strict=True))
    if len({*parts}) < len(parts) or len({*joints}) < len(joints):
        raise ModelError("calls a link as another one, or another joint, is called already")
    said = ", ".join(f"{old} is {new}" for old, new in names.items() if old in model.part_names)
    notes = (*model.notes, f"named by semantics.txt: {said}") if said else model.notes
    return replace(model, part_names=parts, joint_names=joints, notes=notes)


def part_names(folder: Path) -> dict[str, str]:
    """Return the name of each link in semantics.txt: "door", then "door_2", "door_3".

    The result is empty if the file is missing. A helper link gets its link's name + "_helper".
    """
    path = folder / NAMES
    if not path.is_file():
        return {}
    text = read_bounded(path, _LARGEST).decode(errors="replace")
    names: dict[str, str] = {}
    taken = {"base"}
    for words in map(str.split, text.splitlines()):
        if len(words) != 3 or not re.fullmatch(r"[A-Za-z][\w.+-]{0,63}", words[2]):
            continue
        link, _, role = words
        name, k = role, 2
        while name in taken:
            name, k = f"{role}_{k}", k + 1
        if link not in names:
            taken |= {name, f"{name}_helper"}
            names |= {link: name, f"{link}_helper": f"{name}_helper"}
    return names


def scored_joints(model: ArticulatedModel) -> tuple[str, ...]:
    """Return up to three hinge joints of doors; for an object without doors, its first drawer."""
    named = list(zip(model.joint_names, model.joint_types, strict=True))
    doors = [name for name, kind in named if kind != "prismatic" and _DOOR.fullmatch(name)]
    drawers = [name for name, kind in named if kind == "prismatic" and _DRAWER.fullmatch(name)]
    return tuple(doors[:_MOST_SCORED] or drawers[:1])
