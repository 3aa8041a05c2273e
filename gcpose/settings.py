"""All settings of GC-Pose: `--set rgbd.candidates=800` changes one for a run.

Each pipeline's record holds those of the sub-packages that it uses.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .fusion import FusionSettings
from .images import ImageSettings
from .numerics import SettingsRecord
from .rgb import RgbSettings
from .rgbd import RgbdSettings


@dataclass(frozen=True)
class Settings(SettingsRecord):
    """The tuned numbers of `GCPose`."""

    rgbd: RgbdSettings = field(default_factory=RgbdSettings)
    """With depth."""
    rgb: RgbSettings = field(default_factory=RgbSettings)
    """On plain video."""
    fusion: FusionSettings = field(default_factory=FusionSettings)
    """With noisy depth and images at once."""
    images: ImageSettings = field(default_factory=ImageSettings)
    """Of what is measured in images, for both."""
