"""Optical flow, behind an interface: whatever maps two images to displacements will do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError
from .flow_types import Flow


def for_cuts_of(flow: Flow, height: int, width: int) -> Flow:
    """The flow for cuts of images of that size: a network sees them as small as whole ones."""
    sized: Callable[[int, int], Flow] | None = getattr(flow, "for_cuts_of", None)
    return flow if sized is None else sized(height, width)


def dis_flow(rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """OpenCV's dense inverse search."""
    return _dis(cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM), rgb_a, rgb_b)


def fine_dis_flow(rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The same down to single pixels: better on small parts, and six times slower."""
    estimator = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    estimator.setFinestScale(0)
    estimator.setPatchStride(2)
    estimator.setGradientDescentIterations(40)
    return _dis(estimator, rgb_a, rgb_b)


def _dis(
    estimator: cv2.DISOpticalFlow, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]
) -> NDArray[np.float32]:
    a, b = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (rgb_a, rgb_b))
    start = np.zeros((*a.shape, 2), np.float32)
    return np.asarray(estimator.calc(a, b, start), np.float32)


def flow_named(name: str) -> Flow:
    """The flow that `--flow` names: "dis", "dis-fine", "raft[:WEIGHTS]" or "flownet2:CHECKPOINT".

    Raises GcbenchError for another name, a file that does not fit, or where PyTorch is missing.
    """
    kind, _, file = name.partition(":")
    if kind in _CLASSICAL and not file:
        return _CLASSICAL[kind]
    if kind == "raft":
        from .raft_flow import SHIPPED, raft_flow

        return raft_flow(Path(file) if file else SHIPPED)
    if kind == "flownet2":
        if not file:
            raise GcbenchError(
                "flownet2 needs its checkpoint, which is not ours to give: "
                "--flow flownet2:FlowNet2_checkpoint.pth.tar"
            )
        from .flownet2_flow import flownet2_flow

        return flownet2_flow(Path(file))
    raise GcbenchError(
        f"no flow {name!r}; there are {', '.join(_CLASSICAL)}, raft, raft:WEIGHTS and "
        "flownet2:CHECKPOINT"
    )


_CLASSICAL: dict[str, Flow] = {"dis": dis_flow, "dis-fine": fine_dis_flow}


_TRAINED = {
    "raft": "supervised: flow of synthetic video",
    "flownet2": "supervised: FlyingChairs and FlyingThings3D",
    "mono": "self-supervised: KITTI",
}


def training_of(*names: str) -> str:
    """What a row says of the networks that `--flow` and `--depth` name: what their official
    weights, or ours, were trained on."""
    kinds = [name.partition(":")[0] for name in names]
    return "; ".join(_TRAINED[k] for k in kinds if k in _TRAINED) or "none"
