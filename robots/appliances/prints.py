"""What is printed on appliances: names, displays, keys."""

from __future__ import annotations

from collections.abc import Sequence

from . import textures as pictures
from .finish import Finish
from .partnet_export import Paint, Shape
from .sampling import Dice
from .shapes import at, picture

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
