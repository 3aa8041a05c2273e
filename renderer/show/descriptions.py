"""The tables of the page: joints, camera, lights and metadata of a sequence as text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...robots.geometry import inverse
from ..types import Meta, State

_Rows = list[tuple[str, str]]
_HEADINGS = {
    "pixels": "fewest pixels",
    "share": "least unoccluded share",
    "motion": "own flow, px per step",
}
"""Headings of the values in `meta.observability`; `displacement` is the column `total`."""
_LONGEST, _LONGEST_RAW = 600, 200_000
"""Characters of one value, and of the raw metadata below the tables."""


def joint_table(meta: Meta, state: State) -> dict[str, list[Any]]:
    """`{"head": [column], "rows": [[text of each column] of each joint]}`, scored joints first.

    What `meta.observability` says of single joints is in further columns.
    """
    head = ["joint", "scored", "type", "parent → child", "limits", "first → last", "total"]
    known = columns_of_joints(meta.observability, meta.joint_names)
    columns = list(dict.fromkeys(column for values in known.values() for column in values
                                 if column != "displacement"))
    names = ("(world)", *meta.part_names)
    rows: list[list[str]] = []
    for j in sorted(range(len(meta.joint_names)),
                    key=lambda j: meta.joint_names[j] not in meta.scored_joints):
        name, kind, limits = meta.joint_names[j], meta.joint_types[j], meta.joint_limits[j]
        q = state.joint_positions[:, j]
        rows.append([
            name,
            "yes" if name in meta.scored_joints else "–",
            kind,
            f"{names[int(state.joint_parent_part[j])]} → {names[int(state.joint_child_part[j])]}",
            " … ".join(format_position(x, kind) for x in limits) if limits else "none",
            f"{format_position(float(q[0]), kind)} → {format_position(float(q[-1]), kind)}",
            format_position(float(q[-1] - q[0]), kind),
            *(format_value(known.get(name, {}).get(column, "–")) for column in columns),
        ])
    return {"head": head + [_HEADINGS.get(c, c.replace("_", " ")) for c in columns], "rows": rows}


def joint_ranges(meta: Meta, state: State) -> list[str]:
    """Return for each scored joint the least and greatest position in the sequence, in ASCII."""
    out: list[str] = []
    for j, (name, kind) in enumerate(zip(meta.joint_names, meta.joint_types, strict=True)):
        q = state.joint_positions[:, j]
        if name in meta.scored_joints:
            low, high = (f"{x:.3f}" if kind == "prismatic" else f"{math.degrees(x):.1f}"
                         for x in (q.min(), q.max()))
            out.append(f"{name} {low} to {high} {'m' if kind == 'prismatic' else 'deg'}")
    return out


def sections(meta: Meta, state: State) -> list[dict[str, Any]]:
    """`[{"title", "rows": [(key, text)]}]` and, last, the raw metadata as `{"title", "raw"}`."""
    drawn = dict(meta.randomization)
    lights = {k: drawn.pop(k) for k in ("lights", "ambient", "shadows") if k in drawn}
    observability = {k: v for k, v in meta.observability.items()
                     if k not in meta.joint_names and not _of_joints(v, meta.joint_names)}
    camera = drawn.pop("camera", {})
    for said_elsewhere in ("vertical_fov_deg", "world_from_cam", "materials"):
        drawn.pop(said_elsewhere, None)  # by the camera's rows, or too long but for the raw data
    raw = json.dumps(vars(meta), indent=1, default=_plain)[:_LONGEST_RAW]
    sequence: _Rows = [
        ("name", meta.name), ("seed / index", f"{meta.seed} / {meta.index}"),
        ("frames", f"{meta.frames}, {_seconds(state)}"),
        ("image", f"{meta.width} × {meta.height} px"), ("format", meta.format),
        ("parts / joints", f"{len(meta.part_names)} / {len(meta.joint_names)}"),
    ]
    out: list[tuple[str, _Rows]] = [
        ("Robot", flatten(meta.asset)),
        ("Sequence", sequence),
        ("Camera", camera_rows(meta, state) + flatten(camera)),
        ("Lights", [(key.removeprefix("lights / "), said) for key, said in flatten(lights)]),
        ("Observability", flatten(observability)),
        ("Other drawn values", flatten(drawn)),
        ("Renderer", flatten(meta.renderer)),
    ]
    tables: list[dict[str, Any]] = [{"title": title, "rows": rows} for title, rows in out if rows]
    return [*tables, {"title": "Raw metadata", "raw": raw}]


def camera_rows(meta: Meta, state: State) -> _Rows:
    """Return the camera's rows; its position is that of the first frame."""
    k, world_from_cam = state.intrinsics, inverse(state.cam_from_world)
    eye = world_from_cam[0, :3, 3]
    fov = [math.degrees(2 * math.atan(n / (2 * f)))
           for n, f in ((meta.width, k[0, 0]), (meta.height, k[1, 1]))]
    travel = float(np.linalg.norm(world_from_cam[:, :3, 3] - eye, axis=-1).max())
    turned = float(np.abs(state.cam_from_world[:, :3, :3] - state.cam_from_world[0, :3, :3]).max())
    still = travel < 1e-9 and turned < 1e-9
    return [
        ("model", meta.camera_model),
        ("focal length", f"{k[0, 0]:.1f}, {k[1, 1]:.1f} px"),
        ("principal point", f"({k[0, 2]:.1f}, {k[1, 2]:.1f}) px"),
        ("field of view", f"{fov[0]:.1f}° × {fov[1]:.1f}°"),
        ("position in the world", format_value(eye) + " m"),
        ("moves", "no" if still else f"yes, up to {travel:.3f} m from where it starts"),
    ]


