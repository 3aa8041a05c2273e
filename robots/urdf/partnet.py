"""Objects in the layout of PartNet-Mobility: where they lie, and what their parts are called.

The set is under research terms: the user has it, or gets it with a token of their own; nothing of
it is kept here. What its files have that others do not (an empty root, y up, textures in
`../images`, several groups a mesh, no inertia, helper links) is nothing that the reader of URDFs
minds, as long as a file stays inside the object's own folder.
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

from ...errors import GcbenchError, ModelError
from ..files import MissingAssetError, read_bounded
from ..model import ArticulatedModel
from .reader import load_urdf

URDF, NAMES = "mobility.urdf", "semantics.txt"
DATASET_VARIABLE = "PARTNET_MOBILITY_DATASET"
TOKEN = "SAPIEN_ACCESS_TOKEN"
"""Environment variables, those of sapien."""
LICENCE = "PartNet-Mobility: research terms, not to be redistributed"
_LARGEST = 2**20
_DOOR = re.compile(r"(.*_)?door(_\d+)?")
_DRAWER = re.compile(r"(.*_)?drawer(_\d+)?")
_MOST_SCORED = 3


def partnet_folder(number: str, directory: Path | None = None, download: bool = True) -> Path:
    """The folder of an object: in `directory`, else in $PARTNET_MOBILITY_DATASET, else in
    `partnet-mobility-dataset`.

    What is not there is downloaded by sapien, if it is installed and $SAPIEN_ACCESS_TOKEN is set
    (unless `download` is False).
    Raises GcbenchError that says what to do.
    """
    own = os.environ.get(DATASET_VARIABLE)
    root = directory or Path(own or "partnet-mobility-dataset").expanduser()
    folder = root / number
    if (folder / URDF).is_file():
        return folder
    token = os.environ.get(TOKEN) if download else None
    missing = f"partnet:{number} is not in {root}"
    if not token:
        raise GcbenchError(f"{missing}; set {DATASET_VARIABLE} to the folder that holds "
                           f"{number}/{URDF}, or {TOKEN} to your token to download it")
    if find_spec("sapien") is None:
        raise GcbenchError(f"{missing}, and sapien, which downloads it, is not installed; run "
                           "`pip install 'gcbench[sapien]'`")
    try:
        from sapien.asset import download_partnet_mobility  # pyright: ignore

        with redirect_stdout(io.StringIO()):  # it prints an address that has the token in it
            download_partnet_mobility(number, token, str(root))
    except Exception as error:
        why = " ".join(str(error).replace(token, "...").split())[:200]
        raise GcbenchError(f"{missing}, and sapien cannot download it ({why})") from None
    if not (folder / URDF).is_file():
        raise GcbenchError(f"{missing}, nor is it there after sapien's download")
    return folder


def load_object(folder: Path, allow_missing: bool = False) -> ArticulatedModel:
    """The object in a folder; its parts and joints are called by what they mean.

    Raises ModelError as `load_urdf`, MissingAssetError if meshes are missing (in the published set
    some are) and that is not allowed.
    """
    urdf = folder / URDF
    try:
        model = load_urdf(urdf, allow_missing=allow_missing, asset_root=folder)
    except MissingAssetError as error:
        text = str(error).partition("; name the package's folder")[0]
        raise MissingAssetError(
            f"{text}; --allow-missing goes on without (the published set lacks some)") from error
    try:
        return rename_parts(model, part_names(folder))
    except ModelError as error:
        raise ModelError(f"{folder / NAMES}: {error}") from error


def rename_parts(model: ArticulatedModel, names: Mapping[str, str]) -> ArticulatedModel:
    """The model with new part names by old ones; a joint is called like the part that it moves.

    Raises ModelError if two parts or joints would have one name.
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
    """What semantics.txt calls each link: "door"; further ones "door_2", "door_3".

    Empty where there is no such file. A helper link is named after the one that it helps.
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
    """The hinges of an object's doors, if it has any: at most three; else its first drawer."""
    named = list(zip(model.joint_names, model.joint_types, strict=True))
    doors = [name for name, kind in named if kind != "prismatic" and _DOOR.fullmatch(name)]
    drawers = [name for name, kind in named if kind == "prismatic" and _DRAWER.fullmatch(name)]
    return tuple(doors[:_MOST_SCORED] or drawers[:1])
