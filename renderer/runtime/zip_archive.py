"""The members of a sequence, in a ZIP of stored members or in an unpacked folder.

Nothing is held open between two reads, so that an archive may be used by many processes and by
thousands at a time; a stored member is one seek away. Sizes are bounded by the file's own: what is
stored cannot inflate.
"""

from __future__ import annotations

import hashlib
import io
import stat
import struct
import sys
import zipfile
import zlib
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from ...errors import DatasetError
from ...robots.files import read_bounded
from .object_store import RangeFile, StoredObject, address, find_object, is_remote

MAX_MEMBER = 2**29
"""Bytes of a member; a larger one is refused."""
_MAX_DIRECTORY = 2**26
"""Bytes of the directory; 100,000 frames with all layers take 50 MB."""
EPOCH = (1980, 1, 1, 0, 0, 0)
"""The time of every member that we write: equal contents are equal bytes."""


@dataclass(frozen=True)
class _Entry:
    offset: int  # of the member's local header in the file
    size: int  # bytes
    crc: int


@dataclass(frozen=True)
class Archive:
    """Named members of one sequence."""

    path: Path
    """The ZIP file or folder."""
    entries: dict[str, _Entry] | None
    """Of a ZIP; None for a folder."""
    stored: StoredObject | None = None
    """The ZIP, if it is an object in object storage."""

    def where(self, member: str) -> str:
        """ "file: member", the beginning of an error message."""
        return f"{address(self.path)}: {member}"

    def require(self, members: Iterable[str]) -> None:
        """Raises DatasetError that names the first member that is missing."""
        for member in members:
            there = (
                member in self.entries
                if self.entries is not None
                else (self.path / member).is_file()
            )
            if not there:
                raise DatasetError(f"{self.where(member)}: missing")

    def digest(self) -> str:
        """Hash of the names, sizes and checksums of the members; only a folder's are read."""
        if self.entries is not None:
            members = [(name, e.size, e.crc) for name, e in self.entries.items()]
        else:
            files = {file.relative_to(self.path).as_posix(): file.read_bytes()
                     for file in self.path.rglob("*") if file.is_file()}
            members = [(name, len(data), zlib.crc32(data)) for name, data in files.items()]
        return hashlib.sha256(repr(sorted(members)).encode()).hexdigest()

    def read(self, member: str, limit: int = MAX_MEMBER) -> bytes:
        """The member's bytes. Raises DatasetError if missing, over `limit` bytes, or damaged."""
        self.require([member])
        try:
            if self.entries is None:
                file = (self.path / member).resolve()
                if not file.is_relative_to(self.path.resolve()):
                    raise DatasetError(f"{self.where(member)}: a link that leaves the folder")
                return read_bounded(file, limit, DatasetError)
            return self._read_entry(member, self.entries[member], limit)
        except OSError as error:
            raise DatasetError(f"{self.where(member)}: {error.strerror}") from error

    def _read_entry(self, member: str, entry: _Entry, limit: int) -> bytes:
        if entry.size > limit:
            raise DatasetError(f"{self.where(member)}: larger than {limit} bytes")
        # Usually one read: the name has its length in the directory, and there is no extra field.
        data = self._read_range(entry.offset, 30 + len(member.encode()) + entry.size)
        if len(data) >= 30 and data[:4] == b"PK\x03\x04":
            begin = 30 + sum(struct.unpack("<HH", data[26:30]))
            if (missing := begin + entry.size - len(data)) > 0:
                data += self._read_range(entry.offset + len(data), missing)
            data = data[begin : begin + entry.size]
            if len(data) == entry.size and zlib.crc32(data) == entry.crc:
                return data
        raise DatasetError(f"{self.where(member)}: damaged")

    def _read_range(self, start: int, size: int) -> bytes:
        if self.stored:
            return self.stored.read(start, start + size)
        with self.path.open("rb") as file:
            file.seek(start)
            return file.read(size)


