"""Random choices of a case, and changes of trees, XML, bytes, NPY and ZIP files.

A case is a function of (kind, seed, index): the draws do not depend on the code under test (as
those of hypothesis do, which takes constants from it), so that a finding stays reproducible after
it is mended.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Element = ElementTree.Element


class Raw(str):
    """Text that stands in a JSON file as it is, such as 1e999."""


class Dice(random.Random):
    """The choices of one case; `steps` tells them to a reader."""

    def __init__(self, kind: str, seed: int, index: int) -> None:
        super().__init__(f"{kind} {seed} {index}")
        self.steps: list[str] = []

    def chance(self, probability: float) -> bool:
        return self.random() < probability

    def few(self, most: int) -> range:
        """0 to `most` times; few are likelier. The first of hundred cases has none."""
        return range(min(most, int(self.expovariate(0.8))))

    def note(self, text: str) -> None:
        self.steps.append(text[:120])


NAMES = (
    "",
    " ",
    "a",
    "world",
    "base",
    "../secret/secret",
    "/etc/passwd",
    "~",
    "~root",
    "a\nb",
    "a\tb",
    "\x1b[31mred\x1b[0m",
    "\x07",
    "\u202e",
    "\ufeff",
    "\x85",
    "x" * 300,
    "x" * 5000,
    "%s%n",
    "${v}",
    "$(arg x)",
    "{0}",
    "-1",
    "--help",
    "nan",
    "None",
    "C:\\a",
    "a/b",
    "a\\b",
    ".",
    "..",
    ".zip",
    "con",
    "'; x",
    "<script>",
    "&amp;",
    "\u00e9",
    "\U0001f916",
    "a\u0301",
    "000000",
    "=1+1",
)
REFERENCES = (
    "../secret/secret.obj",
    "../../secret/secret.stl",
    "../secret/secret.png",
    "/etc/passwd",
    "file:///etc/passwd",
    "http://127.0.0.1:9/a.obj",
    "ftp://x/a.stl",
    "package://m/a.stl",
    "package:///etc/passwd",
    "package://../secret/secret.obj",
    "model://m/cube.obj",
    "~/a.obj",
    "C:\\a.obj",
    "\\\\host\\a.obj",
    "link.obj",
    "pipe.obj",
    "folder.obj",
    "./cube.obj",
    "m.urdf",
    "cube.obj/../cube.obj",
    "%2e%2e/secret/secret.obj",
    "a%00.obj",
    "cube.OBJ",
    "cube.obj#1",
    "",
    "data:application/octet-stream;base64,AAAA",
    "x" * 2000 + ".obj",
    "nowhere.stl",
    "big.png",
)
NUMBERS = (
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "0.5",
    "1e-9",
    "-1e-9",
    "1e-320",
    "1e9",
    "-1e9",
    "1e16",
    "1e30",
    "1e38",
    "1e39",
    "1e308",
    "1e309",
    "1e999",
    "-1e999",
    "nan",
    "NaN",
    "inf",
    "-inf",
    "Infinity",
    "2147483647",
    "2147483648",
    "4294967295",
    "9223372036854775807",
    "9223372036854775808",
    "18446744073709551616",
    "1" + "0" * 400,
    "1" + "0" * 5000,
    "0x10",
    "1_0",
    "1,5",
    "1.5.5",
    "--1",
    "+1",
    "1e",
    ".",
    "",
    "${v}",
    "n/a",
    "\u0661",
    "1 2",
    "1 2 3 4 5 6 7",
    "true",
    "1f",
    "-0.0",
)
_JSON_RAW = (
    "1e999",
    "-1e999",
    "NaN",
    "Infinity",
    "-Infinity",
    "1" + "0" * 400,
    "1" + "0" * 5000,
    '"\\ud800"',
    "[" * 600 + "]" * 600,
    "1e-400",
    "-0",
    "0.1e1",
    '"\\u0000"',
)


def value(dice: Dice) -> Any:
    """A value that a reader may not expect."""
    return dice.choice(
        [
            lambda: None,
            lambda: dice.chance(0.5),
            lambda: dice.choice(
                [
                    0,
                    -1,
                    1,
                    2,
                    3,
                    7,
                    255,
                    256,
                    65535,
                    65536,
                    2**31 - 1,
                    2**31,
                    2**32,
                    2**53 + 1,
                    2**63,
                    2**64,
                    -(2**31),
                    -(2**63) - 1,
                    10**30,
                ]
            ),
            lambda: dice.choice(
                [0.0, -0.0, 0.5, 1.5, -1.5, 1e-12, 1e-320, 1e9, 1e20, 1e300, -1e300]
            ),
            lambda: dice.choice(NAMES),
            lambda: dice.choice(REFERENCES),
            lambda: dice.choice(NUMBERS),
            lambda: [],
            lambda: {},
            lambda: [value(dice) for _ in range(dice.randrange(1, 5))],
            lambda: {dice.choice(NAMES): value(dice)},
            lambda: Raw(dice.choice(_JSON_RAW)),
        ]
    )()


def _shown(item: Any) -> str:
    return ascii(item)[:60]


# -- trees of JSON --------------------------------------------------------------------------------


def places(tree: Any, path: str = "$") -> list[tuple[Any, Any, str]]:
    """(holder, key, path) of every value below a tree."""
    keys = (
        list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    )
    out: list[tuple[Any, Any, str]] = []
    for key in keys:
        here = f"{path}.{key}" if isinstance(tree, dict) else f"{path}[{key}]"
        out += [(tree, key, here), *places(tree[key], here)]
    return out


def change_tree(dice: Dice, tree: Any, name: str) -> None:
    """Change one place of a tree of dicts and lists."""
    found = places(tree)
    if not found:
        return
    # by depth first, so that the long lists do not take all
    depths = sorted({path.count(".") + path.count("[") for _, _, path in found})
    depth = dice.choice(depths)
    holder, key, path = dice.choice(
        [f for f in found if f[2].count(".") + f[2].count("[") == depth]
    )
    old = holder[key]
    how = dice.choice(["value", "value", "number", "delete", "copy", "wrap", "add", "swap"])
    if how == "delete":
        del holder[key]
    elif how == "copy" and isinstance(holder, list):
        holder.insert(dice.randrange(len(holder) + 1), old)
    elif how == "wrap":
        holder[key] = [old] if dice.chance(0.5) else {str(key): old}
    elif how == "add" and isinstance(old, dict):
        old[dice.choice(NAMES)] = value(dice)
    elif how == "add" and isinstance(old, list):
        old += [value(dice)] * dice.choice([1, 1, 2, 100])
    elif how == "swap":
        other = dice.choice(found)
        holder[key] = _copied(
            other[0].get(other[1])
            if isinstance(other[0], dict)
            else other[0][other[1]]
            if other[1] < len(other[0])
            else None
        )
    elif how == "number" and isinstance(old, int | float) and not isinstance(old, bool):
        holder[key] = dice.choice(
            [old + 1, old - 1, -old, old * 2, old * 1000, float(old), str(old)]
        )
    else:
        holder[key] = value(dice)
    new = holder[key] if how != "delete" and (isinstance(holder, list) or key in holder) else "..."
    dice.note(f"{name}: {path} {how} {_shown(new)}")


def _copied(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {k: _copied(v) for k, v in tree.items()}
    return [_copied(v) for v in tree] if isinstance(tree, list) else tree


def dump_tree(tree: Any) -> bytes:
    """JSON with the texts of Raw as they are; lone surrogates become escapes."""
    raws: list[str] = []

    def marked(item: Any) -> Any:
        if isinstance(item, Raw):
            raws.append(str(item))
            return f"@raw{len(raws) - 1}@"
        if isinstance(item, dict):
            return {str(k): marked(v) for k, v in item.items()}
        return [marked(v) for v in item] if isinstance(item, list | tuple) else item

    text = json.dumps(marked(tree))
    return re.sub(r'"@raw(\d+)@"', lambda m: raws[int(m[1])], text).encode()


def change_json(dice: Dice, data: bytes, name: str, most: int = 3) -> bytes:
    """Change some places of a JSON file, now and then its text."""
    tree = json.loads(data)
    for _ in range(1 + len(dice.few(most - 1))):
        change_tree(dice, tree, name)
    out = dump_tree(tree)
    return change_bytes(dice, out, name) if dice.chance(0.1) else out


# -- XML ------------------------------------------------------------------------------------------


def change_xml(dice: Dice, root: Element, name: str, extra: Callable[[], Element]) -> None:
    """Change one place of an XML tree; `extra` makes an element that may be added."""
    elements = list(root.iter())
    element = dice.choice(elements)
    parents = {child: parent for parent in elements for child in parent}
    how = dice.choice(
        [
            "number",
            "number",
            "text",
            "reference",
            "delete",
            "attribute",
            "copy",
            "move",
            "rename",
            "extra",
            "content",
            "deep",
        ]
    )
    key = dice.choice([*element.attrib] or ["name"])
    if how in ("number", "text", "reference"):
        pool = {"number": NUMBERS, "text": NAMES, "reference": REFERENCES}[how]
        words = element.get(key, "").split()
        new = dice.choice(pool)
        if how == "number" and len(words) > 1 and dice.chance(0.7):
            words[dice.randrange(len(words))] = new
            new = " ".join(words)
        element.set(key, _xml_text(new))
    elif how == "delete" and element in parents:
        parents[element].remove(element)
    elif how == "attribute" and element.attrib:
        del element.attrib[key]
    elif how == "copy" and element in parents:
        parents[element].append(_copied_element(element))
    elif how == "move" and element in parents:
        dice.choice(elements).append(_copied_element(element))
        parents[element].remove(element)
    elif how == "rename":
        element.tag = dice.choice(
            [e.tag for e in elements] + ["xacro:if", "plane", "a:b", "unknown"]
        )
    elif how == "extra":
        element.insert(dice.randrange(len(element) + 1), extra())
    elif how == "content":
        element.text = _xml_text(dice.choice([*NUMBERS, *NAMES, "1 2 3 " * 50]))
    elif how == "deep":
        for _ in range(dice.choice([3, 70, 600])):
            below = ElementTree.Element(element.tag, dict(element.attrib))
            element.append(below)
            element = below
    else:
        element.set("unknown", "x")
    dice.note(f"{name}: <{element.tag[:30]}> {how} {key}={_shown(element.get(key))}")


def _xml_text(text: str) -> str:
    """Without characters that no XML holds."""
    return re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]", "?", text)


def _copied_element(element: Element) -> Element:
    return ElementTree.fromstring(ElementTree.tostring(element))


def dump_xml(dice: Dice, root: Element, name: str) -> bytes:
    """The document, now and then in another encoding, with a document type, or damaged."""
    data = ElementTree.tostring(root)
    how = dice.random()
    if how < 0.03:
        dice.note(f"{name}: document type")
        return b'<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>' + data
    if how < 0.05:
        dice.note(f"{name}: UTF-16")
        return data.decode().encode("utf-16")
    if how < 0.07:
        dice.note(f"{name}: unknown encoding")
        return b'<?xml version="1.0" encoding="rot13"?>' + data
    return change_bytes(dice, data, name) if how < 0.15 else data


# -- bytes ----------------------------------------------------------------------------------------


def change_bytes(dice: Dice, data: bytes, name: str) -> bytes:
    """Damage a file: cut, overwrite, insert, repeat."""
    out = bytearray(data)
    at = dice.randrange(len(out) + 1)
    head = dice.randrange(min(len(out), 128) + 1)
    how = dice.choice(["cut", "flip", "head", "insert", "remove", "repeat", "empty", "zero"])
    if how == "cut":
        del out[at:]
    elif how == "flip":
        for _ in range(dice.choice([1, 1, 4, 32])):
            if out:
                out[dice.randrange(len(out))] ^= 1 << dice.randrange(8)
    elif how == "head":
        patch = dice.choice(
            [b"\xff" * 4, bytes(4), b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"(((("]
        )
        out[head : head + 4] = patch
    elif how == "insert":
        out[at:at] = dice.randbytes(dice.choice([1, 3, 64, 4096]))
    elif how == "remove":
        del out[at : at + dice.choice([1, 4, 100])]
    elif how == "repeat":
        out[at:at] = out[max(0, at - 64) : at] * dice.choice([1, 10, 100])
    elif how == "zero":
        n = dice.choice([1, 16, 1000])
        out[at : at + n] = bytes(len(out[at : at + n]))
    else:
        out = bytearray(
            dice.choice([b"", b"\n", b"\0", b"\xff\xfe", b"\xef\xbb\xbf", b"{}", b"[]"])
        )
    dice.note(f"{name}: bytes {how} at {head if how == 'head' else at}")
    return bytes(out)


def png(width: int, height: int, channels: int = 3, value: int = 200) -> bytes:
    import cv2

    shape = (height, width) if channels == 1 else (height, width, channels)
    return bytes(cv2.imencode(".png", np.full(shape, value, np.uint8))[1])


def change_png(dice: Dice, data: bytes, name: str) -> bytes:
    """Damage a PNG, or change its header with a right checksum, so that a decoder goes on."""
    import zlib

    if dice.chance(0.3) or len(data) < 33:
        return change_bytes(dice, data, name)
    width, height, bits, color, *rest = struct.unpack(">IIBBBBB", data[16:29])
    how = dice.choice(["size", "bits", "color", "rest", "chunk", "other"])
    if how == "size":
        width, height = (
            dice.choice([0, 1, 2**16, 2**31 - 1, 2**32 - 1, width, 2 * width]) for _ in range(2)
        )
    elif how == "bits":
        bits = dice.choice([0, 1, 2, 4, 8, 16, 32])
    elif how == "color":
        color = dice.choice([0, 1, 2, 3, 4, 6, 7])
    elif how == "rest":
        rest[dice.randrange(3)] = dice.choice([0, 1, 2, 255])
    elif how == "other":
        dice.note(f"{name}: another PNG")
        return png(dice.choice([1, 7, 48]), dice.choice([1, 5, 36]), dice.choice([1, 3, 4]))
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, bits, color, *rest)
    out = data[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    if how == "chunk":
        kind = dice.choice([b"tRNS", b"PLTE", b"acTL", b"zTXt", b"iCCP", b"gAMA", b"IDAT", b"eXIf"])
        body = kind + dice.randbytes(dice.choice([0, 1, 6, 768]))
        out += struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    dice.note(f"{name}: PNG {how} {width}x{height} {bits} bit colour {color}")
    return out + data[33:]


# -- NPY and ZIP ----------------------------------------------------------------------------------


def npy(array: NDArray[Any]) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array), allow_pickle=True)
    return out.getvalue()


def change_array(dice: Dice, data: bytes, name: str) -> bytes:
    """Change the values, the shape, the type or the header of an NPY file."""
    how = dice.choice(["values", "values", "shape", "type", "header", "bytes"])
    if how == "bytes":
        return change_bytes(dice, data, name)
    array = np.load(io.BytesIO(data))
    if how == "values" and array.size:
        odd = dice.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 0, -1, 1, 1e9, 2**31])
        with np.errstate(all="ignore"):
            flat = array.reshape(-1).copy()
            where = slice(None) if dice.chance(0.2) else dice.randrange(len(flat))
            if flat.dtype.kind != "f" and not np.isfinite(odd):
                odd = -7
            flat[where] = (
                np.float64(odd).astype(flat.dtype)
                if abs(odd) < 2**62
                else odd
                if flat.dtype.kind == "f"
                else 1
            )
        dice.note(f"{name}: value {odd}")
        return npy(flat.reshape(array.shape))
    if how == "shape":
        new = dice.choice(
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
        kind = dice.choice(
            ["?", "i1", "u8", "f2", "f4", ">f8", "c16", "S4", "U4", "O", "M8[s]", "V8", "g", "i8"]
        )
        with np.errstate(all="ignore"):
            new = (
                np.zeros(array.shape, kind)
                if kind in ("S4", "U4", "M8[s]", "V8", "O")
                else array.astype(kind)
            )
        dice.note(f"{name}: type {kind}")
    else:
        text = dice.choice(
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
        dice.note(f"{name}: header {text[:40]}")
        body = text.encode("latin1") + b"\n"
        version = dice.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x09"])
        size = struct.pack("<H" if version[0] == 1 else "<I", len(body))
        return b"\x93NUMPY" + version + size + body + array.tobytes()
    dice.note(f"{name}: {how} {new.dtype} {new.shape}"[:100])
    return npy(new)


def make_zip(dice: Dice | None, members: dict[str, bytes], name: str = "") -> bytes:
    """A ZIP of stored members; with dice, now and then one with an odd member or damage."""
    out = io.BytesIO()
    odd = dice is not None and bool(members) and dice.chance(0.3)
    target = dice.choice([*members]) if odd and dice else ""
    how = (
        dice.choice(
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
        if odd and dice
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
            if member == target and dice:
                if how == "missing":
                    continue
                if how == "rename":
                    info.filename = dice.choice(
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
                    info.extra = dice.randbytes(dice.choice([1, 4, 40]))
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
    if dice is None or not how:
        return data
    dice.note(f"{name}: ZIP {how} of {target}")
    if how == "bytes":
        return change_bytes(dice, data, name)
    fields = {"crc": (16, "<I"), "size": (24, "<I"), "flag": (8, "<H"), "offset": (42, "<I")}
    at = data.rfind(b"PK\x01\x02")
    if how in fields and at >= 0:
        entry = bytearray(data)
        shift, form = fields[how]
        number = dice.choice([0, 1, 8, 0x800, 0xFFFF] if form == "<H" else [0, 1, 2**31, 2**32 - 1])
        struct.pack_into(form, entry, at + shift, number)
        return bytes(entry)
    if how in methods and dice.chance(0.7):  # the compressed bytes are damaged
        entry = bytearray(data)
        start = data.find(target.encode()) + len(target)
        entry[start : start + 4] = dice.randbytes(4)
        return bytes(entry)
    return data
