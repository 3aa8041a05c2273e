"""Microwaves, dishwashers and ovens: sizes, hinges and details, each drawn from dice.

Sizes are those of the products (metres). The front of the body is the plane z = depth / 2; y is 0
at the ground here, and the object is centred at the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from . import appliance_textures as pictures
from .appliance_parts import (
    Dice,
    Finish,
    basket,
    clock,
    decal,
    dishes,
    door,
    door_label,
    draw_finish,
    feet,
    handle,
    keys,
    knob,
    label,
    vents,
    wire_rack,
)
from .appliance_shapes import Solid, at, cavity, disc, facing, frame, joined, shell, slab, tube
from .geometry import Array
from .partnet_files import Link, Paint, Shape, Thing

GAP = 0.002
"""m of the seam around a door."""


def microwave(dice: Dice, number: int) -> Thing:
    """A door beside its controls, hinged at the left (85 %) or the right."""
    look = draw_finish(dice, ("white", "black", "steel", "slate", "cream", "red", "teal", "yellow"),
                       (5, 6, 6, 2, 2, 2, 2, 1))
    w, h, d = dice.length(0.44, 0.56), dice.length(0.26, 0.34), dice.length(0.32, 0.46)
    wall, foot = dice.length(0.015, 0.03), dice.length(0.006, 0.014)
    share, side = dice.number(700, 800) / 1000, 1 if dice.chance(85) else -1
    dw = round(share * w, 4)
    pw, front, middle = w - dw, d / 2, foot + h / 2
    door_x, panel_x = -side * (w - dw) / 2, side * (w - pw) / 2
    hole = (door_x, 0.0, dw - 2 * wall - 0.02, h - 2 * wall - 0.02)
    body = _cabinet(look, (w, h), (-d / 2, front), hole, middle, 0.06,
                    dice.length(0.003, 0.014), 0.012)
    body += feet(dice, look, (w / 2 - 0.05, d / 2 - 0.05), foot)
    body += _turntable(dice, hole, middle, (front - d + 0.06, front))
    body += [vents(dice, (s * w / 2, middle + dice.length(-0.05, 0.05), -dice.length(0.0, 0.08)),
                   (dice.length(0.08, 0.14), dice.length(0.01, 0.04)), "right" if s > 0 else "left",
                   dice.number(5, 12)) for s in (-1, 1)]

    t = dice.length(0.02, 0.034)
    panel_w, panel_h = pw - GAP, h - 2 * GAP
    plate = slab(panel_w, panel_h, (0.0, t), dice.length(0.002, 0.01), 0.003)
    body.append(Shape("panel", at(plate, panel_x, middle, front), look.panel))
    top = (panel_x, middle, front + t)
    details, knobs = _microwave_controls(dice, look, (panel_w, panel_h), top)
    body += details

    size = (dw - GAP, h - 2 * GAP, t)
    grip = dice.pick(("handle", "push", "pocket"), (6, 3, 2))
    margin = 0.05 if grip == "handle" else 0.03
    window = (-side * (margin - 0.03) / 2, 0.0, dw - 0.05 - margin - dice.length(0.0, 0.04),
              h - dice.length(0.06, 0.11))
    shapes = [replace(s, solid=at(s.solid, door_x, middle, front + 0.001))
              for s in door(dice, look, size, window, screen=dice.chance(65))]
    if dice.chance(60):
        shapes += door_label(dice, look, dice.length(0.04, 0.08), shapes)
    edge_x = door_x + side * (dw / 2 - dice.length(0.02, 0.028))
    links = [Link("body", tuple(body))]
    axis_x = -side * (w / 2 - dice.length(0.005, 0.012))
    links.append(Link("door", tuple(shapes), 0, "revolute", (axis_x, middle, front + t / 2),
                      (0.0, -float(side), 0.0), (0.0, dice.angle(1.57, 2.1))))
    if grip == "handle":
        links.append(_handle(dice, look, h * dice.pick((0.55, 0.7, 0.82)), True,
                             (edge_x, middle, front + t + 0.001), links[1]))
    elif grip == "pocket":
        pocket = at(slab(0.018, h * 0.4, (0.0, 0.004), 0.006, 0.002), edge_x, middle, front + t)
        links.append(Link("handle", (Shape("handle", pocket, look.trim),), 1,
                          origin=links[1].origin))
    return _centred("Microwave", number, [*links, *knobs])


def dishwasher(dice: Dice, number: int) -> Thing:
    """A door over a toe kick, hinged at its bottom, and two racks that slide."""
    look = draw_finish(dice, ("steel", "white", "black", "slate", "navy", "sage", "bronze"),
                       (6, 6, 5, 3, 2, 2, 1))
    w, h, d = dice.pick((0.448, 0.598), (1, 3)), dice.length(0.80, 0.86), dice.length(0.55, 0.60)
    kick, t = dice.length(0.08, 0.12), dice.length(0.02, 0.034)
    if look.textured and dice.chance(35):  # panel-ready: the kitchen's own wood
        tone = dice.near(dice.pick(((150, 104, 66), (196, 156, 110), (96, 66, 46))), 12)
        look = replace(look, front=Paint("front", tone, tile=dice.length(0.3, 0.5),
                                         picture=pictures.wood(dice.rng, tone, dice.number(2, 5))))
    body_h, front = h - kick, d / 2
    middle = kick + body_h / 2
    wall = dice.length(0.022, 0.034)
    hole = (0.0, 0.0, w - 2 * wall, body_h - 2 * wall - 0.01)
    steel = Paint("inside", dice.near(dice.pick(((176, 178, 180), (196, 196, 192))), 8))
    body = _cabinet(replace(look, inside=steel), (w, body_h), (-d / 2, front), hole, middle, 0.04,
                    0.004, 0.02)
    recess = dice.length(0.03, 0.07)
    body.append(Shape("toe_kick", at(slab(w - 0.01, kick, (-d / 2 + 0.01, front - recess)),
                                     y=kick / 2), dice.pick((look.trim, look.rubber, look.body))))
    if dice.chance(30):
        top = dice.length(0.02, 0.04)
        stone = Paint("counter", dice.near(dice.pick(((90, 86, 84), (214, 206, 196),
                                                      (150, 110, 76))), 14))
        body.append(Shape("counter", at(facing(slab(w + 0.006, d + 0.05, (0.0, top), 0.004, 0.003),
                                               "up"), 0, h, 0.02), stone))
    arm = joined([facing(slab(hole[2] * 0.7, 0.04, (0.0, 0.012), 0.018), "up"),
                  facing(disc(0.03, (0.0, 0.02)), "up")])
    body.append(Shape("spray_arm", at(arm, 0.0, kick + wall + 0.02), look.trim))
    seam = slab(0.003, body_h - 0.02, (0.0, 0.0004))
    body += [Shape("seam", at(facing(seam, "right" if s > 0 else "left"), s * w / 2, middle,
                              front - dice.length(0.03, 0.08)), Paint("seam", (40, 40, 42)))
             for s in (-1, 1)]

    dh, y = body_h - 2 * GAP, middle
    strip = dice.length(0.06, 0.11) if dice.chance(65) else 0.0  # else the controls are hidden
    named = 0.0  # m of the door that its name takes
    shapes = [replace(s, solid=at(s.solid, 0.0, y, front + 0.001))
              for s in door(dice, look, (w - 2 * GAP, dh, t), None)]
    z = front + 0.001 + t
    top = y + dh / 2
    if strip:
        plate = slab(w - 2 * GAP, strip, (0.0, dice.length(0.002, 0.006)), 0.003, 0.0015)
        high = float(plate.vertices[:, 2].max())
        shapes.append(Shape("panel", at(plate, 0.0, top - strip / 2, z), look.panel))
        shapes += _strip_controls(dice, look, (w, strip), (0.0, top - strip / 2, z + high))
    else:
        buttons = [facing(slab(0.014, 0.008, (0.0, 0.0012), 0.003), "up")
                   for _ in range(dice.number(4, 9))]
        shapes.append(Shape("buttons", joined([
            at(b, (k - (len(buttons) - 1) / 2) * 0.03, top, front + 0.001 + t / 2)
            for k, b in enumerate(buttons)]), look.trim))
        if dice.chance(70):
            shapes.append(label(dice, look, dice.length(0.06, 0.1), 0.022, look.front,
                                (dice.pick((-1, 0, 1)) * (w / 2 - 0.09), top - 0.03, z)))
            named = 0.03
    if dice.chance(25):  # grooves across the door
        shapes += [Shape("groove", at(slab(w - 0.01, 0.003, (0.0, 0.0006)), 0.0,
                                      y - dh / 2 + dh * dice.pick((0.25, 0.5, 0.66)), z),
                         Paint("seam", (46, 46, 48)))]
    dispenser = at(slab(0.14, 0.09, (-0.014, -0.005), 0.01, 0.0, 0.003), dice.length(-0.05, 0.05),
                   y + dice.length(-0.05, 0.1), front + 0.001)
    shapes.append(Shape("dispenser", dispenser, look.rubber))
    hinge = (0.0, kick + GAP + t / 2, front + 0.001 + t / 2)
    links = [Link("body", tuple(body)),
             Link("door", tuple(shapes), 0, "revolute", hinge, (1.0, 0.0, 0.0),
                  (0.0, dice.angle(1.40, 1.57)))]
    grip = dice.pick(("handle", "pocket", "none"), (7, 3, 2))
    hy = top - strip - named - dice.length(0.035, 0.06)
    if grip == "handle":
        links.append(_handle(dice, look, w * dice.pick((0.55, 0.75, 0.88)), False, (0.0, hy, z),
                             links[1]))
    elif grip == "pocket":
        cup = at(slab(dice.length(0.16, 0.3), 0.035, (0.0, 0.0015), 0.012), 0.0, hy, z)
        links.append(Link("handle", (Shape("handle", cup, look.rubber),), 1,
                          origin=links[1].origin))
    floor, depth = middle - hole[3] / 2, d - 0.04
    color = Paint("rack", dice.near(dice.pick(((226, 228, 230), (150, 152, 156), (90, 110, 150))),
                                    8))
    for k, y0 in enumerate((floor + 0.05, floor + hole[3] * 0.52)):
        deep, wide = depth - 0.07, hole[2] - 0.03
        z0 = front - 0.035 - deep / 2
        rack = [Shape("rack", at(basket(dice, wide, deep, dice.length(0.07, 0.12)), 0, y0, z0),
                      color)]
        if dice.chance(40):
            rack += [Shape("dish", at(s, 0.0, y0, z0), Paint(f"dish{i}", c))
                     for i, (s, c) in enumerate(dishes(dice, wide, deep)) if k == 0]
        links.append(Link("rack", tuple(rack), 0, "prismatic", (0.0, round(y0, 5), round(z0, 5)),
                          (0.0, 0.0, 1.0), (0.0, round(min(0.45, 0.9 * deep), 3))))
    return _centred("Dishwasher", number, links)


def oven(dice: Dice, number: int) -> Thing:
    """A range or a built-in oven (75 %), or a toaster oven: the door is hinged at its bottom."""
    return _big_oven(dice, number) if dice.chance(75) else _toaster(dice, number)


def _big_oven(dice: Dice, number: int) -> Thing:
    look = draw_finish(dice, ("steel", "black", "white", "slate", "cream", "red", "navy", "sage"),
                       (6, 6, 4, 2, 2, 2, 2, 1))
    w, h, d = dice.length(0.55, 0.62), dice.length(0.55, 0.75), dice.length(0.50, 0.60)
    t, strip = dice.length(0.022, 0.036), dice.length(0.08, 0.15)
    foot = dice.length(0.0, 0.02)
    below = dice.length(0.09, 0.17)  # a drawer or a plinth; the open door's handle needs the room
    front, cabinet = d / 2, h - foot
    middle, dh = foot + cabinet / 2, h - foot - strip - below
    door_y = foot + below + dh / 2
    hole = (0.0, door_y - middle, w - 2 * dice.length(0.035, 0.06), dh - 0.07)
    dark = Paint("inside", dice.near(dice.pick(((46, 48, 54), (70, 72, 76), (60, 56, 52))), 6),
                 picture=pictures.speckled(dice.rng, (58, 60, 66), 6) if look.textured else None)
    body = _cabinet(replace(look, inside=dark), (w, cabinet), (-d / 2, front), hole, middle, 0.06,
                    0.005, 0.015)
    if foot >= 0.006:
        body += feet(dice, look, (w / 2 - 0.05, d / 2 - 0.06), foot)
    drawer = slab(w - 2 * GAP, below - 2 * GAP, (0.0, t), 0.006, 0.004)
    body.append(Shape("drawer", at(drawer, 0.0, foot + below / 2, front),
                      dice.pick((look.front, look.trim, look.body))))
    if dice.chance(40):
        body.append(vents(dice, (0.0, foot + below - 0.03, front + t),
                          (w * 0.7, 0.012), "front", dice.number(8, 20)))
    top = h - strip / 2
    plate = slab(w - 2 * GAP, strip - GAP, (0.0, t), dice.length(0.002, 0.01), 0.004)
    body.append(Shape("panel", at(plate, 0.0, top, front), look.panel))
    if dice.chance(60):
        body += _cooktop(dice, look, w, d, h)
    body += _heating(dice, hole, middle, d)
    details, knobs = _oven_controls(dice, look, (w, strip), (0.0, top, front + t))
    return _with_oven_door(dice, number, look, [*body, *details], knobs,
                           (w - 2 * GAP, dh - GAP, t), (0.0, door_y, front), hole, middle, d)


def _toaster(dice: Dice, number: int) -> Thing:
    look = draw_finish(dice, ("steel", "black", "white", "red", "cream", "teal", "graphite"),
                       (6, 5, 3, 2, 2, 2, 1))
    w, h, d = dice.length(0.40, 0.50), dice.length(0.24, 0.32), dice.length(0.30, 0.40)
    t, foot = dice.length(0.010, 0.016), dice.length(0.012, 0.022)
    pw = dice.length(0.09, 0.13)
    side = 1 if dice.chance(90) else -1
    below = dice.length(0.036, 0.048)
    cabinet = h - foot
    middle, dw, dh = foot + cabinet / 2, w - pw, cabinet - below - dice.length(0.02, 0.035)
    x, y, front = -side * pw / 2, foot + below + dh / 2, d / 2
    hole = (x, y - middle, dw - 0.05, dh - 0.03)
    body = _cabinet(look, (w, cabinet), (-d / 2, front), hole, middle, 0.03,
                    dice.length(0.006, 0.03), 0.01)
    body += feet(dice, look, (w / 2 - 0.04, d / 2 - 0.04), foot)
    px = side * (w / 2 - pw / 2)
    body.append(Shape("panel", at(slab(pw - 0.012, cabinet - 0.02, (0.0, t), 0.008, 0.003), px,
                                  middle, front), look.panel))
    body += [vents(dice, (s * w / 2, middle, 0.0), (d * 0.5, 0.03),
                   "right" if s > 0 else "left", dice.number(6, 14)) for s in (-1, 1)]
    body += _heating(dice, hole, middle, d)
    count = dice.number(2, 4)
    step = (cabinet - 0.05) / count
    radius = min(dice.length(0.015, 0.024), pw * 0.3, 0.34 * step)
    style, knobs = dice.number(0, 3), list[Link]()
    ring = pictures.gauge(look.ink, look.panel.color, dice.number(6, 13))
    for k in range(count):
        place = (px, middle + ((count - 1) / 2 - k) * step, front + t)
        body.append(decal("gauge", ring, 2.9 * radius, place))
        knobs.append(knob(dice, look, radius, place, style))
    if dice.chance(70):
        body.append(label(dice, look, pw * 0.6, 0.013, look.panel,
                          (px, middle + cabinet / 2 - 0.018, front + t)))
    return _with_oven_door(dice, number, look, body, knobs, (dw - 0.014, dh - GAP, t),
                           (x, y, front), hole, middle, d)


def _with_oven_door(
    dice: Dice, number: int, look: Finish, body: list[Shape], knobs: list[Link],
    size: tuple[float, float, float], place: tuple[float, float, float],
    hole: tuple[float, float, float, float], middle: float, depth: float,
) -> Thing:
    """The oven with its door, handle and shelves."""
    (w, h, t), (x, y, front) = size, place
    window = (0.0, -dice.length(0.0, 0.02), w * dice.number(55, 82) / 100,
              h * dice.number(45, 64) / 100)
    shapes = [replace(s, solid=at(s.solid, x, y, front + 0.001))
              for s in door(dice, look, size, window)]
    z = front + 0.001 + t
    if dice.chance(40):
        shapes += door_label(dice, look, min(0.3 * w, dice.length(0.06, 0.1)), shapes)
    hinge = (x, y - h / 2 + t / 2, front + 0.001 + t / 2)
    links = [Link("body", tuple(body)),
             Link("door", tuple(shapes), 0, "revolute", hinge, (1.0, 0.0, 0.0),
                  (0.0, dice.angle(1.40, 1.57)))]
    links.append(_handle(dice, look, w * dice.pick((0.6, 0.75, 0.9)), False,
                         (x, y + h / 2 - min(0.035, 0.13 * h), z), links[1]))
    deep, wide = depth - 0.13, hole[2] - 0.012
    z0, steel = front - 0.03 - deep / 2, Paint("rack", (186, 188, 190))
    count = dice.number(0, 2 if h > 0.3 else 1)
    for k in range(count):
        y0 = middle + hole[1] + hole[3] * ((k + 1) / (count + 1) - 0.5)
        rack = at(wire_rack(dice, wide, deep), x, y0, z0)
        links.append(Link("rack", (Shape("rack", rack, steel),), 0, "prismatic",
                          (x, round(y0, 5), round(z0, 5)), (0.0, 0.0, 1.0),
                          (0.0, round(min(0.4, 0.85 * deep), 3))))
    return _centred("Oven", number, [*links, *knobs])


# -- details ------------------------------------------------------------------------------------


def _cabinet(
    look: Finish, size: tuple[float, float], z: tuple[float, float],
    hole: tuple[float, float, float, float], middle: float, behind: float, edge: float,
    corner: float,
) -> list[Shape]:
    """A box with a cavity that reaches to `behind` m from its back; y of its middle is given."""
    outside = shell(*size, z, hole, max(edge, 0.004), edge, corner)
    inside = at(cavity(hole[2:], (z[0] + behind, z[1]), corner), hole[0], hole[1])
    return [Shape("cabinet", at(outside, y=middle), look.body),
            Shape("cavity", at(inside, y=middle), look.inside)]


def _turntable(
    dice: Dice, hole: tuple[float, float, float, float], middle: float, z: tuple[float, float]
) -> list[Shape]:
    """A microwave's plate and the cover of its wave guide."""
    floor, depth = middle + hole[1] - hole[3] / 2, z[1] - z[0]
    r = min(hole[2], depth) / 2 - 0.012
    plate = joined([facing(disc(0.02, (0.0, 0.012)), "up"),
                    at(facing(disc(r * 0.9, (0.0, 0.005), top=r), "up"), y=0.012)])
    cover = facing(slab(min(0.1, depth * 0.4), 0.05, (0.0, 0.0015), 0.006), "left")
    return [Shape("plate", at(plate, hole[0], floor, (z[0] + z[1]) / 2),
                  Paint("plate", dice.near((196, 212, 214), 8))),
            Shape("cover", at(cover, hole[0] + hole[2] / 2, middle + 0.02, (z[0] + z[1]) / 2),
                  Paint("cover", (206, 196, 168)))]


