"""JSON of all our files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from ...errors import GcbenchError

MAX_JSON = 2**26
"""Bytes of a JSON file."""


def dump_json(tree: Any) -> bytes:
    """JSON of dicts, lists, tuples, numbers, strings and NumPy values, for people to read too.

    Raises ValueError for NaN and infinity, which JSON does not have.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic | np.ndarray):
            return value.tolist()
        if isinstance(value, Mapping):
            return dict(cast("Mapping[str, Any]", value))
        raise TypeError(f"{type(value).__name__} has no place in a JSON file")

    return (json.dumps(tree, indent=1, allow_nan=False, default=plain) + "\n").encode()


def parse_json(data: bytes, where: str) -> dict[str, Any]:
    """The object in `data`. Raises GcbenchError that begins with `where`."""

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not JSON")

    try:
        tree = json.loads(data, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise GcbenchError(f"{where}: not JSON ({error})") from error
    if not isinstance(tree, dict):
        raise GcbenchError(f"{where}: not a JSON object")
    return cast("dict[str, Any]", tree)
