"""KITTI 2015's layout of optical flow, with depth in the encoding of KITTI's depth completion.

A pair of consecutive frames has a number, pairs.csv says which frames they are:

    training/image_2/NNNNNN_10.png, _11.png    the first and the second image
    training/flow_occ/NNNNNN_10.png            flow of every pixel where it is known
    training/flow_noc/NNNNNN_10.png            ... that is not hidden in the second image
    training/obj_map/NNNNNN_10.png             part numbers, 0 background
    training/depth_2/NNNNNN_10.png, _11.png    z = value / 256 m, 0 unknown
    training/calib_cam_to_cam/NNNNNN.txt       K_02, P_rect_02, ...

Depth has the resolution of its format, 3.9 mm.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError, RenderError
from ..dataset import Dataset, codec
from ..runtime import Archive, address
from ..types import BACKGROUND, VISIBLE, Sequence
from .writer import SequenceRecord, Writer

_DEPTH_UNIT = 1.0 / 256.0
"""m"""


class Kitti(Writer):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._folder = folder / "training"
        self._rows = ["pair,sequence,first,second"]
        self._images = ("image_2", "flow_occ", "flow_noc", "obj_map", "depth_2")
        for name in (*self._images, "calib_cam_to_cam"):
            (self._folder / name).mkdir(parents=True, exist_ok=True)
        if dataset.config.frames < 2:
            raise DatasetError(
                f"{address(dataset.path)}: sequences of one frame have no optical flow")

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta = sequence.meta
        calibration = calib(sequence.state.intrinsics, meta.width, meta.height)
        wide = len(meta.part_names) > 255
        depth = [_depth(sequence.depth[t], archive) for t in range(len(sequence))]
        first = len(self._rows) - 1
        for t in range(len(sequence) - 1):
            name = f"{first + t:06d}"
            flow, part = sequence.stack("flow")[t], sequence.part[t]
            visibility = sequence.stack("visibility")[t]
            seen = unoccluded_pixels(flow, part, visibility, sequence.part[t + 1])
            self._write("image_2", f"{name}_10", archive.read(f"rgb/{t:06d}.png"))
            self._write("image_2", f"{name}_11", archive.read(f"rgb/{t + 1:06d}.png"))
            self._write("flow_occ", f"{name}_10", codec.encode_flow(flow))
            known = np.where(seen[..., None], flow, np.float32(np.nan))
            self._write("flow_noc", f"{name}_10", codec.encode_flow(known))
            self._write("obj_map", f"{name}_10", codec.encode_part(part, wide))
            self._write("depth_2", f"{name}_10", depth[t])
            self._write("depth_2", f"{name}_11", depth[t + 1])
            (self._folder / "calib_cam_to_cam" / f"{name}.txt").write_text(calibration)
        return {"rows": [f"{first + t},{archive.path.stem},{t},{t + 1}"
                         for t in range(len(sequence) - 1)]}

    def keep(self, record: SequenceRecord) -> None:
        self._rows += record["rows"]

    def finish(self) -> None:
        (self._folder / "pairs.csv").write_text("\n".join(self._rows) + "\n")

    def _write(self, kind: str, name: str, png: bytes) -> None:
        (self._folder / kind / f"{name}.png").write_bytes(png)


def unoccluded_pixels(
    flow: NDArray[np.float32], part: NDArray[np.uint16], visibility: NDArray[np.uint8],
    next_part: NDArray[np.uint16],
) -> NDArray[np.bool_]:
    """[H W] whether a pixel with a known flow [H W 2] is seen in the next frame.

    For parts the visibility image says so; the world behind them is seen where no part is before
    it at the pixel to which the flow leads.
    """
    height, width = part.shape
    known = np.isfinite(flow[..., 0]) & np.isfinite(flow[..., 1])
    v, u = np.indices(part.shape)
    target = np.where(known[..., None], np.rint(np.stack([u, v], -1) + flow), -1).astype(np.int64)
    column, row = target[..., 0], target[..., 1]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    behind = (visibility == BACKGROUND) & inside & (next_part[row, column] == 0)
    return known & ((visibility == VISIBLE) | behind)


def calib(intrinsics: NDArray[np.float64], width: int, height: int) -> str:
    """A calib_cam_to_cam file of a single pinhole camera, number 2."""
    k, eye, zero = intrinsics, np.eye(3), np.zeros(3)
    values = {
        "S_02": [width, height], "K_02": k, "D_02": np.zeros(5), "R_02": eye, "T_02": zero,
        "S_rect_02": [width, height], "R_rect_02": eye,
        "P_rect_02": np.concatenate([k, zero[:, None]], axis=1),
    }  # fmt: skip
    lines = [f"{key}: " + " ".join(f"{x:.12e}" for x in np.ravel(value))
             for key, value in values.items()]
    return "\n".join(["calib_time: 01-Jan-2000 00:00:00", "corner_dist: 0", *lines]) + "\n"


def _depth(depth: NDArray[np.float32], archive: Archive) -> bytes:
    try:
        return codec.encode_depth(depth, _DEPTH_UNIT)
    except RenderError as error:
        raise DatasetError(f"{address(archive.path)}: depth is up to {depth.max():g} m, and a file "
                           "of KITTI holds less than 256 m; use another --format") from error