def _microwave_controls(
    dice: Dice, look: Finish, size: tuple[float, float], place: tuple[float, float, float]
) -> tuple[list[Shape], list[Link]]:
    """Display, buttons and knobs about the centre of a panel's front."""
    (w, h), (x, y, z) = size, place
    inner, top = w - 0.016, y + h / 2
    shapes, knobs = list[Shape](), list[Link]()
    style = dice.pick(("keys", "knobs", "mixed"), (5, 3, 3))
    if dice.chance(75):
        shapes.append(label(dice, look, inner * 0.62, 0.02, look.panel, (x, top - 0.014, z)))
    if style != "knobs" or dice.chance(40):
        wide = inner * dice.number(70, 100) / 100
        shapes.append(clock(dice, look, wide, (x, top - 0.03 - wide * 0.16, z)))
    low = y - h / 2 + 0.021  # above a button
    space = h - 0.039 - inner * 0.42
    if style == "keys":
        shapes.append(keys(dice, look, (inner, space - 0.02), (x, low + (space - 0.02) / 2, z),
                           dice.number(5, 9)))
    else:
        count = 1 if style == "mixed" else dice.pick((1, 2), (1, 4))
        most = 0.2 * space / count + (0.006 if style == "knobs" else -0.009)
        radius = min(inner * 0.3, most, dice.length(0.018, 0.027))
        kind = dice.number(0, 3)
        marks = pictures.gauge(look.ink, look.panel.color, dice.number(7, 15))
        for k in range(count):
            spot = (x, low + space * (0.24 + 0.44 * k) if count > 1 else low + space * 0.3, z)
            shapes.append(decal("gauge", marks, 2.8 * radius, spot))
            knobs.append(knob(dice, look, radius, spot, kind))
        if style == "mixed":
            high = space * 0.42
            shapes.append(keys(dice, look, (inner, high), (x, low + space - 0.012 - high / 2, z),
                               dice.number(2, 4)))
    if dice.chance(45):
        button = at(slab(inner * 0.7, 0.016, (0.0, 0.003), 0.004, 0.001), x,
                    y - h / 2 + 0.011, z - 0.001)
        shapes.append(Shape("button", button, dice.pick((look.trim, look.knob))))
    return shapes, knobs


