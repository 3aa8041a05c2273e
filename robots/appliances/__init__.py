"""Generated microwaves, dishwashers, ovens and drawers: a number decides each to the byte."""

from __future__ import annotations

from .generator import (
    APPLIANCE_LICENCE,
    CATEGORIES,
    GENERATED,
    IDS,
    LAST_ID,
    appliance_folder,
    appliance_model,
    write_appliance,
)

__all__ = [
    "APPLIANCE_LICENCE", "CATEGORIES", "GENERATED", "IDS", "LAST_ID", "appliance_folder",
    "appliance_model", "write_appliance",
]
