"""Rigid groups of a model, how low they reach, and where the ground under it is."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, apply, hull_vertices, inverse
from ..model import ArticulatedModel, forward_kinematics
from .trajectory import joint_window

FLOOR_TOLERANCE = 1e-3
"""m that a part may be below the ground without touching it."""
_SAMPLES = 50
_UPRIGHT = 0.1  # share of random configurations in which an arm is wholly above its own foot


class RigidGroups:
    """The surfaces of a model by rigid group: parts that fixed joints join, in the first's frame.

    A group is named by the index of its first part; groups without a surface are left out.
    """

    def __init__(self, model: ArticulatedModel) -> None:
        self.model = model
        self.group = np.arange(len(model.parent))
        """[P] the group of each part."""
        for p, parent in enumerate(model.parent):
            if parent >= 0 and model.joint[p] < 0:
                self.group[p] = self.group[parent]
        self.surfaces: dict[int, tuple[Array, NDArray[np.int32]]] = {}
        """Vertices [V 3] in the frame of the group's first part, and faces [F 3]."""
        rest = rest_poses(model)
        for group in (int(g) for g in np.unique(self.group)):
            visuals = [v for v in model.visuals
                       if self.group[v.part] == group and len(v.faces)]
            if visuals:
                starts = np.cumsum([0] + [len(v.vertices) for v in visuals])
                self.surfaces[group] = (
                    np.concatenate([apply(inverse(rest[group]) @ rest[v.part], v.vertices)
                                    for v in visuals]),
                    np.concatenate([v.faces + np.int32(start)
                                    for v, start in zip(visuals, starts, strict=False)]))

    @cached_property
    def hulls(self) -> list[Array]:
        """For each group, the points [H 3] that a plane can touch from outside."""
        return [hull_vertices(vertices) for vertices, _ in self.surfaces.values()]

    @cached_property
    def _tries(self) -> Array:
        """[N P 4 4] the rest pose, and random ones."""
        return np.concatenate([rest_poses(self.model)[None], random_poses(self.model)])

    def lowest(self, world_from_part: ArrayLike) -> Array:
        """[... G] height (m) of the lowest point of each group at poses [... P 4 4]."""
        poses = np.asarray(world_from_part, np.float64)
        heights = np.full((*poses.shape[:-3], len(self.surfaces)), np.inf)
        for i, (group, hull) in enumerate(zip(self.surfaces, self.hulls, strict=True)):
            up = poses[..., group, 2, :]
            heights[..., i] = (up[..., :3] @ hull.T).min(axis=-1) + up[..., 3]
        return heights

    def ground_height(self, world_from_part: ArrayLike) -> float:
        """Height (m) of the ground under the model that moves through poses [T P 4 4].

        It is the lowest point of the root's rigid group where the model stands on that: where
        nothing is lower in the rest pose, or in a tenth of random configurations (an arm may hang
        over the edge of its table and can also rise above it; legs and wheels are always below
        the body that they carry). Otherwise, or if that group has no surface, it is the lowest
        point that any part reaches; 0 for a model without a surface.
        """
        poses = np.asarray(world_from_part, np.float64)
        lowest = self.lowest(poses)
        if not self.surfaces:
            return 0.0
        fixed = np.array([group == self.group[0] for group in self.surfaces])
        if not fixed.any():
            return float(lowest.min())
        base = float(lowest[0, fixed].min())
        tries = self.lowest(poses[0, 0] @ self._tries)[:, ~fixed]
        above: NDArray[np.bool_] = np.all(tries >= base - FLOOR_TOLERANCE, axis=1)
        return base if above[0] or above.mean() >= _UPRIGHT else float(lowest.min())


def ground_height(model: ArticulatedModel, world_from_part: ArrayLike) -> float:
    """RigidGroups.ground_height, for a model that is asked about once."""
    return RigidGroups(model).ground_height(world_from_part)


def rest_poses(model: ArticulatedModel) -> Array:
    """root_from_part [P 4 4] with every joint at zero, or at the limit that is nearest to it."""
    return forward_kinematics(model, np.clip(0.0, model.limits[:, 0], model.limits[:, 1]))


def random_poses(model: ArticulatedModel) -> Array:
    """root_from_part [50 P 4 4] of random configurations, always the same ones for a model."""
    windows = np.array([joint_window(model, j) for j in range(len(model.joint_names))])
    low, high = windows.reshape(-1, 2).T
    rng = np.random.default_rng(0)  # what follows from these is a property of the model
    return forward_kinematics(model, rng.uniform(low, high, (_SAMPLES, len(low))))
