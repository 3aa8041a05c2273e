"""Chests of drawers: one to four rows, boards of wood or paint, and trays that slide out.

Drawers are listed in random order, as the first one is scored by default.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..model import JointType
from . import textures
from .doors import handle
from .finish import COLORS, Finish, Finishes, Shape, draw_finishes
from .fittings import Appliance, Part, center_appliance
from .shapes import Solid, Vector, disc, join, orient, shift, slab
from .textures import SeededRng

_WOODS = ((150, 104, 66), (196, 156, 110), (96, 66, 46), (214, 186, 146), (122, 78, 52))
_GAP = 0.003
"""m between a front and its neighbors."""


def chest_of_drawers(rng: SeededRng, number: int) -> Appliance:
    """Draw a chest of one to four rows of drawers in one or two columns."""
    look = draw_finishes(rng, ("white", "black", "slate", "cream", "red", "teal", "navy", "sage",
                              "graphite", "yellow"), (5, 2, 2, 3, 1, 2, 2, 2, 2, 1))
    body, front = _coats(rng, look)
    rows, columns = rng.choice((1, 2, 3, 4), (1, 3, 4, 2)), rng.choice((1, 2), (4, 1))
    w = rng.length(0.36, 0.62) * (1.0 if columns == 1 else 1.6)
    d, board, foot = rng.length(0.36, 0.52), rng.length(0.014, 0.024), rng.length(0.02, 0.14)
    heights = [rng.length(0.13, 0.26) for _ in range(rows)]
    inside_h, inside_w = sum(heights) + board * (rows - 1), w - 2 * board
    top = foot + inside_h + 2 * board
    t = rng.length(0.014, 0.022)
    shapes = _body(rng, (body, front), (w, d, board, foot), top, columns)
    cell_w = (inside_w - board * (columns - 1)) / columns
    y, cells = foot + board, list[_Cell]()
    for row, height in enumerate(heights):
        cells += [_Cell(-inside_w / 2 + cell_w / 2 + k * (cell_w + board), y + height / 2, height,
                        row + 1 == rows) for k in range(columns)]
        y += height
        if row + 1 < rows:  # a rail between two rows
            rail = slab(inside_w, board, (-d / 2 + 0.02, d / 2 - t - 0.002))
            shapes.append(Shape("rail", shift(rail, 0.0, y + board / 2), body))
            y += board
    style = _style(rng, look, front, (cell_w, board, d), t)
    parts = [Part("body", tuple(shapes))]
    for k in rng.generator.permutation(len(cells)).tolist():
        parts += _drawer(rng, style, len(parts), cells[k])
    return center_appliance("StorageFurniture", number, parts)


def _coats(rng: SeededRng, look: Finishes) -> tuple[Finish, Finish]:
    """The finishes of the body and of the fronts: veneer, or paint."""
    if not rng.chance(55):
        return look.body, look.front

    def veneer(role: str) -> Finish:
        tone = rng.near(rng.choice(_WOODS), 12)
        if not look.textured:
            return Finish(role, tone)
        return Finish(role, tone, tile=rng.length(0.3, 0.6),
                     image=textures.wood_grain(rng.generator, tone, rng.integer(2, 5)))

    body = veneer("body")
    kind = rng.choice(("same", "veneer", "paint"), (5, 2, 3))
    return body, replace(body, name="front") if kind == "same" else \
        veneer("front") if kind == "veneer" else look.front


def _body(
    rng: SeededRng, coats: tuple[Finish, Finish], size: tuple[float, float, float, float],
    top: float, columns: int,
) -> list[Shape]:
    """Boards around the drawers, and a plinth or legs; y is 0 at the ground."""
    w, d, board, foot = size
    high, middle, z = top - foot, (top + foot) / 2, (-d / 2, d / 2)
    boards = [shift(slab(board, high - board, z), s * (w - board) / 2, middle - board / 2)
              for s in (-1, 1)]
    boards.append(shift(slab(w - 2 * board, board, z), 0.0, foot + board / 2))
    back = slab(w - 2 * board, high - 2 * board, (-d / 2, -d / 2 + 0.006))
    boards.append(shift(back, 0.0, middle))
    if columns == 2:
        boards.append(shift(slab(board, high - 2 * board, (z[0] + 0.01, z[1] - 0.03)), 0.0, middle))
    over = rng.length(0.0, 0.03)
    plate = slab(w + 2 * over, d + over, (0.0, board), 0.004, rng.length(0.001, 0.006))
    shapes = [Shape("boards", join(boards), coats[0]),
              Shape("top", shift(orient(plate, "up"), 0.0, top - board, over / 2),
                    rng.choice((coats[0], coats[1]), (3, 1)))]
    if foot < 0.06:
        plinth = slab(w - 0.03, foot, (-d / 2 + 0.01, d / 2 - 0.03))
        return [*shapes, Shape("plinth", shift(plinth, 0.0, foot / 2), coats[0])]
    r = rng.length(0.014, 0.024)
    leg = orient(disc(r * 0.7, (0.0, foot), top=r), "up")
    legs = [shift(leg, sx * (w / 2 - 0.05), 0.0, sz * (d / 2 - 0.05))
            for sx in (-1, 1) for sz in (-1, 1)]
    return [*shapes, Shape("legs", join(legs), coats[0])]


@dataclass(frozen=True)
class _Cell:
    """The opening of a drawer; lengths in m."""

    x: float
    """Of the center."""
    y: float
    height: float
    top: bool
    """Whether it is in the top row, below the plate."""


@dataclass(frozen=True)
class _Style:
    """What the drawers of a chest have in common."""

    cell_w: float
    board: float
    depth: float
    """m, depth of the chest."""
    t: float
    """m, thickness of a front."""
    inset: bool
    """Whether the fronts are within the body, not before it."""
    front: Finish
    tray: Finish
    edge: float
    panelled: bool
    grips: tuple[Shape, ...]
    """Handles or knobs about the middle of a front."""


def _style(
    rng: SeededRng, look: Finishes, front: Finish, sizes: tuple[float, float, float], t: float
) -> _Style:
    cell_w, board, depth = sizes
    tray = rng.near(rng.choice(((206, 190, 164), (226, 226, 222), (150, 130, 104))), 10)
    grip = rng.choice(("handle", "knob", "groove"), (5, 3, 2))
    pair = rng.chance(30) and cell_w > 0.4
    places = (-0.25 * cell_w, 0.25 * cell_w) if pair else (0.0,)
    one: tuple[Shape, ...] = ()
    if grip == "handle":
        length = cell_w * rng.choice((0.25, 0.4, 0.6)) / len(places)
        one = (handle(rng, look, max(0.08, length)),)
    elif grip == "knob":
        r, out = rng.length(0.010, 0.018), rng.length(0.018, 0.03)
        solid = join([disc(r * 0.5, (0.0, out)), disc(r, (out - 0.008, out), 0.003)])
        one = (Shape("handle", solid, look.handle),)
    grips = tuple(replace(s, solid=shift(s.solid, x)) for s in one for x in places)
    return _Style(cell_w, board, depth, t, rng.chance(35), front, Finish("tray", tray),
                  rng.length(0.001, 0.005), rng.chance(25), grips)


def _drawer(rng: SeededRng, style: _Style, number: int, cell: _Cell) -> list[Part]:
    """A drawer, which is part `number`, and its grips."""
    w, t, x, y, h = style.cell_w, style.t, cell.x, cell.y, cell.height
    lap = -_GAP if style.inset else (style.board - _GAP) / 2  # over the boards around it
    low, high = y - h / 2 - lap, y + h / 2 + min(lap, -_GAP if cell.top else lap)
    fw, fh, middle = w + 2 * lap, high - low, (low + high) / 2
    back = style.depth / 2 - t - 0.0005 if style.inset else style.depth / 2 + 0.001
    plate = slab(fw, fh, (back, back + t), 0.002, style.edge)
    shapes, face = [Shape("drawer_front", shift(plate, x, middle), style.front)], back + t
    if style.panelled:
        raised = slab(fw - 0.08, fh - 0.06, (face - 0.001, face + 0.004), 0.002, 0.003)
        shapes.append(Shape("panel", shift(raised, x, middle), style.front))
        face += 0.004
    wide, deep = round(w - 0.026, 4), round(style.depth - 0.06 - t, 4)
    tall, floor = round(h * rng.integer(55, 80) / 100, 4), y - h / 2 + 0.012
    shapes.append(Shape("tray", join(_tray((wide, tall, deep), (x, floor, back))), style.tray))
    shapes += _contents(rng, (wide - 0.03, tall, deep - 0.03), (x, floor + 0.009, back - 0.015))
    place = (round(x, 5), round(y, 5), round(back, 5))
    link = Part("drawer", tuple(shapes), 0, JointType.PRISMATIC, place, (0.0, 0.0, 1.0),
                (0.0, round(rng.integer(70, 90) / 100 * deep, 3)))
    if not style.grips:
        return [link]
    placed = tuple(replace(s, solid=shift(s.solid, x, middle, face)) for s in style.grips)
    return [link, Part("handle", placed, number, origin=link.origin)]


def _tray(size: Vector, place: Vector) -> list[Solid]:
    """A box without a lid; `place` is the middle of the front edge of its floor."""
    (w, h, d), (x, y, z), wall = size, place, 0.010
    span = (z - d, z - 0.0005)
    middle = y + 0.004 + h / 2
    return [shift(slab(w, 0.008, span), x, y + 0.004),
            *(shift(slab(wall, h, span), x + s * (w - wall) / 2, middle) for s in (-1, 1)),
            shift(slab(w - 2 * wall, h, (z - d, z - d + wall)), x, middle)]


def _contents(rng: SeededRng, size: Vector, place: Vector) -> list[Shape]:
    """Folded textiles in a tray, in rows from its front."""
    (w, h, d), (x, y, z) = size, place
    out, used = list[Shape](), 0.0
    for k in range(rng.integer(0, 3)):
        deep, high = rng.length(0.05, 0.12), round(h * rng.integer(20, 75) / 100, 4)
        if used + deep > d:
            break
        wide = round(w * rng.integer(40, 95) / 100, 4)
        thing = slab(wide, high, (z - used - deep, z - used - 0.004), 0.008, 0.006, 0.006)
        tone = rng.near(COLORS[rng.choice(tuple(COLORS))], 20)
        side = rng.choice((-1, 0, 1)) * (w - wide) / 2
        out.append(Shape("thing", shift(thing, x + side, y + high / 2), Finish(f"thing{k}", tone)))
        used += deep
    return out
