"""Microwaves: a door beside the controls."""

from __future__ import annotations

from dataclasses import replace

from ..model import JointType
from . import textures
from .doors import door, door_handle
from .finish import (
    Finish,
    Finishes,
    Shape,
    clock_display,
    decal,
    door_label,
    draw_finishes,
    keypad,
    label,
)
from .fittings import (
    DOOR_GAP,
    Appliance,
    Cabinet,
    Part,
    center_appliance,
    feet,
    hollow_box,
    knob,
    vents,
)
from .shapes import Hole, Vector, disc, join, orient, shift, slab
from .textures import SeededRng


def microwave(rng: SeededRng, number: int) -> Appliance:
    """Draw a microwave, its door hinged at the left (85 %) or the right."""
    look = draw_finishes(
        rng, ("white", "black", "steel", "slate", "cream", "red", "teal", "yellow"),
        (5, 6, 6, 2, 2, 2, 2, 1))
    w, h, d = rng.length(0.44, 0.56), rng.length(0.26, 0.34), rng.length(0.32, 0.46)
    wall, foot = rng.length(0.015, 0.03), rng.length(0.006, 0.014)
    share, side = rng.integer(700, 800) / 1000, 1 if rng.chance(85) else -1
    dw = round(share * w, 4)
    pw, front, middle = w - dw, d / 2, foot + h / 2
    door_x, panel_x = -side * (w - dw) / 2, side * (w - pw) / 2
    hole = Hole(door_x, 0.0, dw - 2 * wall - 0.02, h - 2 * wall - 0.02, 0.012)
    box = Cabinet(w, h, middle, (-d / 2, front), hole, 0.06, rng.length(0.003, 0.014))
    body = hollow_box(look, box)
    body += feet(rng, look, (w / 2 - 0.05, d / 2 - 0.05), foot)
    body += _turntable(rng, box)
    body += [vents((s * w / 2, middle + rng.length(-0.05, 0.05), -rng.length(0.0, 0.08)),
                   (rng.length(0.08, 0.14), rng.length(0.01, 0.04)), "right" if s > 0 else "left",
                   rng.integer(5, 12)) for s in (-1, 1)]

    t = rng.length(0.02, 0.034)
    panel_w, panel_h = pw - DOOR_GAP, h - 2 * DOOR_GAP
    plate = slab(panel_w, panel_h, (0.0, t), rng.length(0.002, 0.01), 0.003)
    body.append(Shape("panel", shift(plate, panel_x, middle, front), look.panel))
    top = (panel_x, middle, front + t)
    details, knobs = _microwave_controls(rng, look, (panel_w, panel_h), top)
    body += details

    parts = [Part("body", tuple(body)), *_door(rng, look, box, (dw, t), side)]
    return center_appliance("Microwave", number, [*parts, *knobs])


def _door(
    rng: SeededRng, look: Finishes, box: Cabinet, size: tuple[float, float], side: int
) -> list[Part]:
    """The door, of a width and thickness, and its handle; `side` is 1 if hinged at the left."""
    (wide, t), h, middle, front = size, box.height, box.middle, box.z[1]
    x = box.hole.x
    grip = rng.choice(("handle", "push", "pocket"), (6, 3, 2))
    margin = 0.05 if grip == "handle" else 0.03
    window = Hole(-side * (margin - 0.03) / 2, 0.0, wide - 0.05 - margin - rng.length(0.0, 0.04),
                  h - rng.length(0.06, 0.11))
    leaf = (wide - DOOR_GAP, h - 2 * DOOR_GAP, t)
    shapes = [replace(s, solid=shift(s.solid, x, middle, front + 0.001))
              for s in door(rng, look, leaf, window, screen=rng.chance(65))]
    if rng.chance(60):
        shapes += door_label(rng, look, rng.length(0.04, 0.08), shapes)
    edge_x = x + side * (wide / 2 - rng.length(0.02, 0.028))
    axis_x = -side * (box.width / 2 - rng.length(0.005, 0.012))
    hinged = Part("door", tuple(shapes), 0, JointType.REVOLUTE, (axis_x, middle, front + t / 2),
                  (0.0, -float(side), 0.0), (0.0, rng.angle(1.57, 2.1)))
    if grip == "handle":
        length = h * rng.choice((0.55, 0.7, 0.82))
        place = (edge_x, middle, front + t + 0.001)
        return [hinged, door_handle(rng, look, length, place, hinged, upright=True)]
    if grip == "pocket":
        pocket = shift(slab(0.018, h * 0.4, (0.0, 0.004), 0.006, 0.002), edge_x, middle, front + t)
        shape = Shape("handle", pocket, look.trim)
        return [hinged, Part("handle", (shape,), 1, origin=hinged.origin)]
    return [hinged]


