"""A folder in the layout of CRAVES' Lab data, written from a sequence of the OWI-535."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from gcbench.renderer.types.sequence import Sequence

_CENTIMETRE = 100.0  # of the files, in a metre


def write_lab(folder: Path, sequence: Sequence) -> None:
    """Write the images, and the truth in Unreal's left-handed axes; each is derived here anew."""
    state = sequence.state
    camera = folder / "FusionCameraActor3_2"
    for name in ("angles", "joint", "vertex"):
        (folder / name).mkdir(parents=True)
    for name in ("lit", "caminfo"):
        (camera / name).mkdir(parents=True)
    assert state.keypoint_world is not None
    for t in range(len(sequence)):
        q = np.degrees(state.joint_positions[t, :4])
        _dump(folder / f"angles/{t:08d}.json", [-q[0], *q[1:], 0, 0, 0, 0, 0, 0])
        points = [_unreal(p) for p in state.keypoint_world[t]]
        joints = dict(zip(("Rotation", "Base", "Elbow", "Wrist"), [_unreal([0, 0, 0]), *points[:3]],
                          strict=True))
        _dump(folder / f"joint/{t:08d}.json", {"actor": {"WorldJoints": joints}})
        _dump(folder / f"vertex/{t:08d}.json", points[3:])
        pose = np.linalg.inv(state.cam_from_world[t])
        right, down, ahead = ([*_unreal(pose[:3, k], 1.0).values()] for k in range(3))
        yaw, pitch = np.arctan2(ahead[1], ahead[0]), np.arcsin(ahead[2])
        roll = np.arctan2(-right[2], -down[2])
        _dump(camera / f"caminfo/{t:08d}.json", {
            "Location": _unreal(pose[:3, 3]),
            "Rotation": {"Pitch": np.degrees(pitch), "Yaw": np.degrees(yaw),
                         "Roll": np.degrees(roll)},
            "FilmWidth": sequence.meta.width, "FilmHeight": sequence.meta.height,
            "Fov": np.degrees(2 * np.arctan(sequence.meta.width / 2 / state.intrinsics[0, 0]))})
        cv2.imwrite(str(camera / f"lit/{t:08d}.png"), sequence.rgb[t][..., ::-1])


def _unreal(point: Any, unit: float = _CENTIMETRE) -> dict[str, float]:
    x, y, z = (unit * float(v) for v in point)
    return {"X": -y, "Y": -x, "Z": z}


def _dump(path: Path, tree: Any) -> None:
    path.write_text(json.dumps(tree))
