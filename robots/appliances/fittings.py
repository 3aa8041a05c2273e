"""What else appliances have in common: cabinets, knobs, feet, vents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .finish import Finish
from .partnet_export import Link, Paint, Shape, Thing
from .prints import LIFT
from .sampling import Dice
from .shapes import at, cavity, disc, facing, joined, picture, shell, slab
from .textures import Color

GAP = 0.002
"""m of the seam around a door."""


def hollow_box(
    look: Finish, size: tuple[float, float], z: tuple[float, float],
    hole: tuple[float, float, float, float], middle: float, behind: float, edge: float,
    corner: float,
) -> list[Shape]:
    """A box with a cavity that reaches to `behind` m from its back; y of its middle is given."""
    outside = shell(*size, z, hole, max(edge, 0.004), edge, corner)
    inside = at(cavity(hole[2:], (z[0] + behind, z[1]), corner), hole[0], hole[1])
    return [Shape("cabinet", at(outside, y=middle), look.body),
            Shape("cavity", at(inside, y=middle), look.inside)]


def knob(dice: Dice, look: Finish, radius: float, place: tuple[float, float, float],
         style: int) -> Link:
    """A knob that turns about z; all of one appliance have one style."""
    high = radius * (0.7 + 0.1 * (style % 4))
    x, y, z = place
    solids = [disc(radius * 1.12, (0.0, 0.004), 0.001), disc(radius, (0.004, high), 0.0025,
                                                              top=radius * (0.85, 1.0)[style % 2])]
    if style >= 2:
        solids.append(at(slab(radius * 0.34, radius * 1.9, (high - 0.001, high + radius * 0.35),
                              radius * 0.15, 0.001)))
    top = high + (radius * 0.35 if style >= 2 else 0.0)
    mark_color: Color = (235, 235, 232) if sum(look.knob.color) < 380 else (30, 30, 32)
    mark = at(slab(radius * 0.14, radius * 0.6, (top - 0.0005, top + 0.0005)), y=radius * 0.5)
    shapes = (Shape("knob", at(joined(solids), *place), look.knob),
              Shape("mark", at(mark, *place), Paint("mark", mark_color)))
    return Link("knob", shapes, 0, "revolute", (x, y, z), (0.0, 0.0, 1.0),
                (0.0, dice.pick((3.142, 4.712, 5.236))))


def feet(dice: Dice, look: Finish, spots: tuple[float, float], high: float) -> list[Shape]:
    """Four feet under (x, z) in every combination of signs, from the ground up."""
    r = dice.length(0.008, 0.016)
    foot = facing(disc(r, (0.0, high + 0.002)), "up")
    return [Shape("feet", joined([at(foot, sx * spots[0], 0.0, sz * spots[1])
                                  for sx in (-1, 1) for sz in (-1, 1)]), look.rubber)]


def vents(center: tuple[float, float, float], size: tuple[float, float], where: str,
          slots: int) -> Shape:
    """Dark slots in a row, on the side that looks `where`; size is along the row and across."""
    step = size[0] / slots
    one = picture(step * 0.5, size[1], LIFT)
    row = joined([at(one, (k - (slots - 1) / 2) * step) for k in range(slots)])
    row = replace(row, uv=None)
    return Shape("vents", at(facing(row, where) if where != "front" else row, *center),
                 Paint("slot", (24, 24, 26)))


def centred(category: str, number: int, links: list[Link]) -> Thing:
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
