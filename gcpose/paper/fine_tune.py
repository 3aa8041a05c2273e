"""A flow network tuned to one video (Sec. 3.2): by its parts' epipolar constraint and its colours.

Parts and matrices follow from the flow, the network from them, in turns, until parts stay.
"""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..networks.torch_runtime import torch, warped
from ..numerics import Image
from .epipolar import Pair

_ROUNDS = 10
_SETTLED = 0.99  # of the points keep their part
_GREY = 10.0  # levels that count as a pixel


class Tunable(Protocol):
    """A flow made by a network (see flow_raft.py, flow_flownet2.py)."""

    network: torch.nn.Module
    rate: float

    def tensor(self, rgb_a: NDArray[np.uint8], rgb_b: NDArray[np.uint8]) -> torch.Tensor: ...


def tuned(
    flow: Tunable, images: NDArray[np.uint8], moving: NDArray[np.bool_], focal: float,
    parts: Callable[[int, Image], Pair | None],
) -> Image:
    """The flows [T-1 h w 2] of images [T h w 3] after tuning, px. The network is left as it was.

    moving [T h w] is where colours count; parts(k, flow) finds those between frame k and the next.
    """
    device = next(flow.network.parameters()).device
    kept = {name: value.clone() for name, value in flow.network.state_dict().items()}
    optimizer = torch.optim.Adam(flow.network.parameters(), flow.rate)
    last = len(images) - 1
    colour = torch.from_numpy(images).to(device).permute(0, 3, 1, 2).float()
    inside = torch.from_numpy(moving).to(device)
    out = np.zeros((last, *images.shape[1:3], 2), np.float32)
    labels: list[NDArray[np.int64] | None] = [None] * last
    try:
        for _ in range(_ROUNDS):
            same, many = 0, 1
            for k in range(last):
                field = flow.tensor(images[k], images[k + 1])
                out[k] = field.detach()[0].permute(1, 2, 0).cpu().numpy()
                pair = parts(k, out[k])
                if pair is None:
                    continue
                before, labels[k] = labels[k], pair.label
                many += len(pair.label)
                same += 0 if before is None else int((before == pair.label).sum())
                loss = epipolar_loss(field[0], pair, focal)
                away = (warped(colour[k + 1 : k + 2], field) - colour[k : k + 1]).abs().mean(1)[0]
                loss = loss + (away * inside[k]).sum() / inside[k].sum().clamp(min=1) / _GREY
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                optimizer.step()
            if same > _SETTLED * many:
                break
        for k in range(last):
            with torch.no_grad():
                field = flow.tensor(images[k], images[k + 1])
            out[k] = field[0].permute(1, 2, 0).cpu().numpy()
    finally:
        flow.network.load_state_dict(kept)
    return out


def epipolar_loss(field: torch.Tensor, pair: Pair, focal: float) -> torch.Tensor:
    """Mean Sampson distance, px, of the points' flow [2 h w] from their parts' matrices."""
    device = field.device
    ray = torch.from_numpy(pair.ray).to(device).float()
    essential = torch.from_numpy(pair.essential[pair.label - 1]).to(device).float()
    v, u = (torch.from_numpy(np.ascontiguousarray(x)).to(device) for x in pair.pixel.T[::-1])
    there = ray.clone()
    there[:, :2] += field[:, v, u].T / focal
    line = torch.einsum("nij,nj->ni", essential, ray)
    back = torch.einsum("nij,ni->nj", essential, there)
    below = (line[:, :2].square().sum(1) + back[:, :2].square().sum(1)).clamp(min=1e-12)
    return focal * ((there * line).sum(1).abs() / below.sqrt()).mean()
