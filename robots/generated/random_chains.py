"""Random articulated chains and loose rigid objects: training models, not scored.

The models have plain colours; a renderer can add textures.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..geometry import Array, rotation_about, transform
from ..meshes import box, capsule, cylinder, join_surfaces, revolve, sphere
from ..model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Material,
    TriangleSurface,
    move_surface,
)

_LOOSE = 0.25  # share of models of loose bodies
_BRANCH = 0.2  # share of links that branch off an earlier link
_SLIDES = 0.1  # share of prismatic joints in chains
_AXES = np.eye(3)


def random_object(number: int) -> ArticulatedModel:
    """Return random model `number`: a base with 2 to 6 jointed links, or 1 to 4 loose bodies.

    Lengths are in m. Equal numbers give equal models. A chain starts at the origin along z. Each
    loose body has two prismatic joints and one revolute joint about a random axis.
    """
    rng = np.random.default_rng([zlib.crc32(b"random objects"), number])
    links = _loose_bodies(rng) if rng.random() < _LOOSE else _chain(rng)
    return ArticulatedModel.from_links(f"random:{number}", links, keep_order=True)


def _append(links: list[Link], parent: int, pose: Array, joint: Joint,
            surfaces: Sequence[TriangleSurface] = ()) -> None:
    """Add a link at `pose` [4 4] on link `parent`; name it and its joint by the link's index."""
    number = len(links)
    links.append(Link(f"part{number}", f"part{parent}", pose,
                      replace(joint, name=f"joint{number}"), tuple(surfaces)))


def _chain(rng: np.random.Generator) -> list[Link]:
    palette = _palette(rng)
    radius = rng.uniform(0.03, 0.09)
    foot = [_paint(_solid_of_revolution(rng, 1.4 * radius, rng.uniform(0.05, 0.3)), palette, rng)]
    links = [Link("part0", surfaces=tuple(foot))]
    ends = [transform(translation=_up(foot[0].vertices[:, 2].max()))]
    for _ in range(int(rng.integers(2, 7))):
        parent = len(links) - 1
        if parent and rng.random() < _BRANCH:
            parent = int(rng.integers(0, parent + 1))
        axis = _AXES[rng.choice(3, p=(0.25, 0.5, 0.25))]
        slides = rng.random() < _SLIDES
        shapes, end = _arm(rng, radius, axis, palette)
        bend = rotation_about(_AXES[rng.integers(3)], rng.uniform(-1.3, 1.3))
        limits = (-rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.2)) if slides else (
            -rng.uniform(0.6, 2.4), rng.uniform(0.6, 2.4))
        joint_type = JointType.PRISMATIC if slides else JointType.REVOLUTE
        _append(links, parent, ends[parent] @ transform(bend),
                Joint("", joint_type, axis, limits=limits), shapes)
        ends.append(end)
        radius *= rng.uniform(0.7, 1.0)
    return links


def _arm(
    rng: np.random.Generator, radius: float, axis: Array, palette: list[Material]
) -> tuple[list[TriangleSurface], Array]:
    """Return surfaces of a link and the pose of its end in its frame; often with a housing around
    the joint and the beam beside it, as in industrial arms."""
    length = rng.uniform(2.0, 9.0) * radius
    side = np.zeros(3)
    shapes: list[TriangleSurface] = []
    if rng.random() < 0.7:
        wide, long = rng.uniform(1.05, 1.6) * radius, rng.uniform(1.5, 3.2) * radius
        housing = cylinder(wide, long) if rng.random() < 0.75 else sphere(1.1 * wide)
        shapes.append(_paint(move_surface(housing, _along(axis)), palette, rng))
        if axis[2] == 0 and rng.random() < 0.5:
            side = axis * rng.choice((-1.0, 1.0)) * (long / 2.0 + radius / 2.0)
    beam = _beam(rng, radius, length)
    shapes.append(_paint(move_surface(beam, transform(translation=side)), palette, rng))
    for _ in range(int(rng.integers(0, 3))):  # details: rings and boxes
        at = transform(translation=side + _up(rng.uniform(0.1, 0.9) * length))
        detail = cylinder(1.06 * radius, rng.uniform(0.1, 0.5) * radius)
        if rng.random() < 0.4:
            detail = box([radius * x for x in rng.uniform(0.5, 2.2, 3)])
        shapes.append(_paint(move_surface(detail, at), palette, rng))
    return shapes, transform(translation=side + _up(length))


