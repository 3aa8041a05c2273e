"""Dishwashers: a door over a toe kick, and two racks."""

from __future__ import annotations

from dataclasses import replace

from . import textures as pictures
from .doors import door, hung_handle
from .finish import Finish, Paint, Shape, clock, draw_finish, label
from .fittings import GAP, Link, Thing, basket, centred, dishes, hollow_box
from .shapes import at, disc, facing, joined, slab
from .textures import Dice


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
    body = hollow_box(replace(look, inside=steel), (w, body_h), (-d / 2, front), hole, middle, 0.04,
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
        links.append(hung_handle(dice, look, w * dice.pick((0.55, 0.75, 0.88)), False, (0.0, hy, z),
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
    return centred("Dishwasher", number, links)


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