def format_position(value: float, kind: str) -> str:
    """A joint position or its change: degrees, or metres of a prismatic joint."""
    return f"{value:.4f} m" if kind == "prismatic" else f"{math.degrees(value):.1f}°"


def columns_of_joints(said: Mapping[str, Any], joints: Sequence[str]) -> dict[str, dict[str, Any]]:
    """joint -> column -> value: of `{joint: {column: value}}` and `{column: {joint: value}}`,
    at the top or one level below."""
    out: dict[str, dict[str, Any]] = {}
    for key, value in {"": said, **said}.items():
        if not _of_joints(value, joints):
            continue
        for joint, entry in value.items():
            columns = entry if isinstance(entry, Mapping) else {key or "value": entry}
            if joint in joints:
                out.setdefault(joint, {}).update(columns)
    return out


def _of_joints(value: Any, joints: Sequence[str]) -> bool:
    """Whether this is a mapping from joint names (the top level may hold other keys too)."""
    return isinstance(value, Mapping) and any(key in joints for key in value)


def flatten(values: Mapping[str, Any], prefix: str = "") -> _Rows:
    """(key, text) of each value; the keys of inner mappings are joined by ` / `."""
    rows: _Rows = []
    for key, value in values.items():
        name = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, Mapping) and value:
            rows += flatten(value, f"{name} / ")
        elif isinstance(value, (list, tuple)) and value and isinstance(value[0], Mapping):
            rows += flatten({str(i + 1): item for i, item in enumerate(value)}, f"{name} / ")
        elif value not in ("", [], ()):
            rows.append((name, format_value(value)))
    return rows


def format_value(value: Any) -> str:
    """Format one value for reading: few digits, yes and no."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return "(" + ", ".join(format_value(item) for item in value[:16]) + (
            ", …)" if len(value) > 16 else ")")
    if isinstance(value, Mapping) and not value:
        return "none"
    shown = "–" if value is None or value == "" else str(value)
    return shown if len(shown) <= _LONGEST else shown[:_LONGEST] + " …"


def _plain(value: Any) -> Any:
    """What json.dumps does not know: NumPy values, other mappings, and anything else as text."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else str(value)


def _seconds(state: State) -> str:
    if len(state.times) < 2:
        return "an instant"
    step = float(np.median(np.diff(state.times)))
    return f"{state.times[-1] - state.times[0]:.2f} s" + (f" at {1 / step:.4g} Hz" if step else "")
