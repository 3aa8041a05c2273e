"""The iterable PyTorch dataset of `stream`. PyTorch is an extra."""

# torch is an extra: without it there is nothing to check types against.
# pyright: reportMissingImports=false, reportUnknownVariableType=false, reportUntypedBaseClass=false
# pyright: reportUnknownParameterType=false, reportMissingTypeArgument=false

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count as count_from
from typing import Any

from ...errors import ConfigError
from ..dataset import round_as_stored
from ..dataset.torch import TensorItems
from ..runtime import cpu_count
from ..scene import RenderConfig, resolve

# isort: split
# `dataset.torch` says what to install where there is no PyTorch.
from torch import distributed
from torch.utils.data import IterableDataset, get_worker_info


class TorchStream(IterableDataset):
    """Items of sequences that are rendered by the process that iterates (`stream`).

    Every iteration begins with the first sequence, opens an OpenGL context and closes it.
    """

    def __init__(
        self, config: RenderConfig, count: int | None, start: int, split: tuple[int, int] | None,
        **options: Any,
    ) -> None:
        """Render nothing yet.

        Raises ConfigError for an invalid value.
        """
        rank, world = split = split or _split()
        if not 0 <= rank < world:
            raise ConfigError(f"split {split}: give (rank, world) with a rank of 0 to world - 1")
        if start < 0 or (count is not None and count < 1):
            raise ConfigError(f"a stream of {count} sequences from {start}: give a count of 1 or "
                              "more, and a start of 0 or more")
        self.config = resolve(config)
        self.items = TensorItems(self.config, **options)
        if self.items.per_sequence < 1:
            raise ConfigError("one frame makes no pair; give frames=2 or more, or pairs=False")
        self.count, self.start, self.split = count, start, split
        self._process = os.getpid()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A spawned process unpickles the dataset; a forked one does not."""
        self.__dict__ |= state | {"_process": os.getpid()}

    def __iter__(self) -> Iterator[Any]:
        """Yield the items of this process and worker.

        Raises:
            ConfigError: in a forked process.
            ModelError: if the robot cannot be loaded.
            RenderError: if this machine cannot render.
        """
        if os.getpid() != self._process:
            raise ConfigError("a stream does not render in a forked process; start the workers "
                              'with DataLoader(..., multiprocessing_context="spawn")')
        (rank, world), worker = self.split, get_worker_info()
        if worker is None:
            return self._render(rank, world)
        import cv2

        cv2.setNumThreads(1)
        threads = max(1, cpu_count() // worker.num_workers)
        os.environ["LP_NUM_THREADS"] = str(threads)  # Mesa reads it when it loads
        return self._render(rank + world * worker.id, world * worker.num_workers)

    def _render(self, first: int, step: int) -> Iterator[Any]:
        """Yield the items of the sequences `first`, `first + step`, ... from the start."""
        from .sequence_renderer import SequenceRenderer

        numbers = count_from(self.start + first, step) if self.count is None else range(
            self.start + first, self.start + self.count, step)
        renderer = SequenceRenderer(self.config)
        try:
            for number in numbers:
                sequence = round_as_stored(renderer.render(number).in_memory())
                for frame in range(self.items.per_sequence):
                    yield self.items.item(sequence, number, frame, f"sequence {number:06d}")
        finally:
            renderer.close()


def _split() -> tuple[int, int]:
    """(rank, world) of this process."""
    if distributed.is_available() and distributed.is_initialized():
        return distributed.get_rank(), distributed.get_world_size()
    rank, world = os.environ.get("RANK", "0"), os.environ.get("WORLD_SIZE", "1")
    if not (rank.isdecimal() and world.isdecimal()):
        raise ConfigError(f"RANK {rank[:20]!a} of WORLD_SIZE {world[:20]!a}: no numbers; "
                          "give split=(rank, world)")
    return int(rank), int(world)
