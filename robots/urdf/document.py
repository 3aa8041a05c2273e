"""Checked parser of the bytes of a URDF into the objects of yourdfpy.

yourdfpy receives only known elements and finite numbers, so that no file makes it raise.
Collisions, inertias, transmissions and plug-ins do not affect images and are ignored.
"""

# yourdfpy has no types
# pyright: reportUnknownVariableType=false, reportUnknownMemberType=false
# pyright: reportMissingTypeStubs=false

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ...errors import ModelError
from ..files import Element, new_element, parse_xml, xml_bytes

if TYPE_CHECKING:
    from yourdfpy.urdf import Robot

EXPAND = "expand it: `xacro FILE > model.urdf`"
MAX_LINKS = 2000
MAX_VISUALS = 20_000
MAX_NAME = 256
MAX_NUMBER = 1e6
"""Limit on lengths, scales and angles; joint limits may be larger (1e16 often means "none")."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
GEOMETRIES: dict[str, dict[str, tuple[int, ...]]] = {
    "box": {"size": (3,)}, "sphere": {"radius": (1,)},
    "cylinder": {"radius": (1,), "length": (1,)}, "capsule": {"radius": (1,), "length": (1,)},
    "mesh": {},
}
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")


@dataclass(frozen=True)
class _Where:
    """The part of a document that messages name."""

    name: str
    notes: list[str]

    def __str__(self) -> str:
        return self.name


@dataclass
class UrdfDocument:
    """A checked URDF."""

    robot: Robot
    notes: list[str] = field(default_factory=list)


def read_urdf_document(data: bytes, default_name: str, allow_missing: bool = False) -> UrdfDocument:
    """Check and parse a URDF; raise ModelError.

    yourdfpy has no capsules: a capsule becomes a cylinder in a visual named "capsule".
    """
    notes: list[str] = []
    clean = _clean_robot(parse_xml(data), default_name, allow_missing, notes)

    import yourdfpy

    model: Any = yourdfpy.URDF.load(io.BytesIO(xml_bytes(clean)), build_scene_graph=False,
                                    load_meshes=False)
    return UrdfDocument(model.robot, notes)


def _clean_robot(root: Element, name: str, allow_missing: bool, notes: list[str]) -> Element:
    if root.tag != "robot":
        raise ModelError(f"is not a URDF: its root element is <{root.tag[:40]}>, not <robot>")
    stray = dict.fromkeys(e.tag[:40] for e in root.iter() if e.tag.startswith("xacro:")
                          and e.tag not in ("xacro:arg", "xacro:property"))
    if stray:
        notes.append(f"xacro elements are ignored: {', '.join([*stray][:10])}")
    if not root.get("name", "").strip():
        notes.append("the robot has no name; the file's is used")
    clean = new_element("robot", {"name": root.get("name", "").strip()[:MAX_NAME] or name})
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        raise ModelError(f"has no links, only un-expanded xacro; {EXPAND}" if stray else
                         "has no links")
    if len(links) > MAX_LINKS or len(joints) > MAX_LINKS:
        raise ModelError(f"has more than {MAX_LINKS} links or joints")
    shown = "visual"
    if root.find("link/visual") is None and root.find("link/collision") is not None:
        shown = "collision"
        notes.append("no link has a visual: the collision geometry is shown")
    if len(root.findall(f"link/{shown}")) > MAX_VISUALS:
        raise ModelError(f"has more than {MAX_VISUALS} visuals")
    for material in root.findall("material"):
        clean.append(_clean_material(material, _Where("a material", notes)))
    seen: set[str] = set()
    for link in links:
        link_name = _name(link, "link", seen)
        new = new_element("link", {"name": link_name})
        where = _Where(f"link {link_name!r}", notes)
        for visual in link.findall(shown):
            made = _clean_visual(visual, where, allow_missing)
            if made is not None:
                new.append(made)
        clean.append(new)
    seen = set()
    clean.extend([_clean_joint(joint, _name(joint, "joint", seen), notes) for joint in joints])
    _remove_lone_mimics(clean, seen, notes)
    _add_parents(clean, notes)
    return clean


def _remove_lone_mimics(robot: Element, joints: set[str], notes: list[str]) -> None:
    """Let a joint that mimics none of the `joints` move by itself, as other readers do."""
    for joint in robot.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") not in joints:
            notes.append(f"joint {joint.get('name')!r}: mimics {mimic.get('joint')!r}, which does "
                         "not exist: moves by itself")
            joint.remove(mimic)


def _add_parents(robot: Element, notes: list[str]) -> None:
    """Add links, such as "world", that are not declared but the parents of joints."""
    names = {link.get("name") for link in robot.findall("link")}
    for name in dict.fromkeys(p.get("link", "") for p in robot.findall("joint/parent")):
        if name not in names:
            robot.append(new_element("link", {"name": name}))
            notes.append(f"joints hang on the link {name!r}, which is not declared: added")


def _clean_visual(visual: Element, where: _Where, allow_missing: bool) -> Element | None:
    geometry = visual.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        where.notes.append(f"{where}: a visual without geometry is ignored")
        return None
    if shape.tag not in GEOMETRIES:
        known = ", ".join(GEOMETRIES)
        text = f"{where}: geometry <{shape.tag[:40]}> is not supported ({known})"
        if not allow_missing:
            raise ModelError(f"{text}; allow_missing leaves it out")
        where.notes.append(f"{text}; left out")
        return None
    attributes = _numbers(shape, where, {**GEOMETRIES[shape.tag]}, required=True)
    if shape.tag == "mesh":
        attributes["filename"] = _text(shape, "filename", where)
        if "scale" in shape.attrib:
            attributes |= _numbers(shape, where, {"scale": (1, 3)})
    new = new_element("visual", {"name": shape.tag})
    tag = "cylinder" if shape.tag == "capsule" else shape.tag
    holder = new_element("geometry", {})
    holder.append(new_element(tag, attributes))
    new.append(holder)
    _copy(visual, new, "origin", where, {"xyz": (3,), "rpy": (3,)})
    material = visual.find("material")
    if material is not None:
        new.append(_clean_material(material, where))
    return new


def _clean_material(material: Element, where: _Where) -> Element:
    new = new_element("material", {"name": material.get("name", "")[:MAX_NAME]})
    color, texture = material.find("color"), material.find("texture")
    if color is not None and color.get("rgba", "").strip():
        new.append(new_element("color", _numbers(color, where, {"rgba": (4, 3)})))
    if texture is not None and texture.get("filename", "").strip():
        new.append(new_element("texture", {"filename": _text(texture, "filename", where)}))
    return new


def _clean_joint(joint: Element, name: str, notes: list[str]) -> Element:
    where = _Where(f"joint {name!r}", notes)
    kind = joint.get("type", "").strip()
    if kind not in JOINT_TYPES:
        raise ModelError(f"{where}: type {kind[:40]!r} is unknown; there are "
                         f"{', '.join(JOINT_TYPES)}")
    new = new_element("joint", {"name": name, "type": kind})
    for end in ("parent", "child"):
        element = joint.find(end)
        if element is None:
            raise ModelError(f"{where}: has no <{end}>")
        new.append(new_element(end, {"link": _text(element, "link", where)}))
    _copy(joint, new, "origin", where, {"xyz": (3,), "rpy": (3,)})
    _copy(joint, new, "axis", where, {"xyz": (3,)})
    if kind != "fixed":
        _copy(joint, new, "limit", where, {"lower": (1,), "upper": (1,)}, largest=1e30)
        mimic = joint.find("mimic")
        if mimic is not None:
            _copy(joint, new, "mimic", where, {"multiplier": (1,), "offset": (1,)})
            new[-1].set("joint", _text(mimic, "joint", where))
    return new


def _copy(
    old: Element, new: Element, tag: str, where: _Where, numbers: dict[str, tuple[int, ...]],
    largest: float = MAX_NUMBER,
) -> None:
    element = old.find(tag)
    if element is not None:
        new.append(new_element(tag, _numbers(element, where, numbers, largest=largest)))


def _numbers(
    element: Element, where: _Where, counts: dict[str, tuple[int, ...]], required: bool = False,
    largest: float = MAX_NUMBER,
) -> dict[str, str]:
    """Return normalised attributes; each holds an allowed number (`counts`) of finite numbers.

    Of more than three, the first three are taken, as other readers do.
    """
    out: dict[str, str] = {}
    for key, allowed in counts.items():
        text = element.get(key)
        if text is None or not text.strip():
            if required:
                raise ModelError(f"{where}: <{element.tag}> has no {key!r}")
            continue
        words = text.replace(",", " ").split()
        what = f"{where}: {key}={text[:60]!r} of <{element.tag}>"
        if "$" in text:
            raise ModelError(f"{what} is un-expanded xacro; {EXPAND}")
        if max(allowed) == 3 and len(words) > 3:
            where.notes.append(f"{what}: the first 3 numbers are taken")
            words = words[:3]
        if len(words) not in allowed:
            raise ModelError(f"{what} should be {' or '.join(map(str, allowed))} numbers")
        for word in words:
            if not NUMBER.fullmatch(word) or not math.isfinite(float(word)):
                fix = '; for a joint without limits, give type="continuous" or no limit' * (
                    element.tag == "limit")
                raise ModelError(f"{what} is not a finite number: {word[:40]!r}{fix}")
            if abs(float(word)) > largest:
                raise ModelError(f"{what} is larger than {largest:g}")
        out[key] = " ".join(words)
    return out


def _name(element: Element, kind: str, seen: set[str]) -> str:
    name = _text(element, "name", f"a {kind}", limit=MAX_NAME)
    if name in seen:
        raise ModelError(f"has two {kind}s named {name!r}")
    seen.add(name)
    return name


def _text(element: Element, key: str, where: str | _Where, limit: int = 1024) -> str:
    text = element.get(key, "").strip()
    if not text:
        raise ModelError(f"{where}: <{element.tag}> has no {key!r}")
    if "${" in text or "$(" in text:
        raise ModelError(f"{where}: {key}={text[:60]!r} is un-expanded xacro; {EXPAND}")
    if len(text) > limit or not text.isprintable():
        raise ModelError(f"{where}: {key} of <{element.tag}> is unprintable or longer than "
                         f"{limit} characters")
    return text
