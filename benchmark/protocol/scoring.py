"""Score a stored estimate against the truth, as lines of the score table. Never runs a method."""

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
"""Levels of knowledge that determine the sign of a joint."""


def shape_of(sequence: Sequence) -> EstimateShape:
    """Return the shape that an estimate of the sequence must have."""
    meta = sequence.meta
    return EstimateShape(meta.frames, len(meta.scored_joints), meta.height, meta.width)


def score_sequence(
    sequence: Sequence, stored: Stored, run: Run, name: str, cluster: str | None = None
) -> list[Result]:
    """Compute every metric of one estimate (see metrics.py), in deg and m.

    `name` is that of the sequence in its dataset, `cluster` the unit of the bootstrap (default:
    the sequence).
    """
    truth = truth_of(sequence)
    out = score_motion(truth, stored, run, name, cluster)
    shared = _part_miou(sequence, truth, stored.estimate)
    if shared is not None and np.isfinite(shared):
        out.append(replace(_blank(stored, run, name, cluster), metric="part_miou", value=shared))
    return out


def score_motion(
    truth: Truth, stored: Stored, run: Run, name: str, cluster: str | None = None
) -> list[Result]:
    """Compute every metric but `part_miou`, which alone needs images; see `score_sequence`."""
    blank = _blank(stored, run, name, cluster)
    out = joint_results(truth, stored.estimate, run.row.knowledge in AXES_KNOWN, blank)
    whole = {
        "seconds": (stored.seconds, "s"),
        "seconds_per_frame": (stored.seconds and stored.seconds / len(truth.displacement), "s"),
        "peak_memory": (stored.peak_memory, "MiB"),
    }
    out += [
        replace(blank, metric=metric, value=value, unit=unit)
        for metric, (value, unit) in whole.items()
        if value is not None and np.isfinite(value)
    ]
    return out


def _blank(stored: Stored, run: Run, name: str, cluster: str | None) -> Result:
    """Return what the results of one sequence share."""
    row = run.row
    return Result(
        method=row.name, version=row.version, inputs=row.inputs, knowledge=row.knowledge,
        oracles="+".join(row.oracles), training=row.training, dataset=run.dataset,
        robot=str(run.config.get("robot", "")), sequence=name, cluster=cluster or name,
        joint="", joint_index=0, joint_type="", frame=-1, metric="", value=0.0, unit="", sign="",
        status=stored.status,
    )


def joint_results(
    truth: Truth, estimate: Estimate | None, axes_known: bool, blank: Result
) -> list[Result]:
    """Score each joint; `blank` holds the fields that all lines share."""
    given = None if estimate is None else estimate.displacement
    moved = metrics.fill_missing(given, truth.displacement)
    screw = None if estimate is None else estimate.screw
    prismatic = truth.prismatic
    sign, how = metrics.signs(moved, truth.displacement, prismatic, axes_known, screw, truth.screw)
    scale = np.where(prismatic, 1.0, np.degrees(1.0))  # rad to deg
    error = scale * metrics.errors(moved, truth.displacement, prismatic, sign)
    step = scale * metrics.step_errors(moved, truth.displacement, prismatic, sign)
    per_joint = _joint_metrics(truth, estimate, error, step)
    out: list[Result] = []
    for j, name in enumerate(truth.joint_names):
        unit = "m" if prismatic[j] else "deg"
        common: dict[str, Any] = {
            "joint": name, "joint_index": j + 1, "joint_type": truth.joint_types[j],
            "sign": how[j],
        }
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


def _joint_metrics(
    truth: Truth, estimate: Estimate | None, error: Array, step: Array
) -> dict[str, tuple[Array, str | None]]:
    """Return values [J] and unit (None: deg or m, as the joint) of each metric of a joint, from the
    errors [T J] and the errors of the steps [T-1 J]."""
    prismatic, joints = truth.prismatic, len(truth.joint_names)
    scale = np.where(prismatic, 1.0, np.degrees(1.0))
    covered = metrics.is_covered(None if estimate is None else estimate.displacement, joints)
    out: dict[str, tuple[Array, str | None]] = {
        "final_error": (error[-1], None),
        "mean_error": (metrics.over_frames(error), None),
        "step_error": (step.mean(0) if len(step) else np.zeros(joints), None),
        "displacement": (scale * np.abs(truth.displacement[-1]), None),
        "pixels": (truth.pixels.astype(np.float64), "px"),
        "distance": (np.linalg.norm(truth.origin, axis=1), "m"),
        "covered": (covered.astype(np.float64), ""),
    }
    if estimate is not None and estimate.sigma is not None:
        sigma = np.where(covered, scale * estimate.sigma, np.nan)
        inside = metrics.within_sigma(error, sigma)
        out |= {
            "sigma": (sigma[-1], None),
            "within_sigma": (inside[-1], ""),
            "within_sigma_frames": (metrics.over_frames(inside), ""),
        }
    if estimate is not None and estimate.reliable is not None:
        out["reliable"] = ((covered & estimate.reliable).astype(np.float64), "")
    if estimate is not None and estimate.screw is not None:
        direction = metrics.axis_direction_error(estimate.screw, truth.screw)
        distance = metrics.axis_distance(estimate.screw, truth.screw, truth.origin)
        out |= {
            "axis_direction": (np.degrees(direction), "deg"),
            "axis_distance": (np.where(prismatic, np.nan, distance), "m"),
        }
    return out


def _part_miou(sequence: Sequence, truth: Truth, estimate: Estimate | None) -> float | None:
    if estimate is None or estimate.part is None:
        return None
    joints = len(truth.joint_names)
    both = np.zeros((2, joints), np.int64)
    for part, found in zip(sequence.part, estimate.part, strict=True):
        both += metrics.part_iou(found, truth.label[part], joints)
    return metrics.mean_iou(both[0], both[1])
