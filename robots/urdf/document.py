"""Checked parser of the bytes of a URDF.

Collisions (unless no link has a visual), inertias, transmissions and plug-ins do not affect images
and are ignored.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import ModelError
from ..files import Element, parse_xml
from ..geometry import Array, transform
from ..model import Joint, JointType, Link, Mimic

EXPAND = "expand it: `xacro FILE > model.urdf`"
MAX_LINKS = 5000
MAX_VISUALS = 20_000
MAX_NAME = 256
MAX_NUMBER = 1e6
"""Limit on lengths, scales and angles; joint limits may be larger (1e16 often means "none")."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
GEOMETRIES: dict[str, dict[str, int]] = {
    "box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1}, "mesh": {},
}
"""Number of values of each required attribute."""
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")
_LARGEST_LIMIT = 1000.0
"""rad or m; files that mean "no limit" write larger numbers."""
_UNLIMITED = (-math.inf, math.inf)


@dataclass(frozen=True)
class UrdfMaterial:
    """A <material>: a definition, or the name of one."""

    name: str
    rgba: Sequence[float] | None
    """3 or 4 sRGB values"""
    texture: str | None

    @property
    def defines(self) -> bool:
        return self.rgba is not None or self.texture is not None


@dataclass(frozen=True)
class UrdfVisual:
    """A <visual>."""

    kind: str
    """A key of GEOMETRIES."""
    sizes: Sequence[float]
    """The attributes of the geometry, m; the scale [1] or [3] of a mesh"""
    filename: str
    """Of a mesh."""
    link_from_visual: Array
    """[4 4]"""
    material: UrdfMaterial | None


@dataclass
class UrdfDocument:
    """A checked URDF."""

    name: str
    materials: list[UrdfMaterial] = field(default_factory=list)
    """Of the robot, not of its links."""
    visuals: dict[str, list[UrdfVisual]] = field(default_factory=dict)
    """By name of the link; has all links."""
    joints: list[Link] = field(default_factory=list)
    """The child link of each joint, without surfaces."""
    notes: list[str] = field(default_factory=list)


def read_urdf_document(data: bytes, default_name: str, allow_missing: bool = False) -> UrdfDocument:
    """Check and parse a URDF; raise ModelError."""
    root = parse_xml(data)
    if root.tag != "robot":
        raise ModelError(f"is not a URDF: its root element is <{root.tag[:40]}>, not <robot>")
    name = root.get("name", "").strip()[:MAX_NAME]
    document = UrdfDocument(name or default_name)
    notes = document.notes
    stray = dict.fromkeys(e.tag[:40] for e in root.iter() if e.tag.startswith("xacro:")
                          and e.tag not in ("xacro:arg", "xacro:property"))
    if stray:
        notes.append(f"xacro elements are ignored: {', '.join([*stray][:10])}")
    if not name:
        notes.append("the robot has no name; the file's is used")
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
    document.materials += [_material(m, "a material") for m in root.findall("material")]
    for link in links:
        link_name = _name(link, "link", document.visuals)
        where = f"link {link_name!r}"
        made = [_visual(v, where, allow_missing, notes) for v in link.findall(shown)]
        document.visuals[link_name] = [visual for visual in made if visual is not None]
    # as in Drake
    if "world" not in document.visuals and any(
            p.get("link", "").strip() == "world" for p in root.findall("joint/parent")):
        document.visuals["world"] = []
        notes.append("joints hang on the link 'world', which is not declared: added")
    seen = set[str]()
    for joint in joints:
        joint_name = _name(joint, "joint", seen)
        seen.add(joint_name)
        document.joints.append(_joint(joint, joint_name, notes))
    return document


def _visual(
    visual: Element, where: str, allow_missing: bool, notes: list[str]
) -> UrdfVisual | None:
    geometry = visual.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        notes.append(f"{where}: a visual without geometry is ignored")
        return None
    if shape.tag not in GEOMETRIES:
        known = ", ".join(GEOMETRIES)
        text = f"{where}: geometry <{shape.tag[:40]}> is not supported ({known})"
        if not allow_missing:
            raise ModelError(f"{text}; add --allow-missing to leave it out")
        notes.append(f"{text}; left out")
        return None
    sizes = [number for key, count in GEOMETRIES[shape.tag].items()
             for number in _numbers(shape, key, where, (count,))]
    filename = ""
    if shape.tag == "mesh":
        filename = _text(shape, "filename", where)
        sizes = _numbers(shape, "scale", where, (1, 3), [1.0])
    material = visual.find("material")
    return UrdfVisual(shape.tag, sizes, filename, _pose(visual, where),
                      None if material is None else _material(material, where))


def _material(material: Element, where: str) -> UrdfMaterial:
    color, texture = material.find("color"), material.find("texture")
    rgba = filename = None
    if color is not None and color.get("rgba", "").strip():
        rgba = _numbers(color, "rgba", where, (4, 3))
    if texture is not None and texture.get("filename", "").strip():
        filename = _text(texture, "filename", where)
    return UrdfMaterial(material.get("name", "")[:MAX_NAME], rgba, filename)