def _strip_controls(
    dice: Dice, look: Finish, size: tuple[float, float], place: tuple[float, float, float]
) -> list[Shape]:
    """A dishwasher's buttons, display and name on its control strip."""
    (w, h), (x, y, z) = size, place
    turn = dice.pick((-1, 1))
    shapes = [label(dice, look, dice.length(0.06, 0.1), 0.6 * h, look.panel,
                    (x - turn * (w / 2 - 0.075), y, z))]
    inner = 0.14 * w  # where the buttons end
    if dice.chance(65):
        wide, aside = dice.length(0.05, 0.08), dice.pick((0, 1)) * 0.05
        shapes.append(clock(dice, look, wide, (x + turn * aside, y, z)))
        inner = max(inner, aside + wide / 2 + 0.008)
    count = dice.number(3, 8)
    tall, wide = min(0.02, h * 0.35), dice.length(0.012, 0.022)
    high = dice.length(0.001, 0.003)
    button = slab(wide, tall, (0.0, high), dice.pick((0.002, tall / 2)), 0.0005)
    first = x + turn * (w / 2 - 0.03)
    row = [at(button, first - turn * k * (wide + 0.006), y, z) for k in range(count)
           if w / 2 - 0.03 - k * (wide + 0.006) - wide / 2 > inner]
    return [*shapes, Shape("buttons", joined(row), dice.pick((look.knob, look.trim)))]


