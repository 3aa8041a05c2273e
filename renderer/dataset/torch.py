"""A dataset as tensors, for training: a frame pair or a whole sequence at an index."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false, reportUntypedBaseClass=false
# pyright: reportUnknownParameterType=false, reportMissingTypeArgument=false

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import ConfigError, GcbenchError
from ..types import Sequence
from .reader import Dataset

try:
    import torch
    from torch.utils.data import Dataset as TorchBase
except ImportError as error:
    raise GcbenchError("tensors need PyTorch: pip install 'gcbench[learn]'") from error

IMAGES = ("rgb", "depth", "part", "flow", "flow_backward", "visibility")
_LAYERS = ("normal", "coordinates")
"""Images that only some datasets have."""


class TorchDataset(TorchBase):
    """Dicts of tensors; images are channels first, and only those in `images` are decoded.

    `pairs`: item i is frames (t, t+1) of a sequence, without pairs item i is sequence i. With F
    frames (2 in a pair) and G = F - 1 steps between them: "rgb" [F 3 H W] uint8, "depth" [F H W] m,
    "part" [F H W] int32, "flow" and "flow_backward" [G 2 H W] px with NaN where unknown
    ("flow_backward" of step g is from frame g+1), "visibility" [G H W], "normal" and "coordinates"
    [F 3 H W] (if asked for), "sequence" and "frame" (the first), and the arrays of `State`, those
    of T frames cut to F.
    """

    def __init__(
        self, dataset: Dataset, pairs: bool = True, images: tuple[str, ...] = IMAGES
    ) -> None:
        """Raises ConfigError if there is no image of a name."""
        there = [*IMAGES, *(name for name in _LAYERS if name in dataset.config.layers)]
        if unknown := [name for name in images if name not in there]:
            raise ConfigError(f"no image {unknown[0]!r}; there are {', '.join(there)}")
        self.dataset, self.pairs, self.images = dataset, pairs, images
        self._steps = dataset.config.frames - 1 if pairs else 1

    def __len__(self) -> int:
        return len(self.dataset) * self._steps

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Raises IndexError, or DatasetError if a file is damaged."""
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        number, frame = divmod(index % len(self), self._steps)
        sequence = self.dataset[number]
        stop = frame + 2 if self.pairs else len(sequence)
        return {
            "sequence": number,
            "frame": frame,
            **{name: _images(sequence, name, frame, stop) for name in self.images},
            **{k: torch.tensor(v) for k, v in sequence.state.at(slice(frame, stop)).items()},
        }


def _images(sequence: Sequence, name: str, start: int, stop: int) -> torch.Tensor:
    per_step = name in ("flow", "flow_backward", "visibility")
    stack = np.asarray(getattr(sequence, name)[start : stop - 1 if per_step else stop])
    if stack.dtype == np.uint16:
        stack = stack.astype(np.int32)
    if stack.ndim == 4:
        stack = np.ascontiguousarray(np.moveaxis(stack, -1, 1))
    return torch.from_numpy(stack)
