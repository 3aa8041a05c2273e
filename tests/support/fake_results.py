"""Results as `gcbench eval` writes them, of methods that never ran on sequences that never were."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gcbench.benchmark.protocol.scoring import AXES_KNOWN, joint_results
from gcbench.benchmark.protocol.truth import Truth
from gcbench.benchmark.results.estimates import Stored, dump_stored
from gcbench.benchmark.results.rows import Result, Row, read_scores, write_scores
from gcbench.benchmark.results.runs import ESTIMATES, SCORES, Run, run_folder, write_run
from gcbench.renderer.types.observation import Estimate

GCPOSE = Row("gcpose", "1.0", "rgbd", "axes", "none")
NOISY = Row("gcpose", "1.0", "rgbd-noise", "axes", "none")
FREE = Row("gcpose", "1.0", "rgbd", "free", "none")
ICP = Row("icp", "1.0", "rgbd", "axes", "none")
ORACLE = Row("icp", "1.0", "rgbd", "axes", "none", ("true-parts",))
STILL = Row("hold-still", "1.0", "none", "none", "none")
JOINTS = ("pan", "lift", "elbow")


def truth(rng: np.random.Generator, frames: int, joints: Sequence[str], prismatic: int) -> Truth:
    """A random motion; the last `prismatic` joints slide."""
    n = len(joints)
    slides = np.arange(n) >= n - prismatic
    speed = rng.uniform(0.01, 0.05, n) * rng.choice([-1, 1], n)
    axis = rng.normal(size=(n, 3))
    screw = np.zeros((n, 6))
    screw[:, :3] = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return Truth(
        joint_names=tuple(joints),
        joint_types=tuple("prismatic" if s else "revolute" for s in slides),
        prismatic=slides,
        displacement=np.arange(frames)[:, None] * speed,
        screw=screw,
        origin=rng.uniform(0.5, 2, (n, 3)),
        label=np.arange(n + 1, dtype=np.uint8),
        parent=tuple(range(-1, n - 1)),
        pixels=rng.integers(400, 9000, n),
    )


def write_results(
    folder: Path,
    row: Row,
    scale: float | None,
    dataset: str = "ur5",
    sequences: int = 6,
    joints: Sequence[str] = JOINTS,
    prismatic: int = 0,
    frames: int = 5,
    failing: Sequence[int] = (),
    reason: str = "ValueError: no",
    seed: int = 0,
    config: dict[str, Any] | None = None,
    assets: tuple[dict[str, Any], ...] = (),
    scores: bool = True,
) -> Path:
    """Write one run: the estimate is the truth plus a drift of about `scale` rad a joint, which
    sigma tells; all joints but the first are called reliable. None holds still and tells nothing.
    Everyone sees the same truth."""
    names = tuple(f"{k:06d}" for k in range(sequences))
    run = Run(
        row=row, source="somewhere:Method", dataset=dataset, data=str(folder / "nothing"),
        config=config or {"robot": dataset.rpartition("/")[2], "seed": 7, "frames": frames},
        assets=assets, sequences=names, left_out=0,
        limits={"seconds_per_sequence": 300.0, "workers": 1, "threads": 2},
        environments=({"gcbench": "0.1.0", "dependencies": {"numpy": "2"}, "cpu": "a cpu"},),
    )  # fmt: skip
    path = run_folder(folder, row, dataset)
    write_run(path, run)
    (path / ESTIMATES).mkdir(exist_ok=True)
    lines: list[Result] = []
    for k, name in enumerate(names):
        true = truth(np.random.default_rng([1, k]), frames, joints, prismatic)
        rng = np.random.default_rng([2, seed, k])
        moved = 0.0 * true.displacement
        if scale is not None:
            drift = np.arange(frames)[:, None] / (frames - 1) * rng.normal(size=len(joints))
            moved = true.displacement + scale * drift
        sigma = None if scale is None else np.full_like(moved, scale)
        reliable = None if scale is None else np.arange(len(joints)) > 0
        found = Estimate(moved, sigma=sigma, reliable=reliable)
        stored = Stored("ok", "", 0.1 * frames, 200.0, found)
        if k in failing:
            stored = Stored("raised", reason, 1.0, 200.0)
        (path / ESTIMATES / f"{name}.zip").write_bytes(dump_stored(stored))
        blank = Result(
            method=row.name, version=row.version, inputs=row.inputs, knowledge=row.knowledge,
            oracles="+".join(row.oracles), training=row.training, dataset=dataset,
            robot=str(run.config["robot"]), sequence=name, cluster=name, joint="", joint_index=0,
            joint_type="", frame=-1, metric="", value=0.0, unit="", sign="", status=stored.status,
        )  # fmt: skip
        lines += joint_results(true, stored.estimate, row.knowledge in AXES_KNOWN, blank)
        if row is not STILL:
            lines.append(_replace(blank, "seconds_per_frame", (stored.seconds or 0) / frames, "s"))
    if scores:
        write_scores(path / SCORES, lines)
    return path


def read_results(path: Path) -> list[Result]:
    """The lines of a table of scores."""
    return [Result(*cells) for cells in read_scores(path).itertuples(index=False)]


def _replace(blank: Result, metric: str, value: float, unit: str) -> Result:
    from dataclasses import replace

    return replace(blank, metric=metric, value=value, unit=unit)
