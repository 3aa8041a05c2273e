"""Random streams by name: a draw depends on seed, split, sequence and name, and on nothing else."""

from __future__ import annotations

import zlib
from typing import Literal

import numpy as np


def named_rng(
    seed: int, split: Literal["test", "train"], index: int, name: str, *more: int
) -> np.random.Generator:
    """Return a fresh generator; equal arguments give equal numbers, on every machine.

    Splits, sequences `index` and names of what is drawn have independent streams; `more` numbers
    distinguish further draws, such as the attempt.
    """
    number = 0 if split == "test" else 1
    return np.random.default_rng([seed, number, index, zlib.crc32(name.encode()), *more])
