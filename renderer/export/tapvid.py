"""Point tracks in the form of TAP-Vid, a benchmark of tracking any point: SSSSSS.npz holds

    video [T H W 3] uint8; points [N T 2] float32, (x, y); occluded [N T] bool

A point's x is its distance from the image's left edge over the image's width, y that from the top
over the height: the center of the top-left pixel is (0.5 / W, 0.5 / H). Where a point is outside
of the image it is occluded, and so it is behind the camera, where its place is (0, 0).

The tracks are those of the dataset's layer `tracks`. Without this layer, 256 pixels of parts are
chosen in frames spread evenly over the video, and follow their parts' exact poses. TAP-Vid's own
readers expect a pickled dictionary, {"000000": dict(np.load("000000.npz")), ...}; gcbench writes
no pickle.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...robots.geometry import Array
from ..runtime import Archive, address
from ..truth import TruthImages, track_paths
from ..types import Camera, Sequence
from .writer import Writer

_POINTS = 256


class TapVid(Writer):
    """See `Writer`."""

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta, s = sequence.meta, sequence.state
        if s.track_image is not None and s.track_visible is not None:
            image, visible = s.track_image, s.track_visible
        elif meta.deforming_parts:
            raise DatasetError(f"{address(archive.path)}: parts deform; render with "
                               "`--layers tracks`")
        else:
            image, visible = _follow_parts(sequence)
        points = (np.nan_to_num(image) + 0.5) / [meta.width, meta.height]
        points = np.where(np.isfinite(image), points, 0.0).swapaxes(0, 1).astype(np.float32)
        with (self.folder / f"{archive.path.stem}.npz").open("wb") as file:
            np.savez_compressed(file, video=np.asarray(sequence.rgb[:]), points=points,
                                occluded=~visible.T)
        return {}


def _follow_parts(sequence: Sequence) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels [T N 2] (NaN behind the camera) and visibility [T N] of points on rigid parts."""
    meta, s, frames = sequence.meta, sequence.state, range(len(sequence))
    # In the camera's frame the camera stands still, whether or not it moves in the world.
    camera = Camera(meta.width, meta.height, s.intrinsics, np.eye(4))
    images = TruthImages((camera,) * len(frames), [sequence.depth[t] for t in frames],
                         [sequence.part[t] for t in frames], meta.depth_unit)
    cam_from_part = s.cam_from_world[:, None] @ s.world_from_part
    rng = np.random.default_rng(meta.index)
    paths, _ = track_paths(rng, _POINTS, cam_from_part, images)
    return paths.image, paths.visible
