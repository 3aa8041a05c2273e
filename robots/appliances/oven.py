"""Ovens, ranges and toaster ovens: a door that folds down, knobs, a hob, shelves."""

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
    Cabinet,
    Part,
    center_appliance,
    feet,
    heating_loops,
    hollow_box,
    knob,
    vents,
    wire_rack,
)
from .shapes import Hole, Solid, Vector, disc, frame, join, orient, shift, slab
from .textures import SeededRng


def oven(rng: SeededRng, number: int) -> Appliance:
    """Draw a range or a built-in oven (75 %), or a toaster oven; doors are hinged at the bottom."""
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
    hole = Hole(0.0, door_y - middle, w - 2 * rng.length(0.035, 0.06), dh - 0.07, 0.015)
    box = Cabinet(w, cabinet, middle, (-d / 2, front), hole, 0.06, 0.005)
    tone = rng.near(rng.choice(((46, 48, 54), (70, 72, 76), (60, 56, 52))), 6)
    enamel = textures.speckled_enamel(rng.generator, (58, 60, 66), 6) if look.textured else None
    dark = Finish("inside", tone, image=enamel)
    body = hollow_box(replace(look, inside=dark), box)
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
    body += heating_loops(rng, box)
    details, knobs = oven_controls(rng, look, (w, strip), (0.0, top, front + t))
    parts = [Part("body", (*body, *details)),
             *_door(rng, look, (w - 2 * DOOR_GAP, dh - DOOR_GAP, t), (0.0, door_y, front))]
    return center_appliance("Oven", number, [*parts, *_shelves(rng, box, dh - DOOR_GAP), *knobs])


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
    hole = Hole(x, y - middle, dw - 0.05, dh - 0.03, 0.01)
    box = Cabinet(w, cabinet, middle, (-d / 2, front), hole, 0.03, rng.length(0.006, 0.03))
    body = hollow_box(look, box)
    body += feet(rng, look, (w / 2 - 0.04, d / 2 - 0.04), foot)
    px = side * (w / 2 - pw / 2)
    body.append(Shape("panel", shift(slab(pw - 0.012, cabinet - 0.02, (0.0, t), 0.008, 0.003), px,
                                  middle, front), look.panel))
    body += [vents((s * w / 2, middle, 0.0), (d * 0.5, 0.03),
                   "right" if s > 0 else "left", rng.integer(6, 14)) for s in (-1, 1)]
    body += heating_loops(rng, box)
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
        body.append(label(rng, look, (pw * 0.6, 0.013), look.panel,
                          (px, middle + cabinet / 2 - 0.018, front + t)))
    parts = [Part("body", tuple(body)), *_door(rng, look, (dw - 0.014, dh - DOOR_GAP, t),
                                               (x, y, front))]
    return center_appliance("Oven", number, [*parts, *_shelves(rng, box, dh - DOOR_GAP), *knobs])


def _door(rng: SeededRng, look: Finishes, size: Vector, place: Vector) -> list[Part]:
    """The door and its handle; `place` is the middle of the back of the door."""
    (w, h, t), (x, y, front) = size, place
    window = Hole(0.0, -rng.length(0.0, 0.02), w * rng.integer(55, 82) / 100,
                  h * rng.integer(45, 64) / 100)
    shapes = [replace(s, solid=shift(s.solid, x, y, front + 0.001))
              for s in door(rng, look, size, window)]
    if rng.chance(40):
        shapes += door_label(rng, look, min(0.3 * w, rng.length(0.06, 0.1)), shapes)
    hinge = (x, y - h / 2 + t / 2, front + 0.001 + t / 2)
    leaf = Part("door", tuple(shapes), 0, JointType.REVOLUTE, hinge, (1.0, 0.0, 0.0),
                (0.0, rng.angle(1.40, 1.57)))
    length = w * rng.choice((0.6, 0.75, 0.9))
    top = (x, y + h / 2 - min(0.035, 0.13 * h), front + 0.001 + t)
    return [leaf, door_handle(rng, look, length, top, leaf)]


