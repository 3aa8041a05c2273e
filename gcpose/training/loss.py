"""What a flow network is trained to make small."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

from ..networks.raft import CELL, REACH, RaftOutput
from ..networks.torch_runtime import F, Tensor, torch
from .pairs import MOST_PARTS

_DECAY = 0.8  # weight of an iteration against the next
_COARSE = 0.7  # of all iterations against the full flow
_BIAS = 1.0
_MATCH = 0.3  # of the correlations, at first


def flow_loss(
    out: RaftOutput, flow: Tensor, part: Tensor, weight: Tensor, progress: float
) -> Tensor:
    """Weighted error of the flow and of its mean over each part, and at first of the matches.

    flow [B 2 H W] px, part [B H W] with 0 for what is still, weight [B H W] that sums to 1 in each
    image; `progress` 0..1 is how far training is: what correlations say by themselves counts less
    and less until half of it (without, the features learn nothing for long).
    """
    error = out.fine - flow
    loss = _mean(error.abs().sum(1), weight) + _BIAS * bias(error, part, weight)
    target, share = coarse(flow, weight)
    for k, guess in enumerate(reversed(out.coarse)):
        loss = loss + _COARSE * _DECAY**k * CELL * _mean((guess - target).abs().sum(1), share)
    fade = _MATCH * max(0.0, 1.0 - 2.0 * progress)
    return loss + fade * match(out.correlation, target, share) if fade else loss


def bias(error: Tensor, part: Tensor, weight: Tensor) -> Tensor:
    """Length of the mean error vector of each moving part, summed by the parts' weights.

    It is this that turns into degrees: errors of random sign average out over a part.
    """
    batch = error.shape[0]
    place = (part + MOST_PARTS * torch.arange(batch, device=part.device)[:, None, None]).flatten()
    sums = torch.zeros(batch * MOST_PARTS, 2, device=error.device)
    weighted = (error * weight[:, None]).permute(0, 2, 3, 1).reshape(-1, 2)
    sums = sums.index_add(0, place, weighted.float()).reshape(batch, MOST_PARTS, 2)
    return (sums[:, 1:].square().sum(-1) + 1e-12).sqrt().sum() / batch


def coarse(flow: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """The flow [B 2 h w] in cells, by weight, and the cells' weights [B h w] that sum to 1."""
    total = F.avg_pool2d(weight[:, None], CELL)
    mean = F.avg_pool2d(flow * weight[:, None], CELL) / total.clamp(min=1e-12) / CELL
    return mean, total[:, 0] * CELL**2


def match(correlation: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Cross-entropy of the windows [B h w n n] against where the target [B 2 h w] points.

    The target's four neighbours share it; where it leaves the window nothing is asked.
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
