"""Drawing motion and camera until the motion can be seen, and the model's truth on the way.

Only depth and part numbers are rendered to judge a draw, and the sequence then uses them: a kept
draw costs one pass more than its truth, a refused one stops at the first frame that breaks the
rule.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import GcbenchError
from ..robots.collision import CollisionChecker
from ..robots.geometry import Array, apply
from ..robots.model import ArticulatedModel, forward_kinematics, joint_screws
from ..robots.trajectory import JointTrajectory, sample_trajectory
from .camera import Camera
from .config import RenderConfig
from .observe import MIN_ANGLE, JointVisibility, is_prismatic, own_motion, subtrees
from .randomize import Streams, draw_camera
from .rasterizer import Rasterizer

MAX_DRAWS = 100
"""Draws before a sequence is kept although it is not observable (and marked so)."""
_LEAST_BAD = ("", "displacement", "still", "occluded", "hidden", "collision")


@dataclass(frozen=True)
class Motion:
    """How the model moves, and where its floor is."""

    trajectory: JointTrajectory
    world_from_part: Array
    """[T P 4 4]"""
    floor: float
    """z of the floor, m"""
    touches: bool
    """Whether the model touches itself or the floor in a frame."""


@dataclass(frozen=True)
class Draw:
    """A judged motion and camera, with truth and evidence of every frame. S scored joints."""

    motion: Motion
    camera: Camera
    depth: list[NDArray[np.float32]]
    """T x [H W] m, 0 where the model is not"""
    part: list[NDArray[np.uint16]]
    """T x [H W]"""
    covered: NDArray[np.int64]
    """[T S] pixels of each joint's moving subtree with nothing before it"""
    flow: Array
    """[T-1 S] px, each joint's own contribution to image motion at a step"""
    joints: dict[str, JointVisibility]
    reason: str
    """Why it is not observable, "" if it is."""


