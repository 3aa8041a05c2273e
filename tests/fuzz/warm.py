"""What the parent of all commands does once, so that a forked command need not do it again.

It imports modules, builds the parsers of the options, and reads the versions of the packages. A
command still parses its own arguments.
"""

from __future__ import annotations

import ctypes
import functools
import gc
import importlib
import importlib.metadata
import io
import re
from contextlib import redirect_stdout, suppress
from importlib.util import find_spec
from multiprocessing import resource_tracker
from pathlib import Path
from types import SimpleNamespace
from typing import Any

_LAZY = (
    "collada",
    "encodings.ascii",
    "encodings.cp437",
    "encodings.utf_8_sig",
    "faulthandler",
    "fcl",
    "mapbox_earcut",
    "multiprocessing.pool",
    "multiprocessing.popen_fork",
    "multiprocessing.synchronize",
    "numba",
    "OpenGL.arrays.ctypesarrays",
    "OpenGL.arrays.ctypesparameters",
    "OpenGL.arrays.ctypespointers",
    "OpenGL.arrays.lists",
    "OpenGL.arrays.numpymodule",
    "OpenGL.EGL",
    "OpenGL.GL.shaders",
    "pandas",
    "PIL.BmpImagePlugin",
    "PIL.GifImagePlugin",
    "PIL.Image",
    "PIL.JpegImagePlugin",
    "PIL.PngImagePlugin",
    "PIL.PpmImagePlugin",
    "pygltflib",
    "pyrender.platforms.egl",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse.csgraph",
    "scipy.spatial.transform",
    "trimesh",
    "trimesh.exchange.load",
    "trimesh.visual.material",
    "tyro",
    "xml.dom.minidom",
    "yourdfpy",
)
"""What commands import when they need it."""

_HUGE = 2**21  # bytes
_MADV_COLLAPSE = 25
_EXTRA = {"networks", "network_flow", "torch", "torch_dataset", "training", "rerun"}
"""Modules that need an extra, and much memory; their commands load them."""


def load_everything() -> None:
    """Import what commands import, and have their options parsed once."""
    import gcbench
    from gcbench.__main__ import COMMANDS, main

    # Modules that need PyTorch say so; without it, their commands do the same.
    missing = () if find_spec("torch") else (ModuleNotFoundError, gcbench.GcbenchError)
    root = Path(str(gcbench.__file__)).parent
    for path in sorted(root.glob("*/**/*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(["gcbench", *parts]).removesuffix(".__init__")
        if parts[0] in ("robots", "renderer", "gcpose", "benchmark") and not _EXTRA & {*parts}:
            with suppress(*missing):
                importlib.import_module(name)
    for name in _LAZY:
        importlib.import_module(name)
    metadata = importlib.metadata  # it reads the packages again for each question
    metadata.version = functools.cache(metadata.version)
    metadata.entry_points = functools.cache(metadata.entry_points)
    _remember_parsers()
    for command in (*COMMANDS, "render --randomize none"):
        with redirect_stdout(io.StringIO()), suppress(SystemExit):
            main([*command.split(), "--help"])
    resource_tracker.ensure_running()
    gc.freeze()
    _use_huge_pages()


def _use_huge_pages() -> None:
    """Collect the memory of this process in pages of 2 MiB where Linux can; a fork copies a table
    of pages, which takes half of the time then."""
    advise = getattr(ctypes.CDLL(None), "madvise", None)
    maps = Path("/proc/self/maps")
    if advise is None or not maps.exists():
        return
    for found in re.finditer(r"(?m)^(\w+)-(\w+) rw-p 0+ \S+ 0 ", maps.read_text()):
        first = -(-int(found[1], 16) // _HUGE) * _HUGE
        size = int(found[2], 16) // _HUGE * _HUGE - first
        if size > 0:
            advise(ctypes.c_void_p(first), ctypes.c_size_t(size), _MADV_COLLAPSE)


def _remember_parsers() -> None:
    """Have tyro build the parser of a command once, for each set of default values."""
    import tyro._cli as cli
    from gcbench.renderer.runtime import command_line

    parse, build = command_line._parse, cli._parsers.ParserSpecification.from_callable_or_type
    known: dict[tuple[str, str], Any] = {}
    key = ("", "")

    def remember_key(args: Any, name: str, target: Any, default: Any) -> Any:
        nonlocal key
        key = (name, repr(default))
        return parse(args, name, target, default)

    def remember_parser(*args: Any, **options: Any) -> Any:
        if key not in known:
            known[key] = build(*args, **options)
        return known[key]

    command_line._parse = remember_key
    cli._parsers = SimpleNamespace(  # type: ignore[assignment]
        ParserSpecification=SimpleNamespace(from_callable_or_type=remember_parser))
