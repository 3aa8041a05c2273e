"""The files of one model, read within limits: what the readers of mesh formats are given."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..files import TEXTURES, Asset, AssetFinder, MissingAssetError, read_bounded
from ..model import TextureDecoder


@dataclass(frozen=True)
class MeshLimits:
    """The largest model that is read."""

    triangles: int = 5_000_000
    instances: int = 20_000
    """Pieces of meshes in one file."""
    total_bytes: int = 2**30
    """Of all files together."""


class AssetReader:
    """Reads the mesh and texture files of one model.

    Attributes:
        finder: Resolves references to files.
        limits: What all files together must not exceed.
        textures: Decodes all textures of the model.
        notes: Textures and other files that are missing or cannot be used, as keys.
    """

    def __init__(self, finder: AssetFinder, limits: MeshLimits | None = None) -> None:
        self.finder = finder
        self.limits = limits or MeshLimits()
        self.notes: dict[str, None] = {}
        self.textures = TextureDecoder()
        self._decoded: dict[Path, NDArray[np.uint8]] = {}
        self._bytes = 0

    def read(self, asset: Asset) -> bytes:
        """Return the bytes of a file.

        Raises:
            ModelError: If it cannot be read, or if all files together exceed the limit.
        """
        data = read_bounded(asset.path)
        self.count(len(data), str(asset.path))
        return data

    def count(self, size: int, name: str) -> None:
        """Count bytes that were read; raise ModelError if all together exceed the limit."""
        self._bytes += size
        if self._bytes > self.limits.total_bytes:
            raise ModelError(f"{name}: the model's files exceed {self.limits.total_bytes} bytes")

    def texture(self, reference: str) -> NDArray[np.uint8]:
        """Return the texture [h w 3|4] sRGB that a URDF names by `reference`.

        Raises:
            ModelError: If it is missing or cannot be read.
        """
        return self._decode(self.finder.find(reference, TEXTURES))

    def nested_texture(self, asset: Asset, reference: str) -> NDArray[np.uint8] | None:
        """Return the texture [h w 3|4] that a mesh file names; None and a note on failure."""
        try:
            return self._decode(self.finder.find_beside(asset, reference, TEXTURES))
        except ModelError as error:
            self.note_failure(asset, f"texture {last_part(reference)!r}", error)
            return None

    def note(self, text: str) -> None:
        """Record a note, once."""
        self.notes[text] = None

    def note_failure(self, asset: Asset, what: str, error: ModelError) -> None:
        """Note that something which a mesh file names is missing or cannot be used."""
        reason = "is missing" if isinstance(error, MissingAssetError) else "cannot be used"
        self.note(f"{asset.path.name}: {what} {reason}")

    def _decode(self, asset: Asset) -> NDArray[np.uint8]:
        if asset.path not in self._decoded:
            self._decoded[asset.path] = self.textures.decode(self.read(asset), str(asset.path))
        return self._decoded[asset.path]


@contextmanager
def file_errors(path: Path, kind: str) -> Generator[None]:
    """Raise a ModelError that names the file for every error, and silence the mesh libraries.

    Errors and notes report what their warnings and log lines would.
    """
    loggers = [logging.getLogger(name) for name in ("trimesh", "yourdfpy", "collada")]
    before = [logger.level for logger in loggers]
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            for logger in loggers:
                logger.setLevel(logging.CRITICAL + 1)  # holds for those below it, too
            yield
    except ModelError as error:
        text = str(error)
        raise type(error)(text if text.startswith(str(path)) else f"{path}: {text}") from error
    except (Exception, RecursionError) as error:
        raise ModelError(f"{path}: cannot be read as {kind} ({_explain(error)})") from error
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def _explain(error: BaseException) -> str:
    """Return what a library's error tells a user about a file, in one line."""
    if isinstance(error, MemoryError | RecursionError):
        return "it is too large or nested too deeply"
    text = " ".join(str(error).split())[:200]
    if not text or " at 0x" in text or isinstance(error, LookupError | TypeError | AttributeError):
        return "it is damaged or incomplete"
    return text


def last_part(reference: str) -> str:
    """Return the file name in a reference, which notes show without its folders."""
    return reference.replace("\\", "/").rsplit("/", 1)[-1][:80]
