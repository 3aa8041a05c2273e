"""Resolution of the mesh and texture paths of a model, confined to its asset root.

Models are untrusted input. The rule: a reference is relative (or `package://`), its extension is
that of a mesh or a texture, and the file it leads to, symbolic links followed, lies inside one of
these folders:

* the root that the caller gives; without one, the package of the URDF, and without a package the
  folder of the URDF. The package is the nearest folder at or above it with a `package.xml`; else
  the nearest one that has the layout of a package: the URDF is below its folder `urdf` or `robots`,
  beside `meshes`. (The author of such a layout could as well add a `package.xml`.)
* for `package://NAME/...`, a folder called NAME at most three levels above the URDF, and those of
  NAME among the packages that the caller names and in ROS_PACKAGE_PATH.

A folder found above the URDF is never the root of the file system, the user's home or above it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

from ...errors import ModelError

MESHES = frozenset({".stl", ".obj", ".dae", ".ply", ".glb", ".gltf"})
TEXTURES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tga", ".tif", ".tiff", ".gif", ".webp"})
MATERIALS = frozenset({".mtl"})
_MAX_LEVELS = 3
_PACKAGE_LEVELS = 6
_MAX_REFERENCE = 1024


class MissingAssetError(ModelError):
    """A file that the model refers to does not exist; the message lists the places tried."""


class OutsideAssetError(ModelError):
    """A file that the model refers to is not in a folder that the model may read."""


@dataclass(frozen=True)
class Asset:
    """A file that may be read; files that it refers to must lie inside `root`."""

    path: Path
    root: Path


@dataclass(frozen=True)
class AssetFinder:
    """Resolves the file references of one model; all paths are absolute."""

    folder: Path
    root: Path
    packages: tuple[tuple[str, Path], ...] = ()

    def find(self, reference: str, suffixes: frozenset[str] | None = MESHES) -> Asset:
        """Return the file that a URDF names by `reference`; `suffixes` None admits any kind."""
        scheme, name = _split(reference)
        if suffixes is not None:
            _check_suffix(reference, name, suffixes)
        candidates = self._in_packages(name) if scheme == "package" else self._relative(name)
        return _first(reference, candidates)

    def root_for(self, references: Iterable[str]) -> Path | None:
        """Return the nearest folder above the URDF that, given as the root, has all the files."""
        known = [*dict.fromkeys(references)]
        if all(map(self.has, known)):
            return None
        roots = (replace(self, root=f) for f in _above(self.folder, _PACKAGE_LEVELS)
                 if f != self.root and self.root.is_relative_to(f))
        return next((f.root for f in roots if all(map(f.has, known))), None)

    def has(self, reference: str) -> bool:
        """Whether `find` finds a mesh."""
        try:
            return bool(self.find(reference))
        except ModelError:
            return False

    def find_beside(self, asset: Asset, reference: str, suffixes: frozenset[str]) -> Asset:
        """Return the file that a mesh file names by `reference`: beside it, or inside its root.

        Exporters write absolute paths of their author's machine into materials; only the last
        component of such a path is used, beside the mesh.
        """
        folder, name = asset.path.parent, reference.strip().replace("\\", "/")
        last = name.rsplit("/", 1)[-1]
        _check_suffix(reference, name, suffixes)
        relative = not re.match(r"[A-Za-z][A-Za-z0-9+.-]*:|/", name)
        names = ([name] if relative else []) + [last]
        return _first(reference, ((folder / n, asset.root) for n in _spellings(names)))

    def _relative(self, name: str) -> Iterator[tuple[Path, Path]]:
        # The folders above come second: some simulators give paths relative to a search path.
        for folder in self._upwards():
            for n in _spellings([name]):
                yield folder / n, self.root
        if name.startswith(f"{self.root.name}/"):
            yield self.root.parent / name, self.root

    def _in_packages(self, name: str) -> Iterator[tuple[Path, Path]]:
        package, _, rest = name.lstrip("/").partition("/")
        for n in _spellings([rest]) if rest else ():
            for known, folder in self.packages:
                if known == package:
                    yield folder / n, folder
            for folder in _ros_package_path():
                if folder.name == package:
                    yield folder / n, folder
                yield folder / package / n, folder / package
            for folder in _above(self.folder, _MAX_LEVELS):
                if folder.name == package:
                    yield folder / n, folder
        for folder in self._upwards():
            for n in _spellings([name.lstrip("/")]):
                yield folder / n, self.root
            for n in _spellings([rest]) if rest else ():
                yield folder / n, self.root

    def _upwards(self) -> Iterator[Path]:
        yield self.folder
        for folder in self.folder.parents:
            if not folder.is_relative_to(self.root):
                return
            yield folder


def asset_finder(
    urdf: Path, packages: Mapping[str, Path] | None = None, asset_root: Path | None = None
) -> AssetFinder:
    """Return the finder of the model at `urdf`; `packages` maps package names to folders.

    `asset_root` replaces the folder or package of the URDF.
    """
    folder = urdf.resolve().parent
    if asset_root is None:
        root = _default_root(folder)
    else:
        root = Path(asset_root).resolve()
        if not folder.is_relative_to(root):
            raise ModelError(f"{urdf}: is not inside {root}, the folder given by --root")
    known = tuple((name, Path(path).resolve()) for name, path in (packages or {}).items())
    return AssetFinder(folder, root, known)


def _default_root(folder: Path) -> Path:
    """Return the package of a folder, else the folder itself."""
    above = _above(folder, _PACKAGE_LEVELS)
    named = (f for f in above if (f / "package.xml").is_file())
    laid_out = (package for f, package in pairwise(above)
                if f.name in ("urdf", "robots") and (package / "meshes").is_dir())
    return next(named, None) or next(laid_out, folder)


def _above(folder: Path, levels: int) -> list[Path]:
    """Return a folder and those above it, without the user's home and what is above that."""
    home = Path.home().resolve()
    too_high = {Path(folder.anchor), home, *home.parents}
    return [f for f in [folder, *folder.parents][:levels + 1] if f not in too_high]


