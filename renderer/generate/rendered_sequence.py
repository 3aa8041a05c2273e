"""What rendering a sequence returns, and what renders sequences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ...robots.geometry import Array
from ..types import Frame, Meta, Sequence, State


@dataclass(frozen=True)
class RenderedSequence:
    """A sequence that renders while its frames are iterated."""

    frames: Iterator[Frame]
    depth_unit: float
    """m per unit of the depth images"""
    coordinate_box: Array | None
    """[P 2 3] m, if the frames have coordinates"""
    finish: Callable[[], tuple[Meta, State]]
    """Return meta and state; after the last frame."""

    def in_memory(self) -> Sequence:
        """Render every frame, and return the sequence as arrays."""
        frames = list(self.frames)
        meta, state = self.finish()
        height, width = frames[0].depth.shape

        def stack(name: str, dtype: type[Any], *channels: int) -> Any:
            if name in meta.omitted:
                return None
            images = [image for f in frames if (image := getattr(f, name)) is not None]
            return np.stack(images) if images else np.empty((0, height, width, *channels), dtype)

        layers = {name: stack(name, np.float32, 3) if name in meta.layers else None
                  for name in ("normal", "coordinates")}
        return Sequence(
            meta, state, stack("rgb", np.uint8, 3), stack("depth", np.float32),
            stack("part", np.uint16), stack("flow", np.float32, 2),
            stack("flow_backward", np.float32, 2), stack("visibility", np.uint8), **layers,
        )


class Renderer(Protocol):
    """What a source makes from a config: renders any sequence of it. One per process."""

    @property
    def asset(self) -> Mapping[str, Any]: ...
    def render(self, index: int, /) -> RenderedSequence: ...
    def close(self) -> None: ...
