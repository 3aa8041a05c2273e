"""Colours and coats that go together on one appliance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from . import textures as pictures
from .partnet_export import Paint
from .sampling import Dice
from .textures import Color


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
