"""CRAVES on single images: errors of its angles and of its keypoints, as it publishes them."""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from ...errors import DatasetError
from ...renderer.dataset import DATASET_FILE, Dataset, open_dataset
from ...robots.catalog import load_robot
from ...robots.geometry import Array
from ..networks.keypoint_crops import keypoint_errors
from .arm_fit import ArmFit
from .craves import Craves
from .craves_lab import ArmImage, read_lab


@dataclass(frozen=True)
class ArmErrors:
    """Errors in images of the arm."""

    joints: tuple[str, ...]
    angle: Array
    """[N 4] deg"""
    pixels: Array
    """[N 17] px; NaN where the truth is unknown"""
    close: Array
    """[N 17] 1 where `pixels` is at most 0.2 of the side of the box of the keypoints, else 0"""

    def table(self) -> str:
        """Return the errors of all images, and of the better half of them by the true error."""
        order = np.argsort(self.angle.mean(axis=1), kind="stable")
        half = order[: (len(order) + 1) // 2]
        lines = [f"{'deg':14}" + "".join(f"{j:>12}" for j in (*self.joints, "mean"))]
        for name, rows in (("all images", slice(None)), ("best half", half)):
            means = [*self.angle[rows].mean(axis=0), self.angle[rows].mean()]
            lines.append(f"{name:14}" + "".join(f"{x:12.2f}" for x in means))
        median = [*np.median(self.angle, axis=0), np.median(self.angle)]
        lines.append(f"{'median':14}" + "".join(f"{x:12.2f}" for x in median))
        known = np.isfinite(self.pixels)
        pck = f"{100 * self.close[known].mean():.1f} %" if known.any() else "not known"
        px = f"{self.pixels[known].mean():.2f} px" if known.any() else "not known"
        count = f"{len(self.angle)} images, PCK@0.2 {pck}, error of keypoints {px}"
        return "\n".join([*lines, count])


def score_images(path: Path, weights: str, device: str = "auto", limit: int = 0) -> ArmErrors:
    """Score CRAVES on the images of a dataset of the OWI-535, or of CRAVES' Lab data.

    Each image is estimated by itself, without the pose of its camera.

    Raises:
        ConfigError: If the weights cannot be read.
        DatasetError: If there are no images of the arm at the path, or files are damaged.
    """
    method, fit = Craves(weights, device), ArmFit(load_robot("owi535"))
    images = (_images_of(open_dataset(path)) if (path / DATASET_FILE).exists()
              else read_lab(path, fit))
    return arm_errors(method, fit, islice(images, limit or None))


def arm_errors(method: Craves, fit: ArmFit, images: Iterable[ArmImage]) -> ArmErrors:
    """Return the errors of a method in images. Raises DatasetError if there are none."""
    rows: list[tuple[Array, Array, Array]] = []
    for image in images:
        ((pixels, pose),) = method.poses([image.rgb], image.intrinsics, fit)
        turn = pose.angles - image.angles
        angle = np.degrees(np.abs((turn + np.pi) % (2 * np.pi) - np.pi))
        rows.append((angle, *keypoint_errors(pixels, image.keypoints)))
    if not rows:
        raise DatasetError("there are no images to score")
    names = tuple(fit.model.joint_names[j] for j in fit.joints)
    return ArmErrors(names, *(np.stack(x).astype(np.float64) for x in zip(*rows, strict=True)))


def _images_of(dataset: Dataset) -> Iterator[ArmImage]:
    """Yield each image of a dataset of the OWI-535."""
    for sequence in dataset:
        meta, state = sequence.meta, sequence.state
        try:
            joints = [meta.joint_names.index(n) for n in ("rotation", "base", "elbow", "wrist")]
        except ValueError:
            raise DatasetError(f"sequence {meta.name} does not show the OWI-535") from None
        for t, rgb in enumerate(sequence.rgb):
            pixels = (np.full((17, 2), np.nan) if state.keypoint_image is None
                      else state.keypoint_image[t])
            yield ArmImage(rgb, state.intrinsics, state.joint_positions[t, joints], pixels)
