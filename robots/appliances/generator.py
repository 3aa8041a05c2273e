"""Generated microwaves, dishwashers, ovens and drawers: an instance is a function of
(category, id).

They are written in the layout of PartNet-Mobility, in metres, into the cache, and read by the
same loader. Files are the same bytes on every machine.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..files import cache_folder, whole_folder
from .dishwasher import dishwasher
from .drawers import drawer
from .fittings import Appliance
from .microwave import microwave
from .oven import oven
from .partnet_export import write_partnet
from .textures import SeededRng

VERSION = 3
"""Of the generator; a change of any instance's bytes is a new one."""
CATEGORIES = ("microwave", "dishwasher", "oven")
"""Those of the paper: the suites have them, and flow networks learn on them."""
GENERATED = (*CATEGORIES, "drawer")
IDS: Mapping[str, range] = MappingProxyType({
    "test": range(100_000), "train": range(100_000, 1_000_000)})
"""By stream. They share none: what is learned on one is tested on other instances."""
LAST_ID = IDS["train"].stop - 1
APPLIANCE_SOURCE = f"gcbench appliance generator, version {VERSION}"
APPLIANCE_LICENCE = "MIT"

DESIGNS: dict[str, Callable[[SeededRng, int], Appliance]] = {
    "microwave": microwave, "dishwasher": dishwasher, "oven": oven, "drawer": drawer,
}


def appliance_folder(category: str, number: int) -> Path:
    """The folder of an instance in the cache, generated if it is not there (in about 0.1 s).

    Raises GcbenchError if the cache cannot be written. The category is one of GENERATED, the
    number 0 to LAST_ID.
    """
    target = cache_folder() / "appliances" / f"{category}-v{VERSION}" / f"{number:06d}"
    return whole_folder(
        target, f"{category}:{number}", lambda folder: write_appliance(category, number, folder))


def write_appliance(category: str, number: int, folder: Path) -> None:
    """Write the files of an instance into an empty folder."""
    rng = np.random.Generator(np.random.PCG64([zlib.crc32(category.encode()), number]))
    write_partnet(DESIGNS[category](SeededRng(rng), number), folder)
