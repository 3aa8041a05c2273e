"""Hostile NPY, NPZ and ZIP files end in an error of one line; good ones come back to the bit."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gcbench.errors import DatasetError, GcbenchError
from gcbench.renderer.runtime import ArchiveWriter, ArraySpec, dump_npy, open_archive, parse_npz
from gcbench.renderer.runtime.npz import parse_npy
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

SPEC = ArraySpec((3, 2), "f")
GOOD = dump_npy(np.arange(6.0).reshape(3, 2))


def header(text: str, version: tuple[int, int] = (1, 0)) -> bytes:
    body = text.encode("latin-1") + b"\n"
    size = struct.pack("<H" if version == (1, 0) else "<I", len(body))
    return b"\x93NUMPY" + bytes(version) + size + body


def claim(descr: str = "'<f8'", shape: str = "(3, 2)", order: str = "False") -> str:
    return f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}}}"


@pytest.mark.parametrize(
    "text",
    [
        "", "((((", "(" * 5000, "{" * 5000, "9" * 400, claim(shape="9" * 400), "None", "[]", "{}",
        claim(shape=f"({'9' * 400}, 2)"), claim(shape="(-3, -2)"), claim(shape="(3.0, 2)"),
        claim(shape="3"), claim("'O'"), claim("'<f4'", "(10**9,)"), claim("[('a', '<f8')]"),
        claim("'<c16'"), claim("'<M8[s]'"), claim("'|V8'"), claim("'nonsense'"), claim("None"),
        claim("('<f8', (3,))"), claim("'<f16'"), claim(order="'yes'"), claim("'<i8'"),
        claim(shape="(3L, 2L)"), claim("__import__('os')"), "\x00", "\xff" * 50, "a" * 60_000,
    ],
)
def test_a_hostile_header_is_one_line(text: str) -> None:
    versions = [(1, 0), (2, 0), (3, 0), (9, 9)]
    for version in versions:
        with pytest.raises(DatasetError, match=r"^x: times ") as caught:
            parse_npy(header(text, version) + bytes(48), SPEC, "x: times")
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 200


def test_a_header_and_its_data_must_fit() -> None:
    for data in (GOOD[:-1], GOOD + b"x", GOOD[:20], b""):
        with pytest.raises(DatasetError, match="is damaged"):
            parse_npy(data, SPEC, "x")


dtypes = st.sampled_from(["<f8", ">f8", "<f4", "<i8", "<u2", "|u1", "|b1"])


@given(npst.arrays(dtypes, npst.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)),
       st.booleans())
def test_arrays_come_back_to_the_bit(array: Any, fortran: bool) -> None:
    stream = io.BytesIO()
    np.save(stream, np.array(array, order="F") if fortran else array)
    found = parse_npy(stream.getvalue(), ArraySpec(array.shape), "x")
    assert found.dtype == array.dtype and found.shape == array.shape
    assert found.tobytes() == array.tobytes()
    found[...] = 0  # a copy of its own


@given(st.data())
def test_mutated_bytes_are_right_or_refused(data: st.DataObject) -> None:
    mutated = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 4))):
        mutated[data.draw(st.integers(0, len(GOOD) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = parse_npy(bytes(mutated), SPEC, "x")
        assert found.shape == (3, 2) and found.dtype.kind == "f"
    except DatasetError as error:
        assert "\n" not in str(error)


# -- archives ---------------------------------------------------------------------------------


def npz(*members: tuple[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", compression) as file:
        for name, content in members:
            file.writestr(name, content)
    return out.getvalue()


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_npz_is_bounded_and_its_arrays_known() -> None:
    specs = {"a": SPEC}
    assert np.array_equal(parse_npz(npz(("a.npy", GOOD), ("b.npy", b"")), specs, "x")["a"],
                          np.arange(6.0).reshape(3, 2))
    assert parse_npz(npz(), specs, "x") == {}
    for data, message in (
        (npz(("a.npy", bytes(10**7))), "a is larger than"),
        (npz(("a.npy", GOOD), ("a.npy", GOOD)), "twice"),
        (npz(("a.npy", GOOD), ("b.npy", GOOD)), "unknown array 'b'"),
        (npz(("a.npy", GOOD))[:-30], "not a whole NPZ"),
    ):
        with pytest.raises(DatasetError, match=message):
            parse_npz(data, specs, "x", only_known=True)


@pytest.mark.parametrize(
    ("method", "message"),
    [(zipfile.ZIP_DEFLATED, "not a whole NPZ"), (zipfile.ZIP_LZMA, "compressed by a method"),
     (zipfile.ZIP_BZIP2, "compressed by a method")],
)
def test_a_damaged_compressed_array_is_one_line(method: int, message: str) -> None:
    """Decompressors raise errors of their own: zlib.error, LZMAError, struct.error."""
    whole = npz(("a.npy", GOOD), compression=method)
    for at in range(30 + len("a.npy"), 60):
        for value in (0, 255):
            data = whole[:at] + bytes([value]) + whole[at + 1:]
            if data != whole:
                with pytest.raises(DatasetError, match=message) as caught:
                    parse_npz(data, {"a": SPEC}, "x")
                assert "\n" not in str(caught.value)


def test_an_empty_name_is_refused(tmp_path: Path) -> None:
    """`zipfile` reads such a file, but writes none."""
    entry = struct.pack("<5H3I2H", 20, 0, 0, 0, 33, 0, 0, 0, 0, 0)
    directory = b"PK\x01\x02\x14\x00" + entry + bytes(14)
    data = b"PK\x03\x04" + entry + directory
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, len(directory), 30, 0)
    (tmp_path / "x.zip").write_bytes(data + end)
    assert zipfile.ZipFile(tmp_path / "x.zip").namelist() == [""]
    with pytest.raises(DatasetError, match="'': not a name for a member"):
        open_archive(tmp_path / "x.zip")


def test_a_large_directory_is_not_read(tmp_path: Path) -> None:
    """The end record says how large the directory is; a sparse file may hold what it says."""
    size = 2**26 + 1
    end = struct.pack("<4s4H2IH", b"PK\x05\x06", 0, 0, 1, 1, size, 0, 0)
    with (tmp_path / "x.zip").open("wb") as file:
        file.truncate(size)
        file.seek(size)
        file.write(end)
    with pytest.raises(DatasetError, match=f"directory is larger than {2**26} bytes"):
        open_archive(tmp_path / "x.zip")
    with pytest.raises(DatasetError, match=f"directory is larger than {2**24} bytes"):
        parse_npz(bytes(size) + end, {"a": SPEC}, "x")


@pytest.mark.parametrize("name", ["../a", "/a", "a\\b", "a\nb", "a\x1b[31m"])
def test_a_name_that_no_member_has_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "x.zip").write_bytes(npz((name, GOOD), compression=zipfile.ZIP_STORED))
    with pytest.raises(DatasetError, match="not a name for a member"):
        open_archive(tmp_path / "x.zip")


def archive_of(path: Path) -> Callable[[], dict[str, bytes]]:
    def read() -> dict[str, bytes]:
        archive = open_archive(path)
        return {name: archive.read(name) for name in archive.entries or {}}

    return read


@given(st.data())
def test_a_mutated_archive_is_right_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Each member has a checksum, so what is read is what was written."""
    members = {"a.png": b"first" * 9, "b/c.json": b"{}", "d": b""}
    stream = io.BytesIO()
    writer = ArchiveWriter(stream)
    for name, content in members.items():
        writer.add(name, content)
    writer.close()
    good = stream.getvalue()
    mutated = bytearray(good)
    for _ in range(data.draw(st.integers(1, 3))):
        mutated[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([len(good), len(good), len(good) - 1, 40]))
    path = tmp_path_factory.getbasetemp() / "mutated.zip"
    path.write_bytes(bytes(mutated[:cut]))
    try:
        found = archive_of(path)()
    except GcbenchError as error:
        assert "\n" not in str(error)
    else:
        assert set(found.values()) <= set(members.values())


@given(st.data())
def test_a_mutated_npz_is_right_or_refused(data: st.DataObject) -> None:
    mutated = bytearray(npz(("a.npy", GOOD)))
    for _ in range(data.draw(st.integers(1, 3))):
        mutated[data.draw(st.integers(0, len(mutated) - 1))] = data.draw(st.integers(0, 255))
    try:
        for array in parse_npz(bytes(mutated), {"a": SPEC}, "x").values():
            assert array.shape == (3, 2)
    except DatasetError as error:
        assert "\n" not in str(error)