def _turntable(rng: SeededRng, box: Cabinet) -> list[Shape]:
    """The plate and the cover of the wave guide."""
    hole, z = box.hole, (box.z[0] + box.back, box.z[1])
    floor, depth = box.middle + hole.y - hole.height / 2, z[1] - z[0]
    r = min(hole.width, depth) / 2 - 0.012
    plate = join([orient(disc(0.02, (0.0, 0.012)), "up"),
                    shift(orient(disc(r * 0.9, (0.0, 0.005), top=r), "up"), y=0.012)])
    cover = orient(slab(min(0.1, depth * 0.4), 0.05, (0.0, 0.0015), 0.006), "left")
    return [Shape("plate", shift(plate, hole.x, floor, (z[0] + z[1]) / 2),
                  Finish("plate", rng.near((196, 212, 214), 8))),
            Shape("cover", shift(cover, hole.x + hole.width / 2, box.middle + 0.02,
                                 (z[0] + z[1]) / 2),
                  Finish("cover", (206, 196, 168)))]


def _microwave_controls(
    rng: SeededRng, look: Finishes, size: tuple[float, float], place: Vector
) -> tuple[list[Shape], list[Part]]:
    """Display, buttons and knobs about the center of a panel's front."""
    (w, h), (x, y, z) = size, place
    inner, top = w - 0.016, y + h / 2
    shapes, knobs = list[Shape](), list[Part]()
    style = rng.choice(("keys", "knobs", "mixed"), (5, 3, 3))
    if rng.chance(75):
        shapes.append(label(rng, look, (inner * 0.62, 0.02), look.panel, (x, top - 0.014, z)))
    if style != "knobs" or rng.chance(40):
        wide = inner * rng.integer(70, 100) / 100
        shapes.append(clock_display(rng, look, wide, (x, top - 0.03 - wide * 0.16, z)))
    low = y - h / 2 + 0.021  # above a button
    space = h - 0.039 - inner * 0.42
    if style == "keys":
        shapes.append(keypad(rng, look, (inner, space - 0.02), (x, low + (space - 0.02) / 2, z),
                           rng.integer(5, 9)))
    else:
        count = 1 if style == "mixed" else rng.choice((1, 2), (1, 4))
        most = 0.2 * space / count + (0.006 if style == "knobs" else -0.009)
        radius = min(inner * 0.3, most, rng.length(0.018, 0.027))
        kind = rng.integer(0, 3)
        marks = textures.gauge_image(look.ink, look.panel.color, rng.integer(7, 15))
        for k in range(count):
            spot = (x, low + space * (0.24 + 0.44 * k) if count > 1 else low + space * 0.3, z)
            shapes.append(decal("gauge", marks, 2.8 * radius, spot))
            knobs.append(knob(rng, look, radius, spot, kind))
        if style == "mixed":
            high = space * 0.42
            shapes.append(keypad(rng, look, (inner, high), (x, low + space - 0.012 - high / 2, z),
                               rng.integer(2, 4)))
    if rng.chance(45):
        button = shift(slab(inner * 0.7, 0.016, (0.0, 0.003), 0.004, 0.001), x,
                    y - h / 2 + 0.011, z - 0.001)
        shapes.append(Shape("button", button, rng.choice((look.trim, look.knob))))
    return shapes, knobs
