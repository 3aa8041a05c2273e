"""The EGL devices of this machine, and the one that the user asks for."""

# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
from __future__ import annotations

import ctypes
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .framebuffers import NoRendererError

DEVICE_VARIABLE = "EGL_DEVICE_ID"
"""Environment variable that chooses a device, as `choose_devices` says."""
_EXTENSIONS, _CUDA_DEVICE = 0x3055, 0x323A  # of EGL's device queries
_SOFTWARE = re.compile("llvmpipe|softpipe|swrast|swiftshader|software", re.IGNORECASE)


@dataclass(frozen=True)
class EglDevice:
    """A device that EGL lists."""

    number: int
    handle: Any
    """pyrender's device"""
    file: str | None
    """Such as /dev/dri/card0; None for software, and for a GPU whose driver names no file"""
    is_software: bool
    cuda: int | None = None
    """The driver's number of the CUDA device"""
    pci: str | None = None
    """Such as 0000:65:00.0"""

    def describe(self) -> str:
        """Return its number, and everything by which it can be chosen."""
        names = [self.file or ("software (Mesa)" if self.is_software else "GPU")]
        names += [] if self.cuda is None else [f"cuda:{self.cuda}"]
        names += [self.pci] if self.pci else []
        return f"device {self.number}: {', '.join(names)}"


def choose_devices(devices: list[EglDevice], wanted: str) -> list[EglDevice]:
    """Return the devices that `wanted` means, in the order in which they are tried.

    It is a number of `gcbench doctor`, cuda:N, a PCI address, gpu (any), software, or "" for all.
    Raises NoRendererError if there is none.
    """
    address = re.compile(rf"(0+:)?{re.escape(wanted.lower())}")

    def is_meant(device: EglDevice) -> bool:
        return (wanted in ("", str(device.number), "software" if device.is_software else "gpu")
                or (device.cuda is not None and wanted == f"cuda:{device.cuda}")
                or (device.pci is not None and bool(address.fullmatch(device.pci))))

    if not (chosen := [device for device in devices if is_meant(device)]):
        there = "; ".join(device.describe() for device in devices)
        raise NoRendererError(
            f"no EGL device is {wanted[:40]!r}; there are: {there}. Give --device "
            f"(or {DEVICE_VARIABLE}) a number, cuda:N, a PCI address, gpu or software")
    return chosen


def is_drawn_by_software(renderer: str) -> bool:
    """Return whether OpenGL's name of a renderer is that of a software renderer."""
    return bool(_SOFTWARE.search(renderer))


def examine_device(egl: Any, number: int, device: Any) -> EglDevice:
    """Ask a device for its file, its CUDA device and its place on the bus.

    `egl` is pyrender's EGL platform.
    """
    handle, cuda = device._display, None
    extensions = (egl._eglQueryDeviceStringEXT(handle, _EXTENSIONS) or b"").split()
    if b"EGL_NV_device_cuda" in extensions:
        query = egl._get_egl_func("eglQueryDeviceAttribEXT", egl.egl.EGLBoolean)
        value = ctypes.c_ssize_t(-1)
        if query and query(handle, _CUDA_DEVICE, ctypes.byref(value)) and value.value >= 0:
            cuda = value.value
    place = Path("/sys/class/drm", Path(device.name or "").name, "device").resolve().name
    pci = place if re.fullmatch(r"[0-9a-f]{4,}:[0-9a-f]{2}:[0-9a-f]{2}\.[0-7]", place) else None
    is_software = b"EGL_MESA_device_software" in extensions or not (extensions or device.name)
    return EglDevice(number, device, device.name, is_software, cuda, pci)
