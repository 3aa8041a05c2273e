"""A rendered video and its ground truth, in memory or decoded lazily from disk."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal, Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...robots.geometry import Array
from .cards import html_card

FORMAT = "gcbench/1"
BACKGROUND, VISIBLE, OCCLUDED, OUT_OF_IMAGE = 0, 1, 2, 3
"""Values of a visibility image."""
MAX_PIXELS = 2**26
"""Pixels of an image; a larger one is refused."""
_SHOWN_JOINTS = 12
"""Joints on the card of a notebook."""
_Count = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
_FrameCount = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
_ImageSide = Annotated[int, msgspec.Meta(ge=1, le=MAX_PIXELS)]
_Index = Annotated[int, msgspec.Meta(ge=0)]
_JointType = Annotated[str, msgspec.Meta(pattern="^(revolute|continuous|prismatic)$")]
_Names = Annotated[tuple[str, ...], msgspec.Meta(max_length=65535)]  # masks have 16 bits
_Layer = Annotated[str, msgspec.Meta(pattern="^(normal|coordinates|keypoints|tracks)$")]
_Omissible = Annotated[str, msgspec.Meta(pattern="^(flow|flow_backward|visibility)$")]
_OPTIONAL = {
    "flow": "forward flow; render it with --flow forward",
    "flow_backward": "backward flow; render it with --flow both",
    "visibility": "visibility; render it without --no-visibility",
    "normal": "normals; render it with --layers normal",
    "coordinates": "coordinates; render it with --layers coordinates",
}
"""Images that a dataset may lack, and how to get them."""

_Item = TypeVar("_Item", bound=np.generic, covariant=True)


class Stack(Protocol[_Item]):
    """Images of a sequence, one a frame: an array, or a `LazyStack` that decodes when indexed."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[NDArray[_Item]]: ...
    def __getitem__(self, index: int | slice, /) -> NDArray[_Item]:
        """An int gives one image, a slice a stacked array."""
        ...


@dataclass(frozen=True, eq=False)
class Frame:
    """Images and ground truth of one instant, H x W pixels."""

    rgb: NDArray[np.uint8]
    """[H W 3]"""
    depth: NDArray[np.float32]
    """[H W] z in the camera frame, m; 0 where there is no surface."""
    part: NDArray[np.uint16]
    """[H W] 1-based part number, 0 background."""
    flow: NDArray[np.float32] | None
    """[H W 2] (du, dv) to the next frame, px; NaN where unknown; None in the last frame. This and
    what follows is None in every frame if the dataset was rendered without."""
    flow_backward: NDArray[np.float32] | None
    """[H W 2] to the frame before; None in the first frame."""
    visibility: NDArray[np.uint8] | None
    """[H W] whether the forward correspondence is seen in the next frame: BACKGROUND, VISIBLE,
    OCCLUDED or OUT_OF_IMAGE; None in the last frame."""
    normal: NDArray[np.float32] | None = None
    """[H W 3] unit, camera frame, of the surface towards the camera; NaN where there is none."""
    coordinates: NDArray[np.float32] | None = None
    """[H W 3] m, the point in its part's own frame (at rest, where it deforms); NaN where there is
    no part."""

    def __repr__(self) -> str:
        (height, width), there = self.part.shape, vars(self).items()
        return (f"Frame({width}x{height} px: "
                f"{', '.join(name for name, image in there if image is not None)})")


