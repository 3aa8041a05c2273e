"""From a stored estimate and the truth to lines of the score table. Never runs a method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...renderer.types import Estimate, Sequence
from ...robots.geometry import Array
from ..results import EstimateShape, Result, Run, Stored
from . import metrics
from .truth import Truth, truth_of

AXES_KNOWN = ("axes", "kinematics", "model")
"""Knowledge that decides the sign of a joint."""


def shape_of(sequence: Sequence) -> EstimateShape:
    """What an estimate of the sequence must fit."""
    meta = sequence.meta
    return EstimateShape(meta.frames, len(meta.scored_joints), meta.height, meta.width)


def score_sequence(
    sequence: Sequence, stored: Stored, run: Run, name: str, cluster: str | None = None
) -> list[Result]:
    """Every number about one estimate (metrics.py names them), in deg and m.

    `name` is the sequence's in its dataset, `cluster` what the bootstrap draws (default: `name`).
    """
    truth = truth_of(sequence)
    row = run.row
    blank = Result(
        method=row.name, version=row.version, inputs=row.inputs, knowledge=row.knowledge,
        oracles="+".join(row.oracles), training=row.training, dataset=run.dataset,
        robot=str(run.config.get("robot", "")), sequence=name, cluster=cluster or name,
        joint="", joint_index=0, joint_type="", frame=-1, metric="", value=0.0, unit="", sign="",
        status=stored.status,
    )  # fmt: skip
    out = joint_results(truth, stored.estimate, row.knowledge in AXES_KNOWN, blank)
    whole = {
        "seconds": (stored.seconds, "s"),
        "seconds_per_frame": (stored.seconds and stored.seconds / len(sequence), "s"),
        "peak_memory": (stored.peak_memory, "MiB"),
        "part_miou": (_part_miou(sequence, truth, stored.estimate), ""),
    }
    out += [
        replace(blank, metric=metric, value=value, unit=unit)
        for metric, (value, unit) in whole.items()
        if value is not None and np.isfinite(value)
    ]
    return out


def joint_results(
    truth: Truth, estimate: Estimate | None, axes_known: bool, blank: Result
) -> list[Result]:
    """The lines of each joint; `blank` has what they share."""
    given = None if estimate is None else estimate.displacement
    moved = metrics.no_motion_where_missing(given, truth.displacement)
    covered = metrics.covered(given, len(truth.joint_names))
    screw = None if estimate is None else estimate.screw
    prismatic = truth.prismatic
    sign, how = metrics.signs(moved, truth.displacement, prismatic, axes_known, screw, truth.screw)
    scale = np.where(prismatic, 1.0, np.degrees(1.0))  # rad to deg
    error = scale * metrics.errors(moved, truth.displacement, prismatic, sign)
    step = scale * metrics.step_errors(moved, truth.displacement, prismatic, sign)
    steps = step.mean(0) if len(step) else np.zeros(len(scale))

    per_joint: dict[str, tuple[Array, str | None]] = {
        "final_error": (error[-1], None),
        "mean_error": (metrics.over_frames(error), None),
        "step_error": (steps, None),
        "displacement": (scale * np.abs(truth.displacement[-1]), None),
        "covered": (covered.astype(np.float64), ""),
    }
    if estimate is not None and estimate.sigma is not None:
        sigma = np.where(covered, scale * estimate.sigma, np.nan)
        inside = metrics.within_sigma(error, sigma)
        per_joint |= {
            "sigma": (sigma[-1], None),
            "within_sigma": (inside[-1], ""),
            "within_sigma_frames": (metrics.over_frames(inside), ""),
        }
    if screw is not None:
        distance = metrics.axis_distance(screw, truth.screw, truth.origin)
        per_joint |= {
            "axis_direction": (
                np.degrees(metrics.axis_direction_error(screw, truth.screw)), "deg"
            ),
            "axis_distance": (np.where(prismatic, np.nan, distance), "m"),
        }  # fmt: skip

    out: list[Result] = []
    for j, name in enumerate(truth.joint_names):
        unit = "m" if prismatic[j] else "deg"
        common: dict[str, Any] = {
            "joint": name, "joint_index": j + 1, "joint_type": truth.joint_types[j],
            "sign": how[j],
        }  # fmt: skip
        joint = replace(blank, **common)
        out += [
            replace(joint, metric=metric, value=float(v[j]), unit=unit if u is None else u)
            for metric, (v, u) in per_joint.items()
            if np.isfinite(v[j]) or (metric == "sigma" and np.isposinf(v[j]))
        ]
        out += [
            replace(joint, metric="error", frame=t, value=float(error[t, j]), unit=unit)
            for t in range(1, len(error))
        ]
    return out


def _part_miou(sequence: Sequence, truth: Truth, estimate: Estimate | None) -> float | None:
    if estimate is None or estimate.part is None:
        return None
    joints = len(truth.joint_names)
    both = np.zeros((2, joints), np.int64)
    for part, found in zip(sequence.part, estimate.part, strict=True):
        both += metrics.part_iou(found, truth.label[part], joints)
    return metrics.mean_iou(both[0], both[1])
