"""Contact of a moving model with itself and with the ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import ModelError
from ..files import show_progress
from ..geometry import Array
from ..model import ArticulatedModel
from .floor_contact import FLOOR_TOLERANCE, RigidGroups, ground_height, random_poses, rest_poses

__all__ = ["GROUND", "CollisionChecker", "Contact", "ground_height"]

GROUND = "the ground"
MAX_TESTS = 1_000_000
"""Limit on the exact tests of a model's pairs of bodies in the 51 poses that tell which count."""
_ALWAYS = 0.95
_MARGIN = 1e-6  # m around the boxes, more than their rounding


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
    95 % of 50 random configurations. Such contacts come from the meshes (covers that overlap), not
    from the motion. Meshes are not simplified: 15 frames of an arm of 100,000 triangles take
    milliseconds. The test is of surfaces, not volumes: a group that lies whole inside another one,
    without crossing it, is not found. Nothing is tested between frames.

    Build it once for a model. It keeps the trees of the groups that came near each other.

    Raises:
        ModelError: If more than MAX_TESTS pairs are near each other in these 51 poses.
    """

    def __init__(self, model: ArticulatedModel) -> None:
        self.model = model
        self.groups = RigidGroups(model)
        self._bodies: dict[int, Any] = {}
        self._numbers = np.array(list(self.groups.surfaces), np.int64)
        boxes = np.array([(hull.min(0), hull.max(0)) for hull in self.groups.hulls])
        low, high = boxes.reshape(-1, 2, 3).swapaxes(0, 1)
        self._middle, self._half = (low + high) / 2.0, (high - low) / 2.0
        self.ignored = {(self._towards_base(group), group) for group in self.groups.surfaces}
        """Pairs of groups whose contact does not count, named by their first parts, in order."""
        self._ignore_usual_contacts()

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
            for a, b in self._touching_pairs(frame, self._near(frame)):
                return Contact(t, names[a], names[b])
        return None

    def ground_height(self, world_from_part: ArrayLike) -> float:
        """See RigidGroups.ground_height; [T P 4 4]."""
        return self.groups.ground_height(world_from_part)

    def _near(self, poses: Array) -> list[tuple[int, int]]:
        """Return the pairs that count and whose boxes overlap at poses [P 4 4], in order."""
        frames = poses[self._numbers]
        middle = (frames[:, :3, :3] @ self._middle[:, :, None])[:, :, 0] + frames[:, :3, 3]
        reach = (np.abs(frames[:, :3, :3]) @ self._half[:, :, None])[:, :, 0] + _MARGIN
        pairs = self._numbers[overlapping_boxes(middle - reach, middle + reach)]
        return [(a, b) for a, b in pairs.tolist() if (a, b) not in self.ignored]

    def _touching_pairs(
        self, poses: Array, pairs: Iterable[tuple[int, int]]
    ) -> Iterator[tuple[int, int]]:
        """Yield the pairs whose triangles intersect at poses [P 4 4]."""
        import fcl

        placed = set[int]()
        for a, b in pairs:
            for group in {a, b} - placed:
                if group not in self._bodies:  # of a large mesh it takes seconds
                    self._bodies[group] = _body(*self.groups.surfaces[group])
                self._bodies[group].setTransform(
                    fcl.Transform(poses[group, :3, :3], poses[group, :3, 3]))
                placed.add(group)
            if fcl.collide(self._bodies[a], self._bodies[b],
                           fcl.CollisionRequest(), fcl.CollisionResult()):
                yield a, b

    def _ignore_usual_contacts(self) -> None:
        """Ignore the pairs that touch at rest or in most random configurations."""
        configurations = random_poses(self.model)
        often = Counter[tuple[int, int]]()
        tests = 0
        for k, poses in enumerate(show_progress([rest_poses(self.model), *configurations],
                                                "testing for contact")):
            near = self._near(poses)
            tests += len(near)
            if tests > MAX_TESTS:
                raise ModelError(
                    f"{self.model.name}: more than {MAX_TESTS} pairs of its {len(self._numbers)} "
                    "moving bodies are near each other, too many to test for contact; join bodies "
                    "by fixed joints")
            touching = self._touching_pairs(poses, near)
            often.update(touching) if k else self.ignored.update(touching)
        least = _ALWAYS * len(configurations)
        self.ignored |= {pair for pair, count in often.items() if count >= least}

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


def overlapping_boxes(low: Array, high: Array) -> NDArray[np.int64]:
    """Return the pairs [N 2], first < second, sorted, of boxes [G 3] that overlap.

    A sweep along the axis on which the fewest intervals overlap.
    """
    if len(low) < 2:
        return np.zeros((0, 2), np.int64)
    numbers = np.arange(len(low))
    sweeps: list[tuple[int, NDArray[np.int64], NDArray[np.int64]]] = []
    for axis in range(3):
        order = np.argsort(low[:, axis], kind="stable")
        ends = np.searchsorted(low[order, axis], high[order, axis], side="right")
        later = ends - numbers - 1  # boxes that begin within this one
        sweeps.append((int(later.sum()), order, later))
    _, order, later = min(sweeps, key=lambda sweep: sweep[0])
    first = np.repeat(numbers, later)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(later) - later, later)
    a, b = order[first], order[second]
    for axis in range(3):
        keep = (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
        a, b = a[keep], b[keep]
    pairs = np.stack([np.minimum(a, b), np.maximum(a, b)], axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
