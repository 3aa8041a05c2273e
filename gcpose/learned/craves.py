"""CRAVES (Zuo et al., CVPR 2019) as a method: keypoints of the OWI-535, then its angles.

Each image is fitted by itself. The crop of an image is about the keypoints of the image before, or
is found from the whole image.
"""

# pyright: basic
from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import MethodError
from ...renderer.types import Estimate, Inputs, Knowledge, Observation
from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ..networks.hourglass import KEYPOINTS, StackedHourglass, hourglass_width
from ..networks.keypoint_crops import (
    cut_crop,
    find_peaks,
    frame_keypoints,
    network_input,
    place_crop,
    to_image,
)
from ..networks.torch_runtime import torch
from .arm_fit import ArmFit, ArmPose
from .trained import load_trained

_PUBLISHED_WIDTH = 256
_SURE = 0.15  # heights of peaks that count
_FEWEST = 12  # keypoints of a fit
_PASSES = 2  # times that crops are placed about the keypoints of those before
_SIDES = 0.8, 1.0, 1.3, 1.7  # of these crops, in sides of the first
_ALIKE = 4.0  # cells of a heat map within which crops show the same peak


@dataclass(frozen=True)
class Look:
    """The keypoints as one crop shows them."""

    pixels: Array
    """[17 2] px of the image"""
    score: Array
    """[17] heights of the peaks"""
    cell: float
    """Side of a cell of the heat maps, px of the image"""


class Craves:
    """Keypoints by the network of a file of weights, angles and camera by Levenberg-Marquardt."""

    name = "craves"
    inputs: tuple[Inputs, ...] = ("rgb",)
    knowledge: tuple[Knowledge, ...] = ("model",)
    version = "3"
    authors = "Y. Zuo, W. Qiu, L. Xie, F. Zhong, Y. Wang, A. Yuille"
    link = "https://arxiv.org/abs/1812.00725"
    date = "2018-12"

    def __init__(self, weights: str = "", device: str = "auto") -> None:
        """Load the weights that `gcbench train craves` wrote.

        Raises:
            ConfigError: If the file is missing or has no weights of this network.
        """
        self.trained = load_trained(
            "craves", weights, device, hourglass_width,
            lambda width, _: StackedHourglass(width), _PUBLISHED_WIDTH)
        self.training = self.trained.describe_training("images")
        self.name += f" {self.trained.label}"

    def estimate(self, observation: Observation) -> Estimate:
        """Return the differences of the angles to frame 0, and the axes in frame 0.

        Raises:
            MethodError: If the observation has no images or no model with the keypoints.
        """
        if observation.rgb is None or observation.model is None:
            raise MethodError("craves needs images and the model: --inputs rgb --knowledge model")
        fit = ArmFit(arm_model(observation.model))
        if observation.n_joints != len(fit.joints):
            raise MethodError(f"craves estimates {len(fit.joints)} joints; this video has "
                              f"{observation.n_joints} scored joints")
        poses = [pose for _, pose in self.poses(observation.rgb, observation.intrinsics, fit,
                                                observation.cam_from_world)]
        angle = np.array([pose.angles for pose in poses])
        return Estimate(angle - angle[0], fit.screws(poses[0]))

    def poses(
        self, images: Iterable[NDArray[np.uint8]], intrinsics: Array, fit: ArmFit,
        camera: Array | None = None,
    ) -> Iterator[tuple[Array, ArmPose]]:
        """Yield keypoints [17 2] px, and angles and camera, of each image [H W 3] of a video.

        `camera` is a cam_from_world [4 4] from which the search may start.
        """
        pixels: Array | None = None
        pose: ArmPose | None = None
        for image in images:
            pixels, score = self.keypoints(image, pixels)
            used = choose_keypoints(score)
            weight = np.where(used, np.clip(score, 0.01, 1.0) ** 2, 0.0)
            pose = fit.solve(pixels, weight, intrinsics, pose, camera)
            yield pixels, pose

    def keypoints(self, image: NDArray[np.uint8], near: Array | None = None) -> tuple[Array, Array]:
        """Return the keypoints [17 2] px of an image [H W 3] and their scores [17].

        `near` [17 2] px are keypoints of an image before; they say where to look first. A crop of
        the wrong size misses some keypoints, so there are several crops (see `merge_looks`).
        """
        height, width = image.shape[:2]
        looks, around = list[Look](), near
        if near is None:
            center = np.array([width - 1, height - 1]) / 2
            looks.append(self._look(image, center, float(max(width, height))))
        for _ in range(_PASSES if near is None else 1):
            if looks:
                found, score = merge_looks(looks)
                around = found[score >= np.sort(score)[-_FEWEST]]
            assert around is not None
            center, side = frame_keypoints(around)
            looks += [self._look(image, center, share * side) for share in _SIDES]
        found, score = merge_looks(looks)
        if near is not None and (score > _SURE).sum() < _FEWEST:
            return self.keypoints(image)
        return found, score

    def _look(self, image: NDArray[np.uint8], center: Array, side: float) -> Look:
        """Look for the keypoints in a square of the image."""
        image_from_crop = place_crop(center, side)
        crop = network_input(cut_crop(image, image_from_crop))
        with torch.no_grad():
            maps = self.trained.network(self.trained.tensor(crop))[-1]
        maps = maps[0].cpu().numpy()
        if not np.isfinite(maps).all():
            raise MethodError("craves returned numbers that are not finite")
        position, score = find_peaks(maps)
        return Look(to_image(image_from_crop, position), score, side / maps.shape[-1])


def merge_looks(looks: Sequence[Look]) -> tuple[Array, Array]:
    """Return positions [17 2] px and scores [17] of the keypoints of all looks.

    The look with the highest score decides where a keypoint is; the position is the mean over the
    looks that agree, by their scores, as the errors of the looks differ.
    """
    pixels, score = np.stack([k.pixels for k in looks]), np.stack([k.score for k in looks])
    best, each = score.argmax(axis=0), np.arange(score.shape[1])
    reach = _ALIKE * np.array([look.cell for look in looks])[best]
    alike = np.linalg.norm(pixels - pixels[best, each], axis=2) <= reach
    weight = alike * np.clip(score, 1e-6, None)
    return np.einsum("kn,knd->nd", weight / weight.sum(axis=0), pixels), score[best, each]


def choose_keypoints(score: Array) -> NDArray[np.bool_]:
    """Return which keypoints [17] take part: scores [17] above 0.15, or the 12 highest."""
    return score >= min(np.sort(score)[-_FEWEST], np.nextafter(_SURE, 1.0))


def arm_model(model: ArticulatedModel) -> ArticulatedModel:
    """Return the model. Raises MethodError if it has not the keypoints of the network."""
    if len(model.keypoint) != KEYPOINTS:
        raise MethodError(f"craves knows the {KEYPOINTS} keypoints of the OWI-535; {model.name} "
                          f"has {len(model.keypoint)}")
    return model
