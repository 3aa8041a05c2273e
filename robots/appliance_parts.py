"""What appliances have in common: finishes, doors, handles, knobs, decals, racks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from . import appliance_textures as pictures
from .appliance_shapes import (
    Solid,
    at,
    circle,
    cosine,
    disc,
    facing,
    frame,
    joined,
    loft,
    picture,
    ring,
    rod,
    sine,
    slab,
    tube,
)
from .appliance_textures import Color
from .partnet_files import Link, Paint, Shape

T = TypeVar("T")
LIFT = 0.0006
"""m that a decal lies before its surface."""


class Dice:
    """Draws on grids of integers: the same on every machine."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def number(self, low: int, high: int) -> int:
        """Both ends included."""
        return int(self.rng.integers(low, high + 1))

    def length(self, low: float, high: float) -> float:
        """m, on a grid of a millimetre."""
        return self.number(round(low * 1000), round(high * 1000)) / 1000

    def angle(self, low: float, high: float) -> float:
        """rad, on a grid of a thousandth."""
        return self.length(low, high)

    def chance(self, percent: int) -> bool:
        return self.number(0, 99) < percent

    def pick(self, options: Sequence[T], weights: Sequence[int] | None = None) -> T:
        """One of the options; integer weights."""
        chances = weights or [1] * len(options)
        drawn = self.number(0, sum(chances) - 1)
        for option, weight in zip(options, chances, strict=True):
            drawn -= weight
            if drawn < 0:
                return option
        raise AssertionError("the weights are positive")

    def near(self, color: Color, spread: int) -> Color:
        """A colour that is up to `spread` lighter or darker, its channels almost alike."""
        shift, tint = self.number(-spread, spread), spread // 5
        r, g, b = (min(255, max(0, c + shift + self.number(-tint, tint))) for c in color)
        return r, g, b


@dataclass(frozen=True)
class Finish:
    """The looks of one appliance."""

    textured: bool
    body: Paint
    front: Paint
    """Of the door."""
    panel: Paint
    """Of the controls."""
    trim: Paint
    inside: Paint
    handle: Paint
    knob: Paint
    glass: Paint
    rubber: Paint
    ink: Color
    """Of letters on the panel."""
    lit: Color
    """Of displays."""
    brand: str


COLORS: dict[str, Color] = {
    "white": (238, 238, 235), "black": (30, 30, 32), "steel": (182, 184, 186),
    "slate": (98, 102, 106), "cream": (234, 223, 194), "red": (164, 32, 36),
    "teal": (104, 166, 158), "navy": (44, 60, 96), "sage": (148, 170, 146),
    "bronze": (128, 98, 78), "graphite": (64, 66, 70), "yellow": (226, 186, 72),
}
_SOUNDS = ("NOR", "KEL", "VIR", "ASTRA", "BOR", "MIR", "LUX", "TEK", "HAL", "ZEN", "ORI", "DAN",
           "PEL", "SOL", "FER", "GAL")
_ENDS = ("VA", "IO", "EX", "ON", "A", "TECH", "MAX", "IS", "UM", "LINE", "EN", "OX")


def draw_finish(dice: Dice, fronts: Sequence[str], weights: Sequence[int]) -> Finish:
    """Colours that go together."""
    textured = dice.chance(50)
    front = dice.pick(fronts, weights)
    body = front if dice.chance(45) else dice.pick(("white", "black", "steel", "graphite"))
    panel = dice.pick((front, "black", "graphite", "steel", "white"), (5, 4, 1, 2, 1))
    paints = {role: _coat(dice, role, color, textured)
              for role, color in (("body", body), ("front", front), ("panel", panel))}
    dark_panel = sum(paints["panel"].color) < 380
    handle = dice.pick(("steel", front, "black", "bronze", "graphite"), (6, 3, 3, 1, 1))
    tone = dice.pick((14, 22, 34, 48))
    glass = Paint("glass", (tone, tone + dice.number(0, 4), tone + dice.number(0, 8)),
                  dice.pick((1.0, 0.9, 0.8, 0.7), (5, 2, 2, 2)))
    inside = dice.pick(((206, 206, 200), (150, 152, 154), (120, 122, 126), (226, 224, 214)))
    return Finish(
        textured, paints["body"], paints["front"], paints["panel"],
        _coat(dice, "trim", dice.pick(("steel", "black", "graphite", body)), False),
        Paint("inside", dice.near(inside, 6)),
        _coat(dice, "handle", handle, False),
        _coat(dice, "knob", dice.pick(("black", "steel", "white", handle, front)), False), glass,
        Paint("rubber", (38, 38, 40)),
        (232, 232, 228) if dark_panel else (40, 40, 44),
        dice.pick(((90, 220, 235), (80, 235, 130), (250, 160, 60), (240, 240, 245), (240, 80, 70))),
        dice.pick(_SOUNDS) + dice.pick(_ENDS))


