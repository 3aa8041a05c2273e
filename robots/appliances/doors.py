"""Doors of appliances, and handles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from . import textures
from .finish import Finish, Finishes, Shape
from .fittings import Part
from .shapes import Hole, Solid, Vector, cosine, disc, frame, join, shift, sine, slab, tube
from .textures import SeededRng


def handle(rng: SeededRng, look: Finishes, length: float, upright: bool = False) -> Shape:
    """Draw a handle about the origin, on a plane that faces the front."""
    style = rng.choice(tuple(_HANDLES), (5, 3, 4, 3, 2))
    radius, out = rng.length(0.005, 0.011), rng.length(0.026, 0.042)
    solids = _HANDLES[style](rng, length / 2, radius, out)
    if upright:  # turned about z by a quarter
        turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float64)
        solids = [replace(s, vertices=s.vertices @ turn.T, normals=s.normals @ turn.T)
                  for s in solids]
    return Shape("handle", join(solids), look.handle)


def _bar(rng: SeededRng, half: float, r: float, out: float) -> list[Solid]:
    post = half * rng.choice((0.7, 0.8, 0.92))
    return [tube([[-half, 0, out], [half, 0, out]], r, [0, 1, 0], 12),
            *(shift(disc(r * 0.8, (0.0, out)), x=s * post) for s in (-1, 1))]


def _arch(rng: SeededRng, half: float, r: float, out: float) -> list[Solid]:
    angles = np.linspace(0.0, 180.0, 13)
    rise = np.minimum(1.0, sine(angles) * rng.choice((1.0, 1.4, 2.0)))
    path = np.column_stack([-half * cosine(angles), np.zeros(13), out * rise])
    return [tube(path, r, [0, 1, 0], 10, flat=rng.choice((1.0, 1.4)))]


def _flat(rng: SeededRng, half: float, r: float, out: float) -> list[Solid]:
    wide = rng.length(0.014, 0.026)
    return [slab(2 * half, wide, (out - 0.004, out + 0.006), wide / 2, 0.003, 0.003),
            *(shift(slab(0.014, wide * 0.7, (0.0, out), 0.003), x=s * (half - 0.03))
              for s in (-1, 1))]


def _loop(rng: SeededRng, half: float, r: float, out: float) -> list[Solid]:
    c = min(0.02, half / 3, out * 0.8)
    turn = np.linspace(0.0, 90.0, 5)
    first = np.column_stack([-half + c * (1 - cosine(turn)), np.zeros(5), out - c + c * sine(turn)])
    path = np.vstack([[[-half, 0, 0]], first, first[::-1] * [-1, 1, 1], [[half, 0, 0]]])
    return [tube(path, r, [0, 1, 0], 10, flat=rng.choice((1.0, 1.5)))]


def _ledge(rng: SeededRng, half: float, r: float, out: float) -> list[Solid]:
    reach = rng.length(0.018, 0.028)
    return [slab(2 * half, rng.length(0.02, 0.034), (0.0, reach), 0.008, 0.006)]


_HANDLES: Mapping[str, Callable[[SeededRng, float, float, float], list[Solid]]] = MappingProxyType(
    {"bar": _bar, "arch": _arch, "flat": _flat, "loop": _loop, "ledge": _ledge})
"""Solids of a handle along x, of half its length, the radius of its bar, and how far it stands
out, all in m."""


def door(
    rng: SeededRng, look: Finishes, size: Vector, window: Hole | None, screen: bool = False
) -> list[Shape]:
    """Draw a door about the origin, its back in the plane z = 0.

    Args:
        rng: Draws edges, corners and the style of the window.
        look: Finishes of the appliance.
        size: Width, height and thickness in m.
        window: The window. The radius of its corners is drawn here.
        screen: Whether the glass has the dots of a microwave's screen.
    """
    w, h, t = size
    r, edge = rng.length(0.002, 0.02), min(rng.length(0.002, 0.008), 0.4 * t)
    liner = Finish("liner", look.inside.color)
    seal = frame(w - 0.03, h - 0.03, Hole(0, 0, w - 0.05, h - 0.05, 0.008), (-0.004, 0.0), 0.012)
    shapes = [Shape("seal", seal, look.rubber)]
    pattern = textures.dot_pattern(look.glass.color, (70, 72, 76)) if screen else None
    glass = replace(look.glass, image=pattern, tile=rng.length(0.03, 0.05)) if pattern \
        else look.glass
    if window is None:
        return [*shapes, Shape("door_panel", slab(w, h, (0.0, t), r, edge, edge), look.front),
                Shape("liner", slab(w - 0.07, h - 0.07, (-0.006, 0.0), 0.02, 0.003), liner)]
    style = rng.choice(("frame", "bezel", "sheet"), (4, 4, 4))
    x, y, ww, wh = window.x, window.y, window.width, window.height
    corner = rng.choice((0.003, 0.012, 0.03, 0.3 * min(ww, wh)))
    window = replace(window, radius=corner)
    panel = Finish("sheet", (20, 21, 23)) if style == "sheet" else look.front
    shapes += [
        Shape("door_panel", frame(w, h, window, (0.0, t), r, edge), panel),
        Shape("window", shift(slab(ww - 0.001, wh - 0.001, (0.3 * t, t - 0.0025), corner), x, y),
              glass)]
    if style == "bezel":
        wide = rng.length(0.006, 0.02)
        rim = frame(ww + 2 * wide, wh + 2 * wide, Hole(0, 0, ww - 0.004, wh - 0.004, corner),
                    (t - 0.002, t + 0.002), corner + wide, 0.0015)
        shapes.append(Shape("bezel", shift(rim, x, y), look.trim))
    if style == "sheet" and rng.chance(60):  # a coloured rail along an edge
        wide = rng.length(0.02, 0.045)
        rail = slab(w - 0.002, wide, (t - 0.003, t + 0.0015), 0.002)
        level = rng.choice((-1, 1)) * (h / 2 - wide / 2 - 0.001)
        shapes.append(Shape("rail", shift(rail, 0, level), look.front))
    if abs(x) + ww / 2 < w / 2 - 0.038 and abs(y) + wh / 2 < h / 2 - 0.038:
        rim = frame(w - 0.07, h - 0.07, window, (-0.006, 0.0), 0.02, 0.002)
        shapes.append(Shape("liner", rim, liner))
    return shapes


def door_handle(
    rng: SeededRng, look: Finishes, length: float, place: Vector, leaf: Part, upright: bool = False
) -> Part:
    """Draw a handle that is fixed to a door `leaf`, which is part 1."""
    shape = handle(rng, look, length, upright)
    return Part("handle", (replace(shape, solid=shift(shape.solid, *place)),), 1,
                origin=leaf.origin)
