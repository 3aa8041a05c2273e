"""Observations as files, for methods in any language: what a method may see, and nothing else.

    SSSSSS/observation.json    what is not an image; absent: not granted
    SSSSSS/rgb/TTTTTT.png      the video
    SSSSSS/depth.npy           float32 [T H W] m, 0: no surface; on the tracks with depth

The folder tells neither the seed nor the configuration of the dataset, with which one could render
the truth again.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from pathlib import Path

from ...errors import ConfigError
from ...renderer.dataset import Dataset, image_member, open_dataset, select_sequences
from ...renderer.export import Exported, SequenceRecord, Writer, write_export
from ...renderer.runtime import Archive, dump_json, dump_npy
from ...renderer.types import Inputs, Knowledge, Observation, Sequence
from ..protocol import observe

_IMAGES = ("rgb", "depth", "part", "flow", "flow_backward", "mask")
_TRACKS: dict[str, Inputs] = {"rgb": "rgb", "rgbd": "rgbd", "rgbd-noise": "rgbd-noise"}
_LEVELS: dict[str, Knowledge] = {"free": "free", "axes": "axes", "kinematics": "kinematics"}


class _ObservationWriter(Writer):
    def __init__(
        self, folder: Path, dataset: Dataset, track: Inputs, knowledge: Knowledge
    ) -> None:
        super().__init__(folder, dataset)
        self._track: Inputs = track
        self._knowledge: Knowledge = knowledge

    def add(self, sequence: Sequence, archive: Archive) -> SequenceRecord:
        observation = observe(sequence, self._track, self._knowledge)
        folder = self.folder / archive.path.stem
        folder.mkdir(exist_ok=True)
        if observation.rgb is not None:
            (folder / "rgb").mkdir(exist_ok=True)
            for t in range(len(sequence)):
                (folder / image_member("rgb", t)).write_bytes(archive.read(image_member("rgb", t)))
        if observation.depth is not None:
            (folder / "depth.npy").write_bytes(dump_npy(observation.depth))
        values = {field.name: getattr(observation, field.name) for field in fields(Observation)
                  if field.name not in (*_IMAGES, "model")}
        granted = {key: value for key, value in values.items() if value is not None}
        (folder / "observation.json").write_bytes(dump_json(granted))
        return {}


def export_observations(
    dataset: str | Path | Dataset, out: str | Path, track: str = "rgbd", knowledge: str = "axes",
    sequences: str = "", progress: bool = True,
) -> Exported:
    """Write what a method may see of a dataset, for methods that run outside of gcbench.

    `gb.score` scores their predictions. An interrupted export continues when it is called again
    with the same arguments.

    Args:
        dataset: Folder of the dataset, or an open dataset.
        out: Folder of the export, which must not exist.
        track: "rgb", "rgbd" or "rgbd-noise".
        knowledge: "free", "axes" or "kinematics".
        sequences: Numbers and ranges of sequences, for example "0-9,15". Default: all.
        progress: Whether to show a progress bar.

    Returns:
        The folder, and the number of sequences and frames in it.

    Raises:
        DatasetError: there is no dataset, or it is damaged.
        ConfigError: there is no such track, knowledge or sequence, or `out` exists.

    Example:
        >>> gb.export_observations("data/ur5", "out", "rgbd-noise", progress=False).folder
        PosixPath('out')
    """
    inputs, level = _TRACKS.get(track), _LEVELS.get(knowledge)
    if inputs is None or level is None:
        raise ConfigError(f"no observation of track {track!r} and knowledge {knowledge!r}; tracks: "
                          f"{', '.join(_TRACKS)}; knowledge: {', '.join(_LEVELS)}")
    data = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    models = [{key: str(asset.get(key, "")) for key in ("name", "licence")}
              for asset in data.info.assets]
    origin = {"format": "observation", "track": track, "knowledge": knowledge, "assets": models}
    kind = partial(_ObservationWriter, track=inputs, knowledge=level)
    return write_export(kind, data, select_sequences(data, sequences), out, origin, progress)
