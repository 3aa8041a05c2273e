"""Microwaves, dishwashers, ovens, chests of drawers: sizes, joints, details, drawn from dice.

Sizes are those of the products (metres). The front of the body is the plane z = depth / 2; y is 0
at the ground here, and the object is centred at the end.
"""

from __future__ import annotations

from collections.abc import Callable

from .appliance_dice import Dice
from .appliance_dishwasher import dishwasher
from .appliance_drawer import drawer
from .appliance_microwave import microwave
from .appliance_oven import oven
from .partnet_files import Thing

DESIGNS: dict[str, Callable[[Dice, int], Thing]] = {
    "microwave": microwave, "dishwasher": dishwasher, "oven": oven, "drawer": drawer,
}