class _BoundedReader(io.BufferedReader):
    """Refuses large reads: ZipFile reads as many bytes as the end record says."""

    limit: int

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > self.limit:
            raise zipfile.BadZipFile(f"its directory is larger than {self.limit} bytes")
        return super().read(size)


@contextmanager
def open_zip(
    stream: io.FileIO | io.BytesIO | RangeFile, limit: int = _MAX_DIRECTORY
) -> Generator[zipfile.ZipFile]:
    """Open a ZIP whose directory has at most `limit` bytes. Raises what ZipFile raises."""
    with _BoundedReader(stream) as bounded:  # pyright: ignore[reportArgumentType] # BytesIO is raw
        bounded.limit = limit
        with zipfile.ZipFile(bounded) as archive:
            bounded.limit = sys.maxsize  # members may be larger
            yield archive


def open_archive(path: Path) -> Archive:
    """The archive at `path`, a ZIP file or a folder, or a ZIP in object storage.

    Raises DatasetError if there is none, or if the ZIP is damaged or not of the contract's kind.
    """
    where, stored = address(path), None
    try:
        if is_remote(path):
            if (stored := find_object(path)) is None:
                raise DatasetError(f"{where}: is not there")
            source, size = RangeFile(stored), stored.size
        else:
            status = path.stat()
            if stat.S_ISDIR(status.st_mode):
                return Archive(path, None)
            if not stat.S_ISREG(status.st_mode):
                raise DatasetError(f"{path}: neither a ZIP file nor a folder")
            source, size = io.FileIO(path), status.st_size
        with open_zip(source) as file:
            members = file.infolist()
            end = 22 + len(file.comment)
            assert file.fp
            file.fp.seek(max(0, size - end))
            if not file.fp.read(end).startswith(b"PK\x05\x06"):
                # Of a file that is cut off, zipfile would open the last ZIP inside: state.npz.
                raise zipfile.BadZipFile("its end is missing")
    except OSError as error:
        raise DatasetError(f"{where}: {error.strerror or error}") from error
    except (zipfile.BadZipFile, NotImplementedError, ValueError, struct.error) as error:
        raise DatasetError(f"{where}: not a whole ZIP file ({error})") from error
    entries: dict[str, _Entry] = {}
    for info in members:
        if info.filename.endswith("/"):  # `is_dir` of Python 3.10 fails for an empty name
            continue
        _check_member(path, info, size, entries)
        entries[info.filename] = _Entry(info.header_offset, info.file_size, info.CRC)
    return Archive(path, entries, stored)


def _check_member(path: Path, info: zipfile.ZipInfo, size: int, seen: Iterable[str]) -> None:
    name = info.filename
    parts = PurePosixPath(name).parts
    where = f"{address(path)}: {name!r}"
    if not name or name.startswith("/") or "\\" in name or ".." in parts or not name.isprintable():
        raise DatasetError(f"{where}: not a name for a member")
    if name in seen:
        raise DatasetError(f"{where}: there twice")
    if info.flag_bits & 1:
        raise DatasetError(f"{where}: encrypted")
    if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
        raise DatasetError(f"{where}: compressed; members are stored (zip -0)")
    if info.header_offset < 0 or info.header_offset + info.file_size > size:
        raise DatasetError(f"{where}: larger than the file")


class ArchiveWriter:
    """Appends stored members with a fixed time to an open file."""

    def __init__(self, file: BinaryIO) -> None:
        self._zip = zipfile.ZipFile(file, "w", zipfile.ZIP_STORED)

    def add(self, member: str, data: bytes) -> None:
        """Append a member."""
        info = zipfile.ZipInfo(member, EPOCH)
        info.create_system = 3  # Unix, everywhere: the bytes do not depend on the platform
        info.external_attr = 0o644 << 16
        self._zip.writestr(info, data)

    def close(self) -> None:
        """Write the directory; the file stays open."""
        self._zip.close()
