"""Finishes of surfaces, the finishes that go together on an appliance, and printed details."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from . import textures
from .shapes import Solid, Vector, image_quad, shift
from .textures import Color, PaletteImage, SeededRng


@dataclass(frozen=True)
class Finish:
    """The finish of a surface."""

    name: str
    color: Color
    opacity: float = 1.0
    image: PaletteImage | None = None
    tile: float = 0.3
    """m, side of the image on a solid without texture coordinates."""


@dataclass(frozen=True)
class Shape:
    """A piece of a part, in the object's frame with every joint at zero."""

    name: str
    solid: Solid
    finish: Finish


@dataclass(frozen=True)
class Finishes:
    """The finishes of one appliance."""

    textured: bool
    body: Finish
    front: Finish
    """The door."""
    panel: Finish
    """The panel of the controls."""
    trim: Finish
    inside: Finish
    handle: Finish
    knob: Finish
    glass: Finish
    rubber: Finish
    ink: Color
    """Letters on the panel."""
    lit: Color
    """Letters on displays."""
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


def draw_finishes(rng: SeededRng, fronts: Sequence[str], weights: Sequence[int]) -> Finishes:
    """Draw finishes that go together; the colour of the front is one of `fronts`."""
    textured = rng.chance(50)
    front = rng.choice(fronts, weights)
    body = front if rng.chance(45) else rng.choice(("white", "black", "steel", "graphite"))
    panel = rng.choice((front, "black", "graphite", "steel", "white"), (5, 4, 1, 2, 1))
    paints = {role: _coat(rng, role, color, textured)
              for role, color in (("body", body), ("front", front), ("panel", panel))}
    dark_panel = sum(paints["panel"].color) < 380
    handle = rng.choice(("steel", front, "black", "bronze", "graphite"), (6, 3, 3, 1, 1))
    tone = rng.choice((14, 22, 34, 48))
    glass = Finish("glass", (tone, tone + rng.integer(0, 4), tone + rng.integer(0, 8)),
                  rng.choice((1.0, 0.9, 0.8, 0.7), (5, 2, 2, 2)))
    inside = rng.choice(((206, 206, 200), (150, 152, 154), (120, 122, 126), (226, 224, 214)))
    return Finishes(
        textured, paints["body"], paints["front"], paints["panel"],
        _coat(rng, "trim", rng.choice(("steel", "black", "graphite", body)), False),
        Finish("inside", rng.near(inside, 6)),
        _coat(rng, "handle", handle, False),
        _coat(rng, "knob", rng.choice(("black", "steel", "white", handle, front)), False), glass,
        Finish("rubber", (38, 38, 40)),
        (232, 232, 228) if dark_panel else (40, 40, 44),
        rng.choice(((90, 220, 235), (80, 235, 130), (250, 160, 60), (240, 240, 245),
                    (240, 80, 70))),
        rng.choice(_SOUNDS) + rng.choice(_ENDS))


def _coat(rng: SeededRng, role: str, color: str, textured: bool) -> Finish:
    tone = rng.near(COLORS[color], 9)
    if not textured:
        return Finish(role, tone)
    if color in ("steel", "slate", "bronze", "graphite"):
        image = textures.brushed_metal(rng.generator, tone, rng.integer(5, 12), rng.chance(60))
        return Finish(role, tone, image=image, tile=rng.length(0.15, 0.4))
    image = textures.speckled_enamel(rng.generator, tone, rng.integer(2, 5))
    return Finish(role, tone, image=image, tile=rng.length(0.12, 0.3))


DECAL_LIFT = 0.0006
"""m between a decal and its surface."""


def decal(name: str, image: PaletteImage, width: float, place: Vector,
          height: float | None = None) -> Shape:
    """Return an image on a plane that faces the front; without a height it is not stretched."""
    rows, columns = image.pixels.shape
    solid = image_quad(width, width * rows / columns if height is None else height, DECAL_LIFT)
    return Shape(name, shift(solid, *place), Finish(name, (255, 255, 255), image=image))


def label(rng: SeededRng, look: Finishes, size: tuple[float, float], on: Finish,
          place: Vector) -> Shape:
    """Draw the maker's name in a colour that contrasts with `on`, within a size in m."""
    width, height = size
    light = sum(on.color) > 380
    ink = rng.choice(((40, 40, 44), (120, 30, 34), (30, 50, 110)), (4, 1, 1)) if light else \
        rng.choice(((235, 235, 232), (200, 202, 205), (214, 176, 96)), (3, 2, 1))
    image = textures.text_image(look.brand, ink, on.color)
    rows, columns = image.pixels.shape
    return decal("logo", image, min(width, height * columns / rows), place)


def door_label(
    rng: SeededRng, look: Finishes, width: float, shapes: Sequence[Shape]
) -> list[Shape]:
    """Draw the maker's name below the window of a door of these shapes, if it fits."""
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
    sign = label(rng, look, (width, 0.75 * space), panel.finish, place)
    return [sign] if space > 0.014 else []


def clock_display(rng: SeededRng, look: Finishes, width: float, place: Vector) -> Shape:
    """Draw a display with the time of day."""
    text = f"{rng.integer(0, 23):02d}:{rng.integer(0, 59):02d}"
    return decal("display", textures.text_image(text, look.lit, (12, 14, 16), 4, 2), width, place)


def keypad(
    rng: SeededRng, look: Finishes, size: tuple[float, float], place: Vector, rows: int
) -> Shape:
    """Draw a field of printed buttons."""
    digits = [["1", "2", "3"], ["4", "5", "6"], ["7", "8", "9"], ["0"]]
    names = ["POP", "COOK", "DEF", "TIME", "AUTO", "FISH", "SOUP", "RICE", "WARM", "GRILL", "HI",
             "LO", "ECO", "TEA", "MENU", "KEEP"]
    order = rng.generator.permutation(len(names)).tolist()
    table: list[list[str]] = []
    if rows >= 6 or rng.chance(50):
        table += digits[:max(1, min(4, rows - 2))]
    while len(table) < rows:
        columns = rng.integer(1, 3)
        table.append([names[order.pop()] for _ in range(columns)])
    if rng.chance(30):
        table.reverse()
    table[-1] = ["STOP", "START"] if rng.chance(70) else ["C", "OK"]
    paper = look.panel.color
    light = sum(paper) > 380
    button = rng.near((208, 208, 206) if light else (66, 68, 72), 14)
    image = textures.keypad_image(table, look.ink, paper, button, rng.chance(35))
    return decal("keypad", image, size[0], place, size[1])