def _oven_controls(
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


def _cooktop(dice: Dice, look: Finish, w: float, d: float, h: float) -> list[Shape]:
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


def _heating(
    dice: Dice, hole: tuple[float, float, float, float], middle: float, depth: float
) -> list[Shape]:
    """Heating loops near floor and ceiling of a cavity, and rails for shelves at its sides."""
    x, y, w, h = hole
    a, b = w / 2 - 0.04, depth / 2 - 0.07
    corners = ((-1, -1), (1, -1), (1, 1), (0.3, 1), (0.3, -0.5), (-0.3, -0.5), (-0.3, 1), (-1, 1),
               (-1, -1))
    path: Array = np.array([[a * u, 0.0, b * v] for u, v in corners])
    loop = tube(path, 0.004, [0, 1, 0], 6)
    levels = [s * (h / 2 - 0.012) for s in ((-1, 1) if dice.chance(70) else (1,))]
    shapes = [Shape("heating", joined([at(loop, x, middle + y + level, 0.0) for level in levels]),
                    Paint("heating", dice.pick(((110, 66, 50), (70, 70, 74)))))]
    rails = [at(slab(0.006, 0.008, (-depth / 2 + 0.08, depth / 2 - 0.03)),
                x + s * (w / 2 - 0.003), middle + y + h * q)
             for s in (-1, 1) for q in (-0.28, -0.08, 0.12, 0.32)]
    return [*shapes, Shape("rails", joined(rails), Paint("rails", (150, 152, 154)))]


def _handle(
    dice: Dice, look: Finish, length: float, upright: bool, place: tuple[float, float, float],
    hangs_on: Link,
) -> Link:
    """A handle that is fixed to the door (link 1)."""
    shapes, _ = handle(dice, look, length, upright)
    return Link("handle", tuple(replace(s, solid=at(s.solid, *place)) for s in shapes), 1,
                origin=hangs_on.origin)


def _centred(category: str, number: int, links: list[Link]) -> Thing:
    """The object with the centre of its bounding box at the origin, as in PartNet-Mobility."""
    points = np.concatenate([s.solid.vertices for link in links for s in link.shapes])
    x, y, z = (-np.round((points.min(0) + points.max(0)) / 2.0, 4)).tolist()

    def moved(link: Link) -> Link:
        shapes = tuple(replace(s, solid=at(s.solid, x, y, z)) for s in link.shapes)
        a, b, c = link.origin
        origin = (round(a + x, 5), round(b + y, 5), round(c + z, 5))
        return replace(link, shapes=shapes, origin=origin if link.joint != "fixed" or link.parent
                       else (0.0, 0.0, 0.0))

    return Thing(category, number, tuple(moved(link) for link in links))


DESIGNS: dict[str, Callable[[Dice, int], Thing]] = {
    "microwave": microwave, "dishwasher": dishwasher, "oven": oven,
}
