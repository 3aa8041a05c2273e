"""What a method receives of a sequence: exactly what its inputs, knowledge and oracles grant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ...errors import ConfigError
from ...renderer.types import Inputs, Knowledge, Observation, Sequence, Stack
from ...robots.model import ArticulatedModel
from .truth import truth_of

DEPTH_NOISE = 0.05
"""m, standard deviation of the track rgbd-noise."""
_NEAREST = 0.001  # m; noise does not turn a surface into none
_NOISE_STREAM = 0x6E6F6973

Oracle = Literal["true-parts", "true-flow", "true-mask"]
ORACLES: tuple[Oracle, ...] = get_args(Oracle)
Allocate = Callable[[tuple[int, ...], DTypeLike], NDArray[Any]]
"""Makes an array of a shape and type; its content is arbitrary."""


def are_compatible(inputs: Inputs, knowledge: Knowledge) -> bool:
    """Return whether the two are compatible: no images require no knowledge, and vice versa."""
    return (inputs == "none") == (knowledge == "none")


def observe(
    sequence: Sequence,
    inputs: Inputs,
    knowledge: Knowledge,
    oracles: tuple[str, ...] = (),
    model: ArticulatedModel | None = None,
    allocate: Allocate = np.empty,
) -> Observation:
    """Return the observation of a sequence; everything that is not granted is None.

    Knowledge `model` requires `model`. `allocate` makes the arrays of rgb and depth. Raises
    ConfigError for an invalid combination.
    """
    if not are_compatible(inputs, knowledge):
        raise ConfigError(f"inputs {inputs} and knowledge {knowledge} do not go together")
    if unknown := set(oracles) - set(ORACLES):
        raise ConfigError(f"no oracle {min(unknown)!r}; there are {', '.join(ORACLES)}")
    if oracles and inputs == "none":
        raise ConfigError("an oracle requires images; this row has none")
    if knowledge == "model" and model is None:
        raise ConfigError("knowledge model needs the articulated model of the dataset")
    truth, state = truth_of(sequence), sequence.state
    axes = knowledge in ("axes", "kinematics", "model")
    lines = knowledge in ("kinematics", "model")
    has_depth = inputs in ("rgbd", "rgbd-noise")
    depth = _stack(sequence.depth, np.float32, allocate) if has_depth else None
    noise = DEPTH_NOISE if inputs == "rgbd-noise" else 0.0
    if depth is not None and noise:
        depth[...] = add_noise(depth, noise, sequence.meta.seed, sequence.meta.index)
    asked = {"true-parts", "true-mask"} & set(oracles)
    true_flow = "true-flow" in oracles
    part = true_parts(sequence, truth.label) if asked else None
    return Observation(
        rgb=None if inputs == "none" else _stack(sequence.rgb, np.uint8, allocate),
        depth=depth,
        intrinsics=state.intrinsics.copy(),
        times=state.times.copy(),
        n_joints=len(truth.joint_names),
        joint_types=truth.joint_types,
        joint_parent=truth.parent,
        depth_noise=noise,
        cam_from_world=state.cam_from_world[0].copy() if axes else None,
        axis_direction=truth.screw[:, :3].copy() if axes else None,
        axis_line=truth.screw.copy() if lines else None,
        model=model if knowledge == "model" else None,
        part=part if "true-parts" in oracles else None,
        flow=np.array(sequence.stack("flow")[:]) if true_flow else None,
        flow_backward=np.array(sequence.stack("flow_backward")[:]) if true_flow else None,
        mask=part > 0 if part is not None and "true-mask" in oracles else None,
    )


def _stack(images: Stack[Any], dtype: DTypeLike, allocate: Allocate) -> NDArray[Any]:
    stacked = allocate(images.shape, dtype)
    for target, image in zip(stacked, images, strict=True):
        target[...] = image
    return stacked


def add_noise(
    depth: NDArray[np.float32], sigma: float, seed: int, index: int
) -> NDArray[np.float32]:
    """Depth [T H W] m with Gaussian noise on surface pixels; a function of (seed, index)."""
    rng = np.random.default_rng([seed, index, _NOISE_STREAM])
    noise = rng.standard_normal(depth.shape, np.float32) * np.float32(sigma)
    return np.where(depth > 0, np.maximum(depth + noise, np.float32(_NEAREST)), np.float32(0))


def true_parts(sequence: Sequence, label: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """[T H W] 0 still, j what scored joint j is the last to move."""
    return np.stack([label[image] for image in sequence.part])
