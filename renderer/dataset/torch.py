"""Sequences as tensors, for training: an item is a frame pair or a whole sequence."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false, reportUntypedBaseClass=false
# pyright: reportUnknownParameterType=false, reportMissingTypeArgument=false

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np

from ...errors import ConfigError, DatasetError, GcbenchError
from ..runtime import address
from ..scene import RenderConfig
from ..types import Sequence, State, describe_absence
from .reader import Dataset

try:
    import torch
    from torch.utils.data import Dataset as TorchBase
    from torch.utils.data import default_collate
except ImportError as error:
    raise GcbenchError("tensors need PyTorch: pip install '.[learn]'") from error

IMAGES = ("rgb", "depth", "part", "flow", "flow_backward", "visibility")
STATE = ("times", "intrinsics", "cam_from_world")
"""Arrays of `State` whose sizes do not depend on the model."""
_LAYERS = ("normal", "coordinates")
"""Images that only some datasets have."""
_PER_STEP = ("flow", "flow_backward", "visibility")
"""Images that join two frames."""
_NUMBERS = ("part", "visibility")
_Item = dict[str, Any]


class TensorItems:
    """Makes items of the sequences of a configuration: dicts of tensors.

    With F frames (2 in a pair) and G = F - 1 steps between them: "rgb" [F 3 H W] uint8, "depth"
    [F H W] m, "part" [F H W] int32, "flow" and "flow_backward" [G 2 H W] px with NaN where unknown
    ("flow_backward" of step g is from frame g+1), "visibility" [G H W], "normal" and "coordinates"
    [F 3 H W] (if asked for), "sequence" and "frame" (the first), and the arrays of `State` in
    `state`, those of T frames cut to F. `track_query` counts the frames of the sequence, also in a
    pair.

    By default, all items of one image size have equal shapes, also of several robots. Arrays of
    joints, parts and points have not: batches of them need `collate_fn=pad_collate`.
    """

    def __init__(
        self,
        config: RenderConfig,
        pairs: bool = True,
        images: tuple[str, ...] | None = None,
        state: tuple[str, ...] = STATE,
        masks: bool = False,
        transform: Callable[[_Item], Any] | None = None,
    ) -> None:
        """Choose what is in an item.

        Args:
            config: Configuration of the sequences.
            pairs: An item is a pair of frames (t, t+1), not a sequence.
            images: Names of images. Default: IMAGES, without those that are not stored.
            state: Names of arrays of `State`.
            masks: Make items ready for loss functions: unknown values are 0, and a mask says where
                values are known ("flow_valid" [G H W] bool beside "flow"; also for "flow_backward",
                "normal" and "coordinates"). "part" and "visibility" are int64.
            transform: Applied to each item.

        Raises:
            ConfigError: there is no image or array of a name, or pairs of sequences of one frame.
        """
        if pairs and config.frames < 2:
            raise ConfigError("pairs need 2 frames, and the sequences have 1; use pairs=False")
        stored = [name for name in IMAGES if name not in config.omitted_images]
        images = tuple(stored) if images is None else images
        if lacks := [name for name in images if name in config.omitted_images]:
            raise ConfigError(f"the dataset has {describe_absence(lacks[0])}")
        _check("image", images, [*stored, *(name for name in _LAYERS if name in config.layers)])
        _check("array", state, [f.name for f in dataclasses.fields(State)])
        self.config, self.pairs, self.images, self.state = config, pairs, images, state
        self.masks, self.transform = masks, transform
        self.per_sequence = config.frames - 1 if pairs else 1
        """Number of items of a sequence."""

    def item(self, sequence: Sequence, number: int, frame: int, where: str) -> Any:
        """Return the item of a sequence, the `number`th, that begins with a frame.

        Raises DatasetError, beginning with `where`, for a sequence of another configuration.
        """
        self._check_sequence(sequence, where)
        stop = frame + 2 if self.pairs else len(sequence)
        item: _Item = {"sequence": number, "frame": frame}
        for name in self.images:
            item |= self._images(sequence, name, frame, stop)
        arrays = sequence.state.at(slice(frame, stop))
        item |= {name: torch.tensor(arrays[name]) for name in self.state}
        return item if self.transform is None else self.transform(item)

    def _check_sequence(self, sequence: Sequence, where: str) -> None:
        """A foreign sequence may differ from what its dataset says."""
        config, meta = self.config, sequence.meta
        found = meta.frames, meta.width, meta.height
        if found != (config.frames, config.width, config.height):
            raise DatasetError(f"{where} has (frames, width, height) {found}, and not those of "
                               "dataset.json")
        lacks = [k for k in (*self.images, *self.state)
                 if getattr(sequence, k, None) is None and getattr(sequence.state, k, None) is None]
        if lacks:
            raise DatasetError(f"{where} has {describe_absence(lacks[0])}")

    def _images(self, sequence: Sequence, name: str, start: int, stop: int) -> _Item:
        stack = np.asarray(getattr(sequence, name)[start : stop - (name in _PER_STEP)])
        if name in _NUMBERS and (self.masks or name == "part"):
            stack = stack.astype(np.int64 if self.masks else np.int32)
        if stack.ndim == 4:
            stack = np.ascontiguousarray(np.moveaxis(stack, -1, 1))
        if not self.masks or stack.ndim == 3 or name == "rgb":
            return {name: torch.from_numpy(stack)}
        valid = np.asarray(np.isfinite(stack).all(axis=1))
        stack[~np.broadcast_to(valid[:, None], stack.shape)] = 0
        return {name: torch.from_numpy(stack), f"{name}_valid": torch.from_numpy(valid)}


class TorchDataset(TorchBase):
    """The items of a dataset (`TensorItems`); only the images that are asked for are decoded.

    `pairs`: item i is frames (t, t+1) of a sequence, without pairs item i is sequence i.
    """

    def __init__(self, dataset: Dataset, pairs: bool = True, **options: Any) -> None:
        """Open nothing yet; the options are those of `TensorItems`.

        Raises ConfigError like `TensorItems`, and if `dataset` is a path.
        """
        if isinstance(dataset, str | Path):
            raise ConfigError(f"TorchDataset takes an open dataset: gb.open_dataset({dataset!r})")
        self.dataset = dataset
        self.items = TensorItems(dataset.config, pairs, **options)

    def __len__(self) -> int:
        return len(self.dataset) * self.items.per_sequence

    def __getitem__(self, index: SupportsIndex) -> Any:
        """Raises IndexError, TypeError for no whole number, DatasetError if a file is damaged."""
        place = range(len(self))[operator.index(index)]
        number, frame = divmod(place, self.items.per_sequence)
        where = f"{address(self.dataset.path)}: sequence {self.dataset.names[number]}"
        return self.items.item(self.dataset[number], number, frame, where)


def pad_collate(items: list[_Item]) -> _Item:
    """Make a batch of items of different models, for `DataLoader(..., collate_fn=pad_collate)`.

    Arrays of joints, parts and points are padded with zeros to the largest in the batch. Beside
    each of these arrays, NAME_mask [batch ...] is True at its own values.
    """
    batch: _Item = {}
    for name in items[0]:
        values = [item[name] for item in items]
        if name not in _VARIABLE:
            batch[name] = default_collate(values)
            continue
        shape = np.max([value.shape for value in values], axis=0).tolist()
        padded = values[0].new_zeros((len(values), *shape))
        mask = torch.zeros(padded.shape, dtype=torch.bool)
        for i, value in enumerate(values):
            place = (i, *(slice(n) for n in value.shape))
            padded[place], mask[place] = value, True
        batch |= {name: padded, f"{name}_mask": mask}
    return batch


_VARIABLE = {field.name for field in dataclasses.fields(State)} - {*STATE}


def _check(kind: str, names: tuple[str, ...], there: list[str]) -> None:
    if isinstance(names, str):
        raise ConfigError(f"{names!r} is one name; give a tuple of {kind}s: ({names!r},)")
    if unknown := [name for name in names if name not in there]:
        raise ConfigError(f"no {kind} {unknown[0]!r}; there are {', '.join(there)}")
