"""Contact of a moving model with itself and with the ground."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, apply
from ..model import ArticulatedModel
from .floor_contact import FLOOR_TOLERANCE, RigidGroups, ground_height, random_poses, rest_poses

__all__ = ["GROUND", "CollisionChecker", "Contact", "ground_height"]

GROUND = "the ground"
_ALWAYS = 0.95


@dataclass(frozen=True)
class Contact:
    """The first contact of a motion."""

    frame: int
    a: str
    """Name of the first part of a rigid group (parts that fixed joints join)."""
    b: str
    """The same of the other group, or GROUND."""


class CollisionChecker:
    """Contact between the visible surfaces of a model's rigid groups: exact triangle tests.

    Which pairs of groups count follows the rule of MoveIt's setup assistant: not the ones that a
    joint joins (through groups without a surface, too), not the ones that touch in the rest pose
    (all joints at zero, or at the limit nearest to it), and not the ones that touch in at least
    95 % of 50 random configurations. What is left out so is a matter of the meshes (covers that
    overlap), not of the motion. Meshes are not simplified, for nothing would be won: 15 frames of
    an arm of 100,000 triangles take milliseconds. Surfaces are tested, not volumes: a group
    that lies whole inside another one, without crossing it, is not found. Nothing is tested
    between frames. To be built once for a model; between calls it holds only what it has built of
    the groups that came near each other.
    """

    def __init__(self, model: ArticulatedModel) -> None:
        self.model = model
        self.groups = RigidGroups(model)
        self._bodies: dict[int, Any] = {}
        self._centres = {group: (hull.min(0) + hull.max(0)) / 2.0 for group, hull
                         in zip(self.groups.surfaces, self.groups.hulls, strict=True)}
        self._radii = {group: float(np.linalg.norm(hull - self._centres[group], axis=1).max())
                       for group, hull
                       in zip(self.groups.surfaces, self.groups.hulls, strict=True)}
        self.pairs = self._pairs_that_count()
        """Pairs of groups, each named by the index of its first part."""

    def touches(self, world_from_part: ArrayLike, floor_z: float | None) -> bool:
        """Return whether the model at poses [P 4 4] touches itself or the ground at floor_z (m)."""
        poses = np.asarray(world_from_part, np.float64)
        return self.first_contact(poses[None], floor_z) is not None

    def first_contact(self, world_from_part: ArrayLike, floor_z: float | None) -> Contact | None:
        """The first contact over poses [T P 4 4]: with the ground at floor_z (m; None: there is
        none), else between groups that count; None if there is no contact.

        Only moving groups can touch the ground: what is fixed stands on it, or in it.
        """
        poses = np.asarray(world_from_part, np.float64)
        names = self.model.part_names
        floor = -np.inf if floor_z is None else floor_z - FLOOR_TOLERANCE
        below = self.groups.lowest(poses) < floor
        for t, frame in enumerate(poses):
            for i, group in enumerate(self.groups.surfaces):
                if below[t, i] and group != self.groups.group[0]:
                    return Contact(t, names[group], GROUND)
            for a, b in self._touching(frame, self.pairs):
                return Contact(t, names[a], names[b])
        return None

    def ground_height(self, world_from_part: ArrayLike) -> float:
        """See RigidGroups.ground_height; [T P 4 4]."""
        return self.groups.ground_height(world_from_part)

    def _touching(self, poses: Array, pairs: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
        import fcl

        centres = {g: apply(poses[g], c[None])[0] for g, c in self._centres.items()}
        placed = set[int]()
        for a, b in pairs:
            if np.linalg.norm(centres[a] - centres[b]) > self._radii[a] + self._radii[b]:
                continue
            for group in {a, b} - placed:
                if group not in self._bodies:  # of a large mesh it takes seconds
                    self._bodies[group] = _body(*self.groups.surfaces[group])
                self._bodies[group].setTransform(
                    fcl.Transform(poses[group, :3, :3], poses[group, :3, 3]))
                placed.add(group)
            if fcl.collide(self._bodies[a], self._bodies[b],
                           fcl.CollisionRequest(), fcl.CollisionResult()):
                yield a, b

    def _pairs_that_count(self) -> list[tuple[int, int]]:
        joined = {(self._towards_base(group), group) for group in self.groups.surfaces}
        pairs = [pair for pair in combinations(self.groups.surfaces, 2) if pair not in joined]
        at_rest = set(self._touching(rest_poses(self.model), pairs))
        pairs = [pair for pair in pairs if pair not in at_rest]
        configurations = random_poses(self.model)
        often = dict.fromkeys(pairs, 0)
        for poses in configurations:
            for pair in self._touching(poses, pairs):
                often[pair] += 1
        return [pair for pair in pairs if often[pair] < _ALWAYS * len(configurations)]

    def _towards_base(self, group: int) -> int:
        """The nearest group towards the base that has a surface, or -1."""
        part = int(self.model.parent[group])
        while part >= 0 and int(self.groups.group[part]) not in self.groups.surfaces:
            part = int(self.model.parent[self.groups.group[part]])
        return int(self.groups.group[part]) if part >= 0 else -1


def _body(vertices: Array, faces: NDArray[np.int32]) -> Any:
    import fcl

    mesh = fcl.BVHModel()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addSubModel(vertices, faces)
    mesh.endModel()
    return fcl.CollisionObject(mesh)
