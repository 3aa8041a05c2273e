"""Examine this machine: what renders, how fast, and what is missing."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shutil import which

import numpy as np

from .. import __version__
from ..errors import GcbenchError
from ..robots.catalog import CATALOG, is_local
from ..robots.files import cache_folder
from .runtime import cpu_count

PACKAGES = ("numpy", "opencv-python-headless", "zlib-ng", "scikit-robot-pyrender", "PyOpenGL",
            "trimesh", "yourdfpy", "python-fcl", "pygltflib")
EXTRAS = {"torch": "learn", "sapien": "sapien", "pycocotools": "export",
          "rerun-sdk": "export", "h5py": "export", "submitit": "cluster", "playwright": "test"}


@dataclass(frozen=True)
class Diagnosis:
    """The result of an examination."""

    sections: Mapping[str, tuple[str, ...]]
    """Lines of text by title."""
    ok: bool
    """Whether something renders."""

    @property
    def text(self) -> str:
        """The report for people."""
        head, *others = self.sections.items()
        return "\n".join([*head[1], *(line for title, lines in others for line in (
            "", title, *(f"  {line}" for line in lines)))])


def doctor() -> Diagnosis:
    """Check what renders on this machine, and look for packages and meshes.

    Tries every EGL device, and draws a frame on the one that is used.

    Returns:
        The report with `text`, and `ok` if something renders.

    Example:
        >>> gb.doctor().ok
        True
    """
    machine = (f"gcbench {__version__}, Python {platform.python_version()}, "
               f"{platform.system()} {platform.machine()}, {cpu_count()} cores")
    drawing = [*_devices()]
    try:
        drawing.append(f"ok    {_draw()}")
        ok = True
    except GcbenchError as error:
        drawing.append(f"FAIL  {error}")
        ok = False
    robots = [
        f"ok    {e.name}" if is_local(e)
        else f"later {e.name}: fetched on first use, or gcbench robots fetch {e.name}"
        for e in CATALOG
    ]
    browser = next((b for b in ("chromium", "chromium-browser", "google-chrome") if which(b)), None)
    return Diagnosis({
        "machine": (machine,),
        "rendering": tuple(drawing),
        "packages": tuple(_packages()),
        f"robots (meshes in {cache_folder()})": tuple(robots),
        "browser (for the tests of pages only)":
            (f"ok    {browser}" if browser else "none  apt-get install chromium",),
    }, ok)


def _devices() -> Iterator[str]:
    from .gl import NoRendererError, device_names

    try:
        yield from device_names()
    except NoRendererError as error:
        yield f"FAIL  {error}"


def _draw() -> str:
    """Draw a triangle with the real passes, check its depth, and time a frame."""
    from ..robots.model import ArticulatedModel, Link, TriangleSurface
    from .gl import NoRendererError, Rasterizer
    from .scene import rest
    from .types import Camera, intrinsics_from_fov

    points = np.array([[-1.0, -1, 2], [1, -1, 2], [0, 2, 2]])
    triangle = TriangleSurface(points, np.array([[0, 1, 2]]), np.tile([0.0, 0, -1], (3, 1)))
    model = ArticulatedModel.from_links("triangle", [Link("triangle", surfaces=(triangle,))])
    camera = Camera(640, 480, intrinsics_from_fov(640, 480, 1.0), np.eye(4))
    started = time.perf_counter()
    rasterizer = Rasterizer(640, 480)
    try:
        drawn = rasterizer.draw_truth(rest(model), camera)
        depth, part = drawn.depth[240, 320], drawn.part[240, 320]
        if not (abs(depth - 2.0) < 1e-5 and part == 1):
            raise NoRendererError(f"the driver draws wrong depth ({depth} m instead of 2)")
        seconds = time.perf_counter() - started
        context = rasterizer.context
        return (f"drew and checked a frame in {seconds:.2f} s on device {context.device}: "
                f"{context.renderer}, OpenGL {context.version}")
    finally:
        rasterizer.close()


def _packages() -> Iterator[str]:
    for name in PACKAGES:
        try:
            yield f"ok    {name} {version(name)}"
        except PackageNotFoundError:
            yield f"FAIL  {name}: {Path(sys.executable).name} -m pip install {name}"
    for name, extra in EXTRAS.items():
        try:
            yield f"ok    {name} {version(name)}"
        except PackageNotFoundError:
            yield (f"none  {name}: {Path(sys.executable).name} -m pip install {name}, if you want "
                   f"it (in a checkout, '.[{extra}]' has all of its kind)")
