"""How image noise changes optical flow: paired datasets that differ in the noise and nothing else.

    python 04_noise_study.py --out data/noise --small
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import gcbench as gb
import numpy as np

LEVELS = (0.0, 4.0, 12.0)  # standard deviation, grey levels of 255


def flow_error(data: Path) -> float:
    """Return the median endpoint error of OpenCV's DIS on the moving parts of a dataset, px."""
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    errors = []
    for sequence in gb.open_dataset(data):
        grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in sequence.rgb]
        for t, true in enumerate(sequence.flow):
            found = dis.calc(grey[t], grey[t + 1], None)
            moving = np.linalg.norm(true, axis=-1) > 0.5      # NaN, where unknown, is not
            errors.append(np.linalg.norm(found - true, axis=-1)[moving])
    return float(np.median(np.concatenate(errors)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/noise"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    size = {"frames": 5, "width": 128, "height": 96} if options.small else {}
    config = gb.RenderConfig(robot="owi535", seed=5, **size)
    for level in LEVELS[::2] if options.small else LEVELS:
        # One seed, so the motion, the camera, the light and the background are the same.
        image = replace(config.randomization.image, noise=(level, level))
        noisy = replace(config, randomization=replace(config.randomization, image=image))
        data = options.out / f"noise-{level:g}"
        gb.render_dataset(noisy, n=2 if options.small else 20, out=data)
        print(f"noise {level:4.1f}: median error of the flow {flow_error(data):.2f} px")


if __name__ == "__main__":
    main()
