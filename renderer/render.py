"""One sequence after another: draw it, judge it, render it. A sequence depends on (config, i) only.

Only depth and part numbers are rendered to judge a draw; what is kept is then coloured. So a
refused draw costs a few passes, and a kept one none but the bit-mask pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import GcbenchError
from ..robots import catalog
from ..robots.collision import CollisionChecker
from ..robots.geometry import Array, apply
from ..robots.model import ArticulatedModel, forward_kinematics, joint_screws
from ..robots.trajectory import JointTrajectory, default_scored_joints, sample_trajectory
from .camera import Camera
from .config import RenderConfig, resolved
from .flow import flow_to, pose_table, visibility
from .gl import Rasterizer
from .observe import JointVisibility, is_prismatic, own_motion, subtrees
from .randomize import Streams, draw_camera, draw_scene
from .scene import Scene
from .sequence import Frame, Meta, State

MAX_DRAWS = 200
"""Draws before a sequence is kept although it is not observable (and marked so)."""
UNITS = {"length": "m", "angle": "rad", "time": "s", "flow": "px"}
DEPTH_UNIT = 0.0001


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
    """A judged draw of motion and camera, with the model's truth of every frame."""

    motion: Motion
    camera: Camera
    depth: list[NDArray[np.float32]]
    part: list[NDArray[np.uint16]]
    joints: Mapping[str, JointVisibility]
    reason: str
    """Why it is not observable, "" if it is."""


class RenderedSequence:
    """A sequence that renders while its frames are iterated; `meta` and `state` afterwards."""

    frames: Iterator[Frame]
    depth_unit: float
    """m per unit of the depth images"""
    refused: Mapping[str, int]
    """Draws that were not observable, by reason."""
    meta: Meta
    state: State


