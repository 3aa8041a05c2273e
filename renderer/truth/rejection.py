"""Rejection sampling: draw motion and camera until the motion is observable.

To decide on a draw, only depth and part numbers are rendered. The sequence uses them later, so an
accepted draw costs one pass more than its truth; a rejected one stops at the first frame that
breaks the rule.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from ...robots.geometry import Array
from ...robots.model import Animation, ArticulatedModel, joint_screws
from ...robots.motion import JointTrajectory, joint_window
from ..gl import Rasterizer
from ..scene import Motion, MotionSampler, RenderConfig, Streams, draw_camera, shake_camera
from ..types import Camera
from .observability import MIN_ANGLE, MIN_DISTANCE, JointVisibility, own_motion, subtrees

MAX_DRAWS = 100
"""Draws per sequence; after these the best one is kept and marked as not observable."""
_LEAST_BAD = ("", "displacement", "still", "occluded", "hidden", "collision")


@dataclass(frozen=True)
class Draw:
    """A motion and cameras, with truth and evidence of every frame. S scored joints."""

    motion: Motion
    cameras: tuple[Camera, ...]
    """of each frame; one and the same object if the camera stands still"""
    depth: list[NDArray[np.float32]]
    """T x [H W] m, 0 where the model is not"""
    part: list[NDArray[np.uint16]]
    """T x [H W]"""
    face: list[NDArray[np.int32]]
    """T x [H W] triangle through all visuals, -1 where the model is not; empty unless requested"""
    covered: NDArray[np.int64]
    """[T S] pixels of each joint's moving subtree with nothing before it"""
    flow: Array
    """[T-1 S] px, each joint's own contribution to image motion at a step"""
    joints: dict[str, JointVisibility]
    reason: str
    """why it is not observable; "" if it is"""

    @property
    def camera_moves(self) -> bool:
        """Whether the camera does not stand still."""
        return any(camera is not self.cameras[0] for camera in self.cameras)


