"""BOP's layout, for 6D object pose estimation: a sequence is a scene, a part with a surface is
an object. Lengths are in mm, as there. An object's number is that of its part, counted on through
the instances where each sequence shows another one.

    models/obj_OOOOOO.ply, models_info.json     parts in their own frames; diameter, box
    SPLIT/SSSSSS/rgb, depth                     the dataset's images
    SPLIT/SSSSSS/scene_camera.json              cam_K, depth_scale, cam_R_w2c, cam_t_w2c
    SPLIT/SSSSSS/scene_gt.json                  cam_R_m2c, cam_t_m2c, obj_id of each part
    SPLIT/SSSSSS/scene_gt_info.json             boxes, pixel counts, visib_fract
    SPLIT/SSSSSS/mask, mask_visib               silhouettes as if nothing were before them; what
                                                is seen: IIIIII_GGGGGG.png, image and object
    test_targets_bop19.json                     objects that are visible by 10 % (of split test)

Silhouettes are counted beyond the image too, on a canvas of three times its size, as bop_toolkit's
calc_gt_info.py does; boxes are [x, y, last x - x, last y - y], as there. They need the model: it is
loaded as for rendering, nothing is downloaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ..dataset import Dataset, codec
from ..gl import Rasterizer
from ..runtime import Archive, address, dump_json
from ..scene import PosedModel, model_of, pose_parts, robot_of
from ..types import Camera, Meta, Sequence
from .bop_models import size_of, write_ply
from .writer import SequenceRecord, Writer

_MM = 1000.0
_PASS = 32  # parts whose silhouettes are drawn at once
_LEAST_VISIBLE = 0.1


@dataclass(frozen=True)
class _Model:
    robot: str
    """The name that loads it."""
    model: ArticulatedModel
    parts: list[int]
    """Indices of those that have a surface."""
    first: int
    """Object number of part 0."""


class Bop(Writer):
    """See `Writer`. `add` raises DatasetError if the model is another one or deforms."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        self._split = dataset.config.stream
        self._now: _Model | None = None
        self._firsts: dict[str, int] = {}
        """Number of each model's first object."""
        self._next = 1
        self._infos: dict[str, Any] = {}
        width, height = dataset.config.width, dataset.config.height
        self._rasterizer = Rasterizer(3 * width, 3 * height, 1)
        self._targets: list[dict[str, int]] = []
        self._camera: dict[str, float] = {}
        (folder / "models").mkdir(exist_ok=True)

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta, s = sequence.meta, sequence.state
        now = self._now = self._model_of(meta)
        if meta.part_names != now.model.part_names:
            raise DatasetError(f"{address(archive.path)}: its parts are not those of the "
                               "loaded model")
        folder = self.folder / self._split / archive.path.stem
        for kind in ("rgb", "depth", "mask", "mask_visib"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
        cam_from_part = s.cam_from_world[:, None] @ s.world_from_part
        # Silhouettes are drawn from the camera's frame, on a canvas of three times the image.
        middle = s.intrinsics + np.array([[0, 0, meta.width], [0, 0, meta.height], [0, 0, 0]])
        large = Camera(3 * meta.width, 3 * meta.height, middle, np.eye(4))
        posed = pose_parts(now.model, cam_from_part)
        scale = meta.depth_unit * _MM
        k = s.intrinsics
        camera = {
            "cx": k[0, 2], "cy": k[1, 2], "fx": k[0, 0], "fy": k[1, 1], "depth_scale": scale,
            "width": meta.width, "height": meta.height}
        cameras: dict[str, Any] = {}
        poses: dict[str, Any] = {}
        infos: dict[str, Any] = {}
        targets: list[dict[str, int]] = []
        for t in range(len(sequence)):
            for kind in ("rgb", "depth"):
                (folder / kind / f"{t:06d}.png").write_bytes(archive.read(f"{kind}/{t:06d}.png"))
            cameras[str(t)] = {"cam_K": k.ravel(), "depth_scale": scale,
                               **_pose("w2c", s.cam_from_world[t])}
            poses[str(t)] = [{**_pose("m2c", cam_from_part[t, p]), "obj_id": now.first + p}
                             for p in now.parts]
            silhouettes = self._silhouettes(now.parts, posed, large, t)
            seen = infos[str(t)] = _write_masks(folder, sequence, t, now.parts, silhouettes)
            targets += [{"scene_id": meta.index, "im_id": t, "obj_id": now.first + p,
                         "inst_count": 1} for p, info in zip(now.parts, seen, strict=True)
                        if info["visib_fract"] >= _LEAST_VISIBLE]
        for name, tree in (("camera", cameras), ("gt", poses), ("gt_info", infos)):
            (folder / f"scene_{name}.json").write_bytes(dump_json(tree))
        return {"robot": now.robot, "first": now.first, "parts": len(meta.part_names),
                "objects": {} if now.robot in self._firsts else _objects(now),
                "camera": camera, "targets": targets}

    def keep(self, record: SequenceRecord) -> None:
        if record["robot"] not in self._firsts:
            self._firsts[record["robot"]] = record["first"]
            self._next = record["first"] + record["parts"]
            self._infos |= record["objects"]
        self._camera = self._camera or record["camera"]
        self._targets += record["targets"]

    def finish(self) -> None:
        (self.folder / "models" / "models_info.json").write_bytes(dump_json(self._infos))
        (self.folder / "camera.json").write_bytes(dump_json(self._camera))
        if self._split == "test":
            (self.folder / "test_targets_bop19.json").write_bytes(dump_json(self._targets))

    def close(self) -> None:
        self._rasterizer.close()

    def _silhouettes(
        self, parts: list[int], posed: PosedModel, camera: Camera, t: int
    ) -> list[NDArray[np.bool_]]:
        """[3H 3W] of each object in frame t."""
        count = posed.world_from_part.shape[1]
        where = np.tile([0, 0, camera.width, camera.height], (count, 1))
        out: list[NDArray[np.bool_]] = []
        for start in range(0, len(parts), _PASS):
            members = parts[start:start + _PASS]
            group = np.full(count, -1, np.int64)
            group[members] = np.arange(len(members))
            bits = self._rasterizer.draw_coverage(posed, camera, t, group, where)
            out += [(bits >> np.uint32(g)) & np.uint32(1) > 0 for g in range(len(members))]
        return out

    def _model_of(self, meta: Meta) -> _Model:
        """The model of a sequence; it is written on its first use."""
        robot = robot_of(self.dataset.config, meta)
        if self._now is not None and self._now.robot == robot:
            return self._now
        model = model_of(self.dataset.config, meta, self.dataset.allow_model)
        if any(v.deforms for v in model.visuals):
            raise DatasetError(f"{robot} deforms, and BOP has rigid objects only")
        first = self._firsts.get(robot, self._next)
        now = _Model(robot, model, sorted({v.part for v in model.visuals}), first)
        for p in now.parts if robot not in self._firsts else []:
            write_ply(self.folder / "models" / f"obj_{first + p:06d}.ply",
                      [v for v in model.visuals if v.part == p])
        return now


def _write_masks(
    folder: Path, sequence: Sequence, t: int, parts: list[int], silhouettes: list[NDArray[np.bool_]]
) -> list[dict[str, Any]]:
    """Write the masks of the objects in frame t; return their entries of scene_gt_info."""
    part, depth = sequence.part[t], sequence.depth[t]
    height, width = part.shape
    infos: list[dict[str, Any]] = []
    for k, (p, large) in enumerate(zip(parts, silhouettes, strict=True)):
        visible = part == p + 1
        inside = large[height:2 * height, width:2 * width]
        inside |= visible  # both are sampled at pixel centers, with roundings of their own
        name = f"{t:06d}_{k:06d}.png"
        (folder / "mask" / name).write_bytes(codec.encode_labels(inside * np.uint8(255)))
        (folder / "mask_visib" / name).write_bytes(codec.encode_labels(visible * np.uint8(255)))
        everything, seen = int(large.sum()), int(visible.sum())
        infos.append({
            "bbox_obj": _box(large, width, height) if seen else [-1] * 4,
            "bbox_visib": _box(visible, 0, 0) if seen else [-1] * 4,
            "px_count_all": everything,
            "px_count_valid": int(np.count_nonzero(inside & (depth > 0))),
            "px_count_visib": seen,
            "visib_fract": seen / everything if everything else 0.0,
        })
    return infos


def _objects(now: _Model) -> dict[str, Any]:
    """The entries of models_info.json for the model's parts."""
    return {str(now.first + p): {
        "name": now.model.part_names[p], "model": now.model.name,
        **size_of(np.concatenate([v.vertices for v in now.model.visuals if v.part == p]))}
        for p in now.parts}


def _pose(name: str, matrix: Array) -> dict[str, Any]:
    return {f"cam_R_{name}": matrix[:3, :3].ravel(), f"cam_t_{name}": matrix[:3, 3] * _MM}


def _box(mask: NDArray[np.bool_], left: int, top: int) -> list[int]:
    """[x, y, last x - x, last y - y] of a mask's pixels, of which (left, top) is called (0, 0)."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    x, y = int(columns[0]), int(rows[0])
    return [x - left, y - top, int(columns[-1]) - x, int(rows[-1]) - y]
