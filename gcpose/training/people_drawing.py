"""People who are drawn over a video: someone moves the object, and covers a part of it."""

# pyright: basic
from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...renderer.types import Sequence
from ...robots.geometry import Array

_SKIN = np.array([[60, 38, 28], [110, 72, 52], [165, 112, 82], [205, 150, 118], [240, 196, 172]])
_UPPER_ARM, _FOREARM = 0.29, 0.26  # length, m
_CANDIDATES = 64  # places that may be held


@dataclass(frozen=True)
class _Cloth:
    """A surface with a pattern of two colors, or skin."""

    colors: Array
    """[2 3]"""
    kind: int
    """0: plain, 1: stripes, 2: rings, 3: checks, 4: noise"""
    period: float
    """m"""
    noise: Array = field(repr=False)
    """[64 64] -1..1"""

    def paint(self, along: Array, across: Array) -> Array:
        """Return colors [... 3] at a place on a limb, m."""
        a, b = np.sin(along * (6.28 / self.period)), np.sin(across * (6.28 / self.period))
        if self.kind == 4:
            at = [(x * (8 / self.period)).astype(int) % 64 for x in (along, across)]
            pattern = self.noise[at[0], at[1]]
        else:
            pattern = (np.zeros_like(a), b, a, a * b)[self.kind]
        share = 0.5 + 0.5 * np.clip(2 * pattern, -1, 1)
        return self.colors[0] + share[..., None] * (self.colors[1] - self.colors[0])


@dataclass(frozen=True)
class _Person:
    """What stays the same in all frames."""

    skin: _Cloth
    sleeve: _Cloth
    trousers: _Cloth
    bare: float
    """Share of the forearm, from the hand, that no sleeve covers; above 1, also the upper arm"""
    loose: float
    """Radius of the sleeve, in radii of the arm"""
    wrist: float
    """Radius, m"""
    shading: tuple[float, float]
    """How much a limb darkens to its sides, and where it is brightest, -1..1"""
    fingers: Array
    """[N 2] angle to the hand, rad, and length, m"""
    wrist_turn: float
    """Of the hand against the forearm, rad"""
    body: bool
    head: bool


@dataclass
class _Canvas:
    """One frame that limbs are drawn on."""

    image: Array
    """[H W 3]"""
    cover: Array
    """[H W] 0..1"""
    scale: float
    """px/m"""
    shading: tuple[float, float]

    def limb(self, ends: Array, radii: tuple[float, float], cloth: _Cloth) -> None:
        """Draw a limb between two ends [2 2], px, with radii, px."""
        height, width = self.cover.shape
        reach = max(radii) + 2
        low = np.clip(np.floor(ends.min(axis=0) - reach), 0, [width, height]).astype(int)
        high = np.clip(np.ceil(ends.max(axis=0) + reach), 0, [width, height]).astype(int)
        if (high <= low).any():
            return
        box = np.s_[low[1] : high[1], low[0] : high[0]]
        u, v = np.meshgrid(np.arange(low[0], high[0]) - ends[0, 0],
                           np.arange(low[1], high[1]) - ends[0, 1])
        step = ends[1] - ends[0]
        length = max(float(np.hypot(*step)), 1e-6)
        du, dv = step / length
        along, across = u * du + v * dv, v * du - u * dv
        share = np.clip(along / length, 0, 1)
        radius = radii[0] + share * (radii[1] - radii[0])
        distance = np.hypot(along - share * length, across)
        cover = np.clip(radius - distance + 0.5, 0, 1)
        strength, bright = self.shading
        shade = np.clip(1 - strength * (across / radius - bright) ** 2, 0.25, 1)
        color = cloth.paint(along / self.scale, across / self.scale) * shade[..., None]
        self.image[box] += cover[..., None] * (color - self.image[box])
        self.cover[box] = np.maximum(self.cover[box], cover)


