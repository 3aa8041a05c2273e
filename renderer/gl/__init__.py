"""OpenGL: the only sub-package that draws."""

from __future__ import annotations

from .context import device_names
from .devices import DEVICE_VARIABLE
from .framebuffers import NoRendererError
from .rasterizer import Rasterizer

__all__ = ["DEVICE_VARIABLE", "NoRendererError", "Rasterizer", "device_names"]
