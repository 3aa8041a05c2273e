"""OpenGL: the only sub-package that draws."""

from __future__ import annotations

from .context import device_names
from .rasterizer import Rasterizer
from .targets import NoRendererError

__all__ = ["NoRendererError", "Rasterizer", "device_names"]
