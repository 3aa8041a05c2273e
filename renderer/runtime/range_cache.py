"""Ranges of objects that were read, in files on this machine; those not used for long are deleted.

A key names address, version and range, so that nothing in the cache is ever out of date.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ...errors import ConfigError
from ...robots.files import cache_folder, temporary_name

_DEFAULT = 4.0  # GiB
_VARIABLE = "GCBENCH_OBJECT_CACHE"
_written = 0  # bytes by this process since it deleted


def cached_range(key: str, size: int, load: Callable[[], bytes]) -> bytes:
    """Return the `size` bytes of a key; `load` them if the cache does not have them.

    The environment variable GCBENCH_OBJECT_CACHE is the size of the cache in GiB; 0: none.
    """
    global _written
    limit = _limit()
    if not limit:
        return load()
    name = hashlib.sha256(f"{key} {size}".encode()).hexdigest()
    folder = cache_folder() / "objects"
    path = folder / name[:2] / name
    with suppress(OSError):
        data = path.read_bytes()
        if len(data) == size:  # else the machine stopped while it was written
            os.utime(path)
            return data
    data = load()
    with suppress(OSError):  # a full disk: then without a cache
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_name(path)
        temporary.write_bytes(data)
        temporary.replace(path)
        _written += len(data)
        if _written > limit // 16:
            _written = 0
            delete_oldest(folder, limit - limit // 8)
    return data


def delete_oldest(folder: Path, limit: int) -> None:
    """Delete the files below a folder that were used least recently, until `limit` bytes stay."""
    files: list[tuple[float, int, Path]] = []
    for path in folder.glob("*/*"):
        with suppress(OSError):  # another process deletes, too
            stat = path.stat()
            files.append((stat.st_mtime, stat.st_size, path))
    size = sum(bytes_ for _, bytes_, _ in files)
    for _, bytes_, path in sorted(files):
        if size <= limit:
            break
        path.unlink(missing_ok=True)
        size -= bytes_


def _limit() -> int:
    """Bytes of the cache."""
    text = os.environ.get(_VARIABLE, "")
    try:
        size = float(text or _DEFAULT)
        if not 0 <= size < 1e6:
            raise ValueError
    except ValueError as error:
        raise ConfigError(f"{_VARIABLE}={text[:20]!a}: give a size in GiB, such as 4") from error
    return int(size * 2**30)
