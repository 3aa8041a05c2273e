"""The truth of an accepted draw, frame by frame: flow, visibility, and layers on demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.geometry import Array, apply
from ...robots.model import ArticulatedModel
from ..scene import RenderConfig, RoomSurface, Streams, rest_in_part
from ..types import Camera, Frame
from .correspondence import PointMotion, SurfacePoints, pose_table, surface_points, visibility
from .deforming import DeformingPoints, deforming_points
from .layers import coordinate_boxes, coordinate_image, normal_image
from .rejection import Draw
from .tracks import KEYPOINT_SHARE, TruthImages, keypoint_paths, track_paths


def needs_faces(model: ArticulatedModel, layers: tuple[str, ...]) -> bool:
    """Whether the triangle of each pixel must be drawn."""
    return "normal" in layers or any(v.deforms for v in model.visuals)


def room_normal(
    room: Sequence[RoomSurface], face: NDArray[np.int32], camera: Camera
) -> NDArray[np.float32]:
    """Normals [H W 3] (layers.py) of a room's triangles `face` [H W], counted through surfaces."""
    starts = np.cumsum([0, *(len(s.vertices) for s in room)])
    corners = np.concatenate([s.faces + n for s, n in zip(room, starts, strict=False)])
    vertices = apply(camera.cam_from_world, np.concatenate([s.vertices for s in room]))
    return normal_image(face, corners.astype(np.int64), vertices)


class SequenceTruth:
    """The truth of a draw's frames; `part_pixels` is complete after all frames were requested."""

    def __init__(
        self, config: RenderConfig, index: int, model: ArticulatedModel, draw: Draw,
        depth_unit: float, room_normals: Sequence[NDArray[np.float32]],
    ) -> None:
        """`room_normals`, T x [H W 3], are what the layer `normal` shows where the model is not;
        empty without a room."""
        self.config, self.model, self.draw = config, model, draw
        self._index, self.depth_unit = index, depth_unit
        self._room_normals = room_normals
        frames = config.frames
        self.cam_from_world = np.stack([camera.cam_from_world for camera in draw.cameras])
        self._table = pose_table(self.cam_from_world, draw.motion.world_from_part)
        self.part_pixels = np.zeros((frames, len(model.parent)), np.int64)
        wanted = "coordinates" in config.layers
        self._at_rest = rest_in_part(model) if wanted else np.zeros((0, 3))
        self.coordinate_box = coordinate_boxes(model, self._at_rest) if wanted else None
        self.keypoint_tolerance = 0.0
        if "keypoints" in config.layers:
            size = np.linalg.norm(np.ptp(draw.motion.posed.vertices(0), axis=0))
            self.keypoint_tolerance = KEYPOINT_SHARE * float(size)

    def frame(self, t: int, rgb: Callable[[], NDArray[np.uint8]]) -> Frame:
        """Frame t; `rgb` is called last, because the device may draw its image meanwhile."""
        draw, table = self.draw, self._table
        depth, part = draw.depth[t], draw.part[t]
        points = surface_points(depth, part, draw.cameras[t].intrinsics, len(self.model.parent),
                                draw.camera_moves)
        self.part_pixels[t] = points.part_pixels
        deforming = self._deforming_points(points, t)
        forward = backward = seen = None
        omitted, last = self.config.omitted_images, self.config.frames - 1
        if t > 0 and "flow_backward" not in omitted:
            backward = points.flow_image(self._motion(points, deforming, t, t - 1))
        if t < last and not {"flow", "visibility"} <= {*omitted}:
            moved = self._motion(points, deforming, t, t + 1)
            if "flow" not in omitted:
                forward = points.flow_image(moved)
            if "visibility" not in omitted:
                seen = visibility(
                    points, moved, draw.depth[t + 1], draw.part[t + 1], self.depth_unit)
        coordinates = None
        if "coordinates" in self.config.layers:
            coordinates = coordinate_image(points, table[t], deforming, self._at_rest, part.shape)
        normal = self._normal(t) if "normal" in self.config.layers else None
        return Frame(rgb(), depth, part, forward, backward, seen, normal, coordinates)

    def point_state(self) -> dict[str, Any]:
        """Arrays of the state that belong to the layers."""
        out: dict[str, Any] = {}
        draw, posed, config = self.draw, self.draw.motion.posed, self.config
        images = TruthImages(draw.cameras, draw.depth, draw.part, self.depth_unit)
        if self.coordinate_box is not None:
            out["coordinate_box"] = self.coordinate_box
        if "keypoints" in config.layers:
            found = keypoint_paths(
                self.model, posed.world_from_part, images, self.keypoint_tolerance)
            out |= {f"keypoint_{name}": value for name, value in vars(found).items()}
        if "tracks" in config.layers:
            rng = Streams(config, self._index).tracks_rng()
            found, query = track_paths(
                rng, config.track_points, posed.world_from_part, images,
                (posed, draw.face) if draw.face else None)
            out |= {f"track_{name}": value for name, value in vars(found).items()}
            out["track_query"] = query
        return out

    def _vertices(self, t: int) -> Array:
        """[V 3] m in the camera frame."""
        return apply(self.cam_from_world[t], self.draw.motion.posed.vertices(t))

    def _deforming_points(self, points: SurfacePoints, t: int) -> DeformingPoints | None:
        posed = self.draw.motion.posed
        if not posed.deforming:
            return None
        return deforming_points(points, self.draw.face[t], posed, self._vertices(t))

    def _motion(
        self, points: SurfacePoints, deforming: DeformingPoints | None, t: int, other: int
    ) -> PointMotion:
        rigid = points.motion(self._table[t], self._table[other])
        return deforming.motion(rigid, self._vertices(other)) if deforming else rigid

    def _normal(self, t: int) -> NDArray[np.float32]:
        draw = self.draw
        face = np.where(draw.part[t] > 0, draw.face[t], np.int32(-1))
        normal = normal_image(face, draw.motion.posed.faces, self._vertices(t))
        if not self._room_normals:
            return normal
        return np.where((draw.part[t] > 0)[..., None], normal, self._room_normals[t])
