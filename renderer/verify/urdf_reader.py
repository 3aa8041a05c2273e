"""The verifier's own reading of a URDF: links, joints, origins, axes and mimics.

The loader reads a URDF through yourdfpy. This reader shares only the hardened XML parser with it,
so that a mistake of either shows as a difference of poses. Everything else of a URDF (visuals,
collisions, inertias, limits, transmissions, the robot's name) is skipped and cannot matter here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ModelError
from ...robots.files import Element, parse_xml, read_bounded
from ...robots.geometry import Array

_MAX_BYTES = 32 * 2**20
_MAX_LINKS = 2000
_MAX_NAME = 1024  # characters
_MOVABLE = ("revolute", "continuous", "prismatic")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class UrdfMimic:
    """A joint's value as a function of another's: multiplier * value(leader) + offset."""

    leader: str
    multiplier: float
    offset: float  # rad or m


@dataclass(frozen=True)
class UrdfJoint:
    """One joint; types that gcbench does not move (floating, planar, ...) count as fixed."""

    name: str
    kind: str  # one of "revolute", "continuous", "prismatic", "fixed"
    parent: str
    child: str
    parent_from_child_at_zero: Array  # [4 4]
    axis: Array  # [3] unit vector in the child's frame
    mimic: UrdfMimic | None = None


@dataclass(frozen=True)
class UrdfTree:
    """The kinematic tree of a URDF."""

    links: tuple[str, ...]  # parents before children
    joints: Mapping[str, UrdfJoint]  # by name
    joint_of_link: Mapping[str, UrdfJoint]  # the joint that moves a link; the root has no entry

    def leader_of(self, joint: UrdfJoint) -> tuple[UrdfJoint, float, float]:
        """The joint at the end of a chain of mimics, and the multiplier and offset of its value."""
        multiplier, offset, visited = 1.0, 0.0, {joint.name}
        while joint.mimic is not None and joint.mimic.leader in self.joints:
            if joint.mimic.leader in visited:
                raise ModelError(f"joint {joint.name!r}: mimics {joint.mimic.leader[:80]!r}, which "
                                 "mimics it in turn")
            offset += multiplier * joint.mimic.offset
            multiplier *= joint.mimic.multiplier
            joint = self.joints[joint.mimic.leader]
            visited.add(joint.name)
        return joint, multiplier, offset


def read_urdf_tree(path: Path) -> UrdfTree:
    """Read the kinematic tree of the URDF at `path`.

    Raises:
        ModelError: the file is no URDF, is larger than the limits, or its joints do not make a
            tree.
    """
    try:
        root = parse_xml(read_bounded(path, _MAX_BYTES))
        if root.tag != "robot":
            raise ModelError("the root element is not <robot>")
        links, joints = root.findall("link"), root.findall("joint")
        if max(len(links), len(joints)) > _MAX_LINKS:
            raise ModelError(f"has more than {_MAX_LINKS} links or joints")
        return _tree([_text(link, "name") for link in links], [_joint(j) for j in joints])
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def _tree(declared: list[str], joints: list[UrdfJoint]) -> UrdfTree:
    """Order the links; a link that only joints name ("world" in many files) is one, too."""
    links = list(dict.fromkeys([*declared, *(j.parent for j in joints)]))
    by_name, joint_of_link = {j.name: j for j in joints}, {j.child: j for j in joints}
    if len(by_name) < len(joints) or len(joint_of_link) < len(joints):
        raise ModelError("two joints have one name or one child")
    children: dict[str, list[str]] = {}
    for j in joints:
        children.setdefault(j.parent, []).append(j.child)
    order = [link for link in links if link not in joint_of_link]
    for link in order:  # grows while it is read: breadth first
        order += children.get(link, ())
    if sorted(order) != sorted(links):
        raise ModelError("the joints do not make a tree of the links")
    return UrdfTree(tuple(order), by_name, joint_of_link)


def _joint(element: Element) -> UrdfJoint:
    name, kind = _text(element, "name"), element.get("type", "").strip()
    movable = kind in _MOVABLE
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0)) if movable else np.eye(3)[0]
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise ModelError(f"joint {name!r}: the axis is zero")
    return UrdfJoint(
        name, kind if movable else "fixed", _text(element.find("parent"), "link"),
        _text(element.find("child"), "link"), _pose(element.find("origin")), axis / length,
        _mimic(element.find("mimic")) if movable else None)


def _mimic(element: Element | None) -> UrdfMimic | None:
    if element is None:
        return None
    multiplier, offset = (_numbers(element, key, (default,))[0]
                          for key, default in (("multiplier", 1.0), ("offset", 0.0)))
    return UrdfMimic(_text(element, "joint"), float(multiplier), float(offset))


def _pose(origin: Element | None) -> Array:
    """The matrix of an <origin>: roll, pitch, yaw are turns about the fixed x, y and z axes."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", _numbers(origin, "rpy", (0, 0, 0))).as_matrix()
    pose[:3, 3] = _numbers(origin, "xyz", (0, 0, 0))
    return pose


def _numbers(element: Element | None, key: str, default: tuple[float, ...]) -> Array:
    """The finite numbers of an attribute, the first as the default has; blank: the default."""
    words = (element.get(key, "") if element is not None else "").replace(",", " ").split()
    if not words:
        return np.array(default, np.float64)
    words = words[:len(default)] if len(default) == 3 else words
    numbers = [float(word) if _NUMBER.fullmatch(word) else math.nan for word in words]
    if len(numbers) != len(default) or not all(map(math.isfinite, numbers)):
        raise ModelError(f"{key}={' '.join(words)[:60]!r} is not {len(default)} finite numbers")
    return np.array(numbers, np.float64)


def _text(element: Element | None, key: str) -> str:
    text = element.get(key, "").strip() if element is not None else ""
    if not 0 < len(text) <= _MAX_NAME:
        raise ModelError(f"a link or joint has no {key!r}, or a longer one than {_MAX_NAME}")
    return text
