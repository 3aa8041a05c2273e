"""A model in motion: the vertices of its rigid and deforming surfaces in each frame."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply, inverse
from ...robots.model import ArticulatedModel, ModelState, Visual, deform_visual, forward_kinematics
from .clip_space import box_corners

_Cached = TypeVar("_Cached")
_CACHE_BYTES = 2**28  # bytes of cached vertices


class PosedModel:
    """A model in its states at T instants. Vertices are computed on demand and cached.

    Triangles and vertices are numbered consecutively over all visuals, in their order.
    """

    def __init__(self, model: ArticulatedModel, state: ModelState) -> None:
        self.model, self.state = model, state
        self.deforming = tuple(v for v in model.visuals if v.deforms)
        self._surfaces = OrderedDict[int, tuple[tuple[Array, Array], ...]]()
        self._vertices = OrderedDict[int, Array]()

    @property
    def world_from_part(self) -> Array:
        """[T P 4 4]"""
        return self.state.world_from_part

    def surfaces(self, t: int) -> tuple[tuple[Array, Array], ...]:
        """Return world vertices [V 3] m and normals [V 3] of each deforming visual at instant t."""
        return self._look_up(self._surfaces, t, lambda: tuple(
            self._deform(visual, t) for visual in self.deforming))

    def vertices(self, t: int) -> Array:
        """Return the vertices [V 3] m (world) of all visuals at instant t."""
        def of_visuals() -> Iterator[Array]:
            yield np.zeros((0, 3))
            moved = iter(self.surfaces(t))
            for v in self.model.visuals:
                pose = self.world_from_part[t, v.part]
                yield next(moved)[0] if v.deforms else apply(pose, v.vertices)

        return self._look_up(self._vertices, t, lambda: np.concatenate([*of_visuals()]))

    @cached_property
    def bounds(self) -> Array:
        """World points [N 3] m that bound all deforming visuals at all instants."""
        boxes = [box_corners(vertices) for t in range(len(self.world_from_part))
                 for vertices, _ in self.surfaces(t)]
        return np.concatenate([np.zeros((0, 3)), *boxes])

    @cached_property
    def faces(self) -> NDArray[np.int64]:
        """[F 3] vertex numbers of the triangles: rows of `vertices`."""
        starts = np.cumsum([0, *(len(v.vertices) for v in self.model.visuals)])
        found = [v.faces + start for v, start in zip(self.model.visuals, starts, strict=False)]
        return np.concatenate([np.zeros((0, 3), np.int64), *found])

    @cached_property
    def face_deforms(self) -> NDArray[np.bool_]:
        """[F] whether the triangle deforms relative to its part."""
        faces = [len(v.faces) for v in self.model.visuals]
        return np.repeat(np.array([v.deforms for v in self.model.visuals], bool), faces)

    def _deform(self, visual: Visual, t: int) -> tuple[Array, Array]:
        p = self.state
        stretch = None if p.stretch is None else p.stretch[t]
        return deform_visual(visual, p.world_from_part[t], stretch, p.morph[t])

    def _look_up(
        self, cache: OrderedDict[int, _Cached], t: int, make: Callable[[], _Cached]
    ) -> _Cached:
        if t not in cache:
            size = 48 * max(sum(len(v.vertices) for v in self.model.visuals), 1)
            while len(cache) >= max(4, _CACHE_BYTES // size):
                cache.popitem(last=False)
            cache[t] = make()
        return cache[t]


def pose_parts(model: ArticulatedModel, world_from_part: Array) -> PosedModel:
    """Return the model with parts in poses [T P 4 4], with morph weights and scale at rest."""
    weights = np.broadcast_to(model.morph_weights, (len(world_from_part), len(model.morph_weights)))
    return PosedModel(model, ModelState(world_from_part, None, weights))


def rest(model: ArticulatedModel) -> PosedModel:
    """Return the model (one instant) with every joint at zero."""
    poses = forward_kinematics(model, np.zeros((1, len(model.joint_names))))
    return pose_parts(model, poses)


def rest_in_part(model: ArticulatedModel) -> Array:
    """Return every vertex [V 3] m at rest, in the frame of its visual's part."""
    still = rest(model)
    vertices, end = still.vertices(0).copy(), 0
    for v in model.visuals:
        begin, end = end, end + len(v.vertices)
        part_from_world = inverse(still.world_from_part[0, v.part])
        vertices[begin:end] = apply(part_from_world, vertices[begin:end]) if v.deforms \
            else v.vertices
    return vertices
