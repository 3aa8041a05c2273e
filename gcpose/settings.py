"""All settings of GC-Pose: `--set rgbd.candidates=800` changes one for a run.

Each pipeline's record holds those of the sub-packages that it uses.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .numerics import SettingsRecord
from .rgbd import RgbdSettings


@dataclass(frozen=True)
class Settings(SettingsRecord):
    """The tuned numbers of `GCPose`."""

    rgbd: RgbdSettings = field(default_factory=RgbdSettings)
    """With depth."""
