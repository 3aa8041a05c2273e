"""URDF files and PartNet-Mobility folders as articulated models."""

from __future__ import annotations

from .partnet import partnet_folder
from .reader import load_urdf

__all__ = ["load_urdf", "partnet_folder"]
