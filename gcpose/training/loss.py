"""Loss of the flow network."""

# pyright: basic
from __future__ import annotations

from ..networks.raft import CELL, REACH, RaftOutput
from ..networks.torch_runtime import F, Tensor, torch
from .config import LossConfig
from .pairs import MAX_PARTS


def flow_loss(
    out: RaftOutput, flow: Tensor, part: Tensor, weight: Tensor, progress: float,
    config: LossConfig,
) -> Tensor:
    """Return the weighted error of the flow, of its mean over each part, and of the correlations.

    Correlations count less and less until half of the training; without them the features learn
    slowly.

    Args:
        out: Output of the network.
        flow: True flow [B 2 H W] px.
        part: Parts [B H W]; 0 is static.
        weight: Weights [B H W] that sum to 1 in each image.
        progress: Share of the training that is done.
        config: Weights of the terms.
    """
    error = out.fine - flow
    loss = _mean(error.abs().sum(1), weight) + config.bias * part_bias(error, part, weight)
    target, share = coarse_flow(flow, weight)
    for k, estimate in enumerate(reversed(out.coarse)):
        error = _mean((estimate - target).abs().sum(1), share)
        loss = loss + config.coarse * config.decay**k * CELL * error
    fade = config.correlation * max(0.0, 1.0 - 2.0 * progress)
    return loss + fade * correlation_loss(out.correlation, target, share) if fade else loss


def part_bias(error: Tensor, part: Tensor, weight: Tensor) -> Tensor:
    """Return the length of the mean error vector of each moving part, summed by their weights.

    It determines the error of an angle: errors of random sign average out over a part.
    """
    batch = error.shape[0]
    place = (part + MAX_PARTS * torch.arange(batch, device=part.device)[:, None, None]).flatten()
    sums = torch.zeros(batch * MAX_PARTS, 2, device=error.device)
    weighted = (error * weight[:, None]).permute(0, 2, 3, 1).reshape(-1, 2)
    sums = sums.index_add(0, place, weighted.float()).reshape(batch, MAX_PARTS, 2)
    return (sums[:, 1:].square().sum(-1) + 1e-12).sqrt().sum() / batch


def coarse_flow(flow: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Return the weighted mean flow [B 2 h w] of cells, and their weights [B h w], of sum 1."""
    total = F.avg_pool2d(weight[:, None], CELL)
    mean = F.avg_pool2d(flow * weight[:, None], CELL) / total.clamp(min=1e-12) / CELL
    return mean, total[:, 0] * CELL**2


def correlation_loss(correlation: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Return the cross-entropy of windows [B h w n n] against where the target [B 2 h w] points.

    The four cells around the target share it; a target outside of the window does not count.
    """
    n = 2 * REACH + 1
    log = correlation.float().flatten(3).log_softmax(3)
    at = target.permute(0, 2, 3, 1) + REACH
    inside = ((at >= 0) & (at < n - 1)).all(3)
    at = at.clamp(0, n - 1.001)
    first = at.floor()
    share, first = at - first, first.long()
    out = torch.zeros_like(weight)
    for dv in (0, 1):
        for du in (0, 1):
            part = (share[..., 0] if du else 1 - share[..., 0]) * (
                share[..., 1] if dv else 1 - share[..., 1])
            index = (first[..., 1] + dv) * n + first[..., 0] + du
            out = out - part * log.gather(3, index[..., None])[..., 0]
    return _mean(out * inside, weight)


def _mean(value: Tensor, weight: Tensor) -> Tensor:
    return (value * weight).sum() / value.shape[0]