class DrawSampler:
    """Draws sequences of one model and config until they are observable."""

    def __init__(
        self, model: ArticulatedModel, scored: tuple[str, ...], config: RenderConfig,
        rasterizer: Rasterizer, fixed_motion: Animation | JointTrajectory | None = None,
    ) -> None:
        self.model, self.scored, self.config = model, scored, config
        self.motions = MotionSampler(model, scored, config, fixed_motion)
        self._rasterizer = rasterizer
        self._joints = np.array([model.joint_names.index(n) for n in scored], np.int64)
        self._prismatic = model.prismatic[model.joint_child[self._joints]].tolist()
        self._moved = subtrees(model, self._joints)
        self._patterns, self._group = _groups(self._moved)
        longest = np.radians(config.randomization.motion.max_step) * (config.frames - 1)
        # What no draw can change: a video or a joint too short for the least displacement, a fixed
        # motion.
        is_short = longest < MIN_ANGLE or bool(self.short_joints)
        self._unavoidable = {"displacement"} if is_short else set[str]()
        if isinstance(fixed_motion, JointTrajectory):
            self._unavoidable = {"displacement", "collision"}

    @property
    def short_joints(self) -> dict[str, float]:
        """Scored joints whose whole range, rad or m, is too short to be observable."""
        windows = [joint_window(self.model, int(j)) for j in self._joints]
        return {name: high - low
                for name, (low, high), slides in zip(self.scored, windows, self._prismatic,
                                                     strict=True)
                if high - low < (MIN_DISTANCE if slides else MIN_ANGLE) * (1 - 1e-9)}

    def draw(self, streams: Streams) -> tuple[Draw, dict[str, int]]:
        """The first observable draw, and how many were refused for which reason.

        If there is none in MAX_DRAWS, the first of those that break the rule least; if observable
        or not does not matter (`keep_unobservable`), the first of all.
        """
        refused: list[str] = []
        while len(refused) < MAX_DRAWS:
            draw = self._attempt(streams, len(refused), self.config.keep_unobservable)
            if isinstance(draw, Draw):
                return draw, dict(Counter(refused))
            refused.append(draw)
        best = min(range(len(refused)), key=lambda a: _LEAST_BAD.index(refused[a]))
        kept = self._attempt(streams, best, keep=True)
        assert isinstance(kept, Draw)
        del refused[best]
        return kept, dict(Counter(refused))

    def update_evidence(self, draw: Draw, part: list[NDArray[np.uint16]]) -> Draw:
        """Update a draw for part images T x [H W] in which the room hides pixels."""
        pixels = np.stack([self._count(p[p > 0]) for p in part])
        joints, reason = self._verdict(draw.motion, pixels, draw.covered, draw.flow)
        return replace(draw, joints=joints, reason=reason)

    def _attempt(self, streams: Streams, attempt: int, keep: bool) -> Draw | str:
        """A draw; or, unless it must be kept, the reason for its rejection."""
        motion = self.motions.draw(streams.rng("motion", attempt))
        if motion.touches and not keep and "collision" not in self._unavoidable:
            return "collision"
        # A fixed motion may lead anywhere, and no rule refuses what an animation leads out of the
        # image.
        framed = slice(1) if self.motions.fixed_motion is None else slice(None)
        rng, config = streams.rng("camera", attempt), self.config.randomization.camera
        camera = draw_camera(
            rng, config, self.config.width, self.config.height,
            self.motions.outline(motion.posed, framed), motion.floor,
        )
        cameras = shake_camera(rng, config, camera, self.config.frames)
        draw = self._render(motion, cameras, keep)
        if isinstance(draw, str) or keep:
            return draw
        # What cannot be avoided is kept, and marked, without more draws.
        return draw if draw.reason in {"", *self._unavoidable} else draw.reason

    def _render(self, motion: Motion, cameras: tuple[Camera, ...], keep: bool) -> Draw | str:
        """Render depth and parts of all frames; unless kept, stop at one that breaks the rule."""
        poses, frames, joints = motion.world_from_part, self.config.frames, len(self.scored)
        steps = np.diff(motion.trajectory.positions[:, self._joints], axis=0)
        cam_from_world = np.stack([camera.cam_from_world for camera in cameras])
        screws = joint_screws(self.model, cam_from_world[:, None] @ poses)[:, self._joints]
        depth: list[Any] = [None] * frames
        part: list[Any] = [None] * frames
        face: list[Any] = [None] * frames
        pixels, covered = np.zeros((2, frames, joints), np.int64)
        flow = np.zeros((frames - 1, joints))
        # The ends of a motion are where it is most likely to hide: examine them first.
        order = sorted(range(frames), key=lambda t: (t not in (0, frames - 1), t))
        drawn = self._rasterizer.draw_truth(motion.posed, cameras[order[0]], order[0])
        for t, then in zip(order, [*order[1:], None], strict=True):
            camera = cameras[t]
            depth[t], part[t], face[t] = drawn.depth, drawn.part, drawn.face
            if then is not None:  # the device draws it while this one is examined
                drawn = self._rasterizer.draw_truth(motion.posed, cameras[then], then)
            index = np.flatnonzero(part[t] > 0)
            number = part[t].ravel()[index]
            pixels[t] = self._count(number)
            covered[t] = pixels[t] + self._count_hidden(motion, t, camera, index, number)
            for j in range(joints) if t < frames - 1 else ():
                of_joint = index[self._moved[j][number - 1]]
                flow[t, j] = own_motion(camera, depth[t], of_joint, screws[t, j],
                                        self._prismatic[j], steps[t, j])
            reason = "" if keep else self._reason(_summarize_visibility(pixels[[t]], covered[[t]]))
            if reason:
                return reason
        seen, reason = self._verdict(motion, pixels, covered, flow)
        faces = [] if face[0] is None else face
        return Draw(motion, cameras, depth, part, faces, covered, flow, seen, reason)

    def _verdict(
        self, motion: Motion, pixels: NDArray[np.int64], covered: NDArray[np.int64], flow: Array
    ) -> tuple[dict[str, JointVisibility], str]:
        """What is visible of each scored joint, and why it does not suffice."""
        positions = motion.trajectory.positions[:, self._joints]
        seen = [
            replace(joint, displacement=float(positions[-1, j] - positions[0, j]),
                    motion=float(flow[:, j].mean()) if len(flow) else 0.0)
            for j, joint in enumerate(_summarize_visibility(pixels, covered))
        ]
        reason = "collision" if motion.touches else self._reason(seen)
        return dict(zip(self.scored, seen, strict=True)), reason

    def _reason(self, seen: list[JointVisibility]) -> str:
        """The worst rule that a joint breaks, or ""."""
        reasons = [
            joint.reason(slides, self.config.width, self.config.height)
            for joint, slides in zip(seen, self._prismatic, strict=True)
        ]
        return max(reasons, key=_LEAST_BAD.index, default="")

    def _count(self, number: NDArray[np.uint16]) -> NDArray[np.int64]:
        """[S] visible pixels of each scored joint's subtree, from the part numbers of pixels."""
        counts = np.bincount(number, minlength=len(self.model.parent) + 1)[1:]
        return self._moved @ counts

    def _count_hidden(
        self, motion: Motion, t: int, camera: Camera, index: NDArray[np.int64],
        number: NDArray[np.uint16],
    ) -> NDArray[np.int64]:
        """[S] pixels where each scored joint's subtree lies behind other parts of the model.

        From the flat index [N] and part number [N] of frame t's pixels with a part. A subtree is
        drawn only where parts that it does not move are seen.
        """
        if not len(self.scored):
            return np.zeros(0, np.int64)
        parts = motion.world_from_part.shape[1]
        boxes = _boxes(index, number, parts, camera.width)
        hiders = np.array([  # of each group, and of the parts without one
            _around(boxes[(self._moved[joints] == 0).any(0)])
            for joints in [*self._patterns, np.zeros(len(self.scored), bool)]
        ])[self._group]
        outlines = self._rasterizer.outlines(motion.posed, camera, t)
        low, high = (np.maximum(outlines[:, :2], hiders[:, :2]),
                     np.minimum(outlines[:, 2:], hiders[:, 2:]))
        where = np.concatenate([low, np.maximum(low, high)], axis=1)
        bits = self._rasterizer.draw_coverage(
            motion.posed, camera, t, self._group, where).ravel()[index]
        masks = [sum(1 << g for g, row in enumerate(self._patterns) if row[j])
                 for j in range(len(self.scored))]
        return np.array([
            np.count_nonzero((bits & np.uint32(mask)) * ~moved[number - 1])
            for mask, moved in zip(masks, self._moved, strict=True)
        ], np.int64)


