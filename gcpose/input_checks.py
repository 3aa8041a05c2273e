"""What an observation must be like before GC-Pose reads it: compiled loops check no index."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MethodError
from ..renderer.types import Observation

_KINDS = ("revolute", "continuous", "prismatic")
_TYPES = {"u": "uint8 (0 to 255)", "f": "floats", "b": "booleans", "biu": "integers",
          "fiu": "real numbers"}
"""Words for sets of kinds of data types."""
_FIXES = {
    "depth": ", in meters; of millimeters: depth.astype(numpy.float32) / 1000",
    "mask": "; of integers: mask > 0"}
"""What makes a known array right."""
_MOST_DEPTH, _MOST_NOISE = 100.0, 1.0  # m; of half of the pixels, and its standard deviation
_UNIT = 1e-3
"""Largest difference of the length of an axis from 1."""


def check_observation(observation: Observation) -> Observation:
    """Return an observation whose depth is 0 where it is not finite.

    Raises:
        MethodError: If its arrays do not fit together, an axis is no unit vector, or the camera has
            a skew; or if depth cannot be in meters, or comes without rgb.
    """
    o = observation
    _check_joints(o)
    _check_axes(o)
    _check_camera(o)
    images = o.depth if o.rgb is None else o.rgb
    if images is None:
        return o
    _check_array("depth" if o.rgb is None else "rgb", images)
    _check("times", o.times, (len(images),), "fiu")
    size = (len(o.times), *np.shape(images)[1:3])
    known: list[tuple[str, NDArray[Any] | None, str, tuple[int, ...]]] = [
        ("rgb", o.rgb, "u", (*size, 3)), ("depth", o.depth, "f", size),
        ("part", o.part, "biu", size), ("mask", o.mask, "b", size),
        ("flow", o.flow, "f", (size[0] - 1, *size[1:], 2)),
        ("flow_backward", o.flow_backward, "f", (size[0] - 1, *size[1:], 2))]
    if min(size) < 1:
        raise MethodError(f"gcpose needs images, not {list(np.shape(images))}")
    for name, array, kinds, shape in known:
        if array is not None:
            _check(name, array, shape, kinds)
    if o.rgb is not None and o.rgb.dtype != np.uint8:
        raise MethodError(f"gcpose needs rgb as uint8 (0 to 255), not {o.rgb.dtype}")
    if o.part is not None and o.part.max() > o.n_joints:
        raise MethodError(f"gcpose needs parts 0 to {o.n_joints}, not {o.part.max()}")
    if o.depth is None:
        return o
    if o.rgb is None:
        raise MethodError("gcpose needs rgb, also with depth")
    finite = np.isfinite(o.depth)
    if not finite.all():
        o = replace(o, depth=np.where(finite, o.depth, 0).astype(o.depth.dtype))
    _check_depth(o)
    return o


def _check_depth(o: Observation) -> None:
    noise = o.depth_noise
    if not (np.issubdtype(type(noise), np.number) and 0 <= noise < _MOST_NOISE):
        raise MethodError(f"gcpose needs a depth_noise from 0 (exact) to {_MOST_NOISE:g} m, not "
                          f"{noise}")
    assert o.depth is not None
    seen = o.depth[0][o.depth[0] > 0]
    if seen.size and float(np.median(seen)) > _MOST_DEPTH:
        raise MethodError(f"gcpose needs depth in meters, not {np.median(seen):g} for half of the "
                          "pixels; divide millimeters by 1000")


def _check_joints(o: Observation) -> None:
    if o.n_joints < 1 or len(o.joint_types) != o.n_joints:
        raise MethodError(f"gcpose needs at least one joint and the type of each, not n_joints = "
                          f"{o.n_joints} and {len(o.joint_types)} joint_types")
    if wrong := [kind for kind in o.joint_types if kind not in _KINDS]:
        raise MethodError(f"gcpose knows joints that are {', '.join(_KINDS)}, not {wrong[0]!r}")
    parents = o.joint_parent
    if parents and (len(parents) != o.n_joints or any(
            not -1 <= parent < j for j, parent in enumerate(parents))):
        raise MethodError(f"gcpose needs a joint_parent of each joint, -1 or an earlier joint, not "
                          f"{tuple(parents)}")


def _check_axes(o: Observation) -> None:
    for name, axes, width in (
        ("axis_direction", o.axis_direction, 3), ("axis_line", o.axis_line, 6)
    ):
        if axes is None:
            continue
        _check(name, axes, (o.n_joints, width), "fiu")
        if not np.isfinite(axes).all():
            raise MethodError(f"gcpose needs a finite {name}")
        length = np.linalg.norm(axes[:, :3], axis=1)
        if (np.abs(length - 1) > _UNIT).any():
            raise MethodError(f"gcpose needs axes of length 1 in {name}, not "
                              f"{length[np.abs(length - 1).argmax()]:g}")


def _check_camera(o: Observation) -> None:
    k = o.intrinsics
    _check("intrinsics", k, (3, 3), "fiu")
    if not (np.isfinite(k).all() and min(k[0, 0], k[1, 1]) > 0):
        raise MethodError("gcpose needs finite intrinsics with focal lengths above 0")
    if k[0, 1]:
        raise MethodError(f"gcpose needs a camera without skew, not {k[0, 1]:g} px; undistort the "
                          "images first")
    if o.cam_from_world is not None:
        _check("cam_from_world", o.cam_from_world, (4, 4), "fiu")
        if not np.isfinite(o.cam_from_world).all():
            raise MethodError("gcpose needs a finite cam_from_world")


def _check(
    name: str, array: NDArray[Any] | None, shape: tuple[int, ...], kinds: str
) -> None:
    if array is None:
        raise MethodError(f"gcpose needs {name} {list(shape)}; they are missing")
    _check_array(name, array)
    if array.shape != shape:
        raise MethodError(f"gcpose needs {name} of shape {list(shape)}, not {array.dtype} "
                          f"{list(array.shape)}")
    if array.dtype.kind not in kinds:
        raise MethodError(f"gcpose needs {name} as {_TYPES[kinds]}, not {array.dtype}"
                          + _FIXES.get(name, ""))


def _check_array(name: str, array: object) -> None:
    if not isinstance(array, np.ndarray):
        raise MethodError(f"gcpose needs {name} as one NumPy array, not {type(array).__name__}; "
                          "numpy.array makes one of a list")