@dataclass(frozen=True, eq=False)
class State:
    """Everything about a sequence that is exact: `state.npz`. T frames, J joints, P parts."""

    times: Array
    """[T] s"""
    joint_positions: Array
    """[T J] rad or m"""
    intrinsics: Array
    """[3 3] px"""
    cam_from_world: Array
    """[T 4 4]"""
    world_from_part: Array
    """[T P 4 4]"""
    joint_screw: Array
    """[T J 6] in the camera frame at t: direction and moment p x l; prismatic: direction, zeros."""
    joint_parent_part: NDArray[np.int64]
    """[J] part number as in the masks; 0 where the parent is no part."""
    joint_child_part: NDArray[np.int64]
    """[J] part number as in the masks."""
    part_pixels: NDArray[np.int64]
    """[T P] visible pixels"""
    coordinate_box: Array | None = None
    """[P 2 3] m, least and greatest `coordinates` of each part. This and what follows is None where
    the dataset was rendered without the layer."""
    keypoint_part: NDArray[np.int64] | None = None
    """[K] part number that carries each keypoint"""
    keypoint_world: Array | None = None
    """[T K 3] m"""
    keypoint_image: Array | None = None
    """[T K 2] px; NaN behind the camera"""
    keypoint_visible: NDArray[np.bool_] | None = None
    """[T K] in the image, and not far behind what is seen there"""
    track_part: NDArray[np.int64] | None = None
    """[N] part number of each tracked point"""
    track_query: NDArray[np.int64] | None = None
    """[N] frame in which the point was chosen: there it is the center of a pixel"""
    track_world: Array | None = None
    """[T N 3] m"""
    track_image: Array | None = None
    """[T N 2] px; NaN behind the camera"""
    track_visible: NDArray[np.bool_] | None = None
    """[T N]"""

    def at(self, frames: int | slice) -> dict[str, NDArray[Any]]:
        """Return the arrays at some frames by name; those without a time axis stay whole.

        Arrays of layers that the dataset lacks are left out.
        """
        arrays = {name: value for name, value in vars(self).items() if value is not None}
        return {k: v if k in _WITHOUT_TIME else v[frames] for k, v in arrays.items()}


_WITHOUT_TIME = {
    "intrinsics", "joint_parent_part", "joint_child_part", "coordinate_box", "keypoint_part",
    "track_part", "track_query",
}
"""Arrays of `State` that hold for the whole sequence."""


@dataclass(frozen=True)
class Meta:
    """`meta.json`: what a reader needs beside the arrays."""

    name: str
    asset: Mapping[str, Any]
    """name, source, licence, sha256, notes"""
    joint_names: _Names
    joint_types: tuple[_JointType, ...]
    """[J] "revolute", "continuous" or "prismatic"."""
    joint_limits: tuple[tuple[float, float] | None, ...]
    """[J] rad or m, None where a joint has none."""
    part_names: _Names
    scored_joints: _Names
    width: _ImageSide
    height: _ImageSide
    frames: _FrameCount
    seed: _Index
    index: _Index
    randomization: Mapping[str, Any]
    """What was drawn (docs/reference/dataset_format.md)."""
    renderer: Mapping[str, str]
    """GL renderer and version strings."""
    observability: Mapping[str, Any]
    depth_unit: Annotated[float, msgspec.Meta(ge=1e-9, le=1e3)] = 0.0001
    """m per unit of the depth PNG"""
    camera_model: Literal["pinhole"] = "pinhole"
    units: Mapping[str, str] | None = None
    deforming_parts: _Names = ()
    """Names of the parts with surfaces that move otherwise than the part."""
    layers: tuple[_Layer, ...] = ()
    """Optional truth that is stored: of "normal", "coordinates", "keypoints", "tracks"."""
    keypoint_names: _Names = ()
    """[K]"""
    keypoint_tolerance: Annotated[float, msgspec.Meta(ge=0)] = 0.0
    """m behind the visible surface at which a keypoint still counts as visible."""
    tracks: _Count = 0
    """N"""
    omitted: tuple[_Omissible, ...] = ()
    """Images that are not stored: of "flow", "flow_backward" and "visibility"."""
    format: str = FORMAT


