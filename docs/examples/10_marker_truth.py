"""How far a real door turns, by a printed marker: the error of GC-Pose on your own video.

    gcbench estimate door.mp4 --fov 52.7
    python 10_marker_truth.py --video door.mp4 --table door.csv --calibration calib.xml --side 0.141

Glue an ArUco marker flat to the door. The calibration is a file of OpenCV (`camera_matrix`,
`distortion_coefficients`). `--small` draws a door with a marker and compares with its true turn.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def read_calibration(path: Path) -> tuple[Array, Array]:
    """Return the matrix [3 3] and the distortion of a camera."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    return (np.asarray(file.getNode("camera_matrix").mat(), float),
            np.asarray(file.getNode("distortion_coefficients").mat(), float))


def rotations(video: Path, camera: tuple[Array, Array], side: float, dictionary: int
              ) -> dict[int, Array]:
    """Return the rotation [3 3] of the first marker that is found in each frame."""
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    kind = cv2.aruco.getPredefinedDictionary(dictionary)
    detector = cv2.aruco.ArucoDetector(kind, settings)
    square = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * side / 2
    frames, out, number = cv2.VideoCapture(str(video)), {}, 0
    while True:
        read, image = frames.read()
        if not read:
            return out
        corners, _, _ = detector.detectMarkers(image)
        if len(corners):
            pose = cv2.solvePnPGeneric(square, corners[0][0].astype(float), *camera,
                                       flags=cv2.SOLVEPNP_IPPE_SQUARE)
            out[number] = cv2.Rodrigues(pose[1][0])[0]
        number += 1


def turns(rotation: dict[int, Array], first: int) -> tuple[dict[int, float], float]:
    """Return the turn of a door since a frame, deg, and how far the marker tilts beside it."""
    numbers = sorted(rotation)
    turn = np.array([cv2.Rodrigues(rotation[n] @ rotation[first].T)[0].ravel() for n in numbers])
    _, _, axes = np.linalg.svd(turn)
    angle = np.degrees(turn @ axes[0])
    angle *= np.sign(angle[np.argmax(np.abs(angle))]) or 1
    beside = np.degrees(np.linalg.norm(turn - np.outer(turn @ axes[0], axes[0]), axis=1))
    return dict(zip(numbers, angle.tolist(), strict=True)), float(np.sqrt((beside**2).mean()))


def draw_door(folder: Path) -> tuple[Path, Path, Path]:
    """Write a video of a door with a marker that opens by 30 deg, its calibration, and its turn."""
    folder.mkdir(parents=True, exist_ok=True)
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(10), 3, 300)
    door = cv2.copyMakeBorder(marker, 100, 100, 100, 100, cv2.BORDER_CONSTANT, value=(255,))
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    names = [folder / name for name in ("door.avi", "door.csv", "calib.xml")]
    video = cv2.VideoWriter(str(names[0]), cv2.VideoWriter.fourcc(*"MJPG"), 15, (640, 480))
    rows = ["frame,displacement"]
    for frame in range(8):
        angle = np.radians(30 * frame / 7)
        plane = np.stack([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [-0.15, -0.15, 1]], 1)
        shown = matrix @ plane @ np.diag([0.0006, 0.0006, 1])
        image = cv2.warpPerspective(door, shown, (640, 480), borderValue=(128,))
        video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        rows.append(f"{frame},{np.degrees(angle):.4f}")
    video.release()
    names[1].write_text("\n".join(rows))
    file = cv2.FileStorage(str(names[2]), cv2.FILE_STORAGE_WRITE)
    file.write("camera_matrix", matrix)
    file.write("distortion_coefficients", np.zeros((1, 5)))
    file.release()
    return names[0], names[1], names[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--video", type=Path, default=Path("door.mp4"))
    parser.add_argument("--table", type=Path, default=Path("door.csv"))
    parser.add_argument("--calibration", type=Path, default=Path("calib.xml"))
    parser.add_argument("--side", type=float, default=0.141, help="of the black square, m")
    parser.add_argument("--dictionary", type=int, default=10, help="of OpenCV; 10: DICT_6X6_250")
    parser.add_argument("--out", type=Path, default=Path("data/marker"))
    parser.add_argument("--small", action="store_true", help="draw a video in place of a real one")
    options = parser.parse_args()

    video, table, calibration = options.video, options.table, options.calibration
    if options.small:
        video, table, calibration = draw_door(options.out)
    with table.open() as file:
        estimate = {int(row["frame"]): float(row["displacement"]) for row in csv.DictReader(file)}
    found = rotations(video, read_calibration(calibration), options.side, options.dictionary)
    seen = [number for number in estimate if number in found]
    if not seen or seen[0] != min(estimate):
        raise SystemExit("no marker is found in the first frame; check --dictionary")
    true, beside = turns(found, seen[0])
    sign = np.sign(estimate[seen[-1]] * true[seen[-1]]) or 1  # the axis may point either way
    for number in seen:
        print(f"frame {number}: marker {true[number]:.1f} deg, estimate "
              f"{sign * estimate[number]:.1f} deg")
    error = abs(sign * estimate[seen[-1]] - true[seen[-1]])
    print(f"error at the last frame: {error:.2f} deg; the marker tilts by {beside:.2f} deg (RMS) "
          "beside its axis")


if __name__ == "__main__":
    main()
