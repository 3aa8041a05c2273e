"""Generated model of the OWI-535 "Robotic Arm Edge", a toy arm; needs no download.

Kinematics and keypoints are those of CRAVES (Zuo et al., CVPR 2019); the outer dimensions are
those of the product; details follow its appearance. In the base frame, x is forward at rotation
0, y left, and z up from the table. The frames of CRAVES are left-handed (Unreal Engine), and its
base faces -y: a point (x, y, z) of its base is (-y, -x, z) here, and its lateral axis points
right.

Parallel cranks, all driven by one joint, hold the two fingers of the gripper; the fingertips
touch at joint value 0 and are 45 mm apart at the limit.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..geometry import transform
from ..meshes import bar, block, circle, hull, plate, rod, round_corners
from ..model import (
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Material,
    Mimic,
    TriangleSurface,
    base_color,
    move_surface,
)

SHOULDER, UPPER_ARM, FOREARM, HAND = 67.66, 89.68, 113.58, 75.0
"""mm: from table to shoulder, to elbow, to wrist, to grasp point."""
LIMITS = {"rotation": (-130.0, 130.0), "base": (-90.0, 60.0), "elbow": (-60.0, 90.0),
          "wrist": (-45.0, 45.0)}
"""deg"""
OPENING = 45.0
"""Distance between the fingertips at the joint limit of the gripper, mm."""

_CRANK = 30.0  # distance between the pivots of a crank, mm
_PIVOTS = ((20.0, 17.0), (31.0, 12.0))  # outer, inner left crank, hand frame, mm
_CLOSED = -np.arcsin(7.5 / _CRANK)  # direction of the cranks, closed, rad
GRIPPER = float(np.arcsin((OPENING / 2 - 7.5) / _CRANK) - _CLOSED)
"""Angle of the cranks between closed and open, rad."""

_M = 1e-3


def _plastic(name: str, srgb: tuple[float, float, float], roughness: float = 0.45,
             metallic: float = 0.0) -> Material:
    return Material(name, base_color(srgb), metallic, roughness)


BLACK = _plastic("black plastic", (0.11, 0.11, 0.12))
YELLOW = _plastic("yellow plastic", (0.98, 0.76, 0.06), 0.38)
FOAM = _plastic("foam pad", (0.24, 0.24, 0.25), 0.95)
STEEL = _plastic("steel", (0.72, 0.72, 0.74), 0.3, 1.0)
LENS = _plastic("LED", (0.93, 0.95, 0.98), 0.15)
GREY = _plastic("grey plastic", (0.33, 0.33, 0.35), 0.5)
WIRES = [_plastic(f"{name} wire", srgb, 0.5) for name, srgb in (
    ("red", (0.75, 0.08, 0.07)), ("blue", (0.10, 0.22, 0.62)), ("white", (0.85, 0.85, 0.83)))]
Solids = list[tuple[Material, TriangleSurface]]


def owi535() -> ArticulatedModel:
    """Return the arm: joints rotation, base, elbow, wrist, gripper (all rad), and 17 keypoints."""
    model = ArticulatedModel.from_links("owi535", _links())
    names, parts, points = zip(*_keypoints(), strict=True)
    return replace(model, keypoint_names=names,
                   keypoint_part=np.array([model.part_names.index(p) for p in parts], np.int64),
                   keypoint=np.array(points) * _M)


def _keypoints() -> list[tuple[str, str, tuple[float, float, float]]]:
    """Return (name, part, point in mm, part frame) of the 17 keypoints of CRAVES, in its order."""
    z = SHOULDER
    return [
        ("shoulder", "upper_arm", (0.0, 0.0, 0.0)),
        ("elbow", "forearm", (0.0, 0.0, 0.0)),
        ("wrist", "hand", (0.0, 0.0, 0.0)),
        ("battery_front", "base", (-62.1, -0.8, z - 12.2)),
        ("base_right", "base", (-1.7, -80.8, z - 67.7)),
        ("base_left", "base", (2.3, 79.2, z - 67.2)),
        ("battery_back", "base", (-129.9, -0.6, z - 6.2)),
        ("upper_arm_left_low", "upper_arm", (0.4, 26.1, 34.4)),
        ("upper_arm_left_high", "upper_arm", (0.5, 26.1, 55.4)),
        ("upper_arm_right_low", "upper_arm", (0.1, -25.9, 34.6)),
        ("upper_arm_right_high", "upper_arm", (-0.2, -25.9, 55.7)),
        ("forearm_back", "forearm", (-30.2, -1.3, 0.0)),
        ("forearm_top", "forearm", (28.3, -1.3, 17.1)),
        ("forearm_bottom", "forearm", (35.3, -1.8, -16.9)),
        ("forearm_front", "forearm", (62.6, -1.7, -0.6)),
        ("grip", "hand", (72.7, 1.7, 13.0)),
        ("lamp", "hand", (41.8, 1.4, 25.7)),
    ]


def _links() -> list[Link]:
    """Return the links; at joint values of zero all frames are parallel to the base frame."""
    pitch, up = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)

    def revolute(name: str, axis: tuple[float, float, float]) -> Joint:
        low, high = np.radians(LIMITS[name]).tolist()
        return Joint(name, JointType.REVOLUTE, axis, limits=(low, high))

    links = [
        _link("base", None, _base()),
        _link("turret", "base", _turret(), (0.0, 0.0, SHOULDER), revolute("rotation", up)),
        _link("upper_arm", "turret", _upper_arm(), joint=revolute("base", pitch)),
        _link("forearm", "upper_arm", _forearm(), (0.0, 0.0, UPPER_ARM), revolute("elbow", pitch)),
        _link("hand", "forearm", _hand(), (FOREARM, 0.0, 0.0), revolute("wrist", pitch)),
    ]
    gripper = Joint("gripper", JointType.REVOLUTE, up, limits=(0.0, GRIPPER))
    reach = _CRANK * np.cos(_CLOSED), _CRANK * np.sin(_CLOSED)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for name, (x, y), layer in zip(("outer", "inner"), _PIVOTS, (8.5, 4.5), strict=True):
            crank, end = f"{name}_crank_{side}", (reach[0], sign * reach[1])
            first = crank == "outer_crank_left"
            links.append(_link(crank, "hand", _crank(end, layer), (x, sign * y, 0.0),
                               gripper if first else _follower(gripper, crank, sign)))
            if name == "outer":
                finger = f"finger_{side}"
                links.append(_link(finger, crank, _finger(sign), (*end, 0.0),
                                   _follower(gripper, finger, -sign)))
    return [*links, _link("grasp", "hand", [], (HAND, 0.0, 0.0))]


def _link(name: str, parent: str | None, solids: Solids,
          origin: tuple[float, float, float] = (0.0, 0.0, 0.0), joint: Joint | None = None) -> Link:
    """Return a link of solids in mm at `origin` in the parent, mm; fixed without a joint."""
    surfaces = tuple(TriangleSurface(s.vertices * _M, s.faces, s.normals, material=m)
                     for m, s in solids)
    return Link(name, parent, transform(None, np.array(origin) * _M), joint or Joint(), surfaces)


def _follower(leader: Joint, name: str, multiplier: float) -> Joint:
    return replace(leader, name=name, limits=(-np.inf, np.inf),
                   mimic=Mimic(leader.name, multiplier))


def _base() -> Solids:
    foot = round_corners([(80, -34), (80, 34), (46, 80.8), (-30, 80.8), (-58, 52), (-148.6, 52),
                    (-148.6, -52), (-58, -52), (-30, -80.8), (46, -80.8)],
                   (22, 22, 26, 26, 18, 10, 10, 18, 26, 26))
    solids: Solids = [
        (BLACK, plate(foot, (0.0, 9.0))),
        (BLACK, hull(np.concatenate([np.insert(0.93 * foot[foot[:, 0] > -56], 2, 9.0, axis=1),
                                     np.insert(circle((0, 0), 56), 2, 16.0, axis=1)]))),
        (BLACK, rod((0, 0, 15), (0, 0, 24), 54, 50, 64)),
        # battery box for four D cells in two rows, and its lid
        (BLACK, block((-148.0, -47, 6), (-61.9, 47, 55.6), 2.5)),
        (BLACK, hull(np.concatenate([
            np.insert(round_corners([(-148, -44), (-108, -44), (-108, 44), (-148, 44)], 6), 2, 50.0,
                      axis=1),
            np.insert(round_corners([(-144, -40), (-114, -40), (-114, 40), (-144, 40)], 6), 2, 61.5,
                      axis=1)]))),
        (YELLOW, block((-103, -30, 50), (-71, 30, 56.3), 1.5)),
        (BLACK, block((-98, -22, 50), (-76, 22, 57.0), 1.0)),
        # socket of the switch box, and cable stub
        (GREY, block((-121, -49.5, 18), (-89, -44, 36), 1)),
    ]
    for y in (-1.0, 1.0):
        solids += [(BLACK, block((-140, y * 47 - 3, 9), (-70, y * 47 + 3, 48), 2))]
        solids += [(YELLOW, plate(circle((40, y * 48), 5.5, 24), (8, 11.5)))]
        solids += [(STEEL, rod((40, y * 48, 11), (40, y * 48, 12.2), 2.6, sides=16))]
        solids += [(BLACK, block((-146 + k * 9, y * 46 - 4.5, 20), (-142 + k * 9, y * 46 + 4.5, 46),
                                 1)) for k in range(1, 8)]
    return solids


def _turret() -> Solids:
    """Return the housing of base and shoulder gears on a disc; the frame is at the shoulder."""
    side = round_corners([(-36, -33), (36, -33), (34, -10), (15, 15), (-15, 15), (-34, -10)],
                   (5, 5, 12, 14, 14, 12))
    panel = round_corners([(-30, -29), (30, -29), (28.5, -11), (19, -1), (-19, -1), (-28.5, -11)],
                    (3, 3, 8, 4, 4, 8))
    solids: Solids = [
        (BLACK, rod((0, 0, -43.7), (0, 0, -33), 45, 42, 64)),
        (YELLOW, rod((0, 0, -39), (0, 0, -37), 44.6, 44.2, 64)),
        (BLACK, plate(side, (-19.0, 19.0), axis="y")),
        (YELLOW, plate(panel, (-20.6, 20.6), axis="y")),
        (BLACK, rod((0, -22.8, 0), (0, 22.8, 0), 14)),
        # motors of the shoulder (rear) and of the rotation (front)
        (BLACK, rod((-28, 0, -16), (-45, 0, -16), 13.5, 12.5)),
        (STEEL, rod((-44, 0, -16), (-47, 0, -16), 9)),
        (BLACK, block((25, -13, -31), (43, 13, -12), 4)),
    ]
    for y in (-1.0, 1.0):
        for x, z in ((-26, -25), (26, -25), (-24, -11), (24, -11)):
            solids.append((STEEL, rod((x, y * 20, z), (x, y * 21.2, z), 2.2, sides=12)))
    return solids


def _upper_arm() -> Solids:
    """Return two side plates with posts, and gear covers at both joints."""
    profile = bar((0, 0), (0, UPPER_ARM), 17.5, 17.5, 0.72)
    holes = [circle((0, 22.5), 4.2, 24), circle((0, 45), 6.4, 24), circle((0, 67.5), 4.2, 24)]
    solids: Solids = [(BLACK, plate(profile, (s * 23.4, s * 26.0), holes, "y"))
                      for s in (-1.0, 1.0)]
    solids += [(BLACK, rod((0, -24, z), (0, 24, z), 3.6)) for z in (34.5, 55.5)]
    for s in (-1.0, 1.0):
        solids += [(STEEL, rod((0, s * 25, z), (0, s * 26.1, z), 2.9, sides=20))
                   for z in (34.5, 55.5)]
        for z in (0.0, UPPER_ARM):
            solids += [(YELLOW, rod((0, s * 25, z), (0, s * 28.5, z), 13.5, 12.0)),
                       (BLACK, rod((0, s * 28, z), (0, s * 29.3, z), 6.5)),
                       (STEEL, rod((0, s * 29, z), (0, s * 29.9, z), 2.6, sides=16))]
    return solids + _wires((-9, 20, 14), (-7, 8, 32), (-7, 8, 60), (-9, 18, 72))


def _forearm() -> Solids:
    """Return the gear box of the elbow, its yellow panels, and the side plates of the wrist."""
    core = round_corners([(-30.2, -17), (58, -17), (62.6, -8), (62.6, 8), (58, 17), (-30.2, 17)],
                   (16.9, 5, 4, 4, 5, 16.9))
    panel = round_corners([(-25.5, -13), (55, -13), (58, -6), (58, 6), (55, 13), (-25.5, 13)],
                    (12.5, 4, 3, 3, 4, 12.5))
    solids: Solids = [
        (BLACK, plate(core, (-18.5, 18.5), axis="y")),
        (BLACK, rod((0, -23.0, 0), (0, 23.0, 0), 11)),
        (BLACK, rod((40, -14, 0), (40, 14, 0), 14)),
        (BLACK, block((14, -11, 12), (44, 11, 17.1), 2)),
        (BLACK, block((22, -9, -16.95), (50, 9, -12), 1)),
    ]
    hole = circle((0, 0), 12.2, 32)
    slots = [round_corners([(19, -4), (45, -4), (45, 4), (19, 4)], 3.9)]
    for s in (-1.0, 1.0):
        solids.append((YELLOW, plate(panel, (s * 18.0, s * 21.6), [hole, *slots], "y")))
        solids += [(STEEL, rod((x, s * 21, z), (x, s * 22.1, z), 2.2, sides=12))
                   for x, z in ((-18, 0), (17, 9.5), (17, -9.5), (50, 8.5), (50, -8.5))]
        link = bar((50, 0), (FOREARM, 0), 14.5, 13.0, 0.7)
        solids.append((BLACK, plate(link, (s * 15.4, s * 17.8),
                                    [circle((74, 0), 5, 24), circle((91, 0), 3.6, 24)], "y")))
        solids += [(YELLOW, rod((FOREARM, s * 17, 0), (FOREARM, s * 20.2, 0), 10.0, 9.0)),
                   (STEEL, rod((FOREARM, s * 20, 0), (FOREARM, s * 21, 0), 2.6, sides=16))]
    solids += [(BLACK, rod((82.5, -16, 0), (82.5, 16, 0), 3.2, sides=20))]
    return solids + _wires((30, -4, 16.5), (56, -4, 18.5), (72, -6, 10), (98, -12, 8))


def _wires(*points: tuple[float, float, float]) -> Solids:
    """Return three parallel wires along a polyline."""
    return [(m, move_surface(rod(a, b, 0.9, sides=8), transform(None, (0, 2.1 * k, 0))))
            for k, m in enumerate(WIRES) for a, b in pairwise(points)]


def _hand() -> Solids:
    """Return the gear box of wrist and gripper, its lamp, and the forks of the cranks."""
    core = round_corners([(-12.5, -11.5), (12, -11.5), (18, -12.5), (36, -12.5), (36, 12.5),
                          (18, 12.5), (12, 11.5), (-12.5, 11.5)], (11.4, 3, 3, 3, 3, 3, 3, 11.4))
    wide = round_corners([(15.5, -10), (34, -10), (34, 10), (15.5, 10)], 2.5)
    solids: Solids = [
        (BLACK, plate(core, (-14.6, 14.6), axis="y")),
        (YELLOW, plate(wide, (-16.6, 16.6), axis="y")),
        (BLACK, rod((0, -15.2, 0), (0, 15.2, 0), 8)),
        # motor of the gripper, below
        (BLACK, rod((4, 0, -15), (31, 0, -15), 9.0)),
        (STEEL, rod((2, 0, -15), (5, 0, -15), 6.0)),
        # lamp, above
        (BLACK, block((14, -7, 10), (36, 7, 16), 2)),
        (BLACK, rod((15, 0, 19.2), (30, 0, 19.2), 5.2, 6.5)),
        (BLACK, rod((30, 0, 19.2), (43.2, 0, 19.2), 6.5)),
        (LENS, rod((43, 0, 19.2), (45.4, 0, 19.2), 5.0, 3.4)),
    ]
    for z in (-1.0, 1.0):
        fork = round_corners([(14, -21), (24, -21), (37, -15.5), (37, 15.5), (24, 21), (14, 21)],
                       (3, 6, 3, 3, 6, 3))
        solids.append((BLACK, plate(fork, (z * 10.4, z * 12.4))))
    for s in (-1.0, 1.0):
        solids += [(STEEL, rod((x, s * y, -13), (x, s * y, 13), 2.0, sides=16)) for x, y in _PIVOTS]
    return solids


def _crank(end: tuple[float, float], layer: float) -> Solids:
    """Return two bars from the pivot to `end` mm, at z = +-`layer` mm."""
    profile = bar((0, 0), end, 3.6, 3.6, 0.8)
    return [(BLACK, plate(profile, (z * (layer - 1.2), z * (layer + 1.2)))) for z in (-1.0, 1.0)]


def _finger(sign: float) -> Solids:
    """Return the left (sign 1) or right (-1) finger; the frame is at the outer crank's end."""
    x, y = _PIVOTS[0][0] + _CRANK * np.cos(_CLOSED), _PIVOTS[0][1] + _CRANK * np.sin(_CLOSED)
    inner = _PIVOTS[1][0] + _CRANK * np.cos(_CLOSED), _PIVOTS[1][1] + _CRANK * np.sin(_CLOSED)

    def place(s: TriangleSurface) -> TriangleSurface:
        """Move from the hand frame, left finger closed; mirror for the right finger."""
        at_pivot = move_surface(s, transform(None, (-x, -y, 0.0)))
        return move_surface(at_pivot, np.eye(4), (1.0, sign, 1.0))

    body = round_corners([(x - 4, y - 3), (inner[0], 2.2), (75, 2.2), (75, 5), (inner[0] + 3, 9),
                    (x, y + 4), (x - 4, y + 3)], (2.5, 2, 0.9, 1.5, 3, 2.5, 2.5))
    solids: Solids = [
        (BLACK, plate(body, (-3.2, 3.2))),
        (BLACK, plate(round_corners([(inner[0], 2.2), (75, 2.2), (75, 4.2), (inner[0] + 1, 5.4)],
                              (0.4, 0.8, 0.8, 0.8)), (-13.0, 13.0))),
        (FOAM, block((inner[0] + 1, 0.0, -12), (74.4, 2.6, 12), 0.6)),
    ]
    solids += [(STEEL, rod((*at, -10.5), (*at, 10.5), 1.8, sides=16)) for at in ((x, y), inner)]
    return [(m, place(s)) for m, s in solids]
