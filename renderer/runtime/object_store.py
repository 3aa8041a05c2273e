"""Files in object storage, `s3://bucket/path` and the like: listed, read by ranges, written whole.

A path keeps an address: `Path("s3://bucket/data")` is s3:/bucket/data, so that names are made of it
as of any path. The functions here take both kinds of paths; no other module uses object storage.
fsspec does the work. It is an extra, and is imported when an address is used.
"""

from __future__ import annotations

import io
import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from ...errors import ConfigError, DatasetError, GcbenchError, StorageError
from ...robots.files import create_atomically, read_bounded, write_atomically
from .range_cache import cached_range

_PACKAGES = {"s3:": "'.[cloud]'", "gs:": "gcsfs", "az:": "adlfs"}
"""What to install for each kind of address."""
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")
_OPTIONS: dict[str, dict[str, Any]] = {"s3:": {"config_kwargs": {
    "connect_timeout": 5, "read_timeout": 15, "retries": {"max_attempts": 0}}}}
"""Arguments of the file systems. Attempts are made here, not there."""
_WAITS = (0.5, 1.0, 2.0, 4.0, 8.0, 8.0)
"""s before another attempt: a server that starts again in time goes unnoticed."""
_PATIENCE = 25.0
"""s after which there is no other attempt."""
_outages: dict[str, float] = {}
"""When a call to a kind of storage gave up last."""
_UPLOAD_SECONDS, _UPLOAD_RATE = 20.0, 2**16
"""An attempt to upload ends after so many s, and 1 s more for each so many bytes."""
_CREDENTIALS = ("NoCredentialsError", "PartialCredentialsError", "CredentialRetrievalError",
                "ProfileNotFound", "TokenRetrievalError", "NoAuthTokenError", "RefreshError",
                "DefaultCredentialsError", "ClientAuthenticationError", "PermissionError")
_WRONG = ("ParamValidationError", "ValueError", "TypeError", "InvalidRegionError",
          "IsADirectoryError", "NotImplementedError")
"""Errors that another attempt does not change."""
_TAIL = 2**16
"""Bytes at the end of an object that are read at once: the directory of a usual ZIP."""
_Answer = TypeVar("_Answer")


def is_remote(path: Path) -> bool:
    """Whether a path is an address in object storage."""
    return next(iter(path.parts), "") in _PACKAGES


def refuse_other_addresses(path: Path) -> None:
    """Raise ConfigError if a path is an address, but not in object storage that gcbench knows."""
    kind = next(iter(path.parts), "")
    if _SCHEME.fullmatch(kind) and not is_remote(path) and not path.exists():
        raise ConfigError(f"{address(path)}: no address that gcbench reads; there are "
                          f"{', '.join(f'{name}//' for name in _PACKAGES)} and paths of files")


def require_local(path: Path, option: str) -> None:
    """Raise ConfigError if a folder to write to, named by `option`, is an address."""
    refuse_other_addresses(path)
    if is_remote(path):
        raise ConfigError(f"{option} {address(path)}: only datasets can be in object storage; name "
                          "a folder, and copy it there afterwards")


def address(path: Path) -> str:
    """Return a path as a user writes it."""
    kind, *rest = path.parts or ("",)
    return f"{kind}//{'/'.join(rest)}" if _SCHEME.fullmatch(kind) else str(path)


@dataclass(frozen=True)
class StoredObject:
    """An object, as it was when it was found."""

    path: Path
    size: int
    """bytes"""
    version: str
    """Another one if the content is another."""

    def read(self, start: int, stop: int) -> bytes:
        """Return the bytes from `start` to `stop`; a local cache keeps them."""
        def load() -> bytes:
            found = _call(self.path, lambda files, key: files.cat_file(key, start=start, end=stop))
            if len(found) != stop - start:
                raise DatasetError(f"{address(self.path)}: changed while it was read")
            return found

        stop = min(stop, self.size)
        if start >= stop:
            return b""
        return cached_range(f"{address(self.path)} {self.version} {start}", stop - start, load)


def find_object(path: Path) -> StoredObject | None:
    """Return the object at an address; None if there is none.

    Raises StorageError if the storage does not answer, or refuses.
    """
    try:
        found = _call(path, lambda files, key: files.info(key))
    except FileNotFoundError:
        return None
    if found["type"] != "file":
        return None
    versions = (found.get(k) for k in ("ETag", "etag", "LastModified", "mtime", "updated"))
    return StoredObject(path, int(found["size"]), str(next(filter(None, versions), "")))


def exists(path: Path) -> bool:
    """Whether a file or an object is there. Raises StorageError as `find_object`."""
    return find_object(path) is not None if is_remote(path) else path.exists()


def list_folder(folder: Path) -> list[Path]:
    """Return what is in a folder, sorted; nothing if there is no folder."""
    if not is_remote(folder):
        # comparing paths takes ten times as long as comparing names
        return sorted(folder.iterdir(), key=lambda path: path.name) if folder.is_dir() else []
    try:
        found = _call(folder, lambda files, key: files.ls(key, detail=False))
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(folder / key.rstrip("/").rpartition("/")[2] for key in found)


