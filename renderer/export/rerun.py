"""Recordings for the Rerun viewer, one .rrd a sequence; open several and compare.

    world/camera             pose over time; world/camera/image: pinhole with rgb, depth and part
    world/parts/NAME         pose over time, with the part's surfaces if the model is at hand
    world/tracks, keypoints  points over time, where the dataset has these layers
    joints/NAME              position over time, rad or m

Timelines are `frame` and `time`. Rerun puts the center of the top-left pixel at (0.5, 0.5): its
principal point is half a pixel from that of the dataset.
"""

# rerun is an extra, and gives its names at run time only.
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from ...errors import DatasetError, GcbenchError
from ...robots.geometry import Array, inverse
from ...robots.model import ArticulatedModel, mean_color
from ..dataset import Dataset
from ..runtime import Archive, address, dump_json
from ..scene import model_of, robot_of
from ..types import Meta, Sequence
from .writer import Writer

_APPLICATION = "gcbench"
_LATEST = 9.2e9
"""s; Rerun counts nanoseconds in 64 bits."""
_CAMERA, _IMAGE = ["world", "camera"], ["world", "camera", "image"]


class Rerun(Writer):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._robot: str | None = None
        self._model: ArticulatedModel | None = None

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta, s = sequence.meta, sequence.state
        if np.abs(s.times).max() > _LATEST:
            raise DatasetError(f"{address(archive.path)}: times are beyond the 292 years that "
                               "Rerun can hold; use another --format")
        recording = rr.RecordingStream(
            _APPLICATION, recording_id=f"{self.dataset.path.absolute().name}/{archive.path.stem}")
        recording.disable_timeline("log_time")
        recording.save(str(self.folder / f"{archive.path.stem}.rrd"))
        self._log_once(recording, sequence)
        world_from_cam = inverse(s.cam_from_world)
        for t in range(len(sequence)):
            recording.set_time("frame", sequence=t)
            recording.set_time("time", duration=float(s.times[t]))
            recording.log(_CAMERA, _transform(world_from_cam[t]))
            recording.log([*_IMAGE, "rgb"], rr.EncodedImage(
                contents=archive.read(f"rgb/{t:06d}.png"), media_type="image/png"))
            recording.log([*_IMAGE, "depth"], rr.EncodedDepthImage(
                archive.read(f"depth/{t:06d}.png"), media_type="image/png",
                meter=1.0 / meta.depth_unit))
            recording.log([*_IMAGE, "part"], rr.SegmentationImage(sequence.part[t]))
            for name, pose in zip(meta.part_names, s.world_from_part[t], strict=True):
                recording.log(["world", "parts", name], _transform(pose))
            for name, value in zip(meta.joint_names, s.joint_positions[t], strict=True):
                recording.log(["joints", name], rr.Scalars(float(value)))
            for name, places, parts, visible in (
                    ("tracks", s.track_world, s.track_part, s.track_visible),
                    ("keypoints", s.keypoint_world, s.keypoint_part, s.keypoint_visible)):
                if places is not None and parts is not None and visible is not None:
                    recording.log(["world", name], rr.Points3D(
                        places[t], class_ids=parts, keypoint_ids=np.arange(len(parts)),
                        radii=np.where(visible[t], -3.0, -1.0)))  # px of the screen
        recording.flush()
        recording.disconnect()
        return {}

    def _load(self, meta: Meta) -> None:
        """Get the sequence's model, if it is at hand: else there are poses without surfaces."""
        with suppress(GcbenchError):
            robot = robot_of(self.dataset.config, meta)
            if robot != self._robot:
                self._robot, self._model = robot, None
                self._model = model_of(self.dataset.config, meta, self.dataset.allow_model)

    def _log_once(self, recording: rr.RecordingStream, sequence: Sequence) -> None:
        """What holds for all frames."""
        self._load(sequence.meta)
        meta, k = sequence.meta, sequence.state.intrinsics + np.array([[0, 0, 0.5]] * 2 + [[0] * 3])
        names = ["background", *meta.part_names]
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recording.log("world", rr.AnnotationContext([*enumerate(names)]), static=True)
        recording.log(_IMAGE, rr.Pinhole(
            image_from_camera=k, resolution=[meta.width, meta.height],
            camera_xyz=rr.ViewCoordinates.RDF), static=True)
        recording.log("meta", rr.TextDocument(dump_json(
            {"asset": dict(meta.asset), "seed": meta.seed, "index": meta.index,
             "scored_joints": meta.scored_joints}).decode(), media_type="text/plain"), static=True)
        for name, kind in zip(meta.joint_names, meta.joint_types, strict=True):
            unit = "m" if kind == "prismatic" else "rad"
            recording.log(["joints", name], rr.SeriesLines(names=f"{name} ({unit})"), static=True)
        if self._model is None or self._model.part_names != meta.part_names:
            return
        for number, v in enumerate(self._model.visuals):
            if not v.deforms:
                color = np.array(v.material.base_color)
                if v.material.texture is not None:
                    color[:3] *= mean_color(v.material.texture)[:3]
                path = ["world", "parts", meta.part_names[v.part], f"surface {number}"]
                recording.log(path, rr.Mesh3D(
                    vertex_positions=v.vertices, triangle_indices=v.faces,
                    vertex_normals=v.normals, albedo_factor=color), static=True)


def _transform(a_from_b: Array) -> rr.Transform3D:
    return rr.Transform3D(translation=a_from_b[:3, 3], mat3x3=a_from_b[:3, :3])
