"""The order of parts in a kinematic tree, and the joints that drive other joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...errors import ModelError


def parts_in_order(parts: Sequence[str], joints: Sequence[tuple[str, str, str]]) -> list[str]:
    """The parts with parents before children, each branch in the order of its joints.

    `joints` are (name, parent part, child part). Raises ModelError unless they make one tree.
    """
    known = set(parts)
    children: dict[str, list[str]] = {part: [] for part in parts}
    parent_joint: dict[str, str] = {}
    for name, parent, child in joints:
        for end in (parent, child):
            if end not in known:
                raise ModelError(f"joint {name!r}: there is no link {end!r}; "
                                 f"there are {_some(parts)}")
        if child in parent_joint:
            raise ModelError(f"link {child!r} is the child of two joints, {parent_joint[child]!r} "
                             f"and {name!r}; a link has one parent")
        parent_joint[child] = name
        children[parent].append(child)
    roots = [part for part in parts if part not in parent_joint]
    if not roots:
        raise ModelError("has no root link: its joints make a cycle")
    if len(roots) > 1:
        raise ModelError(f"has {len(roots)} root links ({_some(roots)}); connect them by joints")
    order: list[str] = []
    stack = [roots[0]]
    while stack:
        part = stack.pop()
        order.append(part)
        stack.extend(reversed(children[part]))
    if len(order) < len(parts):
        reached = set(order)
        lost = [part for part in parts if part not in reached]
        raise ModelError(f"has a cycle of joints through the links {_some(lost)}")
    return order


def resolve_mimics(
    mimics: Mapping[str, tuple[str, float, float]], joints: Sequence[str]
) -> dict[str, tuple[str, float, float]]:
    """Each mimic joint's final leader, multiplier and offset, through chains of mimics.

    `mimics` maps a joint to (leader, multiplier, offset); value = multiplier * leader + offset.
    Raises ModelError on an unknown leader or a cycle.
    """
    known = set(joints)
    resolved: dict[str, tuple[str, float, float]] = {}
    for name in mimics:
        chain: list[str] = []
        at = name
        while at in mimics and at not in resolved:
            if at in chain:
                raise ModelError(f"joint {name!r}: mimics in a cycle: "
                                 f"{' -> '.join([*chain[chain.index(at):], at][:10])}")
            chain.append(at)
            at = mimics[at][0]
            if at not in known:
                raise ModelError(f"joint {chain[-1]!r}: mimics {at!r}, which does not exist; "
                                 f"there are {_some(joints)}")
        for follower in reversed(chain):
            leader, multiplier, offset = mimics[follower]
            if leader in resolved:
                first, g, o = resolved[leader]
                leader, multiplier, offset = first, multiplier * g, multiplier * o + offset
            resolved[follower] = (leader, multiplier, offset)
    return resolved


def _some(names: Sequence[str], count: int = 12) -> str:
    shown = ", ".join(names[:count])
    return shown if len(names) <= count else f"{shown}, ... ({len(names)} in all)"
