"""Dishwashers: a door over a toe kick, and two racks."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..model import JointType
from . import textures
from .doors import door, door_handle
from .finish import Finish, Finishes, Shape, clock_display, draw_finishes, label
from .fittings import (
    DOOR_GAP,
    Appliance,
    Cabinet,
    Part,
    basket,
    center_appliance,
    dishes,
    hollow_box,
)
from .shapes import Hole, Vector, disc, join, orient, shift, slab
from .textures import SeededRng


@dataclass(frozen=True)
class _Size:
    """m."""

    width: float
    height: float
    depth: float
    kick: float
    """Height of the toe kick."""
    door: float
    """Thickness of the door."""
    wall: float


def dishwasher(rng: SeededRng, number: int) -> Appliance:
    """Draw a dishwasher: a door, hinged at its bottom, and two racks that slide."""
    look = draw_finishes(rng, ("steel", "white", "black", "slate", "navy", "sage", "bronze"),
                         (6, 6, 5, 3, 2, 2, 1))
    w, h, d = rng.choice((0.448, 0.598), (1, 3)), rng.length(0.80, 0.86), rng.length(0.55, 0.60)
    kick, t = rng.length(0.08, 0.12), rng.length(0.02, 0.034)
    if look.textured and rng.chance(35):  # panel-ready: the wood of the kitchen
        tone = rng.near(rng.choice(((150, 104, 66), (196, 156, 110), (96, 66, 46))), 12)
        tile = rng.length(0.3, 0.5)
        grain = textures.wood_grain(rng.generator, tone, rng.integer(2, 5))
        look = replace(look, front=Finish("front", tone, tile=tile, image=grain))
    body_h = h - kick
    size = _Size(w, h, d, kick, t, rng.length(0.022, 0.034))
    hole = Hole(0.0, 0.0, w - 2 * size.wall, body_h - 2 * size.wall - 0.01, 0.02)
    cabinet = Cabinet(w, body_h, kick + body_h / 2, (-d / 2, d / 2), hole, 0.04, 0.004)
    steel = Finish("inside", rng.near(rng.choice(((176, 178, 180), (196, 196, 192))), 8))
    body = hollow_box(replace(look, inside=steel), cabinet) + _fixtures(rng, look, size, cabinet)
    parts = [Part("body", tuple(body)), *_door(rng, look, size, cabinet)]
    return center_appliance("Dishwasher", number, [*parts, *_racks(rng, cabinet)])


def _fixtures(rng: SeededRng, look: Finishes, size: _Size, cabinet: Cabinet) -> list[Shape]:
    """The toe kick, a counter on top, the spray arm, and seams at the sides."""
    w, d, (back, front) = size.width, size.depth, cabinet.z
    recess = rng.length(0.03, 0.07)
    board = slab(w - 0.01, size.kick, (back + 0.01, front - recess))
    shapes = [Shape("toe_kick", shift(board, y=size.kick / 2),
                    rng.choice((look.trim, look.rubber, look.body)))]
    if rng.chance(30):
        top = rng.length(0.02, 0.04)
        stone = Finish("counter", rng.near(rng.choice(((90, 86, 84), (214, 206, 196),
                                                       (150, 110, 76))), 14))
        board = orient(slab(w + 0.006, d + 0.05, (0.0, top), 0.004, 0.003), "up")
        shapes.append(Shape("counter", shift(board, 0, size.height, 0.02), stone))
    arm = join([orient(slab(cabinet.hole.width * 0.7, 0.04, (0.0, 0.012), 0.018), "up"),
                orient(disc(0.03, (0.0, 0.02)), "up")])
    shapes.append(Shape("spray_arm", shift(arm, 0.0, size.kick + size.wall + 0.02), look.trim))
    seam = slab(0.003, cabinet.height - 0.02, (0.0, 0.0004))
    return shapes + [
        Shape("seam", shift(orient(seam, "right" if s > 0 else "left"), s * w / 2, cabinet.middle,
                            front - rng.length(0.03, 0.08)), Finish("seam", (40, 40, 42)))
        for s in (-1, 1)]


def _door(rng: SeededRng, look: Finishes, size: _Size, cabinet: Cabinet) -> list[Part]:
    """The door with its controls, and its handle."""
    w, t, y, front = size.width, size.door, cabinet.middle, cabinet.z[1]
    h, z = cabinet.height - 2 * DOOR_GAP, front + 0.001 + t
    top = y + h / 2
    strip = rng.length(0.06, 0.11) if rng.chance(65) else 0.0  # else the controls are hidden
    shapes = [replace(s, solid=shift(s.solid, 0.0, y, front + 0.001))
              for s in door(rng, look, (w - 2 * DOOR_GAP, h, t), None)]
    taken = strip  # m of the front below the top
    if strip:
        plate = slab(w - 2 * DOOR_GAP, strip, (0.0, rng.length(0.002, 0.006)), 0.003, 0.0015)
        high = float(plate.vertices[:, 2].max())
        shapes.append(Shape("panel", shift(plate, 0.0, top - strip / 2, z), look.panel))
        shapes += _strip_controls(rng, look, (w, strip), (0.0, top - strip / 2, z + high))
    else:
        buttons = [orient(slab(0.014, 0.008, (0.0, 0.0012), 0.003), "up")
                   for _ in range(rng.integer(4, 9))]
        shapes.append(Shape("buttons", join([
            shift(b, (k - (len(buttons) - 1) / 2) * 0.03, top, front + 0.001 + t / 2)
            for k, b in enumerate(buttons)]), look.trim))
        if rng.chance(70):
            shapes.append(label(rng, look, (rng.length(0.06, 0.1), 0.022), look.front,
                                (rng.choice((-1, 0, 1)) * (w / 2 - 0.09), top - 0.03, z)))
            taken = 0.03
    if rng.chance(25):
        groove = slab(w - 0.01, 0.003, (0.0, 0.0006))
        level = y - h / 2 + h * rng.choice((0.25, 0.5, 0.66))
        shapes.append(Shape("groove", shift(groove, 0.0, level, z), Finish("seam", (46, 46, 48))))
    dispenser = shift(slab(0.14, 0.09, (-0.014, -0.005), 0.01, 0.0, 0.003),
                      rng.length(-0.05, 0.05), y + rng.length(-0.05, 0.1), front + 0.001)
    shapes.append(Shape("dispenser", dispenser, look.rubber))
    hinge = (0.0, size.kick + DOOR_GAP + t / 2, front + 0.001 + t / 2)
    leaf = Part("door", tuple(shapes), 0, JointType.REVOLUTE, hinge, (1.0, 0.0, 0.0),
                (0.0, rng.angle(1.40, 1.57)))
    grip = rng.choice(("handle", "pocket", "none"), (7, 3, 2))
    place = (0.0, top - taken - rng.length(0.035, 0.06), z)
    if grip == "handle":
        return [leaf, door_handle(rng, look, w * rng.choice((0.55, 0.75, 0.88)), place, leaf)]
    if grip == "pocket":
        cup = shift(slab(rng.length(0.16, 0.3), 0.035, (0.0, 0.0015), 0.012), *place)
        return [leaf, Part("handle", (Shape("handle", cup, look.rubber),), 1, origin=hinge)]
    return [leaf]


def _racks(rng: SeededRng, cabinet: Cabinet) -> list[Part]:
    """Two racks, the lower one with dishes or not."""
    hole, front = cabinet.hole, cabinet.z[1]
    floor, depth = cabinet.middle - hole.height / 2, cabinet.depth - 0.04
    color = rng.near(rng.choice(((226, 228, 230), (150, 152, 156), (90, 110, 150))), 8)
    deep, wide = depth - 0.07, hole.width - 0.03
    z = front - 0.035 - deep / 2
    racks = list[Part]()
    for k, y in enumerate((floor + 0.05, floor + hole.height * 0.52)):
        shelf = shift(basket(rng, wide, deep, rng.length(0.07, 0.12)), 0, y, z)
        shapes = [Shape("rack", shelf, Finish("rack", color))]
        if rng.chance(40):
            shapes += [Shape("dish", shift(s, 0.0, y, z), Finish(f"dish{i}", c))
                       for i, (s, c) in enumerate(dishes(rng, wide, deep)) if k == 0]
        racks.append(Part("rack", tuple(shapes), 0, JointType.PRISMATIC,
                          (0.0, round(y, 5), round(z, 5)), (0.0, 0.0, 1.0),
                          (0.0, round(min(0.45, 0.9 * deep), 3))))
    return racks


def _strip_controls(
    rng: SeededRng, look: Finishes, size: tuple[float, float], place: Vector
) -> list[Shape]:
    """Buttons, display and name on the control strip."""
    (w, h), (x, y, z) = size, place
    turn = rng.choice((-1, 1))
    shapes = [label(rng, look, (rng.length(0.06, 0.1), 0.6 * h), look.panel,
                    (x - turn * (w / 2 - 0.075), y, z))]
    inner = 0.14 * w  # where the buttons end
    if rng.chance(65):
        wide, aside = rng.length(0.05, 0.08), rng.choice((0, 1)) * 0.05
        shapes.append(clock_display(rng, look, wide, (x + turn * aside, y, z)))
        inner = max(inner, aside + wide / 2 + 0.008)
    count = rng.integer(3, 8)
    tall, wide = min(0.02, h * 0.35), rng.length(0.012, 0.022)
    high = rng.length(0.001, 0.003)
    button = slab(wide, tall, (0.0, high), rng.choice((0.002, tall / 2)), 0.0005)
    first = x + turn * (w / 2 - 0.03)
    row = [shift(button, first - turn * k * (wide + 0.006), y, z) for k in range(count)
           if w / 2 - 0.03 - k * (wide + 0.006) - wide / 2 > inner]
    return [*shapes, Shape("buttons", join(row), rng.choice((look.knob, look.trim)))]
