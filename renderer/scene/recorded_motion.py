"""Joint motion from a file, which sequences replay: `--motion.file`."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ConfigError, DatasetError
from ...robots.files import read_bounded
from ...robots.geometry import Array
from ...robots.model import ArticulatedModel
from ...robots.motion import JointTrajectory, joint_indices
from ..runtime import ANY_SIZE, ArraySpec, parse_npz

_MAX_BYTES = 2**26
_EXPECTED = ("expected a CSV with the header time,JOINT,... (s; rad or m), or an NPZ with the "
             "arrays times [T], positions [T J] and joints [J]")
_LIMIT_TOLERANCE = 1e-6  # rad or m by which a position may exceed a limit; it is clipped


@dataclass(frozen=True)
class RecordedMotion:
    """Positions of some joints over time."""

    path: Path
    sha256: str
    joints: tuple[str, ...]
    times: Array
    """[N] s, ascending"""
    positions: Array
    """[N K] rad or m"""

    def trajectory(self, model: ArticulatedModel, frames: int, fps: float) -> JointTrajectory:
        """Return the motion of a model from the file's first time on, interpolated.

        Joints that the file lacks stay at zero, or at the limit nearest to it.
        """
        joint_indices(model, self.joints)  # refuses unknown ones
        times = np.arange(frames) / fps
        duration = self.times[-1] - self.times[0]
        if times[-1] > duration * (1 + 1e-9):
            most = int(duration * fps * (1 + 1e-9)) + 1
            raise ConfigError(f"{self.path}: the motion lasts {duration:g} s, which is {most} "
                              f"frames at {fps:g} per second; add --frames {most} or fewer")
        low, high = model.limits.T
        positions = np.tile(np.clip(0.0, low, high), (frames, 1))
        at = np.minimum(self.times[0] + times, self.times[-1])
        for name, path in zip(self.joints, self.positions.T, strict=True):
            j = model.joint_names.index(name)
            positions[:, j] = np.interp(at, self.times, path)
            excess = np.maximum(low[j] - positions[:, j], positions[:, j] - high[j])
            worst = int(excess.argmax())
            if excess[worst] > _LIMIT_TOLERANCE:
                raise ConfigError(f"{self.path}: {name} is at {positions[worst, j]:g} in frame "
                                  f"{worst}, outside its limits {low[j]:g} to {high[j]:g}")
        return JointTrajectory(times, np.clip(positions, low, high))


def read_motion(path: Path) -> RecordedMotion:
    """Return the motion in a CSV or an NPZ file. Raises ConfigError that names the file."""
    data = read_bounded(path, _MAX_BYTES, ConfigError)
    try:
        joints, times, positions = (_from_npz if data[:2] == b"PK" else _from_csv)(data)
    except (ValueError, csv.Error, DatasetError) as error:
        raise ConfigError(f"{path}: {' '.join(str(error).split())[:200]}; {_EXPECTED}") from error
    names = tuple(name.strip() for name in joints)
    for problem, wrong in {
        f"{positions.shape[1]} columns of positions for {len(names)} joints":
            positions.shape[1] != len(names) or not names,
        "a joint twice": len({*names}) < len(names),
        f"{len(positions)} rows for {len(times)} times":
            len(positions) != len(times) or not len(times),
        "a number that is not finite": not np.isfinite([*times, *positions.ravel()]).all(),
        "times that do not ascend": not (np.diff(times) > 0).all(),
    }.items():
        if wrong:
            raise ConfigError(f"{path}: has {problem}; {_EXPECTED}")
    return RecordedMotion(path, hashlib.sha256(data).hexdigest(), names, times, positions)


def _from_csv(data: bytes) -> tuple[Sequence[str], Array, Array]:
    text = data.decode("utf-8-sig")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    time, *joints = next(csv.reader(lines[:1], strict=True), [""])
    if time.strip() != "time":
        raise ValueError(f"the first column is {time[:40]!a}")
    if not lines[1:]:
        raise ValueError("there are no rows")
    for number, line in enumerate(lines[1:], 1):
        if line.count(",") != len(joints):
            raise ValueError(f"row {number} has {line.count(',') + 1} values, the header has "
                             f"{len(joints) + 1}")
    table = np.loadtxt(lines[1:], np.float64, comments=None, delimiter=",", ndmin=2)
    return joints, table[:, 0], table[:, 1:]


def _from_npz(data: bytes) -> tuple[Sequence[str], Array, Array]:
    specs = {
        "times": ArraySpec((ANY_SIZE,)),
        "positions": ArraySpec((ANY_SIZE, ANY_SIZE)),
        "joints": ArraySpec((ANY_SIZE,), "U", 1024),
    }
    arrays = parse_npz(data, specs, "the NPZ")
    if missing := sorted(specs.keys() - arrays.keys()):
        raise ValueError(f"no array {missing[0]}")
    times, positions = (arrays[name].astype(np.float64) for name in ("times", "positions"))
    return arrays["joints"].tolist(), times, positions