def _boxes(
    index: NDArray[np.int64], number: NDArray[np.uint16], parts: int, width: int
) -> NDArray[np.int64]:
    """[P 4] px around each part's pixels: first column and row, and those after the last.

    Zeros for a part that shows none.
    """
    order = np.argsort(number, kind="stable")
    row, column = np.divmod(index[order].astype(np.int32), np.int32(width))
    seen, first = np.unique(number[order], return_index=True)
    out = np.zeros((parts, 4), np.int64)
    if len(seen):
        out[seen - 1] = np.stack([
            np.minimum.reduceat(column, first), np.minimum.reduceat(row, first),
            np.maximum.reduceat(column, first) + 1, np.maximum.reduceat(row, first) + 1,
        ], axis=1)
    return out


def _around(boxes: NDArray[np.int64]) -> NDArray[np.int64]:
    """[4] the box around boxes [N 4] (as `_boxes`); zeros around none."""
    boxes = boxes[boxes[:, 2] > 0]
    if not len(boxes):
        return np.zeros(4, np.int64)
    return np.concatenate([boxes[:, :2].min(0), boxes[:, 2:].max(0)])


def _summarize_visibility(
    pixels: NDArray[np.int64], covered: NDArray[np.int64]
) -> list[JointVisibility]:
    """Fewest pixels and smallest share of each joint, from counts [T S]; the rest is infinite."""
    share = np.minimum(pixels / np.maximum(covered, 1), 1.0)
    return [JointVisibility(np.inf, int(n), float(s), np.inf)
            for n, s in zip(pixels.min(0), share.min(0), strict=True)]


def _groups(moved: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Distinct sets of joints that move a part, [groups S], and each part's group [P] (-1: none).

    From moved [S P].
    """
    patterns, group = np.unique(moved.T, axis=0, return_inverse=True)
    keep = patterns.any(1) if patterns.size else np.zeros(len(patterns), bool)
    if keep.sum() > 32:
        raise ConfigError(f"{keep.sum()} joints cannot be scored at once; choose 32 at most")
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    return patterns[keep], number[group.ravel()]

