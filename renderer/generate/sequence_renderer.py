"""Render one sequence after another. A sequence depends on (config, index) only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.model import ArticulatedModel, joint_screws
from ..dataset import DEPTH_UNIT, UNITS
from ..gl import Rasterizer
from ..scene import (
    PosedModel,
    RenderConfig,
    Scene,
    Streams,
    dataset_asset,
    draw_scene,
    model_source,
    resolve,
)
from ..truth import Draw, DrawSampler, SequenceTruth, needs_faces, room_normal
from ..types import Frame, Meta, State
from .rendered_sequence import RenderedSequence


class SequenceRenderer:
    """Load models, open OpenGL, and render any sequence of a config. One per process."""

    def __init__(self, config: RenderConfig) -> None:
        self.config = config = resolve(config)
        self._source = model_source(config, 0)
        self._rasterizer = Rasterizer(
            config.width, config.height, round(config.samples**0.5),
            faces=needs_faces(self.model, config.layers))
        self._sampler = self._new_sampler()

    @property
    def model(self) -> ArticulatedModel:
        """The model of the last sequence."""
        return self._source.model

    @property
    def asset(self) -> dict[str, Any]:
        """Where the model or the models came from, for `dataset.json`."""
        asset = dataset_asset(self.config, self._source)
        notes = [f"joint {name!r} can move by {reach:.3g} rad or m only; to be observable, a "
                 "scored joint must turn by 10 degrees or slide by 0.03 m"
                 for name, reach in self._sampler.short_joints.items()]
        return asset | {"notes": [*asset["notes"], *notes]}

    def close(self) -> None:
        """Give the GL context back."""
        self._rasterizer.close()

    def render(self, index: int) -> RenderedSequence:
        """Draw sequence `index`; its images render while they are iterated."""
        self._rasterizer.context.make_current()
        source = model_source(self.config, index, self._source)
        if source is not self._source:  # the device holds one at a time
            self._source = source
            self._sampler = self._new_sampler()
        streams = Streams(self.config, index)
        draw, refused = self._sampler.draw(streams)
        motion = draw.motion
        outline = self._sampler.motions.outline(motion.posed)
        scene, record = draw_scene(
            streams, self.model, motion.trajectory, draw.cameras, outline, motion.floor
        )
        record |= motion.record
        rooms, behind = self._draw_rooms(scene, motion.posed)
        if rooms:
            draw = self._in_room(draw, rooms)
        unit = depth_unit(max(float(d.max()) for d in draw.depth))
        truth = SequenceTruth(self.config, index, self.model, draw, unit, behind)
        frames = self._frames(truth, scene)

        def finish() -> tuple[Meta, State]:
            if next(frames, None) is not None:
                raise RuntimeError("a sequence is finished after its last frame")
            state = self._state(truth)
            return self._meta(index, record, truth, refused, state), state

        return RenderedSequence(frames, unit, truth.coordinate_box, finish)

    def _new_sampler(self) -> DrawSampler:
        source = self._source
        return DrawSampler(
            source.model, source.scored, self.config, self._rasterizer, source.fixed_motion)

    def _draw_rooms(
        self, scene: Scene, posed: PosedModel
    ) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
        """Depth T x [H W] m of the room alone, and its normals T x [H W 3] if they are a layer;
        empty without a room."""
        depth: list[NDArray[np.float32]] = []
        normal: list[NDArray[np.float32]] = []
        for t, camera in enumerate(scene.cameras):
            if t and camera is scene.cameras[t - 1]:
                depth.append(depth[-1])
                normal += normal[-1:]
                continue
            room = self._rasterizer.draw_room(scene, posed, t)
            if room is None:
                break
            depth.append(room.depth)
            if "normal" in self.config.layers and room.face is not None:
                normal.append(room_normal(scene.room, room.face, camera))
        return depth, normal

    def _in_room(self, draw: Draw, rooms: list[NDArray[np.float32]]) -> Draw:
        """The draw before (or, where it sinks into the floor, behind) a room, T x [H W] m."""
        part: list[NDArray[np.uint16]] = []
        depth: list[NDArray[np.float32]] = []
        hides = False
        for p, d, room in zip(draw.part, draw.depth, rooms, strict=True):
            hidden = (p > 0) & (room < d)
            hides |= bool(hidden.any())
            part.append(np.where(hidden, np.uint16(0), p) if hidden.any() else p)
            depth.append(np.where(part[-1] == 0, room, d))
        draw = replace(draw, depth=depth, part=part)
        return self._sampler.update_evidence(draw, part) if hides else draw

    def _frames(self, truth: SequenceTruth, scene: Scene) -> Iterator[Frame]:
        """Draw the images of a scene with their truth."""
        posed = truth.draw.motion.posed
        for t in range(self.config.frames):
            drawn = self._rasterizer.draw_color(scene, posed, t)
            yield truth.frame(
                t, lambda t=t, drawn=drawn: _through_lens(drawn.rgb, scene, t))

    def _state(self, truth: SequenceTruth) -> State:
        model, motion = self.model, truth.draw.motion
        return State(
            times=motion.trajectory.times,
            joint_positions=motion.trajectory.positions,
            intrinsics=truth.draw.cameras[0].intrinsics,
            cam_from_world=truth.cam_from_world,
            world_from_part=motion.world_from_part,
            joint_screw=joint_screws(
                model, truth.cam_from_world[:, None] @ motion.world_from_part),
            joint_parent_part=model.parent[model.joint_child] + 1,
            joint_child_part=model.joint_child + 1,
            part_pixels=truth.part_pixels,
            **truth.point_state(),
        )

    def _meta(
        self, index: int, record: dict[str, Any], truth: SequenceTruth, refused: dict[str, int],
        state: State,
    ) -> Meta:
        draw, has_keypoints = truth.draw, "keypoints" in self.config.layers
        config, model, context = self.config, self.model, self._rasterizer.context
        return Meta(
            name=f"{model.name}/{config.seed}/{index:06d}",
            asset=self._source.asset,
            joint_names=model.joint_names,
            joint_types=model.joint_types,
            joint_limits=tuple(
                (float(a), float(b)) if np.isfinite([a, b]).all() else None
                for a, b in model.limits
            ),
            part_names=model.part_names,
            scored_joints=self._source.scored,
            width=config.width,
            height=config.height,
            frames=config.frames,
            seed=config.seed,
            index=index,
            randomization=record,
            renderer={"renderer": context.renderer, "version": context.version},
            observability={
                # The rule is about joints: it does not apply to a motion without joints.
                "observable": None if "animation" in record else not draw.reason,
                "reason": draw.reason,
                "refused": refused,
                "joints": {name: asdict(seen) for name, seen in draw.joints.items()},
            },
            depth_unit=truth.depth_unit,
            units=UNITS,
            deforming_parts=tuple(
                model.part_names[p] for p in sorted({v.part for v in model.visuals if v.deforms})
            ),
            layers=config.layers,
            keypoint_names=model.keypoint_names if has_keypoints else (),
            keypoint_tolerance=truth.keypoint_tolerance,
            tracks=0 if state.track_query is None else len(state.track_query),
            omitted=config.omitted_images,
        )


def depth_unit(far: float) -> float:
    """The unit of a depth image, m: 0.0001, or more (1, 2, 5, 10, ...) where `far` m needs it.

    Less (by tens) for what is so small and near that it would have fewer than 3000 units.
    """
    unit, steps = DEPTH_UNIT, (2.0, 2.5, 2.0)
    while unit > 1e-8 and 0 < far < 3000 * unit:
        unit /= 10
    k = 0
    while far > 65000 * unit:
        unit, k = unit * steps[k % 3], k + 1
    return float(f"{unit:.6g}")


def _through_lens(rgb: NDArray[np.uint8], scene: Scene, t: int) -> NDArray[np.uint8]:
    """Exposure, blur and noise of frame t."""
    exposure = float(scene.exposure[t])
    if exposure == 0 and scene.blur == 0 and scene.noise == 0:
        return rgb
    import cv2

    image = rgb.astype(np.float32)
    if exposure:
        image *= 2.0 ** (exposure / 2.2)  # stops of light, in the image's gamma
    if scene.blur > 0.05:
        image = cv2.GaussianBlur(image, (0, 0), scene.blur)
    if scene.noise:
        rng = np.random.default_rng([scene.noise_seed, t])
        image += scene.noise * rng.standard_normal(image.shape, np.float32)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)
