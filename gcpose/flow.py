"""Optical flow, behind an interface: whatever maps two images to displacements will do."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray


class Flow(Protocol):
    """A learned flow, or a classical one."""

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H W 2] displacement (du, dv), px, of each pixel of image a [H W 3] to image b."""
        ...


def dis_flow(rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """OpenCV's dense inverse search."""
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    a, b = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (rgb_a, rgb_b))
    start = np.zeros((*a.shape, 2), np.float32)
    return np.asarray(estimator.calc(a, b, start), np.float32)