def _joint(joint: Element, name: str, notes: list[str]) -> Link:
    where = f"joint {name!r}"
    kind = joint.get("type", "").strip()
    if kind not in JOINT_TYPES:
        raise ModelError(f"{where}: type {kind[:40]!r} is unknown; there are "
                         f"{', '.join(JOINT_TYPES)}")
    ends: list[str] = []
    for end in ("parent", "child"):
        element = joint.find(end)
        if element is None:
            raise ModelError(f"{where}: has no <{end}>")
        ends.append(_text(element, "link", where))
    parent, child = ends
    pose = _pose(joint, where)
    axis = np.array(_numbers(joint.find("axis"), "xyz", where, (3,), [1.0, 0.0, 0.0]))
    if kind in ("floating", "planar", "spherical"):
        notes.append(f"{where} is {kind}: frozen at zero")
    if kind not in ("revolute", "continuous", "prismatic"):
        return Link(child, parent, pose, Joint(name))
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise ModelError(f"{where}: its axis is zero")
    limits = _limits(joint.find("limit"), kind, where, notes)
    joint_type = JointType(kind)
    if joint_type is not JointType.PRISMATIC:
        joint_type = JointType.CONTINUOUS if limits == _UNLIMITED else JointType.REVOLUTE
    return Link(child, parent, pose, Joint(name, joint_type, axis / length, limits=limits,
                                           mimic=_mimic(joint.find("mimic"), where)))


def _limits(
    limit: Element | None, kind: str, where: str, notes: list[str]
) -> tuple[float, float]:
    (lower,), (upper,) = (_numbers(limit, key, where, (1,), [math.nan], largest=1e30)
                          for key in ("lower", "upper"))
    if kind == "continuous":
        return _UNLIMITED
    if math.isnan(lower) and math.isnan(upper):
        notes.append(f"{where} is {kind} without limits: taken as unlimited")
        return _UNLIMITED
    lower, upper = (0.0 if math.isnan(value) else value for value in (lower, upper))
    if lower > upper:
        notes.append(f"{where}: lower limit {lower:g} > upper {upper:g}: swapped")
        lower, upper = upper, lower
    if max(-lower, upper) > _LARGEST_LIMIT:
        notes.append(f"{where}: limits {lower:g} {upper:g} taken as none")
        lower = lower if lower >= -_LARGEST_LIMIT else -math.inf
        upper = upper if upper <= _LARGEST_LIMIT else math.inf
    return lower, upper


def _mimic(mimic: Element | None, where: str) -> Mimic | None:
    if mimic is None:
        return None
    (multiplier,), (offset,) = (_numbers(mimic, key, where, (1,), [default])
                                for key, default in (("multiplier", 1.0), ("offset", 0.0)))
    return Mimic(_text(mimic, "joint", where), multiplier, offset)


def _pose(holder: Element, where: str) -> Array:
    """Return the [4 4] of an element's <origin>: Rz(yaw) Ry(pitch) Rx(roll), then xyz."""
    origin = holder.find("origin")
    rpy, xyz = (_numbers(origin, key, where, (3,), [0.0, 0.0, 0.0]) for key in ("rpy", "xyz"))
    (si, sj, sk), (ci, cj, ck) = np.sin(rpy), np.cos(rpy)
    rotation = [[cj * ck, sj * (si * ck) - ci * sk, sj * (ci * ck) + si * sk],
                [cj * sk, sj * (si * sk) + ci * ck, sj * (ci * sk) - si * ck],
                [-sj, cj * si, cj * ci]]
    return transform(np.array(rotation) + 0.0, xyz)  # + 0.0 turns minus zero into zero


def _numbers(
    element: Element | None, key: str, where: str, counts: tuple[int, ...],
    default: list[float] | None = None, largest: float = MAX_NUMBER,
) -> list[float]:
    """Return the finite numbers of an attribute, `counts` of them; without it, the default."""
    text = "" if element is None else element.get(key, "").strip()
    if element is None or not text:
        if default is None:
            raise ModelError(f"{where}: <{'' if element is None else element.tag}> has no {key!r}")
        return default
    words = text.replace(",", " ").split()
    what = f"{where}: {key}={text[:60]!r} of <{element.tag}>"
    if "$" in text:
        raise ModelError(f"{what} is un-expanded xacro; {EXPAND}")
    if len(words) not in counts:
        raise ModelError(f"{what} should be {' or '.join(map(str, counts))} numbers")
    for word in words:
        if not NUMBER.fullmatch(word) or not math.isfinite(float(word)):
            raise ModelError(f"{what} is not a finite number: {word[:40]!r}")
        if abs(float(word)) > largest:
            raise ModelError(f"{what} is larger than {largest:g}")
    return [float(word) for word in words]


def _name(element: Element, kind: str, seen: Container[str]) -> str:
    name = _text(element, "name", f"a {kind}", limit=MAX_NAME)
    if name in seen:
        raise ModelError(f"has two {kind}s named {name!r}")
    return name


def _text(element: Element, key: str, where: str, limit: int = 1024) -> str:
    text = element.get(key, "").strip()
    if not text:
        raise ModelError(f"{where}: <{element.tag}> has no {key!r}")
    if "${" in text or "$(" in text:
        raise ModelError(f"{where}: {key}={text[:60]!r} is un-expanded xacro; {EXPAND}")
    if len(text) > limit or not text.isprintable():
        raise ModelError(f"{where}: {key} of <{element.tag}> is unprintable or longer than "
                         f"{limit} characters")
    return text
