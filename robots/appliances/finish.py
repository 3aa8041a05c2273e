"""Colours and coats that go together on one appliance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from . import textures as pictures
from .shapes import Solid, at, picture
from .textures import Color, Dice, Picture


@dataclass(frozen=True)
class Paint:
    """What a surface looks like."""

    name: str
    color: Color
    opacity: float = 1.0
    picture: Picture | None = None
    tile: float = 0.3
    """m: side of the picture where the solid has no texture coordinates of its own."""


@dataclass(frozen=True)
class Shape:
    """A piece of a link, in the object's frame with every joint at zero."""

    name: str
    solid: Solid
    paint: Paint


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


LIFT = 0.0006
"""m that a decal lies before its surface."""


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
