"""Draw the estimated pose over the true one, in red, as in Fig. 3 of the paper.

The masks of a sequence show where the model is; where an estimate says that it is has to be drawn:
the model's surface at the estimated joint positions, by the pass that draws the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...robots.geometry import Array, pinhole
from ...robots.model import ArticulatedModel, forward_kinematics
from ..gl import Rasterizer
from ..scene import pose_parts
from ..types import Camera, Sequence
from .colors import RgbImage

_RED = (224, 28, 36)
_TOLERANCE = 1e-6
"""m, and the sines of angles: how well a model must reproduce the poses of a sequence."""


def estimated_positions(sequence: Sequence, displacement: Mapping[str, float], t: int) -> Array:
    """[J] rad or m at frame t: the named joints displaced from frame 0, all others where they are.

    `displacement` is rad or m since frame 0, finite, by the joint's name.
    """
    meta, state = sequence.meta, sequence.state
    positions = state.joint_positions[t].copy()
    for name, moved in displacement.items():
        j = meta.joint_names.index(name)
        positions[j] = state.joint_positions[0, j] + moved
    return positions


class Painter:
    """Draws estimates over the frames of one model's sequences, all of one size; `model` may be
    set to another one."""

    def __init__(self, model: ArticulatedModel, width: int, height: int) -> None:
        self.model = model
        self._rasterizer = Rasterizer(width, height, finer=1)

    def __enter__(self) -> Painter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._rasterizer.close()

    def paint(self, sequence: Sequence, displacement: Mapping[str, float], t: int = -1) -> RgbImage:
        """RGB [H W 3] of frame t: the object as it is, its background paled, the estimate in red.

        `displacement` is the estimate, rad or m since frame 0, finite, by the joint's name.
        Raises GcbenchError if this is not the model in the sequence.
        """
        t = t % len(sequence)
        meta, state = sequence.meta, sequence.state
        if meta.part_names != self.model.part_names or meta.joint_names != self.model.joint_names:
            raise DatasetError(f"{meta.name} does not show the model {self.model.name}")
        true = forward_kinematics(self.model, state.joint_positions[t])
        if np.abs(true - state.world_from_part[t]).max() > _TOLERANCE:
            raise DatasetError(f"{meta.name} was rendered from another model than the loaded one")
        positions = estimated_positions(sequence, displacement, t)
        poses = forward_kinematics(self.model, positions)
        world_from_cam = np.linalg.inv(state.cam_from_world[t])
        camera = Camera(meta.width, meta.height, state.intrinsics, world_from_cam)
        posed = pose_parts(self.model, poses[None])
        drawn = self._rasterizer.draw_truth(posed, camera)
        frame = sequence.frame(t)
        return blend(frame.rgb, frame.part > 0, drawn.depth, drawn.part > 0, state.intrinsics)


def blend(rgb: RgbImage, object_mask: NDArray[np.bool_], depth: NDArray[np.float32],
          estimate_mask: NDArray[np.bool_], intrinsics: Array) -> RgbImage:
    """RGB [H W 3]: `rgb` with a pale background, and over it an estimate of depth [H W] m in red.

    `object_mask` [H W] says what is object in `rgb`, `estimate_mask` [H W] where the estimate is.
    """
    import cv2

    image = rgb.astype(np.float32)
    grey = image.mean(axis=-1, keepdims=True)
    image = np.where(object_mask[..., None], image, 0.25 * grey + 0.75 * 246.0)
    light = shade(depth, estimate_mask, intrinsics)[..., None]
    red = np.array(_RED, np.float32) * light + 255.0 * np.maximum(light - 0.92, 0.0)
    image = np.where(estimate_mask[..., None], 0.42 * image + 0.58 * red, image)
    thick = max(1, round(min(rgb.shape[:2]) / 320))
    outlines = cv2.findContours(estimate_mask.astype(np.uint8), cv2.RETR_CCOMP,
                                cv2.CHAIN_APPROX_NONE)[0]
    out = np.ascontiguousarray(np.clip(np.rint(image), 0, 255), np.uint8)
    cv2.drawContours(out, outlines, -1, (150, 0, 16), thick, cv2.LINE_AA)
    return out


def shade(depth: NDArray[np.float32], mask: NDArray[np.bool_], intrinsics: Array) -> Array:
    """[H W] 0.35..1: how much each pixel's surface faces the camera; 1 outside the mask."""
    ray = pinhole.pixel_rays(intrinsics, pinhole.pixel_grid(*depth.shape))
    points = ray * depth[..., None]
    along_v, along_u = np.gradient(points, axis=(0, 1))
    normal = np.cross(along_u, along_v)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(ray, axis=-1)
    facing = np.abs((normal * ray).sum(axis=-1)) / np.maximum(length, 1e-30)
    return np.where(mask, 0.35 + 0.65 * facing, 1.0)
