"""The records that every reader produces: links, their joints, and the rules for sorting them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike

from ...errors import ModelError
from ..geometry import Array, prismatic_motion, revolute_motion, transform
from .surface import TriangleSurface

_EQUAL = 1e-6
"""rad or m; limits that differ by less are equal: files round them."""


class JointType(str, Enum):
    """How a joint moves; the values are the words of URDF and of the dataset format."""

    FIXED = "fixed"
    """Does not move."""
    REVOLUTE = "revolute"
    """Turns about its axis, between limits, rad."""
    CONTINUOUS = "continuous"
    """Revolute without limits."""
    PRISMATIC = "prismatic"
    """Slides along its axis, m."""

    __str__ = str.__str__

    def motion(self, screw: Array, value: ArrayLike) -> Array:
        """Return the rigid motion [... 4 4] for an axis [... 6] and a joint value [...]."""
        if self is JointType.FIXED:
            return np.broadcast_to(np.eye(4), (*np.shape(value), 4, 4))
        return (prismatic_motion if self is JointType.PRISMATIC else revolute_motion)(screw, value)


@dataclass(frozen=True)
class Mimic:
    """A joint value that follows another joint: multiplier * value + offset."""

    joint: str
    """Name of the joint that is followed; it may follow another one itself."""
    multiplier: float = 1.0
    offset: float = 0.0
    """rad or m."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint between a link and its parent; its value is the joint position, rad or m."""

    name: str = ""
    type: JointType = JointType.FIXED
    axis: ArrayLike = (0.0, 0.0, 1.0)
    """[3] unit direction, in the link's frame."""
    point: ArrayLike = (0.0, 0.0, 0.0)
    """[3] m, a point of the axis, in the link's frame; without meaning for a prismatic joint."""
    limits: tuple[float, float] = (-np.inf, np.inf)
    """rad or m."""
    mimic: Mimic | None = None

    @property
    def screw(self) -> Array:
        """[6] axis in the link's frame: (l, p x l), prismatic (l, 0), fixed zeros."""
        if self.type is JointType.FIXED:
            return np.zeros(6)
        axis = np.asarray(self.axis, np.float64)
        if axis.shape != (3,) or not abs(float(np.linalg.norm(axis)) - 1.0) < 1e-6:
            raise ModelError(f"joint {self.name!r}: its axis is not a unit vector")
        if self.type is JointType.PRISMATIC:
            return np.concatenate([axis, np.zeros(3)])
        # + 0.0 turns minus zero into zero
        return np.concatenate([axis, np.cross(np.asarray(self.point, np.float64), axis) + 0.0])


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body of a kinematic tree."""

    name: str
    parent: str | None = None
    """Name of the parent link; None for the root."""
    parent_from_link_at_zero: Array = field(default_factory=transform)
    """[4 4] rigid pose in the parent at joint value zero."""
    joint: Joint = Joint()
    surfaces: tuple[TriangleSurface, ...] = ()
    """In the link's frame, m."""


def sort_links(links: Sequence[Link], keep_order: bool = False) -> list[Link]:
    """Return the links depth first from the root, siblings in the given order.

    With `keep_order` the links must be in an order with parents before children, and stay in it.
    """
    children: dict[str, list[Link]] = {link.name: [] for link in links}
    if len(children) < len(links):
        raise ModelError("has two links of one name")
    _check_joint_names([link.joint for link in links])
    for link in links:
        if link.parent is None:
            continue
        if link.parent not in children:
            raise ModelError(f"joint {link.joint.name!r}: there is no link {link.parent!r}; "
                             f"there are {list_names(children)}")
        children[link.parent].append(link)
    stack = [link for link in links if link.parent is None]
    if not stack:
        raise ModelError("has no root link: its joints make a cycle")
    if len(stack) > 1:
        raise ModelError(f"has {len(stack)} root links ({list_names([r.name for r in stack])}); "
                         "connect them by joints")
    order: list[Link] = []
    while stack:
        order.append(stack.pop())
        stack.extend(reversed(children[order[-1].name]))
    if len(order) < len(links):
        reached = {link.name for link in order}
        lost = [name for name in children if name not in reached]
        raise ModelError(f"has a cycle of joints through the links {list_names(lost)}")
    if not keep_order:
        return order
    place = {link.name: p for p, link in enumerate(links)}
    if any(link.parent is not None and place[link.parent] > place[link.name] for link in links):
        raise ModelError("has a link that stands before its parent")
    return list(links)


def _check_joint_names(joints: Sequence[Joint]) -> None:
    for name, count in Counter(joint.name for joint in joints).items():
        if name and count > 1:
            raise ModelError(f"has two joints named {name!r}")
    if any(not joint.name and joint.type is not JointType.FIXED for joint in joints):
        raise ModelError("has a joint without a name")


def resolve_mimics(joints: Sequence[Joint]) -> dict[str, Mimic]:
    """Return for each mimic joint the joint that drives it in the end, through chains of mimics.

    Raises:
        ModelError: If a mimic follows an unknown joint, or itself.
    """
    by_name = {joint.name: joint for joint in joints if joint.name}
    resolved: dict[str, Mimic] = {}
    for start in joints:
        chain: dict[str, Mimic] = {}
        joint = start
        while (mimic := joint.mimic) is not None and joint.name not in resolved:
            if joint.name in chain:
                names = list(chain)
                cycle = [*names[names.index(joint.name):], joint.name]
                raise ModelError(f"joint {start.name!r}: mimics in a cycle: "
                                 f"{' -> '.join(cycle[:10])}")
            chain[joint.name] = mimic
            if mimic.joint not in by_name:
                raise ModelError(f"joint {joint.name!r}: mimics {mimic.joint!r}, which does not "
                                 f"exist; there are {list_names(by_name)}")
            joint = by_name[mimic.joint]
        for name, mimic in reversed(chain.items()):
            first = resolved.get(mimic.joint, Mimic(mimic.joint))
            resolved[name] = Mimic(first.joint, mimic.multiplier * first.multiplier,
                                   mimic.multiplier * first.offset + mimic.offset)
    return resolved


def shared_limits(
    joints: Sequence[Joint], mimics: Mapping[str, Mimic]
) -> tuple[dict[str, tuple[float, float]], tuple[str, ...]]:
    """Return the limits (rad or m) of each joint that drives others, within which they all stay.

    `mimics` are those that `resolve_mimics` returns. Limits of a mimic joint that leave its driver
    no range are left out, which the second result notes.
    """
    limits = {joint.name: joint.limits for joint in joints if joint.mimic is None}
    notes: list[str] = []
    for joint in joints:
        if joint.name not in mimics or joint.type in (JointType.FIXED, JointType.CONTINUOUS):
            continue
        mimic = mimics[joint.name]
        if mimic.joint not in limits or mimic.multiplier == 0.0:
            continue
        low, high = limits[mimic.joint]
        ends = sorted((end - mimic.offset) / mimic.multiplier for end in joint.limits)
        narrow = (ends[0] if ends[0] > low + _EQUAL else low,
                  ends[1] if ends[1] < high - _EQUAL else high)
        if narrow[1] - narrow[0] > _EQUAL or narrow == (low, high):
            limits[mimic.joint] = narrow
        else:
            notes.append(f"limits of joint {joint.name!r} are ignored: it mimics {mimic.joint!r}, "
                         "which could not move within them")
    return limits, tuple(notes)


def list_names(names: Collection[str], count: int = 12) -> str:
    """Return the names with commas, at most `count` of them."""
    shown = ", ".join(islice(names, count))
    return shown if len(names) <= count else f"{shown}, ... ({len(names)} in all)"