class SequenceRenderer:
    """Loads a model, opens OpenGL, renders any sequence of a config. One per process.

    Raises GcbenchError for a robot, a joint name or a configuration that does not work.
    """

    def __init__(self, config: RenderConfig) -> None:
        config = resolved(config)
        self.model = catalog.load(config.robot, _packages(config.package), config.allow_missing)
        if not self.model.visuals:
            raise GcbenchError(f"{config.robot}: the model has no visible geometry to render")
        self.config = config
        names = config.scored_joints or default_scored_joints(self.model)
        unknown = [n for n in names if n not in self.model.joint_names]
        if unknown:
            raise GcbenchError(
                f"{config.robot}: no joint {unknown[0]!r} to score; "
                f"it has {', '.join(self.model.joint_names) or 'none'}"
            )
        self.scored = tuple(n for n in self.model.joint_names if n in names)
        self._joints = np.array([self.model.joint_names.index(n) for n in self.scored], np.int64)
        self._moved = subtrees(self.model, self._joints)
        self._patterns, self._group = _groups(self._moved)
        self._checker = CollisionChecker(self.model)
        self._outline = _outline(self.model)
        self._rasterizer = Rasterizer(
            config.width, config.height, finer=round(config.samples**0.5)
        )

    @property
    def asset(self) -> dict[str, Any]:
        """Where the model came from, for `dataset.json` and `meta.json`."""
        m = self.model
        return {"name": m.name, "source": m.source, "licence": m.licence, "sha256": m.sha256,
                "notes": list(m.notes)}

    def close(self) -> None:
        """Give the GL context back."""
        self._rasterizer.close()

    def render(self, index: int) -> RenderedSequence:
        """Sequence `index`; its refused draws are counted by reason."""
        streams = Streams(self.config, index)
        refused: Counter[str] = Counter()
        for attempt in range(MAX_DRAWS):
            keep = self.config.keep_unobservable or attempt == MAX_DRAWS - 1
            draw = self._draw(streams, attempt, keep)
            if isinstance(draw, Draw):
                break
            refused[draw] += 1
        motion = draw.motion
        outline = _points(self._outline, motion.world_from_part)
        scene, record = draw_scene(
            streams, self.model, motion.trajectory, draw.camera, outline, motion.floor
        )
        self._rasterizer.begin_color(scene, motion.world_from_part)
        room = self._rasterizer.room_depth()
        out = RenderedSequence()
        out.refused = dict(refused)
        out.depth_unit = depth_unit(max(float(d.max()) for d in [room, *draw.depth]))
        out.frames = self._frames(index, draw, scene, record, room, out)
        return out

    # -- motion and camera --------------------------------------------------------------------

    def _draw(self, streams: Streams, attempt: int, keep: bool) -> Draw | str:
        """A draw of motion and camera; or, unless it is to be kept anyhow, why it is refused."""
        config = self.config
        motion = self._move(streams.rng("motion", attempt))
        if motion.touches and not keep:
            return "collision"
        camera = draw_camera(
            streams.rng("camera", attempt), config.randomization.camera,
            config.width, config.height,
            _points(self._outline, motion.world_from_part[0]), motion.floor,
        )
        draw = self._judge(motion, camera, keep)
        return draw if keep or not draw.reason else draw.reason

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

    def _judge(self, motion: Motion, camera: Camera, keep: bool) -> Draw:
        """Render depth and parts of all frames; unless kept, stop at one that breaks the rule."""
        poses = motion.world_from_part
        frames, joints = len(poses), len(self.scored)
        prismatic = [is_prismatic(self.model, int(j)) for j in self._joints]
        positions = motion.trajectory.positions[:, self._joints]
        screws = joint_screws(self.model, camera.cam_from_world @ poses)[:, self._joints]
        self._rasterizer.begin_truth(self.model, camera, poses)
        depth: list[Any] = [None] * frames
        part: list[Any] = [None] * frames
        pixels, share = np.zeros((frames, joints), np.int64), np.zeros((frames, joints))
        flow = np.zeros((max(frames - 1, 1), joints))
        # The ends of a motion are where it is most likely to hide: judge them first.
        for t in sorted(range(frames), key=lambda t: (t not in (0, frames - 1), t)):
            depth[t], part[t] = self._rasterizer.truth(poses[t])
            counts = np.bincount(part[t].ravel(), minlength=len(self.model.parent) + 1)[1:]
            covered = self._covered(poses[t])
            pixels[t] = self._moved @ counts
            share[t] = np.minimum(pixels[t] / np.maximum(covered, 1), 1.0)
            for j in range(joints) if t < frames - 1 else ():
                flow[t, j] = own_motion(
                    depth[t], part[t], camera, screws[t, j], prismatic[j],
                    positions[t + 1, j] - positions[t, j], self._moved[j],
                )
            seen = [JointVisibility(np.inf, int(n), float(s), np.inf)
                    for n, s in zip(pixels[t], share[t], strict=True)]
            reason = self._reason(seen, prismatic)
            if reason and not keep:
                return Draw(motion, camera, [], [], {}, reason)
        total = positions[-1] - positions[0]
        seen = [
            JointVisibility(float(total[j]), int(pixels[:, j].min()), float(share[:, j].min()),
                            float(flow[:, j].mean()))
            for j in range(joints)
        ]
        reason = "collision" if motion.touches else self._reason(seen, prismatic)
        return Draw(motion, camera, depth, part, dict(zip(self.scored, seen, strict=True)), reason)

    def _reason(self, seen: list[JointVisibility], prismatic: list[bool]) -> str:
        """The first rule that a joint breaks, or ""."""
        reasons = (
            joint.reason(slides, self.config.width, self.config.height)
            for joint, slides in zip(seen, prismatic, strict=True)
        )
        return next((r for r in reasons if r), "")

    def _covered(self, poses: Array) -> NDArray[np.int64]:
        """[scored joints] pixels that each joint's subtree would show with nothing before it."""
        values, counts = np.unique(self._rasterizer.coverage(poses, self._group), return_counts=True)
        masks = [
            np.bitwise_or.reduce([1 << g for g, row in enumerate(self._patterns) if row[j]])
            for j in range(len(self.scored))
        ]
        return np.array([counts[(values & mask) != 0].sum() for mask in masks], np.int64)

    # -- frames -------------------------------------------------------------------------------

    def _frames(
        self, index: int, draw: Draw, scene: Scene, record: dict[str, Any],
        room: NDArray[np.float32], out: RenderedSequence,
    ) -> Iterator[Frame]:
        config, poses, camera = self.config, draw.motion.world_from_part, draw.camera
        cam_from_world = np.tile(camera.cam_from_world, (config.frames, 1, 1))
        table = pose_table(cam_from_world, poses)
        k, last = camera.intrinsics, config.frames - 1
        n_parts = len(self.model.parent)
        part_pixels = np.zeros((config.frames, n_parts), np.int64)
        now = _before_room(draw.depth[0], draw.part[0], room)
        then = now
        for t in range(config.frames):
            depth, part = now
            part_pixels[t] = np.bincount(part.ravel(), minlength=n_parts + 1)[1:]
            forward = backward = seen = None
            if t > 0:
                backward = flow_to(depth, part, table[t], table[t - 1], k)[0]
            if t < last:
                then = _before_room(draw.depth[t + 1], draw.part[t + 1], room)
                forward, depth_there = flow_to(depth, part, table[t], table[t + 1], k)
                seen = visibility(forward, depth_there, part, *then, out.depth_unit)
            rgb = _through_lens(self._rasterizer.color(poses[t]), scene, t)
            yield Frame(rgb, depth, part, forward, backward, seen)
            now = then
        out.meta = self._meta(index, record, draw, out)
        out.state = self._state(draw, part_pixels)

    def _state(self, draw: Draw, part_pixels: NDArray[np.int64]) -> State:
        model, camera, motion = self.model, draw.camera, draw.motion
        frames = len(motion.world_from_part)
        return State(
            times=motion.trajectory.times,
            joint_positions=motion.trajectory.positions,
            intrinsics=camera.intrinsics,
            cam_from_world=np.tile(camera.cam_from_world, (frames, 1, 1)),
            world_from_part=motion.world_from_part,
            joint_screw=joint_screws(model, camera.cam_from_world @ motion.world_from_part),
            joint_parent_part=model.parent[model.joint_child] + 1,
            joint_child_part=model.joint_child + 1,
            part_pixels=part_pixels,
        )

    def _meta(
        self, index: int, record: dict[str, Any], draw: Draw, out: RenderedSequence
    ) -> Meta:
        config, model, context = self.config, self.model, self._rasterizer.context
        return Meta(
            name=f"{model.name}/{config.seed}/{index:06d}",
            asset=self.asset,
            joint_names=model.joint_names,
            joint_types=model.joint_types,
            joint_limits=tuple(
                (float(a), float(b)) if np.isfinite([a, b]).all() else None
                for a, b in model.limits
            ),
            part_names=model.part_names,
            scored_joints=self.scored,
            width=config.width,
            height=config.height,
            frames=config.frames,
            seed=config.seed,
            index=index,
            randomization=record,
            renderer={"renderer": context.renderer, "version": context.version},
            observability={
                "observable": not draw.reason,
                "reason": draw.reason,
                "refused": dict(out.refused),
                "joints": {name: asdict(seen) for name, seen in draw.joints.items()},
            },
            depth_unit=out.depth_unit,
            units=UNITS,
        )


