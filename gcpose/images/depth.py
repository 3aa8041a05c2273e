"""Depth from one image, behind an interface; its scale is not known."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import GcbenchError


class Depth(Protocol):
    """A network, as a rule."""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """[H W] depth, up to one factor, of an image [H W 3]."""
        ...


def depth_named(name: str) -> Depth | None:
    """What `--depth` names: "none", or "mono:FOLDER" with Monodepth2's encoder.pth and depth.pth.

    Raises GcbenchError for another name, files that do not fit, or where PyTorch is missing.
    """
    kind, _, folder = name.partition(":")
    if name == "none":
        return None
    if kind == "mono" and folder:
        return _mono(Path(folder))
    if kind == "mono":
        raise GcbenchError(
            "mono needs Monodepth2's weights, which are not ours to give: --depth mono:FOLDER, "
            "with encoder.pth and depth.pth in it"
        )
    raise GcbenchError(f"no depth {name!r}; there are none and mono:FOLDER")


def _mono(folder: Path, device: str = "auto") -> Depth:
    from ..networks.monodepth2 import HEIGHT, WIDTH, Decoder, Encoder, depth_from_disparity
    from ..networks.torch_runtime import device_named, padded, torch, unit
    from ..networks.weights import read_weights

    place = device_named(device)
    encoder, decoder = Encoder(), Decoder()
    for network, file in ((encoder, "encoder.pth"), (decoder, "depth.pth")):
        network.load_state_dict(read_weights(folder / file, network.state_dict(), "Monodepth2"))
        network.to(place).eval()

    def depth(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        small = cv2.resize(rgb, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        image = padded(unit(np.asarray(small, np.uint8)), 1)
        with torch.no_grad():
            out = depth_from_disparity(decoder(encoder(image.to(place))))[0, 0].cpu().numpy()
        size = (rgb.shape[1], rgb.shape[0])
        return np.asarray(cv2.resize(out, size, interpolation=cv2.INTER_LINEAR), np.float32)

    return depth
