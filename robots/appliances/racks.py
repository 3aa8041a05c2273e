"""What is inside of appliances: shelves, baskets, dishes, heating."""

from __future__ import annotations

import numpy as np

from ..geometry import Array
from .lofts import Solid, circle, loft, ring
from .partnet_export import Paint, Shape
from .sampling import Dice
from .shapes import at, facing, joined, rod, slab, tube
from .textures import Color


def wire_rack(dice: Dice, width: float, depth: float) -> Solid:
    """An oven's shelf about the origin, in the plane y = 0."""
    x, z, r = width / 2, depth / 2, 0.003
    bars = [rod([-x, 0, s * z], [x, 0, s * z], r) for s in (-1, 1)]
    bars += [rod([s * x, 0, -z], [s * x, 0, z], r) for s in (-1, 1)]
    count = dice.number(9, 16)
    bars += [rod([x * (2 * k / count - 1), 0.002, -z], [x * (2 * k / count - 1), 0.002, z], 0.0017)
             for k in range(1, count)]
    bars.append(rod([-x, 0, 0], [x, 0, 0], r))
    return joined(bars)


def basket(dice: Dice, width: float, depth: float, high: float) -> Solid:
    """A dishwasher's rack about the origin, its bottom in the plane y = 0."""
    x, z, r = width / 2, depth / 2, 0.0018
    bars: list[Solid] = []
    for y, thick in ((0.0, r), (high, 0.003)):
        corners = [[-x, y, -z], [x, y, -z], [x, y, z], [-x, y, z]]
        bars += [rod(corners[k], corners[(k + 1) % 4], thick) for k in range(4)]
    n, m = dice.number(5, 8), dice.number(5, 8)
    for k in range(n + 1):
        u = x * (2 * k / n - 1)
        bars += [rod([u, 0, -z], [u, 0, z], r, 4)]
        bars += [rod([u, 0, s * z], [u, high, s * z], r, 4) for s in (-1, 1)]
    for k in range(m + 1):
        v = z * (2 * k / m - 1)
        bars += [rod([-x, 0, v], [x, 0, v], r, 4)]
        bars += [rod([s * x, 0, v], [s * x, high, v], r, 4) for s in (-1, 1)]
    tines = min(0.07, high)
    for k in range(1, n):
        bars += [rod([x * (2 * k / n - 1), 0, z * s], [x * (2 * k / n - 1), tines, z * s], r, 4)
                 for s in (-0.5, 0.5)]
    return joined(bars)


def dishes(dice: Dice, width: float, depth: float) -> list[tuple[Solid, Color]]:
    """Plates that stand in a basket about the origin."""
    out: list[tuple[Solid, Color]] = []
    for k in range(dice.number(2, 7)):
        r = dice.length(0.08, 0.115)
        plate = loft([ring(circle(r * 0.5), 0.0, 0.0, -1.0), ring(circle(r * 0.5), 0.0),
                      ring(circle(r), 0.012, 0.6, -0.8), ring(circle(r), 0.015, 0.0, 1.0),
                      ring(circle(r * 0.5), 0.004, 0.0, 1.0)], first_cap=True, last_cap=True)
        place = -width / 2 + 0.05 + k * 0.035
        if place > width / 2 - 0.03:
            break
        z = dice.pick((-1, 1)) * max(0.0, depth / 2 - r - 0.02) * 0.5
        out.append((at(facing(plate, "right"), place, r + 0.004, z),
                    dice.near(dice.pick(((236, 234, 228), (120, 150, 180), (200, 120, 90))), 10)))
    return out


def heating(
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
