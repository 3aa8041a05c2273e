"""The Lab images of CRAVES (Zuo et al., 2019) on the user's disk: real images with true angles.

Its world is that of the Unreal Engine: left-handed, z up, and the base of the arm looks along -y.
A point (x, y, z) of our base is (-y, -x, z) there; so the arm turns the other way about z.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import DatasetError
from ...renderer.runtime import MAX_JSON, parse_json, to_record
from ...robots.files import read_bounded
from ...robots.geometry import Array, pinhole, rotation_from_rpy
from ...robots.model import TextureDecoder
from .arm_fit import ArmFit

_CAMERA = "FusionCameraActor3_2"
_IMAGES = {".png", ".jpg", ".jpeg"}
_MOST = 100_000  # images
_MAX_BYTES = 2**27  # of an image file
_NAME = re.compile(r"[\w-]{1,40}")
_UNREAL = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_SIGNS = np.array([-1.0, 1.0, 1.0, 1.0])  # of the angles there, against ours
_AGREE = 0.015  # m between joints of the files and of our arm at the same angles
_Number = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
_Size = Annotated[float, msgspec.Meta(ge=1, le=1e5)]


@dataclass(frozen=True)
class ArmImage:
    """An image of the arm with its truth."""

    rgb: NDArray[np.uint8]
    """[H W 3]"""
    intrinsics: Array
    """[3 3] px"""
    angles: Array
    """[4] rad: rotation, base, elbow, wrist"""
    keypoints: Array
    """[17 2] px; NaN where unknown"""


@dataclass(frozen=True)
class _Vector:
    X: _Number
    Y: _Number
    Z: _Number

    @property
    def array(self) -> Array:
        return np.array([self.X, self.Y, self.Z])


@dataclass(frozen=True)
class _Turn:
    """deg"""

    Pitch: _Number
    Yaw: _Number
    Roll: _Number


@dataclass(frozen=True)
class _Caminfo:
    Location: _Vector
    Rotation: _Turn
    FilmWidth: _Size
    FilmHeight: _Size
    Fov: Annotated[float, msgspec.Meta(ge=1, le=170)]


@dataclass(frozen=True)
class _Joints:
    Base: _Vector
    Elbow: _Vector
    Wrist: _Vector


@dataclass(frozen=True)
class _Actor:
    WorldJoints: _Joints


def read_lab(folder: Path, fit: ArmFit) -> Iterator[ArmImage]:
    """Yield the images of a folder of CRAVES' Lab data in the order of their names.

    Angles come from `angles/`, the camera from `FusionCameraActor3_2/caminfo/`. The keypoints are
    those of our arm at the true angles, where its joints are those of `joint/`; they are NaN if
    the joints differ by more than 15 mm.

    Raises:
        DatasetError: If the folder has another layout, or a file is damaged.
        ModelError: If an image is damaged.
    """
    pictures = sorted(p for p in (folder / _CAMERA / "lit").glob("*") if p.suffix in _IMAGES)
    if not pictures or not (folder / "angles").is_dir():
        raise DatasetError(f"{folder}: expected CRAVES' Lab data: angles/, joint/ and {_CAMERA}/"
                           "{lit,caminfo}/")
    if len(pictures) > _MOST:
        raise DatasetError(f"{folder}: more than {_MOST} images")
    for path in pictures:
        if not _NAME.fullmatch(path.stem):
            raise DatasetError(f"{path}: the name of an image is letters, digits, - and _")
        file = f"{path.stem}.json"
        angles = _read_angles(folder / "angles" / file)
        rgb = TextureDecoder().decode(read_bounded(path, _MAX_BYTES, DatasetError), str(path))
        where = folder / _CAMERA / "caminfo" / file
        camera = to_record(parse_json(_read(where), str(where)), _Caminfo, str(where))
        intrinsics = _intrinsics(camera, rgb.shape[1], rgb.shape[0], where)
        points = _keypoints_there(folder / "joint" / file, fit, angles)
        in_cam = (points - camera.Location.array) @ _axes(camera.Rotation).T
        ahead = np.where(in_cam[:, 2:] > 0, in_cam, np.nan)
        yield ArmImage(rgb[..., :3], intrinsics, angles, pinhole.project(intrinsics, ahead)[:, :2])


def _read(path: Path) -> bytes:
    return read_bounded(path, MAX_JSON, DatasetError)


def _read_angles(path: Path) -> Array:
    """The four angles of our arm, rad; the file also has the pose of the camera."""
    try:
        row = msgspec.json.decode(_read(path), type=list[_Number])
    except (msgspec.MsgspecError, RecursionError) as error:
        raise DatasetError(f"{path}: not a list of angles ({error})") from error
    if len(row) < len(_SIGNS):
        raise DatasetError(f"{path}: {len(row)} numbers; expected rotation, base, elbow, wrist ...")
    return np.radians(_SIGNS * row[: len(_SIGNS)])


def _intrinsics(camera: _Caminfo, width: int, height: int, where: Path) -> Array:
    """[3 3] px of an image that may be larger or smaller than the film."""
    factor = width / camera.FilmWidth
    if abs(height - factor * camera.FilmHeight) > 2:
        raise DatasetError(f"{where}: a film of {camera.FilmWidth:g} x {camera.FilmHeight:g} for "
                           f"an image of {width} x {height} px")
    f = width / (2 * np.tan(np.radians(camera.Fov) / 2))
    return np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])


def _axes(turn: _Turn) -> Array:
    """The axes [3 3] x (right), y (down), z (forward) of a camera, rows in Unreal's world."""
    # Unreal turns by roll about x, then pitch about y, both clockwise, then yaw about z
    world_from_actor = rotation_from_rpy(np.radians([-turn.Roll, -turn.Pitch, turn.Yaw]))
    forward, right, up = world_from_actor.T
    return np.stack([right, -up, forward])


def _keypoints_there(path: Path, fit: ArmFit, angles: Array) -> Array:
    """The keypoints [K 3] in Unreal's world, in the unit of the files."""
    actors = parse_json(_read(path), str(path))
    actor = to_record(next(iter(actors.values()), {}), _Actor, str(path)).WorldJoints
    joints = np.stack([actor.Base.array, actor.Elbow.array, actor.Wrist.array])
    points = fit.points(angles) @ _UNREAL.T
    unit = np.linalg.norm(joints[1] - joints[0]) / np.linalg.norm(points[1] - points[0])
    there = joints[0] + unit * (points - points[0])
    agree = unit > 0 and bool(np.all(np.abs(there[:3] - joints) <= _AGREE * unit))
    return there if agree else np.full_like(there, np.nan)