def _coat(dice: Dice, role: str, color: str, textured: bool) -> Paint:
    tone = dice.near(COLORS[color], 9)
    if not textured:
        return Paint(role, tone)
    if color in ("steel", "slate", "bronze", "graphite"):
        image = pictures.brushed(dice.rng, tone, dice.number(5, 12), dice.chance(60))
        return Paint(role, tone, picture=image, tile=dice.length(0.15, 0.4))
    image = pictures.speckled(dice.rng, tone, dice.number(2, 5))
    return Paint(role, tone, picture=image, tile=dice.length(0.12, 0.3))


def decal(name: str, image: pictures.Picture, width: float, place: tuple[float, float, float],
          height: float | None = None) -> Shape:
    """A picture on a plane that faces the front, about a place; its own shape unless a height."""
    rows, columns = image.pixels.shape
    solid = picture(width, width * rows / columns if height is None else height, LIFT)
    return Shape(name, at(solid, *place), Paint(name, (255, 255, 255), picture=image))


def label(dice: Dice, look: Finish, width: float, height: float, on: Paint,
          place: tuple[float, float, float]) -> Shape:
    """The maker's name in a colour that shows on its ground; the sizes are the most it takes."""
    light = sum(on.color) > 380
    ink = dice.pick(((40, 40, 44), (120, 30, 34), (30, 50, 110)), (4, 1, 1)) if light else \
        dice.pick(((235, 235, 232), (200, 202, 205), (214, 176, 96)), (3, 2, 1))
    image = pictures.words(look.brand, ink, on.color)
    rows, columns = image.pixels.shape
    return decal("logo", image, min(width, height * columns / rows), place)


def door_label(dice: Dice, look: Finish, width: float, shapes: Sequence[Shape]) -> list[Shape]:
    """The maker's name below the window of a door of these shapes, if there is room for it."""
    panel = next(s for s in shapes if s.name == "door_panel")
    low, high = panel.solid.vertices.min(0), panel.solid.vertices.max(0)
    middle = (low + high) / 2
    floor, ceiling = low[1] + 0.008, middle[1]  # the edge is round
    for shape in shapes:
        bottom, top = shape.solid.vertices[:, 1].min(), shape.solid.vertices[:, 1].max()
        if shape.name == "rail" and top < middle[1]:
            floor = top
        elif shape.name in ("window", "bezel"):
            ceiling = min(ceiling, bottom)
    space = ceiling - floor
    place = (float(middle[0]), float(floor + space / 2), float(high[2]) + 0.0002)
    sign = label(dice, look, width, 0.75 * space, panel.paint, place)
    return [sign] if space > 0.014 else []


def clock(dice: Dice, look: Finish, width: float, place: tuple[float, float, float]) -> Shape:
    """A display with the time of day."""
    text = f"{dice.number(0, 23):02d}:{dice.number(0, 59):02d}"
    return decal("display", pictures.words(text, look.lit, (12, 14, 16), 4, 2), width, place)


def keys(dice: Dice, look: Finish, size: tuple[float, float], place: tuple[float, float, float],
         rows: int) -> Shape:
    """A field of printed or pressed buttons."""
    digits = [["1", "2", "3"], ["4", "5", "6"], ["7", "8", "9"], ["0"]]
    names = ["POP", "COOK", "DEF", "TIME", "AUTO", "FISH", "SOUP", "RICE", "WARM", "GRILL", "HI",
             "LO", "ECO", "TEA", "MENU", "KEEP"]
    order = dice.rng.permutation(len(names)).tolist()
    table: list[list[str]] = []
    if rows >= 6 or dice.chance(50):
        table += digits[:max(1, min(4, rows - 2))]
    while len(table) < rows:
        columns = dice.number(1, 3)
        table.append([names[order.pop()] for _ in range(columns)])
    if dice.chance(30):
        table.reverse()
    table[-1] = ["STOP", "START"] if dice.chance(70) else ["C", "OK"]
    paper = look.panel.color
    light = sum(paper) > 380
    button = dice.near((208, 208, 206) if light else (66, 68, 72), 14)
    image = pictures.keypad(table, look.ink, paper, button, dice.chance(35))
    return decal("keypad", image, size[0], place, size[1])


