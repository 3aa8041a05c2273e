"""Which model a sequence shows: the robot of the config, or an instance drawn of a category."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, DatasetError, GcbenchError, ModelError
from ...robots.catalog import (
    instance_numbers,
    is_category,
    is_file,
    load_robot,
    parse_object_name,
    select_default_scored,
)
from ...robots.model import Animation, ArticulatedModel
from ...robots.motion import JointTrajectory, joint_indices
from ..types import Meta
from .config import RenderConfig
from .motion import NO_ANIMATION, find_animation, remove_joints
from .recorded_motion import read_motion
from .sampling import Streams

_TRIES = 1000
"""Instances of a category that are tried until one has the joints of `scored_joints`."""


@dataclass(frozen=True)
class ModelSource:
    """A model, its scored joints, and where it came from."""

    robot: str
    """The name that loads the model."""
    model: ArticulatedModel
    scored: tuple[str, ...]
    """Scored joints, from the base outward."""
    fixed_motion: Animation | JointTrajectory | None
    """The motion, if it is not random: of the model's surfaces, or of its joints."""
    asset: dict[str, Any]
    """Where the model came from, for `meta.json`."""


class MissingJointError(ConfigError):
    """The model has no joint of a name in `scored_joints`."""


def model_source(config: RenderConfig, index: int, last: ModelSource | None = None) -> ModelSource:
    """Load the model of sequence `index`; return `last` if it has that model.

    Instances of a category that lack a joint of `scored_joints` are drawn again.
    """
    reason = ""
    for attempt in range(_TRIES if is_category(config.robot) else 1):
        robot = draw_instance(Streams(config, index), attempt)
        try:
            return last if last and last.robot == robot else _load(config, robot)
        except MissingJointError as error:
            reason = str(error)
    raise MissingJointError(reason)


def draw_instance(streams: Streams, attempt: int = 0) -> str:
    """Return the name of a sequence's model; of a category, draw an instance of the stream."""
    config = streams.config
    if not is_category(config.robot):
        return config.robot
    numbers = instance_numbers(config.robot, config.stream)
    drawn = int(streams.rng("instance", attempt).integers(len(numbers)))
    return f"{config.robot}:{numbers[drawn]}"


def robot_of(config: RenderConfig, meta: Meta) -> str:
    """Return the name of the model that a sequence shows; DatasetError if the config excludes it.
    """
    if not is_category(config.robot):
        return config.robot
    instance = str(meta.asset.get("instance", ""))
    kind, number = parse_object_name(instance)
    if kind != config.robot or number not in instance_numbers(kind, config.stream):
        raise DatasetError(f"{meta.name} shows {instance!r}, which is no {config.robot} of the "
                           f"stream {config.stream}")
    return instance


def check_model_paths(config: RenderConfig) -> None:
    """Raise ModelError if the model of a dataset's config is read from a path in that config.

    Datasets come from elsewhere, so that they may name any file of this machine.
    """
    if is_file(config.robot) or config.package:
        path = config.robot if is_file(config.robot) else config.package[0]
        raise ModelError(f"the dataset names {path!r} as its model; add --allow-model to read it")


def model_of(
    config: RenderConfig, meta: Meta | None = None, allow: bool = False
) -> ArticulatedModel:
    """Load the model that a sequence shows.

    Only if `allow`, its files are read from paths that the config names, or downloaded. `meta` is
    needed only where each sequence shows another instance.
    """
    if not allow:
        check_model_paths(config)
    robot = config.robot if meta is None else robot_of(config, meta)
    return load_robot(robot, packages_of(config), config.allow_missing, allow, config.root,
                      config.scale)


def dataset_asset(config: RenderConfig, source: ModelSource) -> dict[str, Any]:
    """Return where the models of a whole dataset come from, for `dataset.json`."""
    if not is_category(config.robot):
        return {**source.asset, "files": source.model.files}
    asset = {"name": config.robot, "source": source.model.source, "licence": source.model.licence,
             "sha256": "", "notes": []}  # each sequence shows another instance
    return asset | {k: v for k, v in source.asset.items() if k == "motion"}


def packages_of(config: RenderConfig) -> dict[str, Path]:
    """Return the folders of `--package NAME=DIR` by package name; each must exist."""
    out: dict[str, Path] = {}
    for item in config.package:
        name, equals, folder = item.partition("=")
        if not (name and equals and folder):
            raise ConfigError(f"--package {item!r}: give NAME=DIR, as in my_robot=~/my_robot")
        out[name] = Path(folder).expanduser()
        if not out[name].is_dir():
            raise ConfigError(f"--package {item!r}: there is no folder {out[name]}")
    return out


def _load(config: RenderConfig, robot: str) -> ModelSource:
    model = load_robot(robot, packages_of(config), config.allow_missing, root=config.root,
                       scale=config.scale)
    if not model.visuals:
        raise ModelError(f"{robot}: the model has no visible geometry to render")
    recorded = read_motion(Path(file)) if (file := config.randomization.motion.file) else None
    if recorded and config.animation not in ("", NO_ANIMATION):
        raise ConfigError("--animation and --motion.file exclude each other; give one of them")
    animation = None if recorded else find_animation(model, config.animation)
    if animation is not None:
        if config.scored_joints:
            raise ConfigError(
                f"{robot}: the animation {animation.name!r} moves the model, so that no joint is "
                "scored; add --animation none, or leave --scored-joints out")
        model = remove_joints(model)
    notes = list(model.notes)
    if "keypoints" in config.layers and not model.keypoint_names:
        notes.append("the model has no keypoints: that layer is empty")
    asset: dict[str, Any] = {"name": model.name, "source": model.source, "licence": model.licence,
                             "sha256": model.sha256, "notes": notes}
    if is_category(config.robot):
        asset["instance"] = robot
    fixed_motion: Animation | JointTrajectory | None = animation
    names = config.scored_joints or select_default_scored(robot, model)
    try:
        joint_indices(model, (*names, *(recorded.joints if recorded else ())))
    except GcbenchError as error:
        raise MissingJointError(f"{recorded.path}: {error}" if recorded else str(error)) from error
    if recorded:
        asset["motion"] = {"file": recorded.path.name, "sha256": recorded.sha256}
        fixed_motion = recorded.trajectory(model, config.frames, config.randomization.motion.fps)
        names = config.scored_joints or _moving_joints(model, fixed_motion, names)
    scored = tuple(model.joint_names[j] for j in joint_indices(model, names))
    return ModelSource(robot, model, scored, fixed_motion, asset)


def _moving_joints(
    model: ArticulatedModel, motion: JointTrajectory, wanted: Sequence[str]
) -> tuple[str, ...]:
    """Those of the wanted joints that a motion moves; all that it moves if these are none."""
    moved = [name for name, path in zip(model.joint_names, motion.positions.T, strict=True)
             if np.ptp(path) > 0]
    return tuple(name for name in moved if name in wanted) or tuple(moved)
