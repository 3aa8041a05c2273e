"""Changes of trees of JSON and of XML documents."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from copy import deepcopy
from typing import Any
from xml.etree import ElementTree

from .binary import change_bytes
from .rng import NAMES, NUMBERS, REFERENCES, CaseRng, Raw, shown, value

Element = ElementTree.Element


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


def change_tree(rng: CaseRng, tree: Any, name: str) -> None:
    """Change one place of a tree of dicts and lists."""
    found = places(tree)
    if not found:
        return
    # by depth first, so that the long lists do not take all
    depths = sorted({path.count(".") + path.count("[") for _, _, path in found})
    depth = rng.choice(depths)
    holder, key, path = rng.choice(
        [f for f in found if f[2].count(".") + f[2].count("[") == depth]
    )
    old = holder[key]
    how = rng.choice(["value", "value", "number", "delete", "copy", "wrap", "add", "swap"])
    if how == "delete":
        del holder[key]
    elif how == "copy" and isinstance(holder, list):
        holder.insert(rng.randrange(len(holder) + 1), old)
    elif how == "wrap":
        holder[key] = [old] if rng.chance(0.5) else {str(key): old}
    elif how == "add" and isinstance(old, dict):
        old[rng.choice(NAMES)] = value(rng)
    elif how == "add" and isinstance(old, list):
        old += [value(rng)] * rng.choice([1, 1, 2, 100])
    elif how == "swap":
        other = rng.choice(found)
        holder[key] = _copied(
            other[0].get(other[1])
            if isinstance(other[0], dict)
            else other[0][other[1]]
            if other[1] < len(other[0])
            else None
        )
    elif how == "number" and isinstance(old, int | float) and not isinstance(old, bool):
        holder[key] = rng.choice(
            [old + 1, old - 1, -old, old * 2, old * 1000, float(old), str(old)]
        )
    else:
        holder[key] = value(rng)
    new = holder[key] if how != "delete" and (isinstance(holder, list) or key in holder) else "..."
    rng.note(f"{name}: {path} {how} {shown(new)}")


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


def change_json(rng: CaseRng, data: bytes, name: str, most: int = 3) -> bytes:
    """Change some places of a JSON file, now and then its text."""
    tree = json.loads(data)
    for _ in range(1 + len(rng.few(most - 1))):
        change_tree(rng, tree, name)
    out = dump_tree(tree)
    return change_bytes(rng, out, name) if rng.chance(0.1) else out


# -- XML ------------------------------------------------------------------------------------------


def change_xml(rng: CaseRng, root: Element, name: str, extra: Callable[[], Element]) -> None:
    """Change one place of an XML tree; `extra` makes an element that may be added."""
    elements = list(root.iter())
    element = rng.choice(elements)
    parents = {child: parent for parent in elements for child in parent}
    how = rng.choice(
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
    key = rng.choice([*element.attrib] or ["name"])
    if how in ("number", "text", "reference"):
        pool = {"number": NUMBERS, "text": NAMES, "reference": REFERENCES}[how]
        words = element.get(key, "").split()
        new = rng.choice(pool)
        if how == "number" and len(words) > 1 and rng.chance(0.7):
            words[rng.randrange(len(words))] = new
            new = " ".join(words)
        element.set(key, _xml_text(new))
    elif how == "delete" and element in parents:
        parents[element].remove(element)
    elif how == "attribute" and element.attrib:
        del element.attrib[key]
    elif how == "copy" and element in parents:
        parents[element].append(deepcopy(element))
    elif how == "move" and element in parents:
        rng.choice(elements).append(deepcopy(element))
        parents[element].remove(element)
    elif how == "rename":
        element.tag = rng.choice(
            [e.tag for e in elements] + ["xacro:if", "plane", "a:b", "unknown"]
        )
    elif how == "extra":
        element.insert(rng.randrange(len(element) + 1), extra())
    elif how == "content":
        element.text = _xml_text(rng.choice([*NUMBERS, *NAMES, "1 2 3 " * 50]))
    elif how == "deep":
        for _ in range(rng.choice([3, 70, 600])):
            below = ElementTree.Element(element.tag, dict(element.attrib))
            element.append(below)
            element = below
    else:
        element.set("unknown", "x")
    rng.note(f"{name}: <{element.tag[:30]}> {how} {key}={shown(element.get(key))}")


def _xml_text(text: str) -> str:
    """Without characters that no XML holds."""
    return re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]", "?", text)


def dump_xml(rng: CaseRng, root: Element, name: str) -> bytes:
    """The document, now and then in another encoding, with a document type, or damaged."""
    data = ElementTree.tostring(root)
    how = rng.random()
    if how < 0.03:
        rng.note(f"{name}: document type")
        return b'<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]>' + data
    if how < 0.05:
        rng.note(f"{name}: UTF-16")
        return data.decode().encode("utf-16")
    if how < 0.07:
        rng.note(f"{name}: unknown encoding")
        return b'<?xml version="1.0" encoding="rot13"?>' + data
    return change_bytes(rng, data, name) if how < 0.15 else data
