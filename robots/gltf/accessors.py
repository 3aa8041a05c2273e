"""Range-checked access to the buffers, accessors and images of a glTF file."""

from __future__ import annotations

import base64
import binascii
import re
from dataclasses import dataclass
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..files import Asset, AssetFinder, MissingAssetError
from ..geometry import Array
from ..meshes import AssetReader
from .document import GltfDocument
from .records import Accessor, SparseIndices, SparseValues

MAX_TOTAL_NUMBERS = 2**26
"""Limit on the sum over all accessors of a file."""
_COMPONENTS = {5120: np.dtype("<i1"), 5121: np.dtype("<u1"), 5122: np.dtype("<i2"),
               5123: np.dtype("<u2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_ROWS = {"MAT2": 2, "MAT3": 3}  # matrix columns are aligned to 4 bytes


@dataclass(frozen=True)
class _Layout:
    """Layout of the elements in a buffer view."""

    dtype: np.dtype[np.generic]
    kind: str
    """Accessor type: SCALAR, VEC2, ... MAT4."""
    stride: int | None = None
    """Bytes between the starts of two elements; None for packed elements."""


class Accessors:
    """Decoder of the accessors and images of one document; reads only inside the asset's root."""

    def __init__(self, document: GltfDocument, asset: Asset, reader: AssetReader) -> None:
        self._gltf, self._binary, self._reader = document.gltf, document.binary, reader
        self._finder = AssetFinder(asset.path.parent, asset.root)
        self._buffers: dict[int, bytes] = {}
        self._arrays: dict[int, NDArray[np.generic]] = {}
        self._numbers = 0

    def kind(self, number: int) -> str:
        """Return the type of an accessor: SCALAR, VEC2, ... MAT4."""
        return self._gltf.accessors[number].type

    def count(self, number: int) -> int:
        return self._gltf.accessors[number].count

    def integers(self, number: int) -> NDArray[np.int64]:
        """Return an accessor of unsigned integers, [N] or [N width]; raise ModelError otherwise."""
        array = self._array(number)
        if array.dtype.kind != "u" or self._gltf.accessors[number].normalized:
            raise ModelError(f"accessors[{number}] should hold unsigned integers")
        return array.astype(np.int64)

    def floats(self, number: int, count: int | None = None) -> Array:
        """Return an accessor, [N] or [N width], or its first `count` entries; normalised integers
        are scaled to 0..1 or -1..1.
        """
        array = self._array(number)[:count]
        out = array.astype(np.float64)
        if array.dtype.kind == "f":
            if not np.isfinite(out).all():
                raise ModelError(f"accessors[{number}] holds a number that is not finite")
        elif self._gltf.accessors[number].normalized:
            out = np.maximum(out / np.iinfo(array.dtype.str).max, -1.0)
        return out

    def image(self, number: int) -> tuple[bytes, str]:
        """Return the bytes of an image file, and its name for messages."""
        image, name = self._gltf.images[number], f"images[{number}]"
        if image.buffer_view is not None:
            return bytes(self._view(image.buffer_view)), name
        if image.uri is None:
            raise ModelError(f"{name} has neither uri nor bufferView")
        return self._resource(image.uri, name), name

    def _array(self, number: int) -> NDArray[np.generic]:
        if number not in self._arrays:
            self._arrays[number] = self._decode_accessor(number)
        return self._arrays[number]

    def _decode_accessor(self, number: int) -> NDArray[np.generic]:
        accessor, where = self._gltf.accessors[number], f"accessors[{number}]"
        dtype, width, count = (_COMPONENTS[accessor.component_type], _WIDTHS[accessor.type],
                               accessor.count)
        self._numbers += count * width
        if self._numbers > MAX_TOTAL_NUMBERS:
            raise ModelError(f"has accessors of more than {MAX_TOTAL_NUMBERS} numbers")
        if accessor.buffer_view is None:
            array = np.zeros((count, width), dtype)
        else:
            stride = self._gltf.buffer_views[accessor.buffer_view].byte_stride
            array = self._elements(accessor, _Layout(dtype, accessor.type, stride), count, where)
        sparse = accessor.sparse
        if sparse is not None:
            if sparse.count > count:
                raise ModelError(f"{where} replaces {sparse.count} of {count} elements")
            at = self._elements(
                sparse.indices, _Layout(_COMPONENTS[sparse.indices.component_type], "SCALAR"),
                sparse.count, where).ravel().astype(np.int64)
            if at[-1] >= count or (np.diff(at) <= 0).any():
                raise ModelError(f"{where} has sparse indices that do not rise within its count")
            array = array.copy()
            array[at] = self._elements(
                sparse.values, _Layout(dtype, accessor.type), sparse.count, where)
        return array[:, 0] if width == 1 else array

    def _elements(
        self, place: Accessor | SparseIndices | SparseValues, layout: _Layout, count: int,
        where: str,
    ) -> NDArray[np.generic]:
        """Return [count width] elements at the buffer view and offset of `place`."""
        view, offset = place.buffer_view or 0, place.byte_offset
        width, size = _WIDTHS[layout.kind], layout.dtype.itemsize
        rows = _ROWS.get(layout.kind, width)
        column = -(-rows * size // 4) * 4 if layout.kind in _ROWS else rows * size
        element = (width // rows) * column
        step = element if layout.stride is None else layout.stride
        data = self._view(view)
        end = offset + (count - 1) * step + element
        if step < element or end > len(data):
            raise ModelError(f"{where} needs {end} bytes, and bufferViews[{view}] has {len(data)}"
                             if step >= element else f"{where} has elements that overlap")
        shape, strides = (count, width // rows, rows), (step, column, size)
        return np.ndarray(shape, layout.dtype, data, offset, strides).reshape(count, width)

    def _view(self, number: int) -> memoryview:
        view = self._gltf.buffer_views[number]
        data, end = self._buffer(view.buffer), view.byte_offset + view.byte_length
        if end > len(data):
            raise ModelError(f"bufferViews[{number}] ends at byte {end}, and "
                             f"buffers[{view.buffer}] at {len(data)}")
        return memoryview(data)[view.byte_offset:end]

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            buffer, where = self._gltf.buffers[number], f"buffers[{number}]"
            if buffer.uri is not None:
                data = self._resource(buffer.uri, where)
            elif number == 0 and self._binary is not None:
                data = self._binary
            else:
                raise ModelError(f"{where} has no uri, and there is no binary chunk for it")
            if len(data) < buffer.byte_length:
                raise ModelError(f"{where} has {len(data)} bytes of {buffer.byte_length}")
            self._buffers[number] = data[:buffer.byte_length]
        return self._buffers[number]

    def _resource(self, uri: str, where: str) -> bytes:
        """Return the bytes of a data URI, or of a file in the model's folder or below it."""
        if uri[:5].lower() == "data:":
            data = _data_of_uri(uri, where)
            self._reader.count(len(data), where)
            return data
        try:
            name = f"./{uri}" if uri[:1].isspace() else uri  # "./" keeps a leading space
            return self._reader.read(self._finder.find(name, None))
        except MissingAssetError:
            raise
        except ModelError as error:
            raise ModelError(f"{where}: {error}; only files in the model's folder are read"
                             ) from error


def _data_of_uri(uri: str, where: str) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise ModelError(f"{where} has a data URI without data")
    if not head.lower().endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        text = re.sub(r"\s", "", body).replace("%3D", "=").rstrip("=")
        return base64.b64decode(text + "=" * (-len(text) % 4), validate=True)
    except (binascii.Error, ValueError) as error:
        raise ModelError(f"{where} has a data URI that is not base64 ({error})") from error