def _ros_package_path() -> list[Path]:
    entries = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    return [Path(entry).resolve() for entry in entries if entry]


def _split(reference: str) -> tuple[str, str]:
    """Scheme ("package" or "") and path of a reference in a URDF, refused where unsafe."""
    text = reference.strip().replace("\\", "/")
    if not text or len(text) > _MAX_REFERENCE or not text.isprintable():
        raise ModelError(f"file name {reference[:60]!r} is empty, too long or unprintable")
    match = re.match(r"([A-Za-z][A-Za-z0-9+.-]*):(//)?", text)
    scheme, name = (match[1].lower(), text[match.end():]) if match else ("", text)
    if scheme in ("package", "model"):
        return "package", name
    if scheme not in ("", "file") and len(scheme) > 1:
        raise ModelError(f"{reference!r} is a network or unknown address; only files are read")
    if len(scheme) == 1 or name.startswith(("/", "~")):
        raise ModelError(f"{reference!r} is an absolute path; write it relative or package://")
    return "", name


def _check_suffix(reference: str, name: str, suffixes: frozenset[str]) -> None:
    suffix = Path(name).suffix.lower()
    if suffix not in suffixes:
        known = " ".join(sorted(suffixes))
        raise ModelError(f"{reference!r} has extension {suffix!r}; what is read: {known}")


def _spellings(names: list[str]) -> list[str]:
    """Each name as it stands and with its %20s decoded."""
    return list(dict.fromkeys(s for n in names for s in (n, unquote(n))))


def _first(reference: str, candidates: Iterable[tuple[Path, Path]]) -> Asset:
    tried: dict[str, None] = {}
    outside: Path | None = None
    for path, root in candidates:
        try:
            real = path.resolve()
            if not real.is_relative_to(root):
                outside = root
            elif real.suffix.lower() != path.suffix.lower():
                continue  # a link from an innocent name to another kind of file
            elif real.is_file():
                return Asset(real, root)
        except (OSError, ValueError, RuntimeError):
            continue  # a name that no file can have, or a loop of links
        tried[os.path.normpath(path)] = None
    if outside is not None:
        raise OutsideAssetError(
            f"{reference!r} leads out of {outside}, the folder that the model may read")
    raise MissingAssetError(f"{reference!r} is missing; tried {', '.join(tried)}")
