"""Changes of files of bytes: any, PNG, NPY and ZIP."""

from __future__ import annotations

import io
import struct
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .rng import CaseRng


def change_bytes(rng: CaseRng, data: bytes, name: str) -> bytes:
    """Damage a file: cut, overwrite, insert, repeat."""
    out = bytearray(data)
    at = rng.randrange(len(out) + 1)
    head = rng.randrange(min(len(out), 128) + 1)
    how = rng.choice(["cut", "flip", "head", "insert", "remove", "repeat", "empty", "zero"])
    if how == "cut":
        del out[at:]
    elif how == "flip":
        for _ in range(rng.choice([1, 1, 4, 32])):
            if out:
                out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    elif how == "head":
        patch = rng.choice(
            [b"\xff" * 4, bytes(4), b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"(((("]
        )
        out[head : head + 4] = patch
    elif how == "insert":
        out[at:at] = rng.randbytes(rng.choice([1, 3, 64, 4096]))
    elif how == "remove":
        del out[at : at + rng.choice([1, 4, 100])]
    elif how == "repeat":
        out[at:at] = out[max(0, at - 64) : at] * rng.choice([1, 10, 100])
    elif how == "zero":
        n = rng.choice([1, 16, 1000])
        out[at : at + n] = bytes(len(out[at : at + n]))
    else:
        out = bytearray(
            rng.choice([b"", b"\n", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"{}", b"[]"])
        )
    rng.note(f"{name}: bytes {how} at {head if how == 'head' else at}")
    return bytes(out)


def png(width: int, height: int, channels: int = 3, value: int = 200) -> bytes:
    import cv2

    shape = (height, width) if channels == 1 else (height, width, channels)
    return bytes(cv2.imencode(".png", np.full(shape, value, np.uint8))[1])


def change_png(rng: CaseRng, data: bytes, name: str) -> bytes:
    """Damage a PNG, or change its header with a right checksum, so that a decoder goes on."""
    import zlib

    if rng.chance(0.3) or len(data) < 33:
        return change_bytes(rng, data, name)
    width, height, bits, color, *rest = struct.unpack(">IIBBBBB", data[16:29])
    how = rng.choice(["size", "bits", "color", "rest", "chunk", "other"])
    if how == "size":
        width, height = (
            rng.choice([0, 1, 2**16, 2**31 - 1, 2**32 - 1, width, 2 * width]) for _ in range(2)
        )
    elif how == "bits":
        bits = rng.choice([0, 1, 2, 4, 8, 16, 32])
    elif how == "color":
        color = rng.choice([0, 1, 2, 3, 4, 6, 7])
    elif how == "rest":
        rest[rng.randrange(3)] = rng.choice([0, 1, 2, 255])
    elif how == "other":
        rng.note(f"{name}: another PNG")
        return png(rng.choice([1, 7, 48]), rng.choice([1, 5, 36]), rng.choice([1, 3, 4]))
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, bits, color, *rest)
    out = data[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    if how == "chunk":
        kind = rng.choice([b"tRNS", b"PLTE", b"acTL", b"zTXt", b"iCCP", b"gAMA", b"IDAT", b"eXIf"])
        body = kind + rng.randbytes(rng.choice([0, 1, 6, 768]))
        out += struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    rng.note(f"{name}: PNG {how} {width}x{height} {bits} bit colour {color}")
    return out + data[33:]


# -- NPY and ZIP ----------------------------------------------------------------------------------


def npy(array: NDArray[Any]) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array), allow_pickle=True)
    return out.getvalue()