def depth_unit(far: float) -> float:
    """The unit of a depth image, m: 0.0001, or more (1, 2, 5, 10, ...) where `far` m needs it."""
    unit, steps = DEPTH_UNIT, (2.0, 2.5, 2.0)
    k = 0
    while far > 65000 * unit:
        unit, k = unit * steps[k % 3], k + 1
    return float(f"{unit:.6g}")


def _packages(names: tuple[str, ...]) -> dict[str, Path]:
    """Folders by package name, from NAME=DIR."""
    out: dict[str, Path] = {}
    for item in names:
        name, equals, folder = item.partition("=")
        if not (name and equals and folder):
            raise GcbenchError(f"--package {item!r}: give NAME=DIR, as in --package my_robot=~/my_robot")
        out[name] = Path(folder).expanduser()
        if not out[name].is_dir():
            raise GcbenchError(f"--package {item!r}: there is no folder {out[name]}")
    return out


def _groups(moved: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Distinct sets of joints that move a part, [groups joints], and each part's group [P]."""
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


def _points(outline: list[tuple[int, Array]], world_from_part: Array) -> Array:
    """World points [N 3] of an outline in poses [... P 4 4]."""
    return np.concatenate([
        apply(world_from_part[..., part, :, :], points).reshape(-1, 3) for part, points in outline
    ])


def _before_room(
    depth: NDArray[np.float32], part: NDArray[np.uint16], room: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """The model before (or, where it sinks into the floor, behind) the room."""
    hidden = (part == 0) | ((room > 0) & (room < depth))
    return np.where(hidden, room, depth), np.where(hidden, np.uint16(0), part)


def _through_lens(rgb: NDArray[np.uint8], scene: Scene, t: int) -> NDArray[np.uint8]:
    """Exposure, blur and noise of frame t."""
    if scene.exposure == 0 and scene.blur == 0 and scene.noise == 0:
        return rgb
    import cv2

    image = rgb.astype(np.float32)
    if scene.exposure:
        image *= 2.0 ** (scene.exposure / 2.2)  # stops of light, in the image's gamma
    if scene.blur > 0.05:
        image = cv2.GaussianBlur(image, (0, 0), scene.blur)
    if scene.noise:
        rng = np.random.default_rng([scene.noise_seed, t])
        image += scene.noise * rng.standard_normal(image.shape, np.float32)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
