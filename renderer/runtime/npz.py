"""NPY and NPZ files of untrusted origin: bounded, without pickle, checked before allocation."""

from __future__ import annotations

import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from .zip_archive import open_zip

_HEADER = 4096  # bytes that a header may take
_DIRECTORY = 2**24  # bytes: two arrays of each of 90,000 sequences
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_KINDS = {"b": "booleans", "i": "integers", "u": "integers", "f": "real numbers", "U": "a text"}


ANY_SIZE = -1
"""In `ArraySpec.shape`: a dimension that the file decides."""
_LARGEST = 2**26  # bytes of an array with such a dimension


@dataclass(frozen=True)
class ArraySpec:
    """What an array must be."""

    shape: tuple[int, ...]
    kinds: str = "biuf"
    """Kinds of its dtype, as in `numpy.dtype.kind`."""
    item_bytes: int = 8
    """Largest size of an item."""

    @property
    def max_bytes(self) -> int:
        """Bytes of the largest NPY file of such an array."""
        known = math.prod(self.shape) * self.item_bytes
        return (_LARGEST if ANY_SIZE in self.shape else known) + _HEADER

    def fits(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> bool:
        """Whether an array of this shape and type is what it must be."""
        sizes = tuple(ANY_SIZE if n == ANY_SIZE else size
                      for n, size in zip(self.shape, shape, strict=False))
        return (len(shape) == len(self.shape) and sizes == self.shape
                and dtype.kind in self.kinds and dtype.itemsize <= self.item_bytes)

    def __str__(self) -> str:
        words = " or ".join(dict.fromkeys(_KINDS[kind] for kind in reversed(self.kinds)))
        sizes = ", ".join("any" if n == ANY_SIZE else str(n) for n in self.shape)
        return f"{words} [{sizes}]"


def parse_npy(data: bytes, spec: ArraySpec, where: str) -> NDArray[Any]:
    """Return the array in the bytes of an NPY file.

    Raises:
        DatasetError: beginning with `where`, if the header is damaged, or if the array is not what
            `spec` says, before anything of its declared size is allocated.
    """
    stream = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            version = np.lib.format.read_magic(stream)
            read = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, fortran_order, dtype = read(stream)
    except Exception as error:  # hostile headers make NumPy raise errors of a dozen kinds
        raise DatasetError(f"{where} is damaged: its NPY header cannot be read") from error
    if not spec.fits(shape, dtype):
        found = f"{dtype} {list(shape)}"
        raise DatasetError(f"{where} is {found[:60]}, expected {spec}")
    if math.prod(shape) * dtype.itemsize != len(data) - stream.tell():
        raise DatasetError(f"{where} is damaged: its NPY header does not fit its data")
    flat = np.frombuffer(data, dtype, offset=stream.tell()) if dtype.itemsize else \
        np.zeros(math.prod(shape), dtype)
    return flat.reshape(shape, order="F" if fortran_order else "C").copy()


def parse_npz(
    data: bytes, specs: Mapping[str, ArraySpec], where: str, only_known: bool = False,
    stored: bool = False,
) -> dict[str, NDArray[Any]]:
    """Return those arrays of an NPZ file that `specs` names; the result lacks missing ones.

    Args:
        data: The file.
        specs: What each array must be, by name.
        where: Beginning of an error message.
        only_known: Refuse other arrays. They are ignored otherwise.
        stored: Refuse compressed arrays, so that the file is at least as large as its arrays.

    Raises:
        DatasetError: if the file is damaged, or an array is not what its spec says.
    """
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with open_zip(io.BytesIO(data), _DIRECTORY) as archive:
            for info in archive.infolist():
                name = info.filename.removesuffix(".npy")
                spec = specs.get(name)
                if spec is None:
                    if only_known:
                        known = ", ".join(list(specs)[:20])
                        raise DatasetError(f"{where}: unknown array {name[:60]!a}; known: {known}")
                    continue
                if info.compress_type not in _METHODS:
                    raise DatasetError(f"{where}: {name} is compressed by a method that NumPy "
                                       "does not use; write the file with numpy.savez_compressed")
                if name in arrays:
                    raise DatasetError(f"{where}: {name} is there twice")
                if stored and info.compress_type != zipfile.ZIP_STORED:
                    raise DatasetError(f"{where}: {name} is compressed; store it (numpy.savez)")
                with archive.open(info) as file:
                    member = file.read(spec.max_bytes + 1)
                if len(member) > spec.max_bytes:
                    raise DatasetError(f"{where}: {name} is larger than {spec}")
                arrays[name] = parse_npy(member, spec, f"{where}: {name}")
    except (
        zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError, EOFError,
        OSError, ValueError,
    ) as error:
        reason = " ".join(str(error).split())[:200]
        raise DatasetError(f"{where}: not a whole NPZ file ({reason})") from error
    return arrays


def dump_npy(array: NDArray[Any]) -> bytes:
    """Return the bytes of an NPY file: equal arrays are equal bytes."""
    stream = io.BytesIO()
    contiguous = np.asarray(array, order="C")
    np.lib.format.write_array(stream, contiguous, version=(1, 0), allow_pickle=False)
    return stream.getvalue()
