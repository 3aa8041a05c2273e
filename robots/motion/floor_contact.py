"""Rigid groups of a model, their lowest points, and the height of the ground below it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, apply, hull_vertices, inverse
from ..model import ArticulatedModel, Visual, forward_kinematics
from .trajectory import joint_window

FLOOR_TOLERANCE = 1e-3
"""Depth below the ground, m, up to which a part does not count as touching it."""
_SAMPLES = 50
_UPRIGHT = 0.1  # least share of random configurations with nothing below the root's group


class RigidGroups:
    """Surfaces of a model by rigid group (parts connected by fixed joints).

    The index of its first part identifies a group; groups without a surface are omitted.
    """

    def __init__(self, model: ArticulatedModel) -> None:
        self.model = model
        self.group = np.arange(len(model.parent))
        """[P] group of each part."""
        for p, parent in enumerate(model.parent):
            if parent >= 0 and model.joint[p] < 0:
                self.group[p] = self.group[parent]
        self.surfaces: dict[int, tuple[Array, NDArray[np.int32]]] = {}
        """Vertices [V 3] in the frame of the group's first part, and faces [F 3]."""
        self._root, self._reach = np.zeros((0, 0)), np.zeros((0, 0))
        # `_reach` [N G]: `lowest` of `_tries` with the root at `_root`, which seldom changes.
        rest = rest_poses(model)
        by_group: dict[int, list[Visual]] = {}
        for visual in model.visuals:
            if len(visual.faces):
                by_group.setdefault(int(self.group[visual.part]), []).append(visual)
        for group, visuals in sorted(by_group.items()):
            starts = np.cumsum([0] + [len(v.vertices) for v in visuals])
            self.surfaces[group] = (
                np.concatenate([apply(inverse(rest[group]) @ rest[v.part], v.vertices)
                                for v in visuals]),
                np.concatenate([v.faces + np.int32(start)
                                for v, start in zip(visuals, starts, strict=False)]))

    @cached_property
    def hulls(self) -> list[Array]:
        """The vertices [H 3] of the convex hull of each group."""
        return [hull_vertices(vertices) for vertices, _ in self.surfaces.values()]

    @cached_property
    def _tries(self) -> Array:
        """Poses [N P 4 4] at rest and in random configurations."""
        return np.concatenate([rest_poses(self.model)[None], random_poses(self.model)])

    def lowest(self, world_from_part: ArrayLike) -> Array:
        """Return the height [... G] m of the lowest point of each group at poses [... P 4 4]."""
        poses = np.asarray(world_from_part, np.float64)
        heights = np.full((*poses.shape[:-3], len(self.surfaces)), np.inf)
        for i, (group, hull) in enumerate(zip(self.surfaces, self.hulls, strict=True)):
            up = poses[..., group, 2, :]
            heights[..., i] = (up[..., :3] @ hull.T).min(axis=-1) + up[..., 3]
        return heights

    def ground_height(self, world_from_part: ArrayLike) -> float:
        """Return the height (m) of the ground below a model that moves through poses [T P 4 4].

        It is the lowest point of the root's rigid group if the model stands on that group, i.e. if
        nothing is lower at rest or in a tenth of random configurations (an arm can reach below
        its table and rise above it; legs and wheels are always below their body). Otherwise, or
        if that group has no surface, it is the lowest point of any part; 0 without a surface.
        """
        poses = np.asarray(world_from_part, np.float64)
        lowest = self.lowest(poses)
        if not self.surfaces:
            return 0.0
        fixed = np.array([group == self.group[0] for group in self.surfaces])
        if not fixed.any():
            return float(lowest.min())
        base = float(lowest[0, fixed].min())
        if not np.array_equal(poses[0, 0], self._root):
            self._root, self._reach = poses[0, 0], self.lowest(poses[0, 0] @ self._tries)
        above: NDArray[np.bool_] = np.all(self._reach[:, ~fixed] >= base - FLOOR_TOLERANCE, axis=1)
        return base if above[0] or above.mean() >= _UPRIGHT else float(lowest.min())


def ground_height(model: ArticulatedModel, world_from_part: ArrayLike) -> float:
    """Return `RigidGroups.ground_height` of a model."""
    return RigidGroups(model).ground_height(world_from_part)


def rest_poses(model: ArticulatedModel) -> Array:
    """Return root_from_part [P 4 4] with each joint at the value in its limits nearest to zero."""
    return forward_kinematics(model, np.clip(0.0, model.limits[:, 0], model.limits[:, 1]))


def random_poses(model: ArticulatedModel) -> Array:
    """Return root_from_part [50 P 4 4] of random configurations, the same at every call."""
    windows = np.array([joint_window(model, j) for j in range(len(model.joint_names))])
    low, high = windows.reshape(-1, 2).T
    rng = np.random.default_rng(0)  # fixed: the ground height is a property of the model
    return forward_kinematics(model, rng.uniform(low, high, (_SAMPLES, len(low))))