def read_file(path: Path, limit: int) -> bytes:
    """Return the bytes of a file or an object of at most `limit` bytes, or raise DatasetError."""
    if not is_remote(path):
        return read_bounded(path, limit, DatasetError)
    found = find_object(path)
    if found is None:
        raise DatasetError(f"{address(path)}: is not there")
    if found.size > limit:
        raise DatasetError(f"{address(path)}: is larger than {limit} bytes, the largest file that "
                           "is read")
    return found.read(0, found.size)


def store_file(path: Path, data: bytes, create: bool = False) -> bool:
    """Create or replace a file or an object, whole; with `create`, return False if it exists.

    Storage that cannot create exclusively may replace an object that another process creates in
    the same moment.
    """
    if not is_remote(path):
        if create:
            return create_atomically(path, data)
        write_atomically(path, data)
        return True
    mode = "create" if create else "overwrite"
    try:
        _write(path, len(data), lambda files, key, limit: files.pipe_file(
            key, data, mode=mode, **limit))
    except FileExistsError:  # perhaps by an attempt whose answer was lost
        found = find_object(path)
        return found is not None and found.size == len(data) and found.read(0, len(data)) == data
    return True


def upload_file(source: Path, target: Path) -> None:
    """Write a local file to an address, whole."""
    _write(target, source.stat().st_size, lambda files, key, limit: files.put_file(
        str(source), key, **limit))


def _write(path: Path, size: int, action: Callable[[Any, str, dict[str, float]], Any]) -> None:
    """Call `action(file system, key, time limit for so many bytes)`.

    The limits of `_OPTIONS` do not hold while a request is sent.
    """
    limit = {"timeout": _UPLOAD_SECONDS + size / _UPLOAD_RATE}
    try:
        _call(path, lambda files, key: action(files, key, limit if files.async_impl else {}))
    except FileNotFoundError as error:
        raise DatasetError(f"{address(path)}: there is no bucket {path.parts[1]!r}; create it, or "
                           "name another") from error


def _call(path: Path, action: Callable[[Any, str], _Answer]) -> _Answer:
    """Return `action(file system, key)`; where the storage does not answer, try again.

    If another call gives up meanwhile, or gave up shortly before, there is only one attempt: a
    command whose calls wait one after the other would take minutes to end.

    Raises FileNotFoundError, FileExistsError and NotADirectoryError of the action, and StorageError
    for everything else.
    """
    scheme, *names = path.parts
    if len(names) < 2:
        raise DatasetError(f"{address(path)}: give a bucket and a path, such as "
                           f"{scheme}//bucket/data")
    files, key = _file_system(scheme, os.getpid()), "/".join(names)
    began = time.monotonic()
    for wait in (*_WAITS, None):
        try:
            return action(files, key)
        except (FileNotFoundError, FileExistsError, NotADirectoryError, GcbenchError):
            raise
        except Exception as error:
            fault, now = _fault(error), time.monotonic()
            is_over = now - began > _PATIENCE or began - _outages.get(scheme, -1e9) < _PATIENCE
            if fault or wait is None or is_over:
                if not fault:
                    _outages[scheme] = now
                fault = fault or "does not answer; when it does, run the same command again"
                said = " ".join(str(error).split())[:200] or type(error).__name__
                raise StorageError(f"{address(path)}: the storage {fault} ({said})") from error
        time.sleep(wait)
    raise AssertionError("the last attempt returns or raises")


def _fault(error: Exception) -> str:
    """Return what is wrong, if another attempt does not change it."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    if kinds & {*_CREDENTIALS}:
        return ("gives no access: no credentials, or none with permission; set them, for example "
                "AWS_PROFILE, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY")
    return "cannot use this address or these settings" if kinds & {*_WRONG} else ""


@cache
def _file_system(scheme: str, process: int) -> Any:
    """The file system of a process for a kind of address."""
    try:
        import fsspec

        files = fsspec.filesystem(scheme[:-1], use_listings_cache=False, skip_instance_cache=True,
                                  **_OPTIONS.get(scheme, {}))
        if scheme == "s3:":
            _send_at_once(files)
    except ImportError as error:
        raise GcbenchError(f"{scheme}// needs {error.name or 'a package'}: pip install "
                           f"{_PACKAGES[scheme]}") from error
    files.retries = 1  # of s3fs
    return files


def _send_at_once(files: Any) -> None:
    """Let an S3 file system send data without leave: it waits for leave without a time limit."""
    from aiobotocore.session import AioSession
    from botocore.handlers import add_expect_header

    files.session = AioSession(**files.kwargs)  # as s3fs makes it later
    files.session.unregister("before-call.s3", add_expect_header)


class RangeFile(io.RawIOBase):
    """An object as a file to read; its end is read first, and at once."""

    def __init__(self, stored: StoredObject) -> None:
        self._stored, self._at = stored, 0
        self._tail_at = max(0, stored.size - _TAIL)
        self._tail = stored.read(self._tail_at, stored.size)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._stored.size}[whence]
        if base + offset < 0:
            raise OSError("a place before the beginning")
        self._at = base + offset
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        stop = min(self._at + len(view), self._stored.size)
        if self._at >= self._tail_at:
            data = self._tail[self._at - self._tail_at : max(0, stop - self._tail_at)]
        else:
            data = self._stored.read(self._at, stop)
        view[: len(data)] = data
        self._at += len(data)
        return len(data)