class DrawSampler:
    """Draws sequences of one model and config, and judges them."""

    def __init__(
        self, model: ArticulatedModel, scored: tuple[str, ...], config: RenderConfig,
        rasterizer: Rasterizer,
    ) -> None:
        self.model, self.scored, self.config = model, scored, config
        self._rasterizer = rasterizer
        self._joints = np.array([model.joint_names.index(n) for n in scored], np.int64)
        self._prismatic = [is_prismatic(model, int(j)) for j in self._joints]
        self._moved = subtrees(model, self._joints)
        self._patterns, self._group = _groups(self._moved)
        self._checker = CollisionChecker(model)
        self._outline = _outline(model)
        longest = np.radians(config.randomization.motion.max_step) * (config.frames - 1)
        self._too_short = longest < MIN_ANGLE

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

    def outline(self, world_from_part: Array) -> Array:
        """World points [N 3] m that bound the model in poses [... P 4 4]."""
        return np.concatenate([
            apply(world_from_part[..., part, :, :], points).reshape(-1, 3)
            for part, points in self._outline
        ])

    def judged_again(self, draw: Draw, part: list[NDArray[np.uint16]]) -> Draw:
        """The draw with the evidence of other part images T x [H W]: the room may hide pixels."""
        pixels = np.stack([self._count(p[p > 0]) for p in part])
        joints, reason = self._verdict(draw.motion, pixels, draw.covered, draw.flow)
        return replace(draw, joints=joints, reason=reason)

    def _attempt(self, streams: Streams, attempt: int, keep: bool) -> Draw | str:
        """A draw; or, unless it is to be kept anyhow, why it is refused."""
        motion = self._move(streams.rng("motion", attempt))
        if motion.touches and not keep:
            return "collision"
        camera = draw_camera(
            streams.rng("camera", attempt), self.config.randomization.camera,
            self.config.width, self.config.height,
            self.outline(motion.world_from_part[0]), motion.floor,
        )
        draw = self._judge(motion, camera, keep)
        if isinstance(draw, str) or keep:
            return draw
        # A video too short for the least displacement is kept, and marked, without more draws.
        wanted = not draw.reason or (draw.reason == "displacement" and self._too_short)
        return draw if wanted else draw.reason

    def _move(self, rng: np.random.Generator) -> Motion:
        config, ranges = self.config, self.config.randomization.motion
        trajectory = sample_trajectory(
            self.model, self.scored, config.frames, rng=rng,
            total=(np.radians(ranges.total[0]), np.radians(ranges.total[1])),
            total_prismatic=ranges.total_prismatic,
            max_step=np.radians(ranges.max_step), fps=ranges.fps,
        )
        world_from_part = forward_kinematics(self.model, trajectory.positions)
        # What stands still must do so to the last bit: then its flow is exactly zero.
        still = np.ptp(world_from_part, axis=0).max(axis=(1, 2)) < 1e-12
        world_from_part[:, still] = world_from_part[0, still]
        floor = self._checker.ground_height(world_from_part)
        touches = self._checker.first_contact(world_from_part, floor) is not None
        return Motion(trajectory, world_from_part, floor, touches)

    def _judge(self, motion: Motion, camera: Camera, keep: bool) -> Draw | str:
        """Render depth and parts of all frames; unless kept, stop at one that breaks the rule."""
        poses, frames, joints = motion.world_from_part, self.config.frames, len(self.scored)
        steps = np.diff(motion.trajectory.positions[:, self._joints], axis=0)
        screws = joint_screws(self.model, camera.cam_from_world @ poses)[:, self._joints]
        depth: list[Any] = [None] * frames
        part: list[Any] = [None] * frames
        pixels, covered = np.zeros((2, frames, joints), np.int64)
        flow = np.zeros((frames - 1, joints))
        self._rasterizer.begin_truth(self.model, camera, poses)
        # The ends of a motion are where it is most likely to hide: judge them first.
        order = sorted(range(frames), key=lambda t: (t not in (0, frames - 1), t))
        self._rasterizer.draw_truth(poses[order[0]])
        for t, then in zip(order, [*order[1:], None], strict=True):
            depth[t], part[t] = self._rasterizer.read_truth()
            if then is not None:  # drawn meanwhile
                self._rasterizer.draw_truth(poses[then])
            index = np.flatnonzero(part[t] > 0)
            number = part[t].ravel()[index]
            pixels[t] = self._count(number)
            covered[t] = pixels[t] + self._hidden(poses[t], camera, index, number)
            for j in range(joints) if t < frames - 1 else ():
                flow[t, j] = own_motion(
                    depth[t], index, number, camera, screws[t, j], self._prismatic[j],
                    steps[t, j], self._moved[j],
                )
            reason = "" if keep else self._reason(_seen(pixels[[t]], covered[[t]]))
            if reason:
                return reason
        seen, reason = self._verdict(motion, pixels, covered, flow)
        return Draw(motion, camera, depth, part, covered, flow, seen, reason)

    def _verdict(
        self, motion: Motion, pixels: NDArray[np.int64], covered: NDArray[np.int64], flow: Array
    ) -> tuple[dict[str, JointVisibility], str]:
        """What is seen of each scored joint, and why it is not enough."""
        positions = motion.trajectory.positions[:, self._joints]
        seen = [
            replace(joint, displacement=float(positions[-1, j] - positions[0, j]),
                    motion=float(flow[:, j].mean()) if len(flow) else 0.0)
            for j, joint in enumerate(_seen(pixels, covered))
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

    def _hidden(
        self, poses: Array, camera: Camera, index: NDArray[np.int64], number: NDArray[np.uint16]
    ) -> NDArray[np.int64]:
        """[S] pixels where each scored joint's subtree lies behind other parts of the model.

        From poses [P 4 4] and the flat index [N] and part number [N] of the pixels with a part.
        A subtree is drawn only where parts that it does not move are seen.
        """
        boxes = _boxes(index, number, len(poses), camera.width)
        hiders = np.array([
            _around(boxes[(self._moved[self._moved[:, part]] == 0).any(0)])
            for part in range(len(poses))
        ])
        outlines = self._rasterizer.outlines(camera, poses)
        low, high = (np.maximum(outlines[:, :2], hiders[:, :2]),
                     np.minimum(outlines[:, 2:], hiders[:, 2:]))
        self._rasterizer.draw_coverage(
            poses, self._group, np.concatenate([low, np.maximum(low, high)], axis=1))
        bits = self._rasterizer.read_coverage().ravel()[index]
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


def _seen(pixels: NDArray[np.int64], covered: NDArray[np.int64]) -> list[JointVisibility]:
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
        raise GcbenchError(f"{keep.sum()} joints cannot be scored at once; choose 32 at most")
    number = np.where(keep, np.cumsum(keep) - 1, -1)
    return patterns[keep], number[group.ravel()]


def _outline(model: ArticulatedModel) -> list[tuple[int, Array]]:
    """Each part's convex hull vertices [N 3] m in its frame: enough to find bounding boxes."""
    from scipy.spatial import ConvexHull, QhullError

    out: list[tuple[int, Array]] = []
    for part in sorted({v.part for v in model.visuals}):
        points = np.concatenate([v.vertices for v in model.visuals if v.part == part])
        try:
            points = points[ConvexHull(points).vertices]
        except QhullError:  # flat parts have no hull
            points = np.unique(points, axis=0)
        out.append((part, points))
    return out
