"""Ovens and ranges, and toaster ovens."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from ..model import JointType
from . import textures
from .doors import door, door_handle
from .finish import Finish, Finishes, Shape, clock_display, decal, door_label, draw_finishes, label
from .fittings import (
    DOOR_GAP,
    Appliance,
    Part,
    centre_appliance,
    feet,
    heating,
    hollow_box,
    knob,
    vents,
    wire_rack,
)
from .shapes import Solid, disc, frame, join, orient, shift, slab
from .textures import SeededRng


def oven(rng: SeededRng, number: int) -> Appliance:
    """A range or a built-in oven (75 %), or a toaster oven: the door is hinged at its bottom."""
    return _big_oven(rng, number) if rng.chance(75) else _toaster(rng, number)


def _big_oven(rng: SeededRng, number: int) -> Appliance:
    look = draw_finishes(rng, ("steel", "black", "white", "slate", "cream", "red", "navy", "sage"),
                       (6, 6, 4, 2, 2, 2, 2, 1))
    w, h, d = rng.length(0.55, 0.62), rng.length(0.55, 0.75), rng.length(0.50, 0.60)
    t, strip = rng.length(0.022, 0.036), rng.length(0.08, 0.15)
    foot = rng.length(0.0, 0.02)
    below = rng.length(0.09, 0.17)  # a drawer or a plinth; the open door's handle needs the room
    front, cabinet = d / 2, h - foot
    middle, dh = foot + cabinet / 2, h - foot - strip - below
    door_y = foot + below + dh / 2
    hole = (0.0, door_y - middle, w - 2 * rng.length(0.035, 0.06), dh - 0.07)
    tone = rng.near(rng.choice(((46, 48, 54), (70, 72, 76), (60, 56, 52))), 6)
    enamel = textures.speckled_enamel(rng.generator, (58, 60, 66), 6) if look.textured else None
    dark = Finish("inside", tone, image=enamel)
    body = hollow_box(replace(look, inside=dark), (w, cabinet), (-d / 2, front), hole, middle, 0.06,
                    0.005, 0.015)
    if foot >= 0.006:
        body += feet(rng, look, (w / 2 - 0.05, d / 2 - 0.06), foot)
    drawer = slab(w - 2 * DOOR_GAP, below - 2 * DOOR_GAP, (0.0, t), 0.006, 0.004)
    body.append(Shape("drawer", shift(drawer, 0.0, foot + below / 2, front),
                      rng.choice((look.front, look.trim, look.body))))
    if rng.chance(40):
        body.append(vents((0.0, foot + below - 0.03, front + t),
                          (w * 0.7, 0.012), "front", rng.integer(8, 20)))
    top = h - strip / 2
    plate = slab(w - 2 * DOOR_GAP, strip - DOOR_GAP, (0.0, t), rng.length(0.002, 0.01), 0.004)
    body.append(Shape("panel", shift(plate, 0.0, top, front), look.panel))
    if rng.chance(60):
        body += cooktop(rng, look, w, d, h)
    body += heating(rng, hole, middle, d)
    details, knobs = oven_controls(rng, look, (w, strip), (0.0, top, front + t))
    return _with_oven_door(rng, number, look, [*body, *details], knobs,
                           (w - 2 * DOOR_GAP, dh - DOOR_GAP, t), (0.0, door_y, front), hole,
                           middle, d)


def _toaster(rng: SeededRng, number: int) -> Appliance:
    look = draw_finishes(rng, ("steel", "black", "white", "red", "cream", "teal", "graphite"),
                       (6, 5, 3, 2, 2, 2, 1))
    w, h, d = rng.length(0.40, 0.50), rng.length(0.24, 0.32), rng.length(0.30, 0.40)
    t, foot = rng.length(0.010, 0.016), rng.length(0.012, 0.022)
    pw = rng.length(0.09, 0.13)
    side = 1 if rng.chance(90) else -1
    below = rng.length(0.036, 0.048)
    cabinet = h - foot
    middle, dw, dh = foot + cabinet / 2, w - pw, cabinet - below - rng.length(0.02, 0.035)
    x, y, front = -side * pw / 2, foot + below + dh / 2, d / 2
    hole = (x, y - middle, dw - 0.05, dh - 0.03)
    body = hollow_box(look, (w, cabinet), (-d / 2, front), hole, middle, 0.03,
                    rng.length(0.006, 0.03), 0.01)
    body += feet(rng, look, (w / 2 - 0.04, d / 2 - 0.04), foot)
    px = side * (w / 2 - pw / 2)
    body.append(Shape("panel", shift(slab(pw - 0.012, cabinet - 0.02, (0.0, t), 0.008, 0.003), px,
                                  middle, front), look.panel))
    body += [vents((s * w / 2, middle, 0.0), (d * 0.5, 0.03),
                   "right" if s > 0 else "left", rng.integer(6, 14)) for s in (-1, 1)]
    body += heating(rng, hole, middle, d)
    count = rng.integer(2, 4)
    step = (cabinet - 0.05) / count
    radius = min(rng.length(0.015, 0.024), pw * 0.3, 0.34 * step)
    style, knobs = rng.integer(0, 3), list[Part]()
    ring = textures.gauge_image(look.ink, look.panel.color, rng.integer(6, 13))
    for k in range(count):
        place = (px, middle + ((count - 1) / 2 - k) * step, front + t)
        body.append(decal("gauge", ring, 2.9 * radius, place))
        knobs.append(knob(rng, look, radius, place, style))
    if rng.chance(70):
        body.append(label(rng, look, pw * 0.6, 0.013, look.panel,
                          (px, middle + cabinet / 2 - 0.018, front + t)))
    return _with_oven_door(rng, number, look, body, knobs, (dw - 0.014, dh - DOOR_GAP, t),
                           (x, y, front), hole, middle, d)


def _with_oven_door(
    rng: SeededRng, number: int, look: Finishes, body: list[Shape], knobs: list[Part],
    size: tuple[float, float, float], place: tuple[float, float, float],
    hole: tuple[float, float, float, float], middle: float, depth: float,
) -> Appliance:
    """The oven with its door, handle and shelves."""
    (w, h, t), (x, y, front) = size, place
    window = (0.0, -rng.length(0.0, 0.02), w * rng.integer(55, 82) / 100,
              h * rng.integer(45, 64) / 100)
    shapes = [replace(s, solid=shift(s.solid, x, y, front + 0.001))
              for s in door(rng, look, size, window)]
    z = front + 0.001 + t
    if rng.chance(40):
        shapes += door_label(rng, look, min(0.3 * w, rng.length(0.06, 0.1)), shapes)
    hinge = (x, y - h / 2 + t / 2, front + 0.001 + t / 2)
    links = [Part("body", tuple(body)),
             Part("door", tuple(shapes), 0, JointType.REVOLUTE, hinge, (1.0, 0.0, 0.0),
                  (0.0, rng.angle(1.40, 1.57)))]
    links.append(door_handle(rng, look, w * rng.choice((0.6, 0.75, 0.9)), False,
                         (x, y + h / 2 - min(0.035, 0.13 * h), z), links[1]))
    deep, wide = depth - 0.13, hole[2] - 0.012
    z0, steel = front - 0.03 - deep / 2, Finish("rack", (186, 188, 190))
    count = rng.integer(0, 2 if h > 0.3 else 1)
    for k in range(count):
        y0 = middle + hole[1] + hole[3] * ((k + 1) / (count + 1) - 0.5)
        rack = shift(wire_rack(rng, wide, deep), x, y0, z0)
        links.append(Part("rack", (Shape("rack", rack, steel),), 0, JointType.PRISMATIC,
                          (x, round(y0, 5), round(z0, 5)), (0.0, 0.0, 1.0),
                          (0.0, round(min(0.4, 0.85 * deep), 3))))
    return centre_appliance("Oven", number, [*links, *knobs])


def oven_controls(
    rng: SeededRng, look: Finishes, size: tuple[float, float], place: tuple[float, float, float]
) -> tuple[list[Shape], list[Part]]:
    """Two to six knobs with a display between or beside them."""
    (w, h), (x, y, z) = size, place
    count = rng.integer(2, 6)
    radius = min(rng.length(0.016, 0.026), 0.3 * h)
    style, layout = rng.integer(0, 3), rng.choice(("sides", "left", "row"), (4, 2, 3))
    reach = w / 2 - 0.05
    if layout == "row":
        spots = [-reach + 2 * reach * k / (count - 1) for k in range(count)]
    elif layout == "left":
        spots = [-reach + k * (3 * radius + 0.008) for k in range(count)]
    else:
        left = (count + 1) // 2
        spots = [-reach + k * (3 * radius + 0.004) for k in range(left)]
        spots += [reach - k * (3 * radius + 0.004) for k in range(count - left)]
    marks = textures.gauge_image(look.ink, look.panel.color, rng.integer(7, 15))
    shapes, knobs = list[Shape](), list[Part]()
    for spot in spots:
        here = (x + spot, y, z)
        shapes.append(decal("gauge", marks, 2.8 * radius, here))
        knobs.append(knob(rng, look, radius, here, style))
    free = _widest_gap([-w / 2, *sorted(spots), w / 2])
    wide = min(free[1] - free[0] - 3.4 * radius, rng.length(0.07, 0.12))
    if wide > 0.05:
        middle = x + (free[0] + free[1]) / 2
        shapes.append(clock_display(rng, look, wide, (middle, y + 0.012, z)))
        shapes.append(label(rng, look, wide * 0.7, 0.3 * h, look.panel,
                            (middle, y - h * 0.32, z)))
    return shapes, knobs


def _widest_gap(places: list[float]) -> tuple[float, float]:
    gaps = [(b - a, k) for k, (a, b) in enumerate(pairwise(places))]
    k = max(gaps)[1]
    return places[k], places[k + 1]


def cooktop(rng: SeededRng, look: Finishes, w: float, d: float, h: float) -> list[Shape]:
    """Four fields on a sheet of glass or enamel, on top."""
    sheet = orient(slab(w, d, (0.0, 0.008), 0.01, 0.003), "up")
    paint = rng.choice((Finish("hob", (18, 18, 20)), look.body, look.trim), (3, 1, 1))
    shapes = [Shape("hob", shift(sheet, 0.0, h), paint)]
    gas = rng.chance(50)
    burners: list[Solid] = []
    for sx in (-1, 1):
        for sz in (-1, 1):
            r, spot = rng.length(0.05, 0.085), (sx * w * 0.24, h + 0.008, sz * d * 0.22)
            if gas:
                burners.append(shift(orient(disc(r * 0.6, (0.0, 0.012), 0.002), "up"), *spot))
                for turn in ("x", "z"):
                    bar = slab(0.2 if turn == "x" else 0.01, 0.01 if turn == "x" else 0.2,
                               (0.016, 0.026))
                    burners.append(shift(orient(bar, "up"), *spot))
            else:
                for wide in (2.0 * r, 1.3 * r):
                    ring = frame(wide, wide, (0.0, 0.0, wide - 0.012, wide - 0.012),
                                 (0.0, 0.0008), r, 0.0, r)
                    burners.append(shift(orient(ring, "up"), *spot))
    color = Finish("burner", (52, 52, 56) if gas or sum(paint.color) > 150 else (86, 86, 92))
    return [*shapes, Shape("burners", join(burners), color)]
