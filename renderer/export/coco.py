"""COCO's instance annotations: each visible part of a frame is an instance, its name a category.

    images/SSSSSS_TTTTTT.png
    annotations/instances.json     masks as compressed run lengths, boxes [x y width height]
    annotations/keypoints.json     the whole model as one instance, with the model's keypoints, if
                                   the dataset has that layer: 2 is seen, 1 hidden, 0 not in view

Keypoints are where the dataset has them: the center of the top-left pixel is (0, 0). Pixels of a
mask are counted as in COCO: a box around the single pixel (3, 5) is [3, 5, 1, 1].
"""

# pycocotools is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as _coco

from ..dataset import Dataset
from ..runtime import Archive, dump_json
from ..types import Sequence
from .writer import SequenceRecord, Writer


class Coco(Writer):
    """See `Writer`."""

    def __init__(self, folder: Path, dataset: Dataset) -> None:
        super().__init__(folder, dataset)
        (folder / "images").mkdir(exist_ok=True)
        (folder / "annotations").mkdir(exist_ok=True)
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []
        self._keypoints: list[dict[str, Any]] = []
        self._keypoint_names: list[str] = []
        self._categories: dict[str, int] = {}

    def add(self, sequence: Sequence, archive: Archive) -> dict[str, Any]:
        meta = sequence.meta
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        points: list[dict[str, Any]] = []
        categories = dict(self._categories)
        for t in range(len(sequence)):
            name = f"{archive.path.stem}_{t:06d}.png"
            (self.folder / "images" / name).write_bytes(archive.read(f"rgb/{t:06d}.png"))
            number = len(self._images) + t + 1
            images.append({
                "id": number, "file_name": name, "width": meta.width,
                "height": meta.height, "sequence": archive.path.stem, "frame": t,
            })
            part = sequence.part[t]
            if part.any() and (places := keypoints(sequence, t)) is not None:
                points.append({
                    "id": len(self._keypoints) + len(points) + 1, "image_id": number,
                    "category_id": 1, **instance(part > 0), "keypoints": places,
                    "num_keypoints": int(np.count_nonzero(places[2::3])),
                })
            for p in np.unique(part[part > 0]):
                category = categories.setdefault(meta.part_names[p - 1], len(categories) + 1)
                annotations.append({
                    "id": len(self._annotations) + len(annotations) + 1, "image_id": number,
                    "category_id": category, **instance(part == p), "part": int(p),
                })
        return {"images": images, "annotations": annotations, "keypoints": points,
                "keypoint_names": meta.keypoint_names if points else (), "categories": categories}

    def keep(self, record: SequenceRecord) -> None:
        self._images += record["images"]
        self._annotations += record["annotations"]
        self._keypoints += record["keypoints"]
        self._keypoint_names = record["keypoint_names"] or self._keypoint_names
        self._categories = record["categories"]

    def finish(self) -> None:
        licence = "; ".join(dict.fromkeys(str(a.get("licence", ""))
                                          for a in self.dataset.info.assets))
        model = Path(self.dataset.config.robot).stem
        common = {
            "info": {"description": f"gcbench: {model}", "version": "1.0"},
            "licenses": [{"id": 1, "name": f"of the model: {licence}", "url": ""}],
            "images": [{**image, "license": 1} for image in self._images],
        }
        parts = [{"id": k, "name": part, "supercategory": model}
                 for part, k in self._categories.items()]
        folder = self.folder / "annotations"
        (folder / "instances.json").write_bytes(dump_json(
            {**common, "annotations": self._annotations, "categories": parts}))
        if self._keypoint_names:
            whole = {"id": 1, "name": model, "supercategory": "model",
                     "keypoints": self._keypoint_names, "skeleton": []}
            (folder / "keypoints.json").write_bytes(dump_json(
                {**common, "annotations": self._keypoints, "categories": [whole]}))


def keypoints(sequence: Sequence, t: int) -> list[float] | None:
    """x, y and v of each keypoint in frame t; None without keypoints."""
    s, meta = sequence.state, sequence.meta
    if s.keypoint_image is None or s.keypoint_visible is None or not meta.keypoint_names:
        return None
    image, visible = s.keypoint_image[t], s.keypoint_visible[t]
    with np.errstate(invalid="ignore"):
        inside = ((image > -0.5) & (image < [meta.width - 0.5, meta.height - 0.5])).all(-1)
    image = np.where(inside[:, None], image, 0.0)
    flag = np.where(inside, 1 + visible, 0)
    return np.concatenate([image, flag[:, None]], axis=1).ravel().tolist()


def instance(mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Segmentation, area, box and crowd flag of a mask [H W]."""
    runs: Any = _coco.encode(np.asfortranarray(mask, np.uint8))
    return {
        "segmentation": {"size": list(runs["size"]), "counts": runs["counts"].decode("ascii")},
        "area": int(_coco.area(runs)), "bbox": _coco.toBbox(runs).tolist(), "iscrowd": 0,
    }