def draw_person(
    sequence: Sequence, frames: slice, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return frames of a sequence with a person [T H W 3], and where the person is [T H W] 0..255.

    The hand mostly holds a place of a part that moves, and moves with it. Limbs are cylinders
    with cloth or skin; they may throw a shadow.
    """
    rgb = np.asarray(sequence.rgb[frames])
    size = rgb.shape[2:0:-1]
    hand, scale = _follow_place(sequence, frames, rng)
    if rng.random() < 0.12:  # the hand holds nothing
        hand = rng.uniform(0.1, 0.9, 2) * size + _sway(len(rgb), 0.15 * scale.mean(), rng)
    scale = scale * rng.uniform(0.8, 1.25)
    person = _draw_looks(rng)
    limbs = [_place_arm(hand, scale, rng)]
    if person.body and rng.random() < 0.3:
        other = hand + rng.normal(0, 0.25, 2) * scale.mean() + _sway(len(rgb), 0.03 * scale[0], rng)
        limbs.append(_place_arm(other, scale, rng, limbs[0][:, 2]))
    down = np.radians(rng.normal(90, 15))
    shadow = _Shadow(rng) if rng.random() < 0.6 else None
    soft = rng.uniform(0.3, 0.8)
    images, covers = np.empty_like(rgb), np.empty(rgb.shape[:3], np.uint8)
    for t, image in enumerate(rgb):
        canvas = _Canvas(image.astype(float), np.zeros(image.shape[:2]), scale[t], person.shading)
        if person.body:
            _draw_body(canvas, limbs[0][t, 2], down, person)
        for arm in limbs:
            _draw_arm(canvas, arm[t], person)
        cover = cv2.GaussianBlur(canvas.cover, (0, 0), soft)
        below = image if shadow is None else shadow.darken(image, canvas.cover, scale[t])
        # sharp colors of the limbs, with a soft edge
        mixed = below + cover[..., None] * (canvas.image - below)
        images[t] = np.clip(np.rint(mixed), 0, 255)
        covers[t] = np.rint(255 * cover)
    return images, covers


class _Shadow:
    """The shadow of a person, moved and blurred."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._shift = rng.uniform(-0.2, 0.2, 2)  # m
        self._blur, self._strength = rng.uniform(0.01, 0.06), rng.uniform(0.05, 0.5)

    def darken(self, image: NDArray[np.uint8], cover: Array, scale: float) -> Array:
        du, dv = self._shift * scale
        move = np.array([[1, 0, du], [0, 1, dv]])
        moved = cv2.warpAffine(cover, move, cover.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
        moved = cv2.GaussianBlur(moved, (0, 0), max(0.5, self._blur * scale))
        return image * (1 - self._strength * moved[..., None])


def _follow_place(
    sequence: Sequence, frames: slice, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return the pixel [T 2] of a place on a part that moves much, and px/m there [T]."""
    state = sequence.state
    first = frames.start or 0
    part = np.asarray(sequence.part[first]).astype(int)
    v, u = np.nonzero(part)
    chosen = rng.integers(len(u), size=_CANDIDATES) if len(u) else []
    u, v = u[chosen], v[chosen]
    depth = np.asarray(sequence.depth[first], float)[v, u]
    seen = np.stack([u, v, np.ones(len(u))]).T @ np.linalg.inv(state.intrinsics).T * depth[:, None]
    body = state.cam_from_world[frames, None] @ state.world_from_part[frames]
    moved = body @ np.linalg.inv(body[:1])  # [T P 4 4]
    moved = moved[:, part[v, u] - 1]
    place = np.einsum("tnij,nj->tni", moved[..., :3, :3], seen) + moved[..., :3, 3]
    travel = np.linalg.norm(place - place[:1], axis=2).max(axis=0)
    best = np.argsort(-travel)[: max(1, len(travel) // 3)]
    held = place[:, rng.choice(best)]  # [T 3]
    image = held @ state.intrinsics.T
    return image[:, :2] / image[:, 2:], state.intrinsics[0, 0] / held[:, 2]


def _sway(count: int, size: float, rng: np.random.Generator) -> Array:
    """Return a smooth random path [count 2], px."""
    knots = np.cumsum(rng.normal(0, 0.5 * size, (4, 2)), axis=0)
    at = np.linspace(0, 3, count)
    return np.stack([np.interp(at, np.arange(4), k) for k in knots.T], axis=1)


def _place_arm(
    hand: Array, scale: Array, rng: np.random.Generator, at: Array | None = None
) -> Array:
    """Return hand, elbow and shoulder [T 3 2], px; a shoulder is drawn, or given."""
    upper, fore = (length * rng.uniform(low, 1) * scale for length, low in (
        (_UPPER_ARM, 0.7), (_FOREARM, 0.55)))
    shoulder = _draw_shoulder(hand, upper + fore, scale[0], rng) if at is None else at
    step = shoulder - hand
    reach = np.linalg.norm(step, axis=1)
    near = np.clip(reach, 1.02 * np.abs(upper - fore) + 1e-3, 0.99 * (upper + fore))
    direction = step / np.maximum(reach, 1e-6)[:, None]
    base = (fore**2 + near**2 - upper**2) / (2 * near)
    side = np.sqrt(np.maximum(fore**2 - base**2, 0)) * rng.choice([-1, 1])
    across = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    elbow = hand + direction * base[:, None] + across * side[:, None]
    return np.stack([hand, elbow, hand + direction * near[:, None]], axis=1)


def _draw_shoulder(hand: Array, reach: Array, scale: float, rng: np.random.Generator) -> Array:
    """Return a shoulder [T 2], px, mostly below the hand, that follows it in part and sways."""
    angle = np.radians(rng.normal(90, 35)) if rng.random() < 0.65 else rng.uniform(0, 6.28)
    away = np.array([np.cos(angle), np.sin(angle)]) * reach.mean()
    follow = rng.uniform(0, 1)
    return (hand[0] + away * rng.uniform(0.5, 0.98) + follow * (hand - hand[0])
            + _sway(len(hand), 0.03 * scale, rng))


def _draw_looks(rng: np.random.Generator) -> _Person:
    at = rng.uniform(0, len(_SKIN) - 1)
    low = min(int(at), len(_SKIN) - 2)
    tone = _SKIN[low] + (at - low) * (_SKIN[low + 1] - _SKIN[low])
    tone = tone * rng.uniform(0.55, 1.15) * rng.uniform(0.92, 1.08, 3)
    light = rng.uniform(0.5, 1.1)
    plain = np.zeros((64, 64))
    skin = _Cloth(np.stack([0.93 * tone, 1.07 * tone]), 4, 0.08, _smooth_noise(rng))
    glove = rng.random() < 0.06
    cloths = []
    for _ in range(2):
        kind = int(rng.choice(5, p=[0.35, 0.15, 0.15, 0.15, 0.2]))
        first = rng.uniform(10, 245, 3) if rng.random() < 0.6 else np.full(3, rng.uniform(10, 245))
        other = first * rng.uniform(0.6, 1.4) if rng.random() < 0.6 else rng.uniform(10, 245, 3)
        colors = light * np.stack([first, other])
        cloths.append(_Cloth(colors, kind, rng.uniform(0.01, 0.08), _smooth_noise(rng)))
    fingers = np.stack([rng.uniform(-0.5, 0.5, 5), rng.uniform(0.03, 0.09, 5)], axis=1)
    long = rng.random() < 0.5
    return _Person(
        skin=replace(cloths[1], kind=0, noise=plain) if glove else skin,
        sleeve=cloths[0], trousers=cloths[1],
        bare=rng.uniform(0, 0.15) if long else rng.uniform(0.15, 1.4),
        loose=rng.uniform(1.05, 1.4), wrist=rng.uniform(0.025, 0.042),
        shading=(rng.uniform(0, 0.6), rng.uniform(-0.6, 0.6)),
        fingers=fingers[: rng.integers(2, 6) if rng.random() < 0.7 else 0],
        wrist_turn=rng.normal(0, 0.4), body=rng.random() < 0.6, head=rng.random() < 0.6)


def _smooth_noise(rng: np.random.Generator) -> Array:
    values = rng.normal(size=(64, 64))
    smooth = np.asarray(cv2.GaussianBlur(values, (0, 0), 2, borderType=cv2.BORDER_REFLECT), float)
    return smooth / max(1e-6, float(np.abs(smooth).max()))


def _draw_arm(canvas: _Canvas, arm: Array, person: _Person) -> None:
    hand, elbow, shoulder = arm
    wrist = person.wrist * canvas.scale
    if not person.body:  # the arm goes on to outside of the image
        shoulder = elbow + _unit(shoulder - elbow) * 4 * max(canvas.cover.shape)
    upper = np.stack([elbow, shoulder])
    wide = (1.4 * wrist, 1.8 * wrist if person.body else 1.6 * wrist)
    bare_upper = max(0.0, person.bare - 1)
    canvas.limb(upper, wide, person.skin)
    ends = np.stack([elbow + bare_upper * _UPPER_ARM * canvas.scale * _unit(shoulder - elbow),
                     shoulder])
    canvas.limb(ends, (person.loose * wide[0], person.loose * wide[1]), person.sleeve)
    canvas.limb(np.stack([hand, elbow]), (wrist, 1.4 * wrist), person.skin)
    if person.bare < 1:
        cuff = hand + person.bare * (elbow - hand)
        radius = person.loose * wrist
        canvas.limb(np.stack([cuff, elbow]), (radius * (1 + 0.4 * person.bare), 1.4 * radius),
                    person.sleeve)
    _draw_hand(canvas, hand, _unit(hand - elbow), person)


def _draw_hand(canvas: _Canvas, wrist: Array, direction: Array, person: _Person) -> None:
    m, angle = canvas.scale, np.arctan2(direction[1], direction[0]) + person.wrist_turn
    ahead = np.array([np.cos(angle), np.sin(angle)])
    side = np.array([-ahead[1], ahead[0]])
    palm = wrist + 0.06 * m * ahead
    canvas.limb(np.stack([wrist, palm]), (0.9 * person.wrist * m, 0.038 * m), person.skin)
    for k, (turn, length) in enumerate(person.fingers):
        root = palm + side * m * 0.018 * (k - (len(person.fingers) - 1) / 2)
        tip = angle + turn
        ends = np.stack([root, root + length * m * np.array([np.cos(tip), np.sin(tip)])])
        canvas.limb(ends, (0.012 * m, 0.009 * m), person.skin)


def _draw_body(canvas: _Canvas, shoulder: Array, down: float, person: _Person) -> None:
    m, ahead = canvas.scale, np.array([np.cos(down), np.sin(down)])
    side = np.array([-ahead[1], ahead[0]]) * (1 if person.wrist_turn > 0 else -1)
    chest = shoulder + 0.15 * m * side + 0.05 * m * ahead
    hip = chest + 0.5 * m * ahead
    for k in (-1, 1):
        leg = np.stack([hip + 0.08 * k * m * side, hip + 0.1 * k * m * side + 0.9 * m * ahead])
        canvas.limb(leg, (0.09 * m, 0.06 * m), person.trousers)
    canvas.limb(np.stack([chest, hip]), (0.17 * m, 0.16 * m), person.sleeve)
    if person.head:
        head = chest - 0.3 * m * ahead
        canvas.limb(np.stack([head, chest]), (0.06 * m, 0.06 * m), person.skin)
        canvas.limb(np.stack([head - 0.03 * m * ahead, head + 0.03 * m * ahead]),
                    (0.1 * m, 0.09 * m), person.skin)


def _unit(step: Array) -> Array:
    return step / max(1e-6, float(np.hypot(*step)))
