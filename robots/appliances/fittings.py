"""Parts of appliances, and what several kinds have: cabinets, knobs, feet, vents, racks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry import Array
from ..model import JointType
from .finish import DECAL_LIFT, Finish, Finishes, Shape
from .shapes import (
    Hole,
    Solid,
    Vector,
    cavity,
    circle_outline,
    disc,
    image_quad,
    join,
    loft,
    orient,
    ring,
    shell,
    shift,
    slab,
    tube,
    wire,
)
from .textures import Color, SeededRng


@dataclass(frozen=True)
class Part:
    """A rigid part of an appliance, in the object's frame with every joint at zero."""

    role: str
    """"body", "door", "drawer", "handle", "rack" or "knob"."""
    shapes: tuple[Shape, ...]
    parent: int = 0
    """Index of the parent part. The body is part 0; its own value is not used."""
    joint: JointType = JointType.FIXED
    origin: Vector = (0.0, 0.0, 0.0)
    """m, a point of the joint's axis."""
    axis: Vector = (0.0, 0.0, 0.0)
    """Unit direction of the joint's axis; zeros for a fixed joint."""
    limits: tuple[float, float] = (0.0, 0.0)
    """rad or m."""


@dataclass(frozen=True)
class Appliance:
    """An articulated object, centered at the origin."""

    category: str
    """As PartNet-Mobility spells it: "Microwave"."""
    number: int
    parts: tuple[Part, ...]


DOOR_GAP = 0.002
"""m of the seam around a door."""


@dataclass(frozen=True)
class Cabinet:
    """A box with a cavity that is open in front: the body of an appliance; lengths in m."""

    width: float
    height: float
    middle: float
    """y of the center."""
    z: tuple[float, float]
    """Of the back and of the front."""
    hole: Hole
    """The opening in the front; its y is relative to `middle`."""
    back: float
    """From the back of the box to the back of the cavity."""
    edge: float
    """Radius of the outer edges."""

    @property
    def depth(self) -> float:
        return self.z[1] - self.z[0]


def hollow_box(look: Finishes, box: Cabinet) -> list[Shape]:
    """Return the shapes of a cabinet: its outside and its cavity."""
    hole, z = box.hole, box.z
    outside = shell(box.width, box.height, z, hole, max(box.edge, 0.004), box.edge)
    inside = cavity((hole.width, hole.height), (z[0] + box.back, z[1]), hole.radius)
    return [Shape("cabinet", shift(outside, y=box.middle), look.body),
            Shape("cavity", shift(shift(inside, hole.x, hole.y), y=box.middle), look.inside)]


def knob(rng: SeededRng, look: Finishes, radius: float, place: Vector, style: int) -> Part:
    """Draw a knob that turns about z; the knobs of one appliance share a style of 0 to 3."""
    high = radius * (0.7 + 0.1 * (style % 4))
    x, y, z = place
    solids = [disc(radius * 1.12, (0.0, 0.004), 0.001), disc(radius, (0.004, high), 0.0025,
                                                              top=radius * (0.85, 1.0)[style % 2])]
    if style >= 2:
        solids.append(shift(slab(radius * 0.34, radius * 1.9, (high - 0.001, high + radius * 0.35),
                              radius * 0.15, 0.001)))
    top = high + (radius * 0.35 if style >= 2 else 0.0)
    mark_color: Color = (235, 235, 232) if sum(look.knob.color) < 380 else (30, 30, 32)
    mark = shift(slab(radius * 0.14, radius * 0.6, (top - 0.0005, top + 0.0005)), y=radius * 0.5)
    shapes = (Shape("knob", shift(join(solids), *place), look.knob),
              Shape("mark", shift(mark, *place), Finish("mark", mark_color)))
    return Part("knob", shapes, 0, JointType.REVOLUTE, (x, y, z), (0.0, 0.0, 1.0),
                (0.0, rng.choice((3.142, 4.712, 5.236))))


def feet(rng: SeededRng, look: Finishes, corner: tuple[float, float], high: float) -> list[Shape]:
    """Draw four feet on the ground at (x, z) = (+-corner[0], +-corner[1])."""
    r = rng.length(0.008, 0.016)
    foot = orient(disc(r, (0.0, high + 0.002)), "up")
    return [Shape("feet", join([shift(foot, sx * corner[0], 0.0, sz * corner[1])
                                  for sx in (-1, 1) for sz in (-1, 1)]), look.rubber)]


def vents(center: Vector, size: tuple[float, float], where: str, slots: int) -> Shape:
    """Return a row of dark slots on the side `where`; size is along the row and across."""
    step = size[0] / slots
    one = image_quad(step * 0.5, size[1], DECAL_LIFT)
    row = join([shift(one, (k - (slots - 1) / 2) * step) for k in range(slots)])
    row = replace(row, uv=None)
    return Shape("vents", shift(orient(row, where) if where != "front" else row, *center),
                 Finish("slot", (24, 24, 26)))


