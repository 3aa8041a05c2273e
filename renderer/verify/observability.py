"""Checks of `meta["observability"]`: its numbers recomputed, and its verdict against the rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ...robots.model import ArticulatedModel
from ..types import Sequence
from .checks import CheckResult, check

_KEYS = ("displacement", "pixels", "share", "motion")


def verify_observability(
    sequence: Sequence, model: ArticulatedModel | None = None
) -> list[CheckResult]:
    """Check that the block is complete, agrees with the state, and follows the rule.

    Pixels are compared with `part_pixels`, which have a check of their own against the masks. This
    needs the model, because a sequence does not say which fixed part is attached to which.
    """
    meta, s = sequence.meta, sequence.state
    block = meta.observability
    joints = _mapping(block.get("joints"))
    lacking = [n for n in meta.scored_joints
               if any(not _is_number(_mapping(joints.get(n)).get(k)) for k in _KEYS)]
    lacking += [k for k in ("observable", "reason") if k not in block]
    checks = [check("observability present", len(lacking), 0, "entries", ", ".join(lacking),
                    samples=len(meta.scored_joints))]
    if lacking:
        return checks

    scored = [meta.joint_names.index(n) for n in meta.scored_joints]
    said = np.array([[float(joints[n][k]) for k in _KEYS] for n in meta.scored_joints])
    said = said.reshape(-1, len(_KEYS))
    total = (s.joint_positions[-1] - s.joint_positions[0])[scored]
    checks.append(check("observability: displacement", said[:, 0] - total, 1e-9, "rad|m",
                        lambda i: meta.scored_joints[i]))
    if model is not None and set(meta.scored_joints) <= set(model.joint_names) \
            and model.part_names == meta.part_names:
        fewest = [s.part_pixels[:, _moving_parts(model, n)].sum(1).min()
                  for n in meta.scored_joints]
        checks.append(check("observability: pixels", said[:, 1] - fewest, 0, "px",
                            lambda i: meta.scored_joints[i]))

    prismatic = np.array([meta.joint_types[j] == "prismatic" for j in scored], bool)
    scale = meta.width / 640, meta.height / 480
    rule = np.empty_like(said)
    rule[:, 0] = np.where(prismatic, 0.03, np.radians(10))
    rule[:, 1:] = 400 * scale[0] * scale[1], 0.25, 0.3 * min(scale)
    kept = np.abs(said) >= rule * (1 - 1e-9)
    unsound = (said[:, 2] < 0) | (said[:, 2] > 1)
    if block["observable"] is None and not len(scored):
        return [*checks, check("observability: verdict", "animation" not in meta.randomization, 0,
                               "joints", "none, although no animation moves the model")]
    claims = bool(block["observable"])
    wrong = unsound | (claims & ~kept.all(-1))
    # An unobservable sequence breaks a rule; a collision cannot be seen in these numbers.
    excuse = block["reason"] == "collision" or not kept.all() or not len(scored)
    checks.append(check("observability: verdict", [*wrong, not claims and not excuse,
                                                   claims == bool(block["reason"])], 0, "joints",
                        lambda i: meta.scored_joints[i] if i < len(scored) else "reason"))
    return checks


def _moving_parts(model: ArticulatedModel, joint: str) -> NDArray[np.bool_]:
    """[P] parts that the joint carries along, mimicking ones included."""
    number = model.joint_names.index(joint)
    moved = np.zeros(len(model.parent), bool)
    for p, parent in enumerate(model.parent):
        moved[p] = (parent >= 0 and moved[parent]) or model.joint[p] == number
    return moved


def _mapping(value: Any) -> Mapping[str, Any]:
    return cast("Mapping[str, Any]", value) if isinstance(value, Mapping) else {}


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
