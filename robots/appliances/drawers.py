"""Chests of drawers: one to four rows, boards of wood or paint, and trays that slide out.

The first drawer of the list is the one that is scored unless told otherwise; it is any of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from . import textures as pictures
from .doors import handle
from .finish import COLORS, Finish, Paint, Shape, draw_finish
from .fittings import Link, Thing, centred
from .shapes import Solid, at, disc, facing, joined, slab
from .textures import Dice

_WOODS = ((150, 104, 66), (196, 156, 110), (96, 66, 46), (214, 186, 146), (122, 78, 52))
_GAP = 0.003
"""m between a front and its neighbours."""


def drawer(dice: Dice, number: int) -> Thing:
    """A chest of one to four rows of drawers in one or two columns."""
    look = draw_finish(dice, ("white", "black", "slate", "cream", "red", "teal", "navy", "sage",
                              "graphite", "yellow"), (5, 2, 2, 3, 1, 2, 2, 2, 2, 1))
    body, front = _coats(dice, look)
    rows, columns = dice.pick((1, 2, 3, 4), (1, 3, 4, 2)), dice.pick((1, 2), (4, 1))
    w = dice.length(0.36, 0.62) * (1.0 if columns == 1 else 1.6)
    d, board, foot = dice.length(0.36, 0.52), dice.length(0.014, 0.024), dice.length(0.02, 0.14)
    heights = [dice.length(0.13, 0.26) for _ in range(rows)]
    inside_h, inside_w = sum(heights) + board * (rows - 1), w - 2 * board
    top = foot + inside_h + 2 * board
    t = dice.length(0.014, 0.022)
    shapes = _body(dice, (body, front), (w, d, board, foot), top, columns)
    cell_w = (inside_w - board * (columns - 1)) / columns
    y, cells = foot + board, list[tuple[float, float, float, bool]]()
    for row, height in enumerate(heights):
        cells += [(-inside_w / 2 + cell_w / 2 + k * (cell_w + board), y + height / 2, height,
                   row + 1 == rows) for k in range(columns)]
        y += height
        if row + 1 < rows:  # a rail between two rows
            rail = slab(inside_w, board, (-d / 2 + 0.02, d / 2 - t - 0.002))
            shapes.append(Shape("rail", at(rail, 0.0, y + board / 2), body))
            y += board
    style = _style(dice, look, front, (cell_w, board, d), t)
    links = [Link("body", tuple(shapes))]
    for k in dice.rng.permutation(len(cells)).tolist():
        links += _drawer(dice, style, len(links), *cells[k])
    return centred("StorageFurniture", number, links)


def _coats(dice: Dice, look: Finish) -> tuple[Paint, Paint]:
    """Of the body and of the fronts: veneer, or the paints of the finish."""
    if not dice.chance(55):
        return look.body, look.front

    def veneer(role: str) -> Paint:
        tone = dice.near(dice.pick(_WOODS), 12)
        if not look.textured:
            return Paint(role, tone)
        return Paint(role, tone, tile=dice.length(0.3, 0.6),
                     picture=pictures.wood(dice.rng, tone, dice.number(2, 5)))

    body = veneer("body")
    kind = dice.pick(("same", "veneer", "paint"), (5, 2, 3))
    return body, replace(body, name="front") if kind == "same" else \
        veneer("front") if kind == "veneer" else look.front


def _body(
    dice: Dice, coats: tuple[Paint, Paint], size: tuple[float, float, float, float], top: float,
    columns: int,
) -> list[Shape]:
    """Boards around the drawers, and what the chest stands on; y is 0 at the ground."""
    w, d, board, foot = size
    high, middle, z = top - foot, (top + foot) / 2, (-d / 2, d / 2)
    boards = [at(slab(board, high - board, z), s * (w - board) / 2, middle - board / 2)
              for s in (-1, 1)]
    boards.append(at(slab(w - 2 * board, board, z), 0.0, foot + board / 2))
    boards.append(at(slab(w - 2 * board, high - 2 * board, (-d / 2, -d / 2 + 0.006)), 0.0, middle))
    if columns == 2:
        boards.append(at(slab(board, high - 2 * board, (z[0] + 0.01, z[1] - 0.03)), 0.0, middle))
    over = dice.length(0.0, 0.03)
    plate = slab(w + 2 * over, d + over, (0.0, board), 0.004, dice.length(0.001, 0.006))
    shapes = [Shape("boards", joined(boards), coats[0]),
              Shape("top", at(facing(plate, "up"), 0.0, top - board, over / 2),
                    dice.pick((coats[0], coats[1]), (3, 1)))]
    if foot < 0.06:
        plinth = slab(w - 0.03, foot, (-d / 2 + 0.01, d / 2 - 0.03))
        return [*shapes, Shape("plinth", at(plinth, 0.0, foot / 2), coats[0])]
    r = dice.length(0.014, 0.024)
    leg = facing(disc(r * 0.7, (0.0, foot), top=r), "up")
    legs = [at(leg, sx * (w / 2 - 0.05), 0.0, sz * (d / 2 - 0.05))
            for sx in (-1, 1) for sz in (-1, 1)]
    return [*shapes, Shape("legs", joined(legs), coats[0])]


@dataclass(frozen=True)
class _Style:
    """What the drawers of a chest have in common."""

    cell_w: float
    board: float
    depth: float
    """m, of the chest."""
    t: float
    """m, of a front."""
    inset: bool
    """The fronts are within the body, not before it."""
    front: Paint
    tray: Paint
    edge: float
    panelled: bool
    grips: tuple[Shape, ...]
    """About the middle of a front, on a plane that faces the front."""


def _style(
    dice: Dice, look: Finish, front: Paint, sizes: tuple[float, float, float], t: float
) -> _Style:
    cell_w, board, depth = sizes
    tray = dice.near(dice.pick(((206, 190, 164), (226, 226, 222), (150, 130, 104))), 10)
    grip = dice.pick(("handle", "knob", "groove"), (5, 3, 2))
    pair = dice.chance(30) and cell_w > 0.4
    spots = (-0.25 * cell_w, 0.25 * cell_w) if pair else (0.0,)
    one: tuple[Shape, ...] = ()
    if grip == "handle":
        length = cell_w * dice.pick((0.25, 0.4, 0.6)) / len(spots)
        one, _ = handle(dice, look, max(0.08, length), False)
    elif grip == "knob":
        r, out = dice.length(0.010, 0.018), dice.length(0.018, 0.03)
        solid = joined([disc(r * 0.5, (0.0, out)), disc(r, (out - 0.008, out), 0.003)])
        one = (Shape("handle", solid, look.handle),)
    grips = tuple(replace(s, solid=at(s.solid, x)) for s in one for x in spots)
    return _Style(cell_w, board, depth, t, dice.chance(35), front, Paint("tray", tray),
                  dice.length(0.001, 0.005), dice.chance(25), grips)


def _drawer(
    dice: Dice, style: _Style, number: int, x: float, y: float, h: float, top: bool
) -> list[Link]:
    """A drawer, link `number`, in an opening of height h about (x, y), and what is fixed to it;
    over the `top` row lies the plate."""
    w, t = style.cell_w, style.t
    lap = -_GAP if style.inset else (style.board - _GAP) / 2  # over the boards around it
    low, high = y - h / 2 - lap, y + h / 2 + min(lap, -_GAP if top else lap)
    fw, fh, middle = w + 2 * lap, high - low, (low + high) / 2
    back = style.depth / 2 - t - 0.0005 if style.inset else style.depth / 2 + 0.001
    plate = slab(fw, fh, (back, back + t), 0.002, style.edge)
    shapes, face = [Shape("drawer_front", at(plate, x, middle), style.front)], back + t
    if style.panelled:
        raised = slab(fw - 0.08, fh - 0.06, (face - 0.001, face + 0.004), 0.002, 0.003)
        shapes.append(Shape("panel", at(raised, x, middle), style.front))
        face += 0.004
    wide, deep = round(w - 0.026, 4), round(style.depth - 0.06 - t, 4)
    tall, floor = round(h * dice.number(55, 80) / 100, 4), y - h / 2 + 0.012
    shapes.append(Shape("tray", joined(_tray((wide, tall, deep), (x, floor, back))), style.tray))
    shapes += _contents(dice, (wide - 0.03, tall, deep - 0.03), (x, floor + 0.009, back - 0.015))
    link = Link("drawer", tuple(shapes), 0, "prismatic", (round(x, 5), round(y, 5), round(back, 5)),
                (0.0, 0.0, 1.0), (0.0, round(dice.number(70, 90) / 100 * deep, 3)))
    if not style.grips:
        return [link]
    placed = tuple(replace(s, solid=at(s.solid, x, middle, face)) for s in style.grips)
    return [link, Link("handle", placed, number, origin=link.origin)]


def _tray(size: tuple[float, float, float], place: tuple[float, float, float]) -> list[Solid]:
    """A box without a lid; `place` is the middle of its floor's front edge."""
    (w, h, d), (x, y, z), wall = size, place, 0.010
    span = (z - d, z - 0.0005)
    return [at(slab(w, 0.008, span), x, y + 0.004),
            *(at(slab(wall, h, span), x + s * (w - wall) / 2, y + 0.004 + h / 2) for s in (-1, 1)),
            at(slab(w - 2 * wall, h, (z - d, z - d + wall)), x, y + 0.004 + h / 2)]


def _contents(
    dice: Dice, size: tuple[float, float, float], place: tuple[float, float, float]
) -> list[Shape]:
    """Folded things that lie in a tray, in rows from its front."""
    (w, h, d), (x, y, z) = size, place
    out, used = list[Shape](), 0.0
    for k in range(dice.number(0, 3)):
        deep, high = dice.length(0.05, 0.12), round(h * dice.number(20, 75) / 100, 4)
        if used + deep > d:
            break
        wide = round(w * dice.number(40, 95) / 100, 4)
        thing = slab(wide, high, (z - used - deep, z - used - 0.004), 0.008, 0.006, 0.006)
        tone = dice.near(COLORS[dice.pick(tuple(COLORS))], 20)
        side = dice.pick((-1, 0, 1)) * (w - wide) / 2
        out.append(Shape("thing", at(thing, x + side, y + high / 2), Paint(f"thing{k}", tone)))
        used += deep
    return out
