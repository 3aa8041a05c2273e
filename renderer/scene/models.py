"""Which model a sequence shows: the config's one, or an instance of a category, drawn for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import ConfigError, GcbenchError
from ...robots.catalog import entries as catalog
from ...robots.catalog import names as objects
from ...robots.model import Animation, ArticulatedModel
from ...robots.motion import default_scored_joints, joint_indices
from ...robots.urdf import partnet
from ..types import Meta
from .config import RenderConfig
from .motion import animated, chosen_animation
from .sampling import Streams

_TRIES = 1000


@dataclass(frozen=True)
class ModelSource:
    """A model, and what of it is scored."""

    robot: str
    """The name that loads it."""
    model: ArticulatedModel
    scored: tuple[str, ...]
    """From the base outward."""
    animation: Animation | None
    """What moves the model, where no joint does."""
    asset: dict[str, Any]
    """Where the model came from, for `meta.json`."""


def model_source(config: RenderConfig, index: int, last: ModelSource | None = None) -> ModelSource:
    """The cast of sequence `index`: `last`, if that is the one.

    An instance that lacks a joint of `scored_joints` is drawn again. Raises GcbenchError if a model
    cannot be loaded, shows nothing, or has not the joints that are to be scored.
    """
    reason = ""
    for attempt in range(_TRIES if objects.is_category(config.robot) else 1):
        robot = draw_instance(Streams(config, index), attempt)
        try:
            return last if last and last.robot == robot else _load(config, robot)
        except MissingJointError as error:
            reason = str(error)
    raise GcbenchError(reason)


def draw_instance(streams: Streams, attempt: int = 0) -> str:
    """The name of the model: of an instance from those of the stream, if it is a category."""
    config = streams.config
    if not objects.is_category(config.robot):
        return config.robot
    numbers = objects.instances(config.robot, config.stream)
    drawn = int(streams.rng("instance", attempt).integers(len(numbers)))
    return f"{config.robot}:{numbers[drawn]}"


def robot_of(config: RenderConfig, meta: Meta) -> str:
    """The name of the model that a sequence of a config shows.

    Raises GcbenchError if the sequence does not name an instance that the config may show.
    """
    if not objects.is_category(config.robot):
        return config.robot
    instance = str(meta.asset.get("instance", ""))
    kind, number = objects.split(instance)
    if kind != config.robot or number not in objects.instances(kind, config.stream):
        raise GcbenchError(f"{meta.name} shows {instance!r}, which is no {config.robot} of the "
                           f"stream {config.stream}")
    return instance


def dataset_asset(config: RenderConfig, cast: ModelSource) -> dict[str, Any]:
    """Where the models of a whole dataset come from, for `dataset.json`."""
    if not objects.is_category(config.robot):
        return cast.asset
    return {"name": config.robot, "source": cast.model.source, "licence": cast.model.licence,
            "sha256": "", "notes": ["another instance in each sequence: asset of its meta.json"]}


def packages_of(config: RenderConfig) -> dict[str, Path]:
    """Folders by package name, from NAME=DIR. Raises GcbenchError for another form."""
    out: dict[str, Path] = {}
    for item in config.package:
        name, equals, folder = item.partition("=")
        if not (name and equals and folder):
            raise GcbenchError(f"--package {item!r}: give NAME=DIR, as in my_robot=~/my_robot")
        out[name] = Path(folder).expanduser()
        if not out[name].is_dir():
            raise GcbenchError(f"--package {item!r}: there is no folder {out[name]}")
    return out


class MissingJointError(ConfigError):
    """A model has no joint of a name that is to be scored."""


def _load(config: RenderConfig, robot: str) -> ModelSource:
    model = catalog.load(robot, packages_of(config), config.allow_missing)
    if not model.visuals:
        raise GcbenchError(f"{robot}: the model has no visible geometry to render")
    animation = chosen_animation(model, config.animation)
    if animation is not None:
        if config.scored_joints:
            raise GcbenchError(
                f"{robot}: the animation {animation.name!r} moves the model, so that no joint is "
                "scored; add --animation none, or leave --scored-joints out")
        model = animated(model)
    notes = list(model.notes)
    if "keypoints" in config.layers and not model.keypoint_names:
        notes.append("the model has no keypoints: that layer is empty")
    asset: dict[str, Any] = {"name": model.name, "source": model.source, "licence": model.licence,
                             "sha256": model.sha256, "notes": notes}
    if objects.is_category(config.robot):
        asset["instance"] = robot
    return ModelSource(robot, model, _scored_joints(config, model), animation, asset)


def _scored_joints(config: RenderConfig, model: ArticulatedModel) -> tuple[str, ...]:
    """Those that are asked for, else the catalogue's, else an object's doors, else the bottom
    three; base outward."""
    names = config.scored_joints
    if not names and objects.is_object(config.robot):
        names = partnet.scored_joints(model)
    elif not names and not catalog.is_path(config.robot):
        names = catalog.find(config.robot).scored
    names = names or default_scored_joints(model)
    try:
        return tuple(model.joint_names[j] for j in joint_indices(model, names))
    except GcbenchError as error:
        raise MissingJointError(str(error)) from error
