"""A sequence in memory, with the values that its file would give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Sequence, Stack
from . import codes
from .lazy_images import LazyStack


def round_as_stored(sequence: Sequence) -> Sequence:
    """Return a rendered sequence, its images rounded as in a file. They are rounded when indexed.

    Integer images and the state are stored exactly.
    """
    unit, box = sequence.meta.depth_unit, sequence.state.coordinate_box
    coordinates = sequence.coordinates
    if coordinates is not None and box is not None:
        metres, part = coordinates, sequence.part

        def in_box(t: int) -> NDArray[np.float32]:
            shares = codes.share_codes(codes.shares_of_boxes(metres[t], part[t], box))
            rounded = codes.shares_of_codes(shares).astype(np.float32)
            return codes.coordinates_in_boxes(rounded, part[t], box)

        coordinates = LazyStack(in_box, metres.shape, np.dtype(np.float32))
    return replace(
        sequence,
        depth=LazyStack(
            lambda t: codes.depth_of_codes(codes.depth_codes(sequence.depth[t], unit), unit),
            sequence.depth.shape, np.dtype(np.float32)),
        flow=_stack(sequence.flow, _round_flow),
        flow_backward=_stack(sequence.flow_backward, _round_flow),
        normal=_stack(sequence.normal, lambda n: codes.normal_of_codes(codes.normal_codes(n))),
        coordinates=coordinates,
    )


def _round_flow(flow: NDArray[np.float32]) -> NDArray[np.float32]:
    return codes.flow_of_codes(codes.flow_codes(flow))


def _stack(
    images: Stack[np.float32] | None, function: Callable[[NDArray[Any]], NDArray[np.float32]]
) -> Stack[np.float32] | None:
    if images is None:
        return None
    return LazyStack(lambda t: function(images[t]), images.shape, np.dtype(np.float32))
