"""Mesh files (STL, OBJ, DAE, PLY, glTF) of untrusted models, as surfaces in metres."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..files import TEXTURES, Asset, AssetFinder, MissingAssetError
from ..files import read_file as read_bytes
from ..model import TriangleSurface, decode_texture

MAX_TRIANGLES = 5_000_000
MAX_TOTAL_BYTES = 2**30
MAX_INSTANCES = 20_000


class MeshLibrary:
    """Reads each mesh file of one model once; `notes` says what could not be had."""

    def __init__(self, finder: AssetFinder) -> None:
        self.finder = finder
        self.notes: dict[str, None] = {}
        self._surfaces: dict[Path, tuple[TriangleSurface, ...]] = {}
        self._textures: dict[Path, NDArray[np.uint8]] = {}
        self._bytes = 0

    def surfaces(self, reference: str) -> tuple[TriangleSurface, ...]:
        """The surfaces of the mesh that a URDF means by `reference`; raises ModelError."""
        asset = self.finder.find(reference)
        if asset.path not in self._surfaces:
            self._surfaces[asset.path] = self._load(asset)
        return self._surfaces[asset.path]

    def texture(self, reference: str) -> NDArray[np.uint8]:
        """The texture [h w 3|4] that a URDF means by `reference`; raises ModelError."""
        return self._decoded(self.finder.find(reference, TEXTURES))

    def nested_texture(self, asset: Asset, reference: str) -> NDArray[np.uint8] | None:
        """The texture that a mesh file means; one that cannot be had is noted, and None."""
        try:
            return self._decoded(self.finder.nested(asset, reference, TEXTURES))
        except ModelError as error:
            reason = "is missing" if isinstance(error, MissingAssetError) else "cannot be used"
            self.note(f"{asset.path.name}: texture {last_part(reference)!r} {reason}")
            return None

    def note(self, text: str) -> None:
        self.notes[text] = None

    def read(self, asset: Asset) -> bytes:
        data = read_bytes(asset.path)
        self._bytes += len(data)
        if self._bytes > MAX_TOTAL_BYTES:
            raise ModelError(f"{asset.path}: the model's files exceed {MAX_TOTAL_BYTES} bytes")
        return data

    def _decoded(self, asset: Asset) -> NDArray[np.uint8]:
        if asset.path not in self._textures:
            self._textures[asset.path] = decode_texture(self.read(asset), str(asset.path))
        return self._textures[asset.path]

    def _load(self, asset: Asset) -> tuple[TriangleSurface, ...]:
        data = self.read(asset)
        kind = asset.path.suffix.lower()
        if not data.strip():
            raise ModelError(f"{asset.path}: is empty")
        if data.startswith(b"version https://git-lfs"):
            raise ModelError(f"{asset.path}: is a Git LFS pointer; run `git lfs pull` there first")
        try:
            with quiet():
                if kind == ".dae":
                    from .collada import surfaces_of_dae

                    found = surfaces_of_dae(data, asset, self)
                else:
                    from .trimesh_reader import surfaces_of_trimesh

                    found = surfaces_of_trimesh(data, kind[1:], asset, self)
        except ModelError as error:
            raise ModelError(_named(asset.path, str(error))) from error
        except (Exception, RecursionError) as error:
            why = " ".join(str(error).split())[:200] or type(error).__name__
            raise ModelError(f"{asset.path}: is not a {kind} file that can be read ({why})"
                             ) from error
        if not found:
            raise ModelError(f"{asset.path}: holds no triangles")
        return tuple(found)


@contextmanager
def quiet() -> Generator[None]:
    """Without the warnings and log lines of mesh libraries: what matters is an error or a note."""
    loggers = [logging.getLogger(name) for name in ("trimesh", "yourdfpy.urdf", "collada")]
    before = [logger.disabled for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for logger in loggers:
                logger.disabled = True
            with np.errstate(all="ignore"):
                yield
        finally:
            for logger, disabled in zip(loggers, before, strict=True):
                logger.disabled = disabled


def last_part(reference: str) -> str:
    """The file name in a reference: what a note may say without telling folders."""
    return reference.replace("\\", "/").rsplit("/", 1)[-1][:80]


def _named(path: Path, text: str) -> str:
    return text if text.startswith(str(path)) else f"{path}: {text}"
