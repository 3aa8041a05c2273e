"""Initialization strategies: starts on the first frames, and the stages that keep the best."""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics import Count, Scales, Whole

_WIDE = 16.0, 8.0, 4.0, 2.0
_FIRST = 8.0, 8.0, 6.0
_MIDDLE = 4.0, 4.0, 2.0, 2.0


@dataclass(frozen=True)
class Stage:
    """A stage of a strategy: the best hypotheses are tracked further, or refined by EM."""

    kept: Whole = 0  # Distinct hypotheses that enter; 0: all.
    until: Whole = 0  # Frame to which they are tracked; 0: none, they are refined instead.
    rounds: Whole = 0  # Rounds of EM of the refinement.
    scales: Scales = (3.0, 1.5)  # Robust scales of an adjustment.
    fixed_axes: bool = False  # Whether axes are fixed: a few frames do not show where they are.
    accelerated: bool = False  # Whether the refinement extrapolates and ends when nothing changes.


@dataclass(frozen=True)
class Strategy:
    """Starts on the first frames, and the stages that reduce them to few hypotheses."""

    sweep_spans: tuple[Count, ...] = ()  # Frames between the two frames of each sweep.
    sweep_kept: Count = 1  # Starts of each sweep.
    flow_spans: tuple[Count, ...] = ()  # Frames between the two frames of each start by flow.
    flow_kept: Count = 1  # Starts of each of these, and of each hinge slack.
    extend_to: Whole = 0  # Frame to which starts are extrapolated before the first stage.
    stages: tuple[Stage, ...] = ()


KNOWN_LINES = Strategy(
    sweep_spans=(1, 3), sweep_kept=6, flow_spans=(1, 2), flow_kept=4, extend_to=2,
    stages=(Stage(rounds=2, scales=_WIDE), Stage(kept=6, until=5)),
)
KNOWN_LINES_MORE = Strategy(
    sweep_spans=(1, 2, 4), sweep_kept=16, flow_spans=(4,), flow_kept=6,
    stages=(Stage(rounds=1, scales=_FIRST), Stage(kept=12, until=5),
            Stage(kept=6, rounds=1, scales=_MIDDLE)),
)
FREE_FLOW = Strategy(
    flow_spans=(1, 2, 4), flow_kept=6, extend_to=2,
    stages=(Stage(rounds=2, scales=_WIDE), Stage(kept=24, until=4),
            Stage(kept=16, rounds=1, scales=_MIDDLE), Stage(kept=10, until=7),
            Stage(kept=6, rounds=2, scales=_MIDDLE)),
)


def _stages(fixed_until: int, factor: int) -> tuple[Stage, ...]:
    """The stages after sweeps; `factor` times as many hypotheses are kept."""
    return (
        Stage(rounds=1, scales=_FIRST, fixed_axes=True),
        Stage(kept=24 * factor, until=fixed_until, scales=(8.0, 6.0), fixed_axes=True),
        Stage(kept=16 * factor, rounds=1, scales=(8.0, 6.0, 4.0, 4.0)),
        Stage(kept=10 * factor, until=6, scales=(4.0, 3.0)),
        Stage(kept=8 * factor, rounds=1, scales=_MIDDLE),
        Stage(kept=6 * factor, until=8),
        Stage(kept=6 * factor, rounds=2, scales=_MIDDLE, accelerated=True),
    )


FREE_SWEEPS = Strategy(sweep_spans=(1, 3), sweep_kept=20, flow_spans=(2, 4), flow_kept=6,
                   stages=_stages(4, 1))
FREE_SWEEPS_MORE = Strategy(sweep_spans=(1, 2, 3, 4), sweep_kept=24, stages=_stages(5, 2))
