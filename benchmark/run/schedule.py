"""The order of jobs, the plan in words, and the time that is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ...renderer.runtime import plural
from ..results import Row, Stored
from .jobs import Job

SECONDS_PER_FRAME = {
    ("gcpose", "rgbd", "kinematics"): 0.07, ("gcpose", "rgbd", "axes"): 0.2,
    ("gcpose", "rgbd", "free"): 0.33, ("gcpose", "rgbd-noise", "kinematics"): 0.1,
    ("gcpose", "rgbd-noise", "axes"): 0.25, ("gcpose", "rgbd-noise", "free"): 0.4,
    ("gcpose", "rgb", "kinematics"): 0.5, ("gcpose", "rgb", "axes"): 1.2,
    ("gcpose flow=dis-fine", "rgb", "axes"): 0.6, ("gcpose", "rgb", "free"): 0.7,
    ("icp", "rgbd", "axes"): 0.2,
    ("hold-still", "none", "none"): 0.001, ("constant-velocity", "none", "none"): 0.001,
}
"""Typical time of methods of this package, on one core, at 640 x 480 px; that of a method without
options stands for rows with others."""
_INPUTS = ("none", "rgbd", "rgbd-noise", "rgb")  # cheap to expensive, as a rule
_COMPILED = "gcpose"


def cheap_first(jobs: Sequence[Job]) -> list[Job]:
    """Return jobs by the expected time of a frame; unknown methods by their inputs, last."""
    return sorted(jobs, key=lambda job: (
        _expected_seconds(job.row) is None,
        _expected_seconds(job.row) or _INPUTS.index(job.row.inputs),
    ))


def interleave(jobs: Sequence[Job]) -> list[tuple[Job, str]]:
    """Return (job, sequence) for all that is missing: first one sequence of each row, which tells
    how long the row takes, then the rest, job by job."""
    first = {job.row: job for job in reversed(jobs) if job.todo}
    head = [(job, job.todo[0]) for job in jobs if first.get(job.row) is job]
    return head + [(job, name) for job in jobs for name in job.todo if (job, name) not in head]


def describe_plan(jobs: Sequence[Job], workers: int) -> str:
    """Return what an evaluation will do, and how long it will take if that is known."""
    todo = sum(len(job.todo) for job in jobs)
    total = sum(len(job.share) for job in jobs)
    rows = len({job.row for job in jobs})
    sequences = len({(job.data.name, s) for job in jobs for s in job.share})
    text = f"plan: {plural(rows, 'row')} x {plural(sequences, 'sequence')}"
    if todo < total:
        text += f", {total - todo} of {total} estimates exist"
    if not todo:
        return text
    seconds = Clock(workers, list(jobs)).remaining_time()
    text += f", {seconds}" if seconds else ", the time left shows after one sequence of each row"
    if any(job.todo and job.row.method.startswith(_COMPILED) for job in jobs):
        text += "; the first run after an installation compiles, for about half a minute"
    for name in sorted({job.data.name for job in jobs if _is_of_train(job)}):
        text += (f"; {name} is of the stream train: a method that has learned from it is not "
                 "tested by it")
    return text


def _is_of_train(job: Job) -> bool:
    learned = not job.row.training.startswith(("none", "self-supervised"))
    return learned and job.data.dataset.config.stream == "train"


@dataclass
class Clock:
    """Tells the time that is left from the time that the sequences of each row took."""

    workers: int
    jobs: list[Job]
    _left: dict[Job, int] = field(init=False)
    _times: dict[Row, list[float]] = field(default_factory=dict[Row, list[float]])

    def __post_init__(self) -> None:
        self._left = {job: len(job.todo) for job in self.jobs}

    def count(self, job: Job, stored: Stored, seconds: float) -> None:
        """Count a finished sequence that took `seconds` at most."""
        self._left[job] -= 1
        took = seconds if stored.seconds is None else stored.seconds
        self._times.setdefault(job.row, []).append(took)

    def remaining_time(self) -> str:
        """Return the time left, such as "about 12 min"; empty if there is none or it is unknown."""
        total, unknown = 0.0, False
        for job in self.jobs:
            times = self._times.get(job.row)
            frames = job.data.dataset.config.frames
            expected = _expected_seconds(job.row)
            if times:
                total += self._left[job] * sum(times) / len(times)
            elif expected is not None:
                total += self._left[job] * (expected * frames + 0.2)
            elif self._left[job]:
                unknown = True
        if not total:
            return ""
        minutes = total / 60 / self.workers
        return f"{'more than' if unknown else 'about'} " + (
            f"{minutes:.0f} min" if minutes >= 1.5 else f"{max(5, round(minutes * 12) * 5)} s")


def _expected_seconds(row: Row) -> float | None:
    names = row.method, row.method.partition(" ")[0]
    found = (SECONDS_PER_FRAME.get((name, row.inputs, row.knowledge)) for name in names)
    return next(filter(None, found), None)
