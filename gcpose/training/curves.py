"""A page with the curves of a training run, from its log."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ...robots.files import write_atomically

_WIDTH, _HEIGHT, _LEFT, _TOP, _BOTTOM = 720, 260, 60, 12, 24  # px
_COLORS = "#1f6feb", "#d1495b", "#2e8b57", "#8a63d2", "#b8860b", "#5b6770"
_MOST_POINTS = 500  # of a line
_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>body{{font:14px system-ui,sans-serif;max-width:{width}px;margin:24px auto}}
text{{font-size:11px;fill:#5b6770}}</style>
<h1>{title}</h1>
{charts}
"""
Curve = Sequence[tuple[int, float]]
"""Values by step"""


def write_curves(
    log: Path, page: Path, title: str, units: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Draw the loss, and each error on held-out data, of a log over the steps.

    `units` are those of the errors, by name.
    """
    charts: dict[str, dict[str, list[tuple[int, float]]]] = {}
    records: list[dict[str, Any]] = [json.loads(line) for line in log.read_text().splitlines()]
    folders = {str(record["held_out"]) for record in records if "held_out" in record}
    names = [Path(folder).name for folder in folders]
    for record in records:
        step, folder = record.pop("step"), str(record.pop("held_out", ""))
        record.pop("seconds", None)
        if names.count(Path(folder).name) == 1:
            folder = Path(folder).name
        if "loss" in record and not folder:
            loss = record["loss"]
            charts.setdefault("loss", {}).setdefault("loss", []).append(
                (step, float("nan" if loss is None else loss)))
        for name, scores in record.items() if folder else ():
            for metric, value in scores.items():
                unit = f" ({units[metric]})" if metric in units else ""
                chart = charts.setdefault(f"{metric}{unit}, {folder}", {})
                chart.setdefault(name, []).append(
                    (step, float("nan" if value is None else value)))
    drawn = "\n".join(f"<h2>{escape(name)}</h2>\n{draw_chart(curves)}"
                      for name, curves in charts.items())
    write_atomically(page, _PAGE.format(title=escape(title), width=_WIDTH, charts=drawn).encode())


def draw_chart(curves: Mapping[str, Curve]) -> str:
    """Return an SVG with lines by name over a common axis of steps; long lines are averaged."""
    lines = {name: _shorten([p for p in curve if abs(p[1]) < float("inf")])
             for name, curve in curves.items()}
    points = [p for line in lines.values() for p in line]
    if not points:
        return "<p>no finite value</p>"
    last = max(1, *(step for step, _ in points))
    low, high = (f(0.0, *(value for _, value in points)) for f in (min, max))
    high = high if high > low else low + 1.0

    def place(step: float, value: float) -> str:
        x = _LEFT + (_WIDTH - _LEFT) * step / last
        y = _TOP + (_HEIGHT - _TOP - _BOTTOM) * (high - value) / (high - low)
        return f"{x:.1f},{y:.1f}"

    out = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">']
    for value in (low, (low + high) / 2, high):
        x, y = place(0, value).split(",")
        out.append(f'<line x1="{x}" x2="{_WIDTH}" y1="{y}" y2="{y}" stroke="#ddd"/>'
                   f'<text x="0" y="{float(y) + 4:.1f}">{value:.4g}</text>')
    out.append(f'<text x="{_WIDTH}" y="{_HEIGHT - 4}" text-anchor="end">step {last}</text>')
    for k, (name, line) in enumerate(lines.items()):
        color = _COLORS[k % len(_COLORS)]
        path = " ".join(place(*p) for p in line)
        out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="1.5"/>'
                   f'<text x="{_LEFT + 110 * k}" y="{_HEIGHT - 4}" style="fill:{color}">'
                   f"{escape(name)}</text>")
    return "\n".join([*out, "</svg>"])


def _shorten(curve: Curve) -> Curve:
    """Means of neighbors, so that at most _MOST_POINTS are left."""
    count = -(-len(curve) // _MOST_POINTS)
    parts = [curve[i : i + count] for i in range(0, len(curve), count or 1)]
    return [(p[-1][0], sum(v for _, v in p) / len(p)) for p in parts]
