"""Random streams by name: a draw depends on seed, split, sequence and name, and on nothing else."""

from __future__ import annotations

import zlib
from typing import Literal

import numpy as np


def named_rng(
    seed: int, split: Literal["test", "train"], index: int, name: str, *more: int
) -> np.random.Generator:
    """Return a fresh generator; equal arguments give equal numbers, on every machine.

    Args:
        seed: Of the dataset.
        split: Sequences of `test` and `train` share no draw.
        index: Number of the sequence.
        name: Of what is drawn. Streams of different names are independent.
        more: Further numbers that distinguish draws, such as the attempt.
    """
    number = 0 if split == "test" else 1
    return np.random.default_rng([seed, number, index, zlib.crc32(name.encode()), *more])
