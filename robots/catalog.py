"""The robots that can be named on the command line, and how a name becomes a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from .. import GcbenchError
from . import fetch as _fetch
from .fetch import WheelFiles
from .model import ArticulatedModel


@dataclass(frozen=True)
class CatalogEntry:
    """A robot: what it is, whose it is, and which files of which wheel describe it."""

    name: str
    maker: str
    title: str
    joints: int
    """Number of independent joints."""
    scored: tuple[str, ...]
    """Joints that move and are scored unless told otherwise, from the base outward."""
    licence: str
    """SPDX expression of the model's files."""
    upstream: str
    """Where the wheel took them from."""
    files: WheelFiles
    urdf: str
    """Path inside the fetched folder."""
    licence_files: tuple[str, ...]
    """Paths inside the fetched folder: the licence, or where the wheel declares it."""
    textured: bool = False
    """Whether its parts always carry a drawn texture (the meshes have none of their own)."""

    @property
    def source(self) -> str:
        """One line of provenance."""
        return f"{self.name}: {self.files.requirement}, from {self.upstream}"


_UR = "cmeel.prefix/share/example-robot-data/robots/ur_description/"
_UR_LICENCE = ("example_robot_data-6.0.0.dist-info/licenses/LICENSE", _UR + "README.md")
_UR5 = CatalogEntry(
    name="ur5", maker="Universal Robots", title="UR5 (CB3)", joints=6,
    scored=("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    licence="BSD-3-Clause", upstream="https://github.com/ros-industrial/universal_robot",
    files=WheelFiles(
        name="ur5", project="example-robot-data", version="6.0.0", size=131_055_297,
        sha256="424092a8093411ac2cd4ccc0572382bfc6b5eb4833aa984ef5e671dd67cd0a6e",
        keep=(_UR + "urdf/ur5_robot.urdf", _UR + "meshes/ur5/", *_UR_LICENCE)),
    urdf=_UR + "urdf/ur5_robot.urdf", licence_files=_UR_LICENCE)

_IIWA = "rtbdata/xacro/kuka_description/kuka_lbr_iiwa/"
_IIWA_LICENCE = ("rtb_data-2.0.0.dist-info/METADATA",)
_IIWA14 = CatalogEntry(
    name="iiwa14", maker="KUKA", title="LBR iiwa 14 R820", joints=7,
    scored=("joint_a1", "joint_a2", "joint_a3"),
    licence="MIT AND Apache-2.0",
    upstream="https://github.com/ros-industrial/kuka_experimental (meshes: Apache-2.0)",
    files=WheelFiles(
        name="iiwa14", project="rtb-data", version="2.0.0", size=45_462_197,
        sha256="ecbcad669eb4d91ef971311640683eab19e2310f2a2be5c04fa5d32c6f0efce6",
        keep=(_IIWA + "urdf/lbr_iiwa_14_r820.urdf", _IIWA + "meshes/", *_IIWA_LICENCE)),
    urdf=_IIWA + "urdf/lbr_iiwa_14_r820.urdf", licence_files=_IIWA_LICENCE)

_IRB = "tesseract_robotics/data/tesseract/"
_IRB_LICENCE = ("tesseract_robotics_nanobind-0.35.0.8.dist-info/METADATA", _IRB + "package.xml")
_IRB2400 = CatalogEntry(
    name="irb2400", maker="ABB", title="IRB 2400/10", joints=6,
    scored=("joint_1", "joint_2", "joint_3"),
    licence="Apache-2.0", upstream="https://github.com/ros-industrial/abb",
    files=WheelFiles(
        name="irb2400", project="tesseract-robotics-nanobind", version="0.35.0.8",
        sha256="cc659258024b01b9bc2c13e090e62a1f0ac6ce58bb550a31bb24492e07e95a46",
        size=134_782_652,
        keep=(_IRB + "support/urdf/abb_irb2400.urdf",
              _IRB + "support/meshes/abb_irb2400/irb2400/", *_IRB_LICENCE),
        platform=("--python-version=3.12", "--implementation=cp",
                  "--platform=manylinux_2_35_x86_64")),
    urdf=_IRB + "support/urdf/abb_irb2400.urdf", licence_files=_IRB_LICENCE)

CATALOG: tuple[CatalogEntry, ...] = (
    _UR5,
    replace(_UR5, name="ur5-textured", title="UR5 (CB3), textured", textured=True),
    _IIWA14,
    _IRB2400,
)


def find(name: str) -> CatalogEntry:
    """The entry of that name. Raises GcbenchError that lists what exists."""
    for entry in CATALOG:
        if entry.name == name:
            return entry
    raise GcbenchError(f"no robot {name!r}; there are {', '.join(e.name for e in CATALOG)}, "
                       "and any path to a .urdf file")


def is_path(name_or_path: str | Path) -> bool:
    """Whether it means a file, not a name of the catalogue."""
    return isinstance(name_or_path, Path) or name_or_path.lower().endswith(".urdf")


def is_fetched(entry: CatalogEntry) -> bool:
    """Whether the robot loads without network."""
    return _fetch.is_fetched(entry.files)


def fetch(entry: CatalogEntry) -> Path:
    """The folder of the robot's files; downloads them on first use (see fetch.fetch)."""
    return _fetch.fetch(entry.files)


def load(name_or_path: str | Path, packages: Mapping[str, Path] | None = None,
         allow_missing: bool = False) -> ArticulatedModel:
    """The model of a catalogue name (fetched on first use) or of a URDF file.

    `packages` says where `package://NAME/...` of the file is. `allow_missing` loads a file of
    which meshes are missing, and records them; a catalogue robot is always whole.
    """
    from .urdf import load_urdf  # parses XML and meshes; a listing of names needs neither

    if is_path(name_or_path):
        return load_urdf(Path(name_or_path), packages or {}, allow_missing)
    entry = find(str(name_or_path))
    folder = fetch(entry)
    model = load_urdf(folder / entry.urdf, asset_root=folder)
    return replace(model, name=entry.name, source=entry.source, licence=entry.licence)
