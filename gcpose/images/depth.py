"""Depth from single images behind an interface."""

# pyright: basic
from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import ConfigError, suggestion


class Depth(Protocol):
    """Depth from single images, usually by a network; `training` names a network's data."""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the depth z [H W] of an image [H W 3], 0 where it is unknown.

        It is in m by a metric network, else up to a factor. GC-Pose uses only the ratios of depths
        in a video.
        """
        ...


@dataclass(frozen=True)
class NetworkDepth:
    """Depth by a network."""

    run: Callable[[NDArray[np.uint8]], NDArray[np.float32]]
    training: str
    """What the network was trained on"""

    def __call__(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """See `Depth`."""
        return self.run(rgb)


_NAMES = ("none", "mono:FOLDER", "hf:MODEL", "hf-metric:MODEL", "hf-relative:MODEL")


def find_depth(name: str) -> Depth | None:
    """Return the depth of a name: "none", "mono:FOLDER" with Monodepth2's weights, or "hf:MODEL".

    The folder holds encoder.pth and depth.pth. MODEL is one of transformers: a folder, or
    OWNER/NAME on the Hugging Face hub, from where transformers downloads it into its cache.
    "hf-metric:MODEL" and "hf-relative:MODEL" say what the network returns, see
    `load_transformers_depth`.

    Raises:
        ConfigError: If the name is unknown, or a file is missing or does not fit.
        MethodError: If PyTorch or transformers is missing.
    """
    kind, _, model = name.partition(":")
    if name == "none":
        return None
    if kind == "mono" and model:
        return _load_monodepth2(Path(model))
    if kind == "mono":
        raise ConfigError(
            "mono needs Monodepth2's weights, which are not distributed with gcbench: "
            "--depth mono:FOLDER, with encoder.pth and depth.pth in it"
        )
    if kind in ("hf", "hf-metric", "hf-relative") and model:
        from ..networks.hugging_face_depth import load_transformers_depth

        return NetworkDepth(*load_transformers_depth(model, kind.partition("-")[2]))
    raise ConfigError(f"no depth {name!r}{suggestion(name, _NAMES)}; there are {', '.join(_NAMES)}")


def _load_monodepth2(folder: Path, device: str = "auto") -> Depth:
    from ..networks import monodepth2
    from ..networks.torch_runtime import find_device, pad_image, torch, unit_range
    from ..networks.weights import read_weights

    place = find_device(device)
    encoder, decoder = monodepth2.DepthEncoder(), monodepth2.DepthDecoder()
    for network, file in ((encoder, "encoder.pth"), (decoder, "depth.pth")):
        network.load_state_dict(read_weights(folder / file, network.state_dict(), "Monodepth2"))
        network.to(place).eval()
    size = (monodepth2.IMAGE_WIDTH, monodepth2.IMAGE_HEIGHT)

    def depth(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
        image = pad_image(unit_range(np.asarray(small, np.uint8)), 1).to(place)
        with torch.no_grad():
            out = monodepth2.depth_from_disparity(decoder(encoder(image)))[0, 0].cpu().numpy()
        full = (rgb.shape[1], rgb.shape[0])
        return np.asarray(cv2.resize(out, full, interpolation=cv2.INTER_LINEAR), np.float32)

    return NetworkDepth(depth, "self-supervised: KITTI")
