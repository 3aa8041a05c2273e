"""Optical flow behind an interface: any function from two images to displacements."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError
from .settings import FlowSettings

_DEFAULT = FlowSettings()


class Flow(Protocol):
    """A learned or classical optical flow."""

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the displacement (du, dv) [H W 2], px, of each pixel of image a [H W 3] to b."""
        ...


def for_cuts_of(flow: Flow, height: int, width: int) -> Flow:
    """Return the flow for crops of images of a size, px.

    A network sees crops at the resolution at which it sees whole images.
    """
    sized: Callable[[int, int], Flow] | None = getattr(flow, "for_cuts_of", None)
    return flow if sized is None else sized(height, width)


def dis_flow(rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the flow [H W 2], px, by OpenCV's dense inverse search (Kroeger et al., ECCV 2016)."""
    return _dis(cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM), rgb_a, rgb_b)


def fine_dis_flow(
    rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8], settings: FlowSettings = _DEFAULT
) -> NDArray[np.float32]:
    """Return the same at full resolution: better on small parts, and six times slower."""
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    estimator.setFinestScale(settings.fine_scale)
    estimator.setPatchStride(settings.fine_stride)
    estimator.setGradientDescentIterations(settings.fine_iterations)
    return _dis(estimator, rgb_a, rgb_b)


def _dis(
    estimator: cv2.DISOpticalFlow, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]
) -> NDArray[np.float32]:
    a, b = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (rgb_a, rgb_b))
    start = np.zeros((*a.shape, 2), np.float32)
    return np.asarray(estimator.calc(a, b, start), np.float32)


_TRAINED = {
    "raft": "supervised: flow of synthetic video",
    "flownet2": "supervised: FlyingChairs and FlyingThings3D",
    "mono": "self-supervised: KITTI",
}


def flow_named(name: str, settings: FlowSettings = _DEFAULT) -> Flow:
    """Return the flow of a name: "dis", "dis-fine", "raft[:WEIGHTS]" or "flownet2:CHECKPOINT".

    Raises:
        ConfigError: If the name is unknown, or a file is missing or does not fit.
        MethodError: If PyTorch is missing.
    """
    kind, _, file = name.partition(":")
    if name == "dis":
        return dis_flow
    if name == "dis-fine":
        return partial(fine_dis_flow, settings=settings)
    if kind == "raft":
        from . import network_flow

        return network_flow.load_raft(
            Path(file) if file else network_flow.SHIPPED, settings)
    if kind == "flownet2":
        if not file:
            raise ConfigError(
                "flownet2 needs its checkpoint, which is not distributed with gcbench: "
                "--flow flownet2:FlowNet2_checkpoint.pth.tar"
            )
        from . import network_flow

        return network_flow.load_flownet2(Path(file), settings)
    raise ConfigError(
        f"no flow {name!r}; there are dis, dis-fine, raft, raft:WEIGHTS and flownet2:CHECKPOINT"
    )


def training_of(*names: str) -> str:
    """Return the training data of the networks with these names of `--flow` and `--depth`."""
    kinds = [name.partition(":")[0] for name in names]
    return "; ".join(_TRAINED[k] for k in kinds if k in _TRAINED) or "none"