def handle(dice: Dice, look: Finish, length: float, upright: bool) -> tuple[tuple[Shape, ...],
                                                                           float]:
    """A handle about the origin, on a plane that faces the front, and how far it stands out."""
    style = dice.pick(("bar", "arch", "flat", "loop", "ledge"), (5, 3, 4, 3, 2))
    r = dice.length(0.005, 0.011)
    out = dice.length(0.026, 0.042)
    half = length / 2
    solids: list[Solid]
    if style == "bar":
        post = half * dice.pick((0.7, 0.8, 0.92))
        solids = [tube([[-half, 0, out], [half, 0, out]], r, [0, 1, 0], 12)]
        solids += [at(disc(r * 0.8, (0.0, out)), x=s * post) for s in (-1, 1)]
        reach = out + r
    elif style == "arch":
        angles = np.linspace(0.0, 180.0, 13)
        rise = np.minimum(1.0, sine(angles) * dice.pick((1.0, 1.4, 2.0)))
        path = np.column_stack([-half * cosine(angles), np.zeros(13), out * rise])
        solids = [tube(path, r, [0, 1, 0], 10, flat=dice.pick((1.0, 1.4)))]
        reach = out + r
    elif style == "flat":
        wide = dice.length(0.014, 0.026)
        solids = [at(slab(length, wide, (out - 0.004, out + 0.006), wide / 2, 0.003, 0.003))]
        solids += [at(slab(0.014, wide * 0.7, (0.0, out), 0.003), x=s * (half - 0.03))
                   for s in (-1, 1)]
        reach = out + 0.006
    elif style == "loop":
        c = min(0.02, half / 3, out * 0.8)
        turn = np.linspace(0.0, 90.0, 5)
        first = np.column_stack([-half + c * (1 - cosine(turn)), np.zeros(5),
                                 out - c + c * sine(turn)])
        path = np.vstack([[[-half, 0, 0]], first, first[::-1] * [-1, 1, 1], [[half, 0, 0]]])
        solids = [tube(path, r, [0, 1, 0], 10, flat=dice.pick((1.0, 1.5)))]
        reach = out + r
    else:
        reach = dice.length(0.018, 0.028)
        solids = [slab(length, dice.length(0.02, 0.034), (0.0, reach), 0.008, 0.006)]
    if upright:  # turned about z by a quarter
        turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float64)
        solids = [replace(s, vertices=s.vertices @ turn.T, normals=s.normals @ turn.T)
                  for s in solids]
    return (Shape("handle", joined(solids), look.handle),), reach


def door(dice: Dice, look: Finish, size: tuple[float, float, float],
         window: tuple[float, float, float, float] | None, screen: bool = False) -> list[Shape]:
    """A door about the origin, its back in the plane 0; size is width, height, thickness.

    `window` is x, y of its centre, its width and height; `screen` puts dots on the glass.
    """
    w, h, t = size
    r, edge = dice.length(0.002, 0.02), min(dice.length(0.002, 0.008), 0.4 * t)
    liner = Paint("liner", look.inside.color)
    seal = frame(w - 0.03, h - 0.03, (0, 0, w - 0.05, h - 0.05), (-0.004, 0.0), 0.012, 0.0, 0.008)
    shapes = [Shape("seal", seal, look.rubber)]
    pattern = pictures.dotted(look.glass.color, (70, 72, 76)) if screen else None
    glass = replace(look.glass, picture=pattern, tile=dice.length(0.03, 0.05)) if pattern \
        else look.glass
    style = dice.pick(("frame", "bezel", "sheet"), (4, 4, 4)) if window else "plain"
    if window is None:
        shapes += [Shape("door_panel", slab(w, h, (0.0, t), r, edge, edge), look.front),
                   Shape("liner", slab(w - 0.07, h - 0.07, (-0.006, 0.0), 0.02, 0.003), liner)]
        return shapes
    x, y, ww, wh = window
    corner = dice.pick((0.003, 0.012, 0.03, 0.3 * min(ww, wh)))
    panel = Paint("sheet", (20, 21, 23)) if style == "sheet" else look.front
    shapes += [
        Shape("door_panel", frame(w, h, window, (0.0, t), r, edge, corner), panel),
        Shape("window", at(slab(ww - 0.001, wh - 0.001, (0.3 * t, t - 0.0025), corner), x, y),
              glass)]
    if style == "bezel":
        wide = dice.length(0.006, 0.02)
        rim = frame(ww + 2 * wide, wh + 2 * wide, (0, 0, ww - 0.004, wh - 0.004),
                    (t - 0.002, t + 0.002), corner + wide, 0.0015, corner)
        shapes.append(Shape("bezel", at(rim, x, y), look.trim))
    if style == "sheet" and dice.chance(60):  # a coloured rail along an edge
        wide = dice.length(0.02, 0.045)
        rail = slab(w - 0.002, wide, (t - 0.003, t + 0.0015), 0.002)
        shapes.append(Shape("rail", at(rail, 0, dice.pick((-1, 1)) * (h / 2 - wide / 2 - 0.001)),
                            look.front))
    rim = frame(w - 0.07, h - 0.07, (x, y, ww, wh), (-0.006, 0.0), 0.02, 0.002, corner)
    if abs(x) + ww / 2 < w / 2 - 0.036 and abs(y) + wh / 2 < h / 2 - 0.036:
        shapes.append(Shape("liner", rim, liner))
    return shapes


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


def vents(dice: Dice, center: tuple[float, float, float], size: tuple[float, float], where: str,
          slots: int) -> Shape:
    """Dark slots in a row, on the side that looks `where`; size is along the row and across."""
    step = size[0] / slots
    one = picture(step * 0.5, size[1], LIFT)
    row = joined([at(one, (k - (slots - 1) / 2) * step) for k in range(slots)])
    row = replace(row, uv=None)
    return Shape("vents", at(facing(row, where) if where != "front" else row, *center),
                 Paint("slot", (24, 24, 26)))


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
