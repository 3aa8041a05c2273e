"""The numbers in the tables of the GC-Pose paper.

The paper's datasets are not published. The report shows these numbers as a reference, never ranked
with results of this benchmark.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from ...errors import DatasetError
from ...robots.files import read_bounded
from ..results import Row, is_label

_MAX_BYTES = 2**20
_Error = Annotated[float, msgspec.Meta(ge=0, le=1e6)]
_Percent = Annotated[float, msgspec.Meta(ge=0, le=100)]


@dataclass(frozen=True)
class PublishedCell:
    """One cell of a table of the paper."""

    table: int
    """Number of the table: 1 objects, 2 OWI-535 by joint, 3 robots."""
    method: str
    """Name in the paper."""
    robot: str
    """Name in the catalogue of robots."""
    joint: int
    """Number of the joint, 1 .. J from the base outward; 0 for all joints (in table 2: of the real
    images)."""
    mean: float
    """Mean error, deg."""
    std: float | None = None
    """Standard deviation, deg."""
    pcp5: float | None = None
    """PCP@5, percent."""


FULL = "GC-Pose, true depth"
NOISY = "GC-Pose, true depth with 5 cm noise"
ESTIMATED = "GC-Pose, estimated depth"
ALONE, EPIPOLAR = "FlowNet2 alone", "FlowNet2, epipolar"
ARMS = ("ur5", "ur5-textured", "iiwa14", "irb2400")
OBJECTS = ("microwave", "dishwasher", "oven")
OWI = "owi535"
ACROSS = "oven, trained on other classes"

_OBJECTS = {
    "ScrewNet": ((2.549, 0.939), (4.037, 1.613), (0.720, 0.140)),
    "ICP": ((9.895, 8.043), (14.396, 10.472), (11.227, 9.311)),
    "Abbatematteo et al.": ((11.856, 2.456), (9.735, 4.600), (13.087, 4.649)),
    "GC-Pose": ((1.231, 0.717), (1.605, 1.057), (1.337, 1.199)),
}
_ACROSS = {"ScrewNet": (8.650, 0.207), "Abbatematteo et al.": (9.915, 3.934)}
_OWI = {
    "CRAVES": ((2.8415, 0.8263), (3.0825, 1.0282), (2.8257, 0.9200), (3.3806, 1.2193)),
    "GC-Pose, RGB": ((2.9719, 1.2091), (2.8177, 1.9490), (3.0132, 1.6279), (4.1522, 2.6377)),
    "GC-Pose, RGB-D": ((1.7632, 1.0900), (1.3688, 1.0862), (1.7357, 1.3744), (2.9779, 1.7250)),
}
_REAL = {"CRAVES": (4.4128, 1.931), "GC-Pose, RGB": (3.1416, 2.850)}
_ROBOTS = {
    ALONE: ((25.7216, 12.5), (8.4578, 45.0), (17.1803, 19.5), (29.1733, 3.5)),
    EPIPOLAR: ((8.7170, 49.2), (5.6970, 65.5), (8.1617, 42.0), (9.0064, 31.0)),
    ESTIMATED: ((3.8168, 85.9), (3.1532, 87.5), (4.0264, 83.5), (5.9153, 81.5)),
    FULL: ((2.2132, 91.6), (1.4633, 96.5), (2.5158, 89.0), (3.1479, 93.5)),
    NOISY: ((2.9758, 89.6), (2.2413, 94.0), (3.2217, 87.0), (4.6583, 85.0)),
}

PUBLISHED: tuple[PublishedCell, ...] = (
    *(PublishedCell(1, method, robot, 0, mean, std)
      for method, cells in _OBJECTS.items()
      for robot, (mean, std) in zip(OBJECTS, cells, strict=True)),
    *(PublishedCell(1, f"{method} ({ACROSS})", "oven", 0, mean, std)
      for method, (mean, std) in _ACROSS.items()),
    *(PublishedCell(2, method, OWI, joint, mean, std)
      for method, cells in _OWI.items()
      for joint, (mean, std) in enumerate(cells, 1)),
    *(PublishedCell(2, method, OWI, 0, mean, std) for method, (mean, std) in _REAL.items()),
    *(PublishedCell(3, method, robot, 0, mean, pcp5=pcp5)
      for method, cells in _ROBOTS.items()
      for robot, (mean, pcp5) in zip(ARMS, cells, strict=True)),
)
"""All numbers; those on the real images of table 2 have no counterpart here."""

_COUNTERPARTS = {
    ("gcpose", "rgb", 3): ESTIMATED,
    ("gcpose", "rgbd", 3): FULL,
    ("gcpose", "rgbd-noise", 3): NOISY,
    ("gcpose-flow", "rgb", 3): ALONE,
    ("gcpose-epipolar", "rgb", 3): EPIPOLAR,
    ("gcpose-depth", "rgb", 3): ESTIMATED,
    ("gcpose-depth", "rgbd", 3): FULL,
    ("gcpose-depth", "rgbd-noise", 3): NOISY,
    ("icp", "rgbd", 1): "ICP",
    ("gcpose", "rgb", 1): "GC-Pose",
    ("gcpose", "rgbd", 1): "GC-Pose",
    ("gcpose", "rgb", 2): "GC-Pose, RGB",
    ("gcpose", "rgbd", 2): "GC-Pose, RGB-D",
}
"""Names in the paper by (method, inputs, table). Table 1 does not state the inputs of GC-Pose: its
cell stands beside both."""


def paper_order(robot: str) -> int:
    """Return the position of a robot in the tables of the paper; unknown robots come last."""
    known = (*ARMS, OWI, *OBJECTS)
    return known.index(robot) if robot in known else len(known)


_LEARNED = {"screwnet": "ScrewNet", "abbatematteo": "Abbatematteo et al."}
"""Names in table 1 by the first word of our name, which what it has learned from follows."""


def counterpart(row: Row, table: int, robot: str) -> str:
    """Return the name of the corresponding method in the paper, or "".

    The paper's method knows the directions of the axes ("computed using the kinematic chain"), so
    a row with other knowledge has no counterpart, unless the method is learned. CRAVES has the
    model. A network of table 1 has learned from the robot's own class, also with others; or from
    other classes only, for ACROSS. The row's name says which.
    """
    if row.oracles:
        return ""
    method, _, learned = row.method.partition(" ")
    if (method, table, row.knowledge) == ("craves", 2, "model"):
        return "CRAVES"
    if method in _LEARNED and table == 1:
        classes = set(learned.partition(" ")[0].split("+"))
        if robot in classes:
            return _LEARNED[method]
        across = robot == "oven" and classes < {*OBJECTS}
        return f"{_LEARNED[method]} ({ACROSS})" if across else ""
    return _COUNTERPARTS.get((row.method, row.inputs, table), "") if row.knowledge == "axes" else ""


@dataclass(frozen=True)
class _Line:
    """A line of a file of numbers."""

    method: str
    robot: str
    mean: _Error
    joint: Annotated[int, msgspec.Meta(ge=0, le=999)] = 0
    std: _Error | None = None
    pcp5: _Percent | None = None


def read_published(path: Path) -> tuple[PublishedCell, ...]:
    """Read numbers of other papers from a CSV file.

    Its columns are method, robot and mean (deg), and may be joint (1 .. J; empty or 0: all joints),
    std (deg) and pcp5 (percent), in any order.

    Raises:
        DatasetError: Naming the file and the line that is invalid.
    """
    text = read_bounded(path, _MAX_BYTES, DatasetError).decode("utf-8-sig", errors="replace")
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    out: list[PublishedCell] = []
    seen: set[tuple[str, str, int]] = set()
    try:
        columns, known = lines.fieldnames or (), _Line.__dataclass_fields__
        if not {"method", "robot", "mean"} <= {*columns} <= {*known}:
            raise ValueError(f"the first line names columns: method, robot, mean, and of "
                             f"{', '.join([*known][3:])} those that there are")
        for cells in lines:
            if None in cells or None in cells.values():
                raise ValueError(f"expected {len(columns)} cells")
            given = {name: cell for name, cell in cells.items() if cell.strip()}
            line = msgspec.convert(given, _Line, strict=False)
            if not (is_label(line.method) and is_label(line.robot)):
                raise ValueError("a name is not printable, or has over 200 characters or an @")
            key = line.method, line.robot, line.joint
            if key in seen:
                raise ValueError(f"{line.method} on {line.robot} is there twice; leave one out")
            seen.add(key)
            table = 2 if line.joint else 1 if line.robot in OBJECTS else 3
            out.append(PublishedCell(
                table, line.method, line.robot, line.joint, line.mean, line.std, line.pcp5))
    except (ValueError, csv.Error) as error:
        raise DatasetError(f"{path}: line {lines.line_num}: {error}") from error
    return tuple(out)
