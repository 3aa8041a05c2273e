"""A flow network tuned to one video (Sec. 3.2), by the epipolar constraint and brightness.

Parts and matrices are estimated from the flow, and the network from them, in turns until the parts
stay.
"""

# pyright: basic
from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..networks.torch_runtime import torch, warp_image
from ..numerics import Image
from .epipolar import MatchedParts, sampson_distance
from .settings import PaperSettings


class Tunable(Protocol):
    """A flow by a network."""

    network: torch.nn.Module
    rate: float
    """Learning rate"""

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor:
        """Return the flow [1 2 H W] px, with gradients."""
        ...


def tune_flow(
    flow: Tunable, images: NDArray[np.uint8], moving: NDArray[np.bool_], focal: float,
    match: Callable[[int, Image], MatchedParts | None], settings: PaperSettings,
) -> Image:
    """Return the flows [T-1 h w 2] px of images [T h w 3] after tuning; the network is restored.

    The brightness of the pixels `moving` [T h w] counts. `match` returns the matched parts of frame
    k and the next, from k and their flow.
    """
    device = next(flow.network.parameters()).device
    kept = {name: value.clone() for name, value in flow.network.state_dict().items()}
    optimizer = torch.optim.Adam(flow.network.parameters(), flow.rate)
    last = len(images) - 1
    color = torch.from_numpy(images).to(device).permute(0, 3, 1, 2).float()
    inside = torch.from_numpy(moving).to(device)
    out = np.zeros((last, *images.shape[1:3], 2), np.float32)
    labels: list[NDArray[np.int64] | None] = [None] * last
    try:
        for _ in range(settings.tuning_rounds):
            same, many = 0, 1
            for k in range(last):
                field = flow.tensor(images[k], images[k + 1])
                out[k] = field.detach()[0].permute(1, 2, 0).cpu().numpy()
                parts = match(k, out[k])
                if parts is None:
                    continue
                before, labels[k] = labels[k], parts.label
                many += len(parts.label)
                same += 0 if before is None else int((before == parts.label).sum())
                loss = epipolar_loss(field[0], parts, focal)
                away = (warp_image(color[k + 1 : k + 2], field) - color[k : k + 1]).abs().mean(1)[0]
                mean = (away * inside[k]).sum() / inside[k].sum().clamp(min=1)
                loss = loss + mean / settings.color_scale
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                optimizer.step()
            if same > settings.settled_share * many:
                break
        for k in range(last):
            with torch.no_grad():
                field = flow.tensor(images[k], images[k + 1])
            out[k] = field[0].permute(1, 2, 0).cpu().numpy()
    finally:
        flow.network.load_state_dict(kept)
    return out


def epipolar_loss(field: torch.Tensor, parts: MatchedParts, focal: float) -> torch.Tensor:
    """Return the mean Sampson distance, px, of the points' flow [2 h w] from their matrices."""
    device = field.device
    ray = torch.from_numpy(parts.ray).to(device).float()
    essential = torch.from_numpy(parts.essential[parts.label - 1]).to(device).float()
    v, u = (torch.from_numpy(np.ascontiguousarray(x)).to(device) for x in parts.pixel.T[::-1])
    there = ray.clone()
    there[:, :2] += field[:, v, u].T / focal
    return focal * sampson_distance(essential, ray, there, tiny=1e-12).abs().mean()
