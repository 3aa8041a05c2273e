"""Sequences that are rendered while a network trains, in place of files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..scene import RenderConfig

if TYPE_CHECKING:
    from .torch_stream import TorchStream


def stream(
    config: RenderConfig,
    count: int | None = None,
    start: int = 0,
    split: tuple[int, int] | None = None,
    **options: Any,
) -> TorchStream:
    """Return an iterable PyTorch dataset that renders its items; nothing is written.

    The items are those of `TorchDataset`, to the bit, for a dataset of the same configuration. The
    workers of a `DataLoader` share the sequences. They must be spawned
    (`multiprocessing_context="spawn"`), because OpenGL and CUDA do not survive a fork; each has one
    OpenGL context.

    Args:
        config: What to render.
        count: Number of sequences of an epoch, in all processes together; without, the stream has
            no end. A multiple of ranks and workers gives each the same number of items.
        start: Number of the first sequence. To continue a training, give the number of sequences
            that it has seen.
        split: (rank, world): this process takes the sequences `start + rank`,
            `start + rank + world`, ... Default: as torch.distributed says, or the variables RANK
            and WORLD_SIZE.
        options: pairs, images, state, masks and transform, as of `TorchDataset`.

    Returns:
        The dataset, for `torch.utils.data.DataLoader`.

    Raises:
        ConfigError: if a value is invalid.
        GcbenchError: if PyTorch is not installed.

    Example:
        >>> config = gb.RenderConfig("owi535", frames=3, width=64, height=48)
        >>> pairs = gb.stream(config, count=2, images=("rgb", "flow"))
        >>> [(item["sequence"], item["frame"]) for item in pairs]
        [(0, 0), (0, 1), (1, 0), (1, 1)]
    """
    from .torch_stream import TorchStream

    return TorchStream(config, count, start, split, **options)
