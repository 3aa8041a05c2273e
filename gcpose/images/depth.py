"""Depth from single images behind an interface; its scale is unknown."""

# pyright: basic
from __future__ import annotations

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError


class Depth(Protocol):
    """Depth from single images, usually by a network."""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the depth [H W] of an image [H W 3], up to scale."""
        ...


def depth_named(name: str) -> Depth | None:
    """Return the depth of a name: "none", or "mono:FOLDER" with Monodepth2's weights.

    The folder holds encoder.pth and depth.pth.

    Raises:
        ConfigError: If the name is unknown, or a file is missing or does not fit.
        MethodError: If PyTorch is missing.
    """
    kind, _, folder = name.partition(":")
    if name == "none":
        return None
    if kind == "mono" and folder:
        return _load_monodepth2(Path(folder))
    if kind == "mono":
        raise ConfigError(
            "mono needs Monodepth2's weights, which are not distributed with gcbench: "
            "--depth mono:FOLDER, with encoder.pth and depth.pth in it"
        )
    raise ConfigError(f"no depth {name!r}; there are none and mono:FOLDER")


def _load_monodepth2(folder: Path, device: str = "auto") -> Depth:
    from ..networks import monodepth2
    from ..networks.torch_runtime import device_named, padded, torch, unit_range
    from ..networks.weights import read_weights

    place = device_named(device)
    encoder, decoder = monodepth2.DepthEncoder(), monodepth2.DepthDecoder()
    for network, file in ((encoder, "encoder.pth"), (decoder, "depth.pth")):
        network.load_state_dict(read_weights(folder / file, network.state_dict(), "Monodepth2"))
        network.to(place).eval()
    size = (monodepth2.IMAGE_WIDTH, monodepth2.IMAGE_HEIGHT)

    def depth(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
        image = padded(unit_range(np.asarray(small, np.uint8)), 1).to(place)
        with torch.no_grad():
            out = monodepth2.depth_from_disparity(decoder(encoder(image)))[0, 0].cpu().numpy()
        full = (rgb.shape[1], rgb.shape[0])
        return np.asarray(cv2.resize(out, full, interpolation=cv2.INTER_LINEAR), np.float32)

    return depth
