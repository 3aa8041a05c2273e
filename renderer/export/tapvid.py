"""Point tracks in the form of TAP-Vid, a benchmark of tracking any point: SSSSSS.npz holds

    video [T H W 3] uint8; points [N T 2] float32, (x, y); occluded [N T] bool

A point's x is its distance from the image's left edge over the image's width, y that from the top
over the height: the centre of the top-left pixel is (0.5 / W, 0.5 / H). Where a point is outside
of the image it is occluded, and so it is behind the camera, where its place is (0, 0).

The tracks are those of the dataset's layer `tracks`. Where it has none, POINTS pixels of parts are
chosen, in frames spread evenly over the video, and follow their parts' exact poses. TAP-Vid's own
readers want a pickled dictionary, {"000000": dict(np.load("000000.npz")), ...}: it is for who
trusts it to make one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from ...robots.geometry import Array, inverse
from ..dataset import Dataset
from ..runtime import Archive
from ..truth import projected, surface_visible
from ..types import Camera, Sequence
from .journal import Record

POINTS = 256


class TapVid:
    """See export.Writer."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        self._folder = folder

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta, s = sequence.meta, sequence.state
        if s.track_image is not None and s.track_visible is not None:
            image, visible = s.track_image, s.track_visible
        elif meta.deforming_parts:
            raise GcbenchError(f"{archive.path}: parts deform; render with `--layers tracks`")
        else:
            image, visible = rigid_tracks(sequence, POINTS, np.random.default_rng(meta.index))
        points = (np.nan_to_num(image) + 0.5) / [meta.width, meta.height]
        points = np.where(np.isfinite(image), points, 0.0).swapaxes(0, 1).astype(np.float32)
        with (self._folder / f"{archive.path.stem}.npz").open("wb") as file:
            np.savez_compressed(file, video=np.asarray(sequence.rgb[:]), points=points,
                                occluded=~visible.T)
        return {}

    def keep(self, record: Record) -> None:
        pass

    def finish(self) -> None:
        pass

    def close(self) -> None:
        pass


def rigid_tracks(
    sequence: Sequence, count: int, rng: np.random.Generator
) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels [T N 2] (NaN behind the camera) and visibility [T N] of points on parts.

    Each is the centre of a pixel in one frame: all parts that are seen there being equally likely,
    any pixel of the part. N is 0 if no part is ever seen.
    """
    s, frames = sequence.state, len(sequence)
    part = [sequence.part[t] for t in range(frames)]
    depth = [sequence.depth[t] for t in range(frames)]
    seen = [t for t in range(frames) if part[t].any()]
    number, local = np.zeros(count if seen else 0, np.int64), np.zeros((count if seen else 0, 3))
    cam_from_part = s.cam_from_world[:, None] @ s.world_from_part
    for i in range(len(number)):
        t = seen[i * len(seen) // count]
        number[i] = rng.choice(np.unique(part[t][part[t] > 0]))
        v, u = rng.choice(np.argwhere(part[t] == number[i]))
        point = np.linalg.solve(s.intrinsics, [u, v, 1.0]) * depth[t][v, u]
        local[i] = (inverse(cam_from_part[t, number[i] - 1]) @ [*point, 1.0])[:3]
    poses = cam_from_part[:, number - 1]
    cam = np.einsum("tnij,nj->tni", poses[..., :3, :3], local) + poses[..., :3, 3]
    camera = Camera(sequence.meta.width, sequence.meta.height, s.intrinsics, np.eye(4))
    image, z = projected(camera, cam)
    visible = np.array([
        surface_visible(image[t], z[t], number, depth[t], part[t], sequence.meta.depth_unit)
        for t in range(frames)], bool).reshape(frames, len(number))
    return image, visible
