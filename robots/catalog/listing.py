"""The list of robots and objects that gcbench knows by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...errors import ModelError
from ..appliances import APPLIANCE_LICENCE, GENERATED
from .descriptions import clone_robot
from .entries import (
    CATALOG,
    ClonedEntry,
    FetchedRobot,
    GeneratedRobot,
    find_robot,
    is_local,
    robot_folder,
)
from .names import is_object


@dataclass(frozen=True)
class RobotInfo:
    """One line of `gcbench robots`."""

    name: str
    """What `load_robot` and `--robot` take."""
    robot: str
    """Maker and model."""
    joints: str
    """Number of independent joints."""
    scored: str
    """Number of joints that are scored, or which."""
    licence: str
    """SPDX expression of the model's files."""
    fetched: str
    """"yes" if it loads without network."""
    source: str
    """Requirement of the wheel that holds the meshes, or "generated"."""


def list_robots() -> list[RobotInfo]:
    """List the robots and objects that `load_robot` knows by name.

    Examples:
        >>> [robot.name for robot in gb.list_robots()][:2]
        ['ur5', 'ur5-textured']
    """
    out = [RobotInfo(
        entry.name, f"{entry.maker} {entry.title}", str(entry.joints), str(len(entry.scored)),
        entry.licence, "yes" if is_local(entry) else "no",
        entry.files.requirement if isinstance(entry, FetchedRobot) else "generated")
        for entry in CATALOG]
    for name in GENERATED:
        scored = "drawer" if name == "drawer" else "door"
        out.append(RobotInfo(name, f"any {name}, or {name}:17", "1+", scored, APPLIANCE_LICENCE,
                             "yes", "generated"))
    out.append(RobotInfo("partnet:7310", "an object of your PartNet-Mobility folder", "", "",
                         "research", "no", "yours"))
    return out


def fetch_robot(name: str) -> Path | None:
    """Download the files of a robot, once, with a pinned hash.

    Args:
        name: A robot of `list_robots`, or of the package robot_descriptions ("rd:NAME").

    Returns:
        The folder of its files in the cache (`GCBENCH_CACHE`); None if the robot is generated.

    Raises:
        ModelError: There is no robot of that name, it is an object, or the download fails.

    Example:
        >>> gb.fetch_robot("owi535")  # generated: there is nothing to fetch
    """
    if is_object(name):
        raise ModelError(f"{name}: an object has nothing to fetch; name robots")
    entry = find_robot(name)
    if isinstance(entry, ClonedEntry):
        return clone_robot(name).repository
    return None if isinstance(entry, GeneratedRobot) else robot_folder(entry)


def records_table(records: Sequence[Mapping[str, object]]) -> str:
    """Return a line of text for each record, with aligned columns below a header."""
    rows = [[*records[0]], *([str(cell) for cell in record.values()] for record in records)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows)