@dataclass(frozen=True, eq=False)
class Sequence:
    """A video and its ground truth. Image stacks are arrays, or decode a frame when indexed."""

    meta: Meta
    state: State
    rgb: Stack[np.uint8]
    """T x [H W 3]"""
    depth: Stack[np.float32]
    """T x [H W] m, 0 = no surface"""
    part: Stack[np.uint16]
    """T x [H W]"""
    flow: Stack[np.float32] | None
    """T-1 x [H W 2], entry t: t -> t+1. This and what follows is None if it is not stored."""
    flow_backward: Stack[np.float32] | None
    """T-1 x [H W 2], entry t: t+1 -> t"""
    visibility: Stack[np.uint8] | None
    """T-1 x [H W]"""
    normal: Stack[np.float32] | None = None
    """T x [H W 3] (Frame.normal)"""
    coordinates: Stack[np.float32] | None = None
    """T x [H W 3] m (Frame.coordinates)"""

    def __repr__(self) -> str:
        m = self.meta
        return (f"Sequence({reprlib.repr(m.name)}, {m.frames} frames of "
                f"{m.width}x{m.height} px, {len(m.joint_names)} joints, seed {m.seed})")

    def _repr_html_(self) -> str:
        m, times = self.meta, self.state.times
        duration = f", {times[-1] - times[0]:.3g} s" if len(times) > 1 else ""
        facts = {
            "robot": m.asset.get("name", m.name),
            "video": f"{m.frames} frames of {m.width} x {m.height} px{duration}",
            "seed": m.seed,
            "licence": m.asset.get("licence", ""),
        }
        chosen = dict.fromkeys((0, (m.frames - 1) // 2, m.frames - 1))
        pictures = {f"frame {t}": partial(self.rgb.__getitem__, t) for t in chosen}
        return html_card(f"Sequence {m.name}", facts, pictures, self._joint_table())

    def _joint_table(self) -> list[tuple[object, ...]]:
        """Return where each scored joint is in the first and in the last frame, with a head."""
        m, rows = self.meta, list[tuple[object, ...]]([("scored joint", "type", "first", "last")])
        for name in m.scored_joints[:_SHOWN_JOINTS]:
            j = m.joint_names.index(name)
            kind, positions = m.joint_types[j], self.state.joint_positions[[0, -1], j]
            ends = [f"{q:.3f} m" if kind == "prismatic" else f"{np.degrees(q):.1f}°"
                    for q in positions]
            rows.append((name, kind, *ends))
        if len(m.scored_joints) > _SHOWN_JOINTS:
            rows.append((f"and {len(m.scored_joints) - _SHOWN_JOINTS} more", "", "", ""))
        return rows

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.meta.frames

    def stack(self, name: str) -> Stack[Any]:
        """Return the images of a name. Raises DatasetError if the sequence has none."""
        if (images := getattr(self, name)) is None:
            raise DatasetError(f"{self.meta.name} has {describe_absence(name)}")
        return images

    def frame(self, t: int) -> Frame:
        """Return frame t; -1 is the last. Raises IndexError beyond."""
        frames = range(self.meta.frames)
        if not -len(frames) <= t < len(frames):
            raise IndexError(f"there is no frame {t}; {self.meta.name} has {len(frames)}, from 0 "
                             f"to {frames[-1]} (-1 is the last)")
        t = frames[t]
        step, before = (t if t + 1 < self.meta.frames else None), (t - 1 if t > 0 else None)
        return Frame(
            rgb=self.rgb[t],
            depth=self.depth[t],
            part=self.part[t],
            flow=_image(self.flow, step),
            flow_backward=_image(self.flow_backward, before),
            visibility=_image(self.visibility, step),
            normal=_image(self.normal, t),
            coordinates=_image(self.coordinates, t),
        )

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames in order."""
        return (self.frame(t) for t in range(self.meta.frames))


def describe_absence(name: str) -> str:
    """Return what a dataset lacks and how to get it: "no normals; render it with ..."."""
    return f"no {_OPTIONAL.get(name, name)}"


def _image(images: Stack[_Item] | None, number: int | None) -> NDArray[_Item] | None:
    return None if images is None or number is None else images[number]
