"""What is around an oven's door: its knobs and its cooktop."""

from __future__ import annotations

from itertools import pairwise

from . import textures as pictures
from .finish import Finish
from .fittings import knob
from .lofts import Solid
from .partnet_export import Link, Paint, Shape
from .prints import clock, decal, label
from .sampling import Dice
from .shapes import at, disc, facing, frame, joined, slab


def oven_controls(
    dice: Dice, look: Finish, size: tuple[float, float], place: tuple[float, float, float]
) -> tuple[list[Shape], list[Link]]:
    """Two to six knobs with a display between or beside them."""
    (w, h), (x, y, z) = size, place
    count = dice.number(2, 6)
    radius = min(dice.length(0.016, 0.026), 0.3 * h)
    style, layout = dice.number(0, 3), dice.pick(("sides", "left", "row"), (4, 2, 3))
    reach = w / 2 - 0.05
    if layout == "row":
        spots = [-reach + 2 * reach * k / (count - 1) for k in range(count)]
    elif layout == "left":
        spots = [-reach + k * (3 * radius + 0.008) for k in range(count)]
    else:
        left = (count + 1) // 2
        spots = [-reach + k * (3 * radius + 0.004) for k in range(left)]
        spots += [reach - k * (3 * radius + 0.004) for k in range(count - left)]
    marks = pictures.gauge(look.ink, look.panel.color, dice.number(7, 15))
    shapes, knobs = list[Shape](), list[Link]()
    for spot in spots:
        here = (x + spot, y, z)
        shapes.append(decal("gauge", marks, 2.8 * radius, here))
        knobs.append(knob(dice, look, radius, here, style))
    free = _widest_gap([-w / 2, *sorted(spots), w / 2])
    wide = min(free[1] - free[0] - 3.4 * radius, dice.length(0.07, 0.12))
    if wide > 0.05:
        middle = x + (free[0] + free[1]) / 2
        shapes.append(clock(dice, look, wide, (middle, y + 0.012, z)))
        shapes.append(label(dice, look, wide * 0.7, 0.3 * h, look.panel,
                            (middle, y - h * 0.32, z)))
    return shapes, knobs


def _widest_gap(places: list[float]) -> tuple[float, float]:
    gaps = [(b - a, k) for k, (a, b) in enumerate(pairwise(places))]
    k = max(gaps)[1]
    return places[k], places[k + 1]


def cooktop(dice: Dice, look: Finish, w: float, d: float, h: float) -> list[Shape]:
    """Four fields on a sheet of glass or enamel, on top."""
    sheet = facing(slab(w, d, (0.0, 0.008), 0.01, 0.003), "up")
    paint = dice.pick((Paint("hob", (18, 18, 20)), look.body, look.trim), (3, 1, 1))
    shapes = [Shape("hob", at(sheet, 0.0, h), paint)]
    gas = dice.chance(50)
    burners: list[Solid] = []
    for sx in (-1, 1):
        for sz in (-1, 1):
            r, spot = dice.length(0.05, 0.085), (sx * w * 0.24, h + 0.008, sz * d * 0.22)
            if gas:
                burners.append(at(facing(disc(r * 0.6, (0.0, 0.012), 0.002), "up"), *spot))
                for turn in ("x", "z"):
                    bar = slab(0.2 if turn == "x" else 0.01, 0.01 if turn == "x" else 0.2,
                               (0.016, 0.026))
                    burners.append(at(facing(bar, "up"), *spot))
            else:
                for wide in (2.0 * r, 1.3 * r):
                    ring = frame(wide, wide, (0.0, 0.0, wide - 0.012, wide - 0.012),
                                 (0.0, 0.0008), r, 0.0, r)
                    burners.append(at(facing(ring, "up"), *spot))
    color = Paint("burner", (52, 52, 56) if gas or sum(paint.color) > 150 else (86, 86, 92))
    return [*shapes, Shape("burners", joined(burners), color)]
