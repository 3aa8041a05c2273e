"""Animations of a glTF file: keyed translations, rotations, scales and morph weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from ..geometry import Array, inverse, rotation_from_quaternion, transform
from ..model import ModelState
from .accessors import Accessors
from .document import GltfDocument
from .nodes import Z_UP, NodeTree, Rig
from .records import AnimationSampler, GltfAnimation

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3", "weights": "SCALAR"}
_SAME = 1e-7
"""Largest relative difference from the rest value at which a track counts as constant."""
_SIMILAR = 1e-6
_FLAT = 1e-4
"""Below this ratio of smallest to largest singular value, a nearest rotation is ill-defined."""
MAX_KEY_NUMBERS = 2**27
"""Limit on times and values of all channels; it bounds the memory and the reading time."""


@dataclass(frozen=True)
class Track:
    """One animated property of one node, with K keys."""

    node: int
    path: str
    times: Array
    """[K] s"""
    values: Array
    """[K C]; for a cubic spline [K 3 C]: in-tangent, value, out-tangent"""
    interpolation: str

    def at(self, times: Array) -> Array:
        """Return the values [T C] at times [T] s; quaternions are normalised."""
        t = np.clip(times, self.times[0], self.times[-1])
        last = len(self.times) - 1
        k = np.searchsorted(self.times, t, side="right") - 1
        if self.interpolation == "STEP" or last == 0:
            found = self.values[k] if self.values.ndim == 2 else self.values[k, 1]
            return _unit(found) if self.path == "rotation" else found
        k = np.minimum(k, last - 1)
        span = (self.times[k + 1] - self.times[k])[:, None]
        u = (t - self.times[k])[:, None] / span
        if self.interpolation == "CUBICSPLINE":
            (a, out), (into, b) = ((self.values[k, 1], self.values[k, 2]),
                                   (self.values[k + 1, 0], self.values[k + 1, 1]))
            u2, u3 = u * u, u * u * u
            found = ((2 * u3 - 3 * u2 + 1) * a + span * (u3 - 2 * u2 + u) * out
                     + (3 * u2 - 2 * u3) * b + span * (u3 - u2) * into)
            return _unit(found) if self.path == "rotation" else found
        a, b = self.values[k], self.values[k + 1]
        return slerp(a, b, u) if self.path == "rotation" else a + u * (b - a)


@dataclass(frozen=True)
class KeyedAnimation:
    """Animation of a glTF file; implements `model.Animation`. P parts, M morph channels."""

    name: str
    duration: float
    """s"""
    tree: NodeTree
    rig: Rig
    tracks: tuple[Track, ...]
    moves: NDArray[np.bool_]
    """[P] whether the part moves"""
    stretches: NDArray[np.bool_]
    """[P] whether the motion of the part may be non-rigid"""
    morph_weights: Array
    """[M] weights at rest"""
    channels: Mapping[int, slice]
    """Morph channels by node number, for nodes with morph targets."""

    def at(self, times: Array) -> ModelState:
        """Return the state at times [T] s, constant before the first key and after the last."""
        times = np.asarray(times, np.float64)
        by_node: dict[int, dict[str, Array]] = {}
        morph = np.tile(self.morph_weights, (len(times), 1))
        for track in self.tracks:
            if track.path != "weights":
                by_node.setdefault(track.node, {})[track.path] = track.at(times)
            elif track.node in self.channels:
                morph[:, self.channels[track.node]] = track.at(times)
        rig, tree = self.rig, self.tree
        poses = np.tile(rig.world_from_part, (len(times), 1, 1, 1))
        stretch = np.tile(np.eye(4), (*poses.shape[:2], 1, 1)) if self.stretches.any() else None
        rest = rig.world_from_part @ rig.part_from_node
        world: dict[int, Array] = {0: rest[0]}
        turn: dict[int, Array] = {0: Z_UP}  # product of the rotations, without scale
        for p in range(1, len(rig.node)):
            n, above = int(rig.node[p]), int(rig.parent[p])
            if not self.moves[p]:
                world[p], turn[p] = rest[p], rig.world_from_part[p, :3, :3]
                continue
            keyed = by_node.get(n, {})
            rotation, scale = keyed.get("rotation"), keyed.get("scale")
            spin = rotation_from_quaternion(tree.rotation[n] if rotation is None else rotation)
            linear = tree.linear[n]
            if rotation is not None or scale is not None:
                linear = spin * (tree.scale[n] if scale is None else scale)[..., None, :]
            shift = keyed.get("translation")
            world[p] = world[above] @ transform(linear, tree.translation[n] if shift is None
                                                else shift)
            turn[p] = turn[above] @ spin
            moved = world[p] @ np.linalg.inv(rig.part_from_node[p])
            poses[:, p, :3, 3] = moved[..., :3, 3]
            poses[:, p, :3, :3] = _rotation_in(moved[..., :3, :3], turn[p])
            if stretch is not None and self.stretches[p]:
                stretch[:, p, :3, :3] = (inverse(poses[:, p]) @ moved)[:, :3, :3]
        return ModelState(poses, stretch, morph)


def _rotation_in(linear: Array, fallback: Array) -> Array:
    """Return the nearest rotation to each [... 3 3]; the fallback if it mirrors or is singular."""
    u, s, v = np.linalg.svd(linear)
    good = (np.linalg.det(linear) > 0.0) & (s[..., 2] > _FLAT * s[..., 0])
    return np.where(good[..., None, None], u @ v, fallback)


def read_animations(
    document: GltfDocument, accessors: Accessors, tree: NodeTree, parts: Rig,
    channels: Mapping[int, slice], morph_weights: Array,
) -> tuple[KeyedAnimation, ...]:
    """Read the animations that move a part or a morph channel; raise ModelError."""
    found: list[KeyedAnimation] = []
    names: set[str] = set()
    keys = _Keys(accessors)
    for i, animation in enumerate(document.gltf.animations):
        tracks = [track for track in _tracks(animation, f"animations[{i}]", keys, tree, document)
                  if (track.path == "weights" and track.node in channels)
                  or (track.path != "weights" and track.node in parts.part_of_node)]
        for track in tracks:
            wide = channels[track.node] if track.path == "weights" else None
            if wide is not None and track.values.shape[-1] != wide.stop - wide.start:
                raise ModelError(f"animations[{i}] has {track.values.shape[-1]} morph weights "
                                 f"a key for nodes[{track.node}], which has "
                                 f"{wide.stop - wide.start}")
        name = _unique_name(animation.name, i, names)
        if tracks:
            moves, stretches = _what_moves(tracks, tree, parts)
            found.append(KeyedAnimation(
                name, max(float(track.times[-1]) for track in tracks), tree, parts,
                tuple(tracks), moves, stretches, morph_weights, channels))
    return tuple(found)


def _unique_name(name: str, number: int, names: set[str]) -> str:
    text = "".join(c for c in name if c.isprintable()).strip()[:100]
    text = text or f"animation_{number}"
    if text in names:
        text = f"{text}_{number}"
    names.add(text)
    return text


def _tracks(
    animation: GltfAnimation, where: str, keys: _Keys, tree: NodeTree, document: GltfDocument,
) -> list[Track]:
    tracks: list[Track] = []
    seen: set[tuple[int, str]] = set()
    for c, channel in enumerate(animation.channels):
        at, target = f"{where}.channels[{c}]", channel.target
        if channel.sampler >= len(animation.samplers):
            raise ModelError(f"{at}.sampler is {channel.sampler}, and there are "
                             f"{len(animation.samplers)} samplers")
        if target.node is None:
            continue  # no target node, or the target of an extension
        if target.path not in _KINDS:
            raise ModelError(f"{at} moves {target.path[:40]!r}; it may be {', '.join(_KINDS)}")
        if (target.node, target.path) in seen:
            raise ModelError(f"{at} moves the {target.path} of nodes[{target.node}] once more")
        seen.add((target.node, target.path))
        if target.path != "weights" and tree.has_matrix[target.node]:
            raise ModelError(f"{at} moves nodes[{target.node}], whose pose is a matrix")
        tracks.append(_track(animation.samplers[channel.sampler], target.node, target.path, at,
                             keys, document))
    return tracks


class _Keys:
    """Cached reader of the times and values of samplers, which channels may share."""

    def __init__(self, accessors: Accessors) -> None:
        self._accessors = accessors
        self._read: dict[tuple[int, int, str, str, int], tuple[Array, Array]] = {}
        self._numbers = 0

    def read(self, sampler: AnimationSampler, path: str, wide: int) -> tuple[Array, Array]:
        """Return times [K] and values as of `Track`, `wide` weights a key; raise ModelError."""
        kind, count = self._accessors.kind, self._accessors.count
        if (kind(sampler.input), kind(sampler.output)) != ("SCALAR", _KINDS[path]):
            raise ModelError(f"has keys of the wrong type for {path}")
        width = {"weights": 1, "rotation": 4}.get(path, 3)
        self._numbers += count(sampler.input) + width * count(sampler.output)
        if self._numbers > MAX_KEY_NUMBERS:
            raise ModelError("needs too many keys to hold, with those of the channels before")
        each = 3 if sampler.interpolation == "CUBICSPLINE" else 1
        if not wide or count(sampler.output) != each * wide * count(sampler.input):
            raise ModelError(f"has {count(sampler.output)} values for {count(sampler.input)} keys")
        key = (sampler.input, sampler.output, path, sampler.interpolation, wide)
        if key not in self._read:
            self._read[key] = self._decode(sampler, path, wide if path == "weights" else -1)
        return self._read[key]

    def _decode(self, sampler: AnimationSampler, path: str, width: int) -> tuple[Array, Array]:
        times = self._accessors.floats(sampler.input)
        values = self._accessors.floats(sampler.output)
        if (np.diff(times) <= 0.0).any() or times[0] < 0.0:
            raise ModelError("has key times that do not rise from 0")
        cubic = sampler.interpolation == "CUBICSPLINE"
        values = values.reshape((len(times), *((3,) if cubic else ()), width))
        if path == "rotation":
            turns = values[:, 1] if cubic else values
            if (np.linalg.norm(turns, axis=-1) < 1e-6).any():
                raise ModelError("has a rotation of zero length")
            if not cubic:
                values = _unit(values)
        return times, values


def _track(
    sampler: AnimationSampler, node: int, path: str, where: str, keys: _Keys,
    document: GltfDocument,
) -> Track:
    wide = 1
    if path == "weights":
        mesh = document.gltf.nodes[node].mesh
        wide = 0 if mesh is None else len(document.gltf.meshes[mesh].primitives[0].targets)
    try:
        times, values = keys.read(sampler, path, wide)
    except ModelError as error:
        raise ModelError(f"{where} {error}") from error
    return Track(node, path, times, values, sampler.interpolation)


def _what_moves(
    tracks: Sequence[Track], tree: NodeTree, parts: Rig
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return [P] which parts move, and [P] which of them may move non-rigidly."""
    moves, stretches = np.zeros((2, len(parts.node)), bool)
    world = parts.world_from_part @ parts.part_from_node
    by_node: dict[int, list[Track]] = {}
    for track in tracks:
        by_node.setdefault(track.node, []).append(track)
    for p in range(1, len(parts.node)):
        n, above = int(parts.node[p]), int(parts.parent[p])
        own = [track for track in by_node.get(n, []) if track.path != "weights"]
        moves[p] = moves[above] or bool(own)
        stretches[p] = stretches[above]
        for track in own:
            if track.path == "scale" and not _rests(track, tree.scale[n]):
                stretches[p] = True
            if track.path == "rotation":
                square = world[above, :3, :3].T @ world[above, :3, :3]
                size = np.trace(square) / 3.0
                if np.abs(square - size * np.eye(3)).max() > _SIMILAR * size:
                    stretches[p] = True
    return moves, stretches


def _rests(track: Track, value: Array) -> bool:
    """Return whether a track is constant at a value [C]."""
    keys, slopes = track.values, np.zeros(1)
    if keys.ndim == 3:
        keys, slopes = keys[:, 1], keys[:, [0, 2]]
    size = max(float(np.abs(value).max()), 1e-12)
    return bool(np.abs(keys - value).max() <= _SAME * size and np.abs(slopes).max() <= _SAME * size)


def _unit(quaternions: Array) -> Array:
    """Return the quaternions [... 4] scaled to length 1."""
    length = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return quaternions / np.maximum(length, 1e-12)


def slerp(a: Array, b: Array, u: Array) -> Array:
    """Interpolate from quaternions a [T 4] to b [T 4] along the shorter arc; u [T 1] in 0..1."""
    dot = np.einsum("ti,ti->t", a, b)[:, None]
    b, dot = np.where(dot < 0.0, -b, b), np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    sine = np.sin(angle)
    near = sine < 1e-6
    safe = np.where(near, 1.0, sine)
    from_a = np.where(near, 1.0 - u, np.sin((1.0 - u) * angle) / safe)
    from_b = np.where(near, u, np.sin(u * angle) / safe)
    return _unit(from_a * a + from_b * b)