def _beam(rng: np.random.Generator, radius: float, length: float) -> TriangleSurface:
    """Return a solid from the origin to `length` along z."""
    kind = rng.integers(4)
    if kind == 0:
        made = cylinder(radius, length)
    elif kind == 1:
        made = box([2 * radius, 2 * radius * rng.uniform(0.5, 1.3), length])
    elif kind == 2:
        made = capsule(radius, length)
    else:
        return _solid_of_revolution(rng, radius, length)
    return move_surface(made, transform(translation=_up(length / 2.0)))


def _solid_of_revolution(rng: np.random.Generator, radius: float, length: float) -> TriangleSurface:
    """Return a solid of revolution from the origin to `length` along z, with flat ends."""
    z = np.linspace(0.0, 1.0, 25)
    waves = np.sin(np.pi * np.arange(1, 4) * z[:, None] + rng.uniform(0, 2 * np.pi, 3))
    r = 1.0 + waves @ (rng.uniform(0.0, 0.25, 3)) + rng.uniform(-0.4, 0.4) * z
    r, z = radius * np.clip(r, 0.3, 1.8), length * z
    slope = np.gradient(r, z)
    steep = np.hypot(1.0, slope)
    return join_surfaces([
        revolve([0.0, r[0]], [0.0, 0.0], [0.0, 0.0], [-1.0, -1.0]),
        revolve(r, z, 1.0 / steep, -slope / steep),
        revolve([r[-1], 0.0], [length, length], [0.0, 0.0], [1.0, 1.0]),
    ])


def _loose_bodies(rng: np.random.Generator) -> list[Link]:
    """Return loose bodies: two prismatic links without surface precede each revolute link."""
    links = [Link("part0")]
    palette = _palette(rng)
    for _ in range(int(rng.integers(1, 5))):
        frame = rotation_about(_direction(rng), rng.uniform(0.0, np.pi))
        pose = transform(frame, rng.uniform(-0.35, 0.35, 3) + _up(0.5))
        reach = rng.uniform(0.05, 0.25)
        for above, place, axis in ((0, pose, _AXES[0]), (len(links), transform(), _AXES[1])):
            _append(links, above, place,
                    Joint("", JointType.PRISMATIC, axis, limits=(-reach, reach)))
        size = rng.uniform(0.03, 0.16)
        shapes = [_paint(_beam(rng, size * rng.uniform(0.6, 1.4), size * rng.uniform(1.0, 4.0)),
                           palette, rng)]
        for _ in range(int(rng.integers(0, 3))):
            at = transform(rotation_about(_direction(rng), rng.uniform(0.0, np.pi)),
                           size * rng.uniform(-1.0, 1.0, 3))
            shapes.append(_paint(move_surface(_beam(rng, 0.5 * size, size), at), palette, rng))
        hinge = Joint("", JointType.REVOLUTE, _direction(rng), limits=(-1.5, 1.5))
        _append(links, len(links) - 1, transform(), hinge, shapes)
    return links


def _palette(rng: np.random.Generator) -> list[Material]:
    """Return one to three materials of light, dark or random colour."""
    out: list[Material] = []
    for k in range(int(rng.integers(1, 4))):
        kind = rng.random()
        if kind < 0.3:
            color = rng.uniform(0.4, 0.9) * rng.uniform(0.92, 1.0, 3)
        elif kind < 0.55:
            color = rng.uniform(0.01, 0.3) * rng.uniform(0.9, 1.0, 3)
        else:
            color = rng.random(3) ** 1.5
        r, g, b = (float(c) for c in color)
        out.append(Material(f"color{k}", (r, g, b, 1.0), 0.0, float(rng.uniform(0.3, 0.9))))
    return out


def _paint(
    shape: TriangleSurface, palette: list[Material], rng: np.random.Generator
) -> TriangleSurface:
    return replace(shape, material=palette[rng.integers(len(palette))])


def _up(z: float) -> Array:
    return np.array([0.0, 0.0, z])


def _direction(rng: np.random.Generator) -> Array:
    d = rng.standard_normal(3)
    return d / np.linalg.norm(d)


def _along(axis: Array) -> Array:
    """Return the pose that rotates z to a coordinate axis."""
    return transform(np.roll(np.eye(3), int(np.argmax(axis)) + 1, axis=1))