def change_array(rng: CaseRng, data: bytes, name: str) -> bytes:
    """Change the values, the shape, the type or the header of an NPY file."""
    how = rng.choice(["values", "values", "shape", "type", "header", "bytes"])
    if how == "bytes":
        return change_bytes(rng, data, name)
    array = np.load(io.BytesIO(data))
    if how == "values" and array.nbytes:  # a huge array of empty texts has none
        odd = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 0, -1, 1, 1e9, 2**31])
        with np.errstate(all="ignore"):
            flat = array.reshape(-1).copy()
            where = slice(None) if rng.chance(0.2) else rng.randrange(len(flat))
            if flat.dtype.kind != "f" and not np.isfinite(odd):
                odd = -7
            flat[where] = (
                np.float64(odd).astype(flat.dtype)
                if abs(odd) < 2**62
                else odd
                if flat.dtype.kind == "f"
                else 1
            )
        rng.note(f"{name}: value {odd}")
        return npy(flat.reshape(array.shape))
    if how == "shape":
        new = rng.choice(
            [
                array[:-1] if array.ndim else array,
                array.reshape(-1),
                array[None],
                array[..., None],
                array[:0] if array.ndim else array,
                np.zeros((0,)),
                np.zeros((3, 0, 2)),
            ]
        )
    elif how == "type":
        kind = rng.choice(
            ["?", "i1", "u8", "f2", "f4", ">f8", "c16", "S4", "U4", "O", "M8[s]", "V8", "g", "i8"]
        )
        with np.errstate(all="ignore"):
            new = (
                np.zeros(array.shape, kind)
                if kind in ("S4", "U4", "M8[s]", "V8", "O")
                else array.astype(kind)
            )
        rng.note(f"{name}: type {kind}")
    else:
        text = rng.choice(
            [
                "((((",
                "{'descr': '<f8', 'fortran_order': False, 'shape': (2**40,)}",
                "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999, 3), }",
                "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
                "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }",
                "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
                "{}",
                "[]",
                "0",
                "\xff",
                "{'descr': '<f8', 'fortran_order': True, 'shape': (), }",
                "(" * 3000,
                "__import__('os')",
                "{'descr': '<f8', 'fortran_order': 1, 'shape': (1,), }",
                "-" * 9000,
                "{'descr': '<V0', 'fortran_order': False, 'shape': (1000000000000,), }",
            ]
        )
        rng.note(f"{name}: header {text[:40]}")
        body = text.encode("latin1") + b"\n"
        version = rng.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x09"])
        size = struct.pack("<H" if version[0] == 1 else "<I", len(body))
        return b"\x93NUMPY" + version + size + body + array.tobytes()
    rng.note(f"{name}: {how} {new.dtype} {new.shape}"[:100])
    return npy(new)


def make_zip(rng: CaseRng | None, members: dict[str, bytes], name: str = "") -> bytes:
    """A ZIP of stored members; with rng, now and then one with an odd member or damage."""
    out = io.BytesIO()
    odd = rng is not None and bool(members) and rng.chance(0.3)
    target = rng.choice([*members]) if odd and rng else ""
    how = (
        rng.choice(
            [
                "deflate",
                "bzip2",
                "lzma",
                "twice",
                "rename",
                "crc",
                "size",
                "flag",
                "offset",
                "extra",
                "missing",
                "folder",
                "comment",
                "bytes",
            ]
        )
        if odd and rng
        else ""
    )
    methods = {
        "deflate": zipfile.ZIP_DEFLATED,
        "bzip2": zipfile.ZIP_BZIP2,
        "lzma": zipfile.ZIP_LZMA,
    }
    with zipfile.ZipFile(out, "w") as archive:
        for member, data in members.items():
            info = zipfile.ZipInfo(member, (1980, 1, 1, 0, 0, 0))
            if member == target and rng:
                if how == "missing":
                    continue
                if how == "rename":
                    info.filename = rng.choice(
                        [
                            "",
                            "/",
                            "a/",
                            "../x",
                            "/etc/passwd",
                            "a\\b",
                            "x" * 300,
                            "\x1b[2J",
                            "\x00",
                            member.upper(),
                            member + " ",
                            "\u00e9.png",
                            "meta.json",
                            "./" + member,
                        ]
                    )
                info.compress_type = methods.get(how, zipfile.ZIP_STORED)
                if how == "extra":
                    info.extra = rng.randbytes(rng.choice([1, 4, 40]))
                if how == "folder":
                    info.filename += "/"
            archive.writestr(info, data)
            if how == "twice" and member == target:
                import warnings

                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    archive.writestr(zipfile.ZipInfo(member), data)
        if how == "comment":
            archive.comment = b"PK\x05\x06" + bytes(30)
    data = out.getvalue()
    if rng is None or not how:
        return data
    rng.note(f"{name}: ZIP {how} of {target}")
    if how == "bytes":
        return change_bytes(rng, data, name)
    fields = {"crc": (16, "<I"), "size": (24, "<I"), "flag": (8, "<H"), "offset": (42, "<I")}
    at = data.rfind(b"PK\x01\x02")
    if how in fields and at >= 0:
        entry = bytearray(data)
        shift, form = fields[how]
        number = rng.choice([0, 1, 8, 0x800, 0xFFFF] if form == "<H" else [0, 1, 2**31, 2**32 - 1])
        struct.pack_into(form, entry, at + shift, number)
        return bytes(entry)
    if how in methods and rng.chance(0.7):  # the compressed bytes are damaged
        entry = bytearray(data)
        start = data.find(target.encode()) + len(target)
        entry[start : start + 4] = rng.randbytes(4)
        return bytes(entry)
    return data
