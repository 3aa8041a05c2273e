"""From a robot's name or path to its model."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import cast

from ...errors import ModelError
from ..appliances import GENERATED, appliance_folder, appliance_model
from ..files import hash_files
from ..model import ArticulatedModel
from ..motion import default_scored_joints
from .descriptions import clone_robot
from .entries import ClonedEntry, FetchedRobot, GeneratedRobot, find_robot, is_local, robot_folder
from .names import PARTNET, is_object, parse_object_name

_URDF, _GLTF = (".urdf",), (".glb", ".gltf")
_UNSUPPORTED = {
    ".xacro": "is a xacro file: run `xacro FILE > robot.urdf` (pip install xacro) and load the "
              "result",
    **dict.fromkeys((".xml", ".mjcf"), "is not supported (MuJoCo's MJCF): convert it to URDF"),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"),
                    "is not supported (USD): export it as URDF or glTF"),
    **dict.fromkeys((".sdf", ".world"), "is not supported (Gazebo's SDF): convert it to URDF"),
}


def load_robot(
    name: str | Path, packages: Mapping[str, str | Path] | None = None,
    allow_missing: bool = False, download: bool = True, root: str | Path | None = None,
    scale: float = 1.0,
) -> ArticulatedModel:
    """Load an articulated model by its name or from a file.

    Args:
        name: A robot of the catalogue ("ur5"), a generated object ("microwave:17"), an object of
            PartNet-Mobility ("partnet:7310"), a random object ("random:5"), a robot of the
            package robot_descriptions ("rd:panda_description"), or the path of a .urdf, .glb or
            .gltf file.
        packages: Folders of ROS packages by name, for references `package://NAME/...` of a URDF.
            The entry "partnet" is the folder that holds PartNet-Mobility objects.
        allow_missing: Load a file although meshes are missing, and list them in the model's
            `notes`.
        download: Whether files of a named robot may be downloaded on first use.
        root: Folder that a URDF may read meshes from; default: its package (the nearest folder
            with a package.xml), else its own folder.
        scale: Factor of all lengths of a file that is not in metres.

    Returns:
        The model. Lengths are in m, angles in rad.

    Raises:
        ModelError: There is no such robot (the message lists those that exist), the file is not
            of a supported format, is broken or lacks meshes, or is not on this machine and must
            not be downloaded.

    Examples:
        >>> robot = gb.load_robot("owi535")
        >>> robot.joint_names
        ('rotation', 'base', 'elbow', 'wrist', 'gripper')
    """
    if not isinstance(cast("object", name), str | Path):
        raise ModelError(f"{str(name)[:60]!a} is no robot; give a name or the path of a file, as "
                         "text or Path")
    folders = {key: Path(folder) for key, folder in (packages or {}).items()}
    if is_file(name):
        with hash_files() as hashes:
            model = _load_file(Path(name), folders, allow_missing, root, scale)
        return _with_files(model, Path(name).parent, hashes)
    name = str(name)
    if scale != 1.0:
        raise ModelError(f"{name} is in metres; --scale is for files")
    if is_object(name):
        return _load_object(name, folders, allow_missing, download)
    entry = find_robot(name)
    if isinstance(entry, GeneratedRobot):
        module, _, function = entry.builder.partition(":")
        build = getattr(import_module(f"..{module}", __package__), function)
        model = build() if entry.number is None else build(entry.number)
    elif isinstance(entry, ClonedEntry):
        return _load_cloned(entry, folders, allow_missing, download)
    else:
        model = _load_fetched(entry, _catalog_urdf(entry, download))
    return replace(model, name=entry.name, source=entry.source, licence=entry.licence)


def is_file(name: str | Path) -> bool:
    """Whether a robot is given by the path of a file, not by a name."""
    suffixes = (*_URDF, *_GLTF, *_UNSUPPORTED)
    return isinstance(name, Path) or name.lower().endswith(suffixes)


def robot_urdf(
    name: str | Path, packages: Mapping[str, str | Path] | None = None, download: bool = True
) -> Path | None:
    """Return the URDF that describes a robot, None for models without one.

    The files of a generated appliance are written into the cache first. Arguments and errors are
    those of `load_robot`.
    """
    if is_file(name):
        path = Path(name)
        return path if path.suffix.lower() in _URDF else None
    name = str(name)
    if is_object(name):
        from ..urdf import partnet

        folders = {key: Path(folder) for key, folder in (packages or {}).items()}
        return _object_folder(name, folders, download) / partnet.URDF
    entry = find_robot(name)
    if isinstance(entry, ClonedEntry):
        return clone_robot(name, download).urdf
    return None if isinstance(entry, GeneratedRobot) else _catalog_urdf(entry, download)


def select_default_scored(name: str | Path, model: ArticulatedModel) -> tuple[str, ...]:
    """Return the joints that move and are scored by default.

    These are the catalogue's, the doors (else a drawer) of an object, or the bottom three joints
    of any other model.
    """
    names: tuple[str, ...] = ()
    if not is_file(name):
        from ..urdf import partnet

        names = partnet.scored_joints(model) if is_object(str(name)) else \
            find_robot(str(name)).scored
    return names or default_scored_joints(model)


def _with_files(
    model: ArticulatedModel, folder: Path, hashes: Mapping[Path, str]
) -> ArticulatedModel:
    """Return the model with the hashes of its files, by their paths from a folder."""
    above = folder.resolve()
    files = {Path(os.path.relpath(path, above)).as_posix(): h for path, h in hashes.items()}
    return replace(model, files=dict(sorted(files.items())))


def _load_fetched(entry: FetchedRobot, urdf: Path) -> ArticulatedModel:
    """Load a robot from the cache. Each file is compared with the one that the catalogue pins."""
    from ..urdf import load_urdf

    folder = robot_folder(entry)
    pinned = json.loads((Path(__file__).parent / "hashes.json").read_bytes())[entry.files.name]
    expected = {(folder / name).resolve(): digest for name, digest in pinned.items()}
    with hash_files() as hashes:
        try:
            model, problem = load_urdf(urdf, asset_root=folder), None
        except ModelError as error:
            model, problem = None, error
    changed = [path for path in expected if not path.is_file()]
    changed += [path for path, digest in hashes.items() if expected.get(path) != digest]
    if changed:
        raise ModelError(f"{changed[0]}: is not the file that was fetched; delete the folder "
                         f"{folder}, and gcbench fetches it again") from problem
    if model is None:
        raise problem or AssertionError
    return _with_files(model, folder, hashes)


def _load_cloned(
    entry: ClonedEntry, packages: Mapping[str, Path], allow_missing: bool, download: bool
) -> ArticulatedModel:
    """Load a robot of robot_descriptions; `packages` go before the folders of its repository."""
    from ..urdf import load_urdf

    robot = clone_robot(entry.name, download)
    with hash_files() as hashes:
        model = load_urdf(robot.urdf, {**robot.packages, **packages}, allow_missing,
                          robot.repository)
    model = _with_files(model, robot.repository, hashes)
    return replace(model, name=entry.name, source=robot.source, licence=entry.licence)


def _catalog_urdf(entry: FetchedRobot, download: bool) -> Path:
    """The URDF of a fetched robot of the catalogue."""
    if not (download or is_local(entry)):
        raise ModelError(f"the meshes of {entry.name} are not on this machine "
                         f"(gcbench robots fetch {entry.name})")
    return robot_folder(entry) / entry.urdf


def _load_file(
    path: Path, packages: Mapping[str, Path], allow_missing: bool, root: str | Path | None,
    scale: float,
) -> ArticulatedModel:
    suffix = path.suffix.lower()
    if suffix in _UNSUPPORTED:
        raise ModelError(f"{path}: {_UNSUPPORTED[suffix]}")
    if suffix in _GLTF:
        from ..gltf import load_gltf

        return load_gltf(path, allow_missing, scale)
    if suffix not in _URDF:
        raise ModelError(f"{path}: is no robot file; .urdf, .glb and .gltf files are read")
    from ..urdf import load_urdf

    return load_urdf(path, packages, allow_missing, Path(root).expanduser() if root else None,
                     scale)


def _load_object(
    name: str, packages: Mapping[str, Path], allow_missing: bool, download: bool
) -> ArticulatedModel:
    kind, number = parse_object_name(name)
    if kind in GENERATED:
        return appliance_model(kind, number)
    from ..urdf import partnet

    folder = _object_folder(name, packages, download)
    with hash_files() as hashes:
        model = partnet.load_object(folder, allow_missing)
    model = _with_files(model, folder, hashes)
    name = f"{kind}:{number}"
    return replace(model, name=name, source=f"{name}, PartNet-Mobility", licence=partnet.LICENCE)


def _object_folder(name: str, packages: Mapping[str, Path], download: bool) -> Path:
    """The folder of one object: generated, or the user's (`packages["partnet"]` goes first)."""
    kind, number = parse_object_name(name)
    if kind in GENERATED:
        return appliance_folder(kind, number)
    from ..urdf import partnet_folder

    return partnet_folder(str(number), packages.get(PARTNET), download)
