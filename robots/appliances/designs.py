"""Microwaves, dishwashers, ovens, chests of drawers: sizes, joints, details, drawn from dice.

Sizes are those of the products (metres). The front of the body is the plane z = depth / 2; y is 0
at the ground here, and the object is centred at the end.
"""

from __future__ import annotations

from collections.abc import Callable

from .dishwasher import dishwasher
from .drawers import drawer
from .microwave import microwave
from .oven import oven
from .partnet_export import Thing
from .sampling import Dice

DESIGNS: dict[str, Callable[[Dice, int], Thing]] = {
    "microwave": microwave, "dishwasher": dishwasher, "oven": oven, "drawer": drawer,
}
