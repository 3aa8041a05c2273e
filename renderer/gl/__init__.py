"""OpenGL: the only sub-package that draws."""

from __future__ import annotations

from .context import device_names, find_cuda_device
from .framebuffers import NoRendererError
from .rasterizer import Rasterizer

__all__ = ["NoRendererError", "Rasterizer", "device_names", "find_cuda_device"]
