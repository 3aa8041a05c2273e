"""Optical flow behind an interface: any function from two images to displacements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, suggestion
from .raft_network import RAFT_WEIGHTS, load_raft
from .settings import FlowSettings

_DEFAULT = FlowSettings()


class Flow(Protocol):
    """A learned or classical optical flow; an attribute `training` names a network's data.

    Two threads may call it at once.
    """

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the displacement (du, dv) [H W 2], px, of each pixel of image a [H W 3] to b."""
        ...


@dataclass(frozen=True)
class FlowPair:
    """Two flows with different errors; a call returns their mean."""

    one: Flow
    two: Flow
    training: str = ""
    """What their networks were trained on"""

    def for_cuts_of(self, height: int, width: int) -> FlowPair:
        """Return the same for crops of images of a size, px."""
        return replace(self, one=for_cuts_of(self.one, height, width),
                       two=for_cuts_of(self.two, height, width))

    def __call__(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the mean [H W 2], px."""
        return np.asarray((self.one(rgb_a, rgb_b) + self.two(rgb_a, rgb_b)) / 2, np.float32)


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


_NAMES = ("dis", "dis-fine", "raft", "raft:WEIGHTS", "flownet2:CHECKPOINT",
          "torchvision:NAME[:WEIGHTS]", "dis-fine+FLOW")


def find_flow(name: str, settings: FlowSettings = _DEFAULT) -> Flow:
    """Return the flow of a name: one of `_NAMES`, where capitals stand for files and networks.

    `dis-fine+FLOW` is a `FlowPair`.

    Raises:
        ConfigError: If the name is unknown, or a file is missing or does not fit.
        MethodError: If PyTorch or torchvision is missing, for networks other than `raft`.
    """
    kind, _, file = name.partition(":")
    if name == "dis":
        return dis_flow
    if name == "dis-fine":
        return partial(fine_dis_flow, settings=settings)
    if name.startswith("dis-fine+"):
        second = find_flow(name.removeprefix("dis-fine+"), settings)
        return FlowPair(find_flow("dis-fine", settings), second, getattr(second, "training", ""))
    if kind == "raft":
        return load_raft(Path(file) if file else RAFT_WEIGHTS, settings)
    if kind in ("flownet2", "torchvision"):
        from .network_flow import find_network_flow

        return find_network_flow(name, settings)
    raise ConfigError(f"no flow {name!r}{suggestion(name, _NAMES)}; there are {', '.join(_NAMES)}")


def training_of(*estimators: object, then: str = "") -> str:
    """Return what the networks among flow and depth estimators, and `then` they, were trained on.

    It is short enough for the attribute `training` of a method.
    """
    data = [*(getattr(e, "training", "") for e in estimators), then]
    return "; ".join(filter(None, data))[:200] or "none"


def row_suffix(**options: str) -> str:
    """Return what options such as flow="raft:FILE" add to a method's name, without folders."""
    return "".join(f" {option}={_without_folders(name)}" for option, name in options.items()
                   if name not in ("", "none"))


def _without_folders(name: str) -> str:
    kind, *rest = name.split(":")
    return ":".join([kind, *(Path(r).absolute().name if Path(r).exists() else r for r in rest)])