def _shelves(rng: SeededRng, box: Cabinet, height: float) -> list[Part]:
    """Racks that slide, up to two behind a door of a height above 0.3 m, else up to one."""
    hole, front = box.hole, box.z[1]
    deep, wide = box.depth - 0.13, hole.width - 0.012
    z, steel = front - 0.03 - deep / 2, Finish("rack", (186, 188, 190))
    racks, count = list[Part](), rng.integer(0, 2 if height > 0.3 else 1)
    for k in range(count):
        y = box.middle + hole.y + hole.height * ((k + 1) / (count + 1) - 0.5)
        shelf = shift(wire_rack(rng, wide, deep), hole.x, y, z)
        racks.append(Part("rack", (Shape("rack", shelf, steel),), 0, JointType.PRISMATIC,
                          (hole.x, round(y, 5), round(z, 5)), (0.0, 0.0, 1.0),
                          (0.0, round(min(0.4, 0.85 * deep), 3))))
    return racks


def oven_controls(
    rng: SeededRng, look: Finishes, size: tuple[float, float], place: Vector
) -> tuple[list[Shape], list[Part]]:
    """Draw two to six knobs with a display between or beside them."""
    (w, h), (x, y, z) = size, place
    count = rng.integer(2, 6)
    radius = min(rng.length(0.016, 0.026), 0.3 * h)
    style, layout = rng.integer(0, 3), rng.choice(("sides", "left", "row"), (4, 2, 3))
    reach = w / 2 - 0.05
    if layout == "row":
        offsets = [-reach + 2 * reach * k / (count - 1) for k in range(count)]
    elif layout == "left":
        offsets = [-reach + k * (3 * radius + 0.008) for k in range(count)]
    else:
        left = (count + 1) // 2
        offsets = [-reach + k * (3 * radius + 0.004) for k in range(left)]
        offsets += [reach - k * (3 * radius + 0.004) for k in range(count - left)]
    marks = textures.gauge_image(look.ink, look.panel.color, rng.integer(7, 15))
    shapes, knobs = list[Shape](), list[Part]()
    for offset in offsets:
        here = (x + offset, y, z)
        shapes.append(decal("gauge", marks, 2.8 * radius, here))
        knobs.append(knob(rng, look, radius, here, style))
    free = _widest_gap([-w / 2, *sorted(offsets), w / 2])
    wide = min(free[1] - free[0] - 3.4 * radius, rng.length(0.07, 0.12))
    if wide > 0.05:
        middle = x + (free[0] + free[1]) / 2
        shapes.append(clock_display(rng, look, wide, (middle, y + 0.012, z)))
        shapes.append(label(rng, look, (wide * 0.7, 0.3 * h), look.panel,
                            (middle, y - h * 0.32, z)))
    return shapes, knobs


def _widest_gap(places: list[float]) -> tuple[float, float]:
    gaps = [(b - a, k) for k, (a, b) in enumerate(pairwise(places))]
    k = max(gaps)[1]
    return places[k], places[k + 1]


def cooktop(rng: SeededRng, look: Finishes, w: float, d: float, h: float) -> list[Shape]:
    """Draw a hob: four burners on a sheet of glass or enamel, on top of the oven."""
    sheet = orient(slab(w, d, (0.0, 0.008), 0.01, 0.003), "up")
    paint = rng.choice((Finish("hob", (18, 18, 20)), look.body, look.trim), (3, 1, 1))
    shapes = [Shape("hob", shift(sheet, 0.0, h), paint)]
    gas = rng.chance(50)
    burners: list[Solid] = []
    for sx in (-1, 1):
        for sz in (-1, 1):
            r, place = rng.length(0.05, 0.085), (sx * w * 0.24, h + 0.008, sz * d * 0.22)
            if gas:
                burners.append(shift(orient(disc(r * 0.6, (0.0, 0.012), 0.002), "up"), *place))
                for turn in ("x", "z"):
                    bar = slab(0.2 if turn == "x" else 0.01, 0.01 if turn == "x" else 0.2,
                               (0.016, 0.026))
                    burners.append(shift(orient(bar, "up"), *place))
            else:
                for wide in (2.0 * r, 1.3 * r):
                    hole = Hole(0.0, 0.0, wide - 0.012, wide - 0.012, r)
                    ring = frame(wide, wide, hole, (0.0, 0.0008), r)
                    burners.append(shift(orient(ring, "up"), *place))
    color = Finish("burner", (52, 52, 56) if gas or sum(paint.color) > 150 else (86, 86, 92))
    return [*shapes, Shape("burners", join(burners), color)]
