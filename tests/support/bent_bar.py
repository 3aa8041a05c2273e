"""A bar that two bones bend, in closed form: what a skinned model must do.

The bar lies along x from 0 to 1 m, 0.1 m thick. Bone "low" holds x < 0.4, bone "high" x > 0.6,
in between they share; "high" turns by an angle about the axis through (0.5, 0, 0) along y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from gcbench.robots.geometry import rotation_about, transform
from gcbench.robots.model import (
    Animation,
    ArticulatedModel,
    Joint,
    JointType,
    Link,
    Material,
    ModelState,
    Morph,
    Skin,
    Visual,
)

HINGE = np.array([0.5, 0.0, 0.0])
MESH_SCALE = 100.0
"""The mesh is stored in centimetres, which the inverse bind matrices undo."""


def bent(points: np.ndarray, angle: float) -> np.ndarray:
    """Where points [N 3] of the straight bar go."""
    share = np.clip((points[:, :1] - 0.4) / 0.2, 0.0, 1.0)
    turned = (points - HINGE) @ rotation_about([0.0, 1.0, 0.0], angle).T + HINGE
    return (1 - share) * points + share * turned


def grid(n: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and normals of the bar's four long sides and two ends."""
    vertices, faces, normals = [], [], []

    def sheet(corner, along, across, rows, columns):
        normal = np.cross(along, across)
        start = sum(len(v) for v in vertices)
        a, b = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1),
                           indexing="ij")
        points = corner + a[..., None] * along + b[..., None] * across
        vertices.append(points.reshape(-1, 3))
        normals.append(np.tile(normal / np.linalg.norm(normal), (points[..., 0].size, 1)))
        i = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel() + start
        faces.append(np.stack([i, i + columns + 1, i + columns + 2], 1))
        faces.append(np.stack([i, i + columns + 2, i + 1], 1))

    x, y, z = np.array([1.0, 0, 0]), np.array([0, 0.1, 0]), np.array([0, 0, 0.1])
    low = np.array([0.0, -0.05, -0.05])
    sheet(low + z, x, y, n, 4)
    sheet(low + y, x, -y, n, 4)
    sheet(low, x, z, n, 4)
    sheet(low + y + z, x, -z, n, 4)
    sheet(low + x, y, z, 4, 4)
    sheet(low, z, y, 4, 4)
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32), np.concatenate(normals)


@dataclass(frozen=True)
class Swing:
    """The hinge from 0 to 1 rad and back, in a second; the bar rises by 0.1 m meanwhile."""

    name: str = "swing"
    duration: float = 1.0
    bulge: float = 0.0
    """Of the morph channel, at the end."""

    def angle(self, times):
        return np.sin(np.pi * np.asarray(times))

    def at(self, times: np.ndarray) -> ModelState:
        times = np.clip(times, 0, self.duration)
        root = transform(None, np.stack([0 * times, 0 * times, 0.1 * times], -1))
        turn = transform(rotation_about(np.array([0.0, 1.0, 0.0]), self.angle(times)), None)
        poses = np.stack([root, root @ transform(None, HINGE) @ turn], axis=1)
        return ModelState(poses, None, self.bulge * times[:, None])


def bar(animations: tuple[Animation, ...] = (), morph: bool = False,
        block: bool = False) -> ArticulatedModel:
    """The bar; `morph`: its upper side can bulge by 5 cm; `block`: a rigid one rides on "high"."""
    points, faces, normals = grid()
    into_high = transform(None, -HINGE)
    scale = np.diag([1 / MESH_SCALE] * 3 + [1.0])
    share = np.clip((points[:, 0] - 0.4) / 0.2, 0.0, 1.0)
    skin = Skin(np.array([0, 1]), np.stack([scale, into_high @ scale]),
                np.tile([0, 1], (len(points), 1)), np.stack([1 - share, share], 1))
    bulge = None
    if morph:
        up = np.where(points[:, 2:] > 0.049, [[0, 0, 0.05 * MESH_SCALE]], 0.0)
        bulge = Morph(np.array([0]), up[None], None)
    grey = Material("grey", (0.6, 0.5, 0.3, 1.0))
    mostly_high = share[faces].mean(1) > 0.5
    visuals = tuple(
        Visual(part, points * MESH_SCALE, faces[mostly_high == bool(part)], normals, None,
               grey, skin, bulge) for part in (0, 1))
    if block:
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        triangles = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
        visuals += (Visual(1, corners * 0.15 + [0.3, -0.07, 0.06], np.array(triangles, np.int32),
                           np.tile([0, 0, 1.0], (8, 1)), None, replace(grey, name="block")),)
    bend = Joint("bend", JointType.REVOLUTE, (0.0, 1.0, 0.0), limits=(-1.2, 1.2))
    links = [Link("low"), Link("high", "low", transform(None, HINGE), bend)]
    return replace(
        ArticulatedModel.from_links("bar", links), visuals=visuals, animations=animations,
        morph_weights=np.zeros(int(morph)),
        keypoint_names=("foot", "tip"), keypoint_part=np.array([0, 1]),
        keypoint=np.array([[0.0, 0.0, 0.05], [0.5, 0.0, 0.05]]))