def center_appliance(category: str, number: int, parts: Sequence[Part]) -> Appliance:
    """Return the appliance with the center of its bounding box at the origin.

    PartNet-Mobility centers its objects likewise.
    """
    points = np.concatenate([s.solid.vertices for part in parts for s in part.shapes])
    x, y, z = (-np.round((points.min(0) + points.max(0)) / 2.0, 4)).tolist()

    def center(part: Part) -> Part:
        shapes = tuple(replace(s, solid=shift(s.solid, x, y, z)) for s in part.shapes)
        a, b, c = part.origin
        moves = part.joint is not JointType.FIXED or part.parent
        origin = (round(a + x, 5), round(b + y, 5), round(c + z, 5))
        return replace(part, shapes=shapes, origin=origin if moves else (0.0, 0.0, 0.0))

    return Appliance(category, number, tuple(map(center, parts)))


def wire_rack(rng: SeededRng, width: float, depth: float) -> Solid:
    """Draw the shelf of an oven about the origin, in the plane y = 0."""
    x, z, r = width / 2, depth / 2, 0.003
    bars = [wire([-x, 0, s * z], [x, 0, s * z], r) for s in (-1, 1)]
    bars += [wire([s * x, 0, -z], [s * x, 0, z], r) for s in (-1, 1)]
    count = rng.integer(9, 16)
    bars += [wire([x * (2 * k / count - 1), 0.002, -z], [x * (2 * k / count - 1), 0.002, z], 0.0017)
             for k in range(1, count)]
    bars.append(wire([-x, 0, 0], [x, 0, 0], r))
    return join(bars)


def basket(rng: SeededRng, width: float, depth: float, high: float) -> Solid:
    """Draw the rack of a dishwasher about the origin, its bottom in the plane y = 0."""
    x, z, r = width / 2, depth / 2, 0.0018
    bars: list[Solid] = []
    for y, thick in ((0.0, r), (high, 0.003)):
        corners = [[-x, y, -z], [x, y, -z], [x, y, z], [-x, y, z]]
        bars += [wire(corners[k], corners[(k + 1) % 4], thick) for k in range(4)]
    n, m = rng.integer(5, 8), rng.integer(5, 8)
    for k in range(n + 1):
        u = x * (2 * k / n - 1)
        bars += [wire([u, 0, -z], [u, 0, z], r, 4)]
        bars += [wire([u, 0, s * z], [u, high, s * z], r, 4) for s in (-1, 1)]
    for k in range(m + 1):
        v = z * (2 * k / m - 1)
        bars += [wire([-x, 0, v], [x, 0, v], r, 4)]
        bars += [wire([s * x, 0, v], [s * x, high, v], r, 4) for s in (-1, 1)]
    tines = min(0.07, high)
    for k in range(1, n):
        bars += [wire([x * (2 * k / n - 1), 0, z * s], [x * (2 * k / n - 1), tines, z * s], r, 4)
                 for s in (-0.5, 0.5)]
    return join(bars)


def dishes(rng: SeededRng, width: float, depth: float) -> list[tuple[Solid, Color]]:
    """Draw plates that stand in a basket about the origin."""
    out: list[tuple[Solid, Color]] = []
    for k in range(rng.integer(2, 7)):
        r = rng.length(0.08, 0.115)
        foot, rim = circle_outline(r * 0.5), circle_outline(r)
        plate = loft([ring(foot, 0.0, 0.0, -1.0), ring(foot, 0.0), ring(rim, 0.012, 0.6, -0.8),
                      ring(rim, 0.015, 0.0, 1.0), ring(foot, 0.004, 0.0, 1.0)],
                     first_cap=True, last_cap=True)
        place = -width / 2 + 0.05 + k * 0.035
        if place > width / 2 - 0.03:
            break
        z = rng.choice((-1, 1)) * max(0.0, depth / 2 - r - 0.02) * 0.5
        out.append((shift(orient(plate, "right"), place, r + 0.004, z),
                    rng.near(rng.choice(((236, 234, 228), (120, 150, 180), (200, 120, 90))), 10)))
    return out


def heating_loops(rng: SeededRng, box: Cabinet) -> list[Shape]:
    """Draw heating loops near the ceiling or floor of a cavity, and rails for shelves."""
    x, y, w, h = box.hole.x, box.hole.y, box.hole.width, box.hole.height
    middle, depth = box.middle, box.depth
    a, b = w / 2 - 0.04, depth / 2 - 0.07
    corners = ((-1, -1), (1, -1), (1, 1), (0.3, 1), (0.3, -0.5), (-0.3, -0.5), (-0.3, 1), (-1, 1),
               (-1, -1))
    path: Array = np.array([[a * u, 0.0, b * v] for u, v in corners])
    loop = tube(path, 0.004, [0, 1, 0], 6)
    levels = [s * (h / 2 - 0.012) for s in ((-1, 1) if rng.chance(70) else (1,))]
    shapes = [Shape("heating", join([shift(loop, x, middle + y + level, 0.0) for level in levels]),
                    Finish("heating", rng.choice(((110, 66, 50), (70, 70, 74)))))]
    rails = [shift(slab(0.006, 0.008, (-depth / 2 + 0.08, depth / 2 - 0.03)),
                x + s * (w / 2 - 0.003), middle + y + h * q)
             for s in (-1, 1) for q in (-0.28, -0.08, 0.12, 0.32)]
    return [*shapes, Shape("rails", join(rails), Finish("rails", (150, 152, 154)))]
