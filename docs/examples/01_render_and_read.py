"""Render a dataset and read it: images, parts, flow, joint motion.

    python 01_render_and_read.py --out data/example
    python 01_render_and_read.py --out data/example --small    # seconds
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb
import numpy as np


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/example"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    size = {"frames": 5, "width": 128, "height": 96} if options.small else {}
    config = gb.RenderConfig(robot="owi535", seed=7, **size)
    summary = gb.render_dataset(config, n=2 if options.small else 20, out=options.out)
    print(summary.describe())

    for sequence in gb.open_dataset(options.out):
        meta, state = sequence.meta, sequence.state
        print(f"\n{meta.name} {meta.index:06d}: {len(sequence)} frames of "
              f"{meta.width} x {meta.height}")

        # How far each scored joint moves from the first frame to the last.
        for name in meta.scored_joints:
            positions = state.joint_positions[:, meta.joint_names.index(name)]
            print(f"  {name:10} moves {np.degrees(positions[-1] - positions[0]):6.1f} deg")

        # Each image is decoded when it is indexed.
        part, depth, flow = sequence.part[0], sequence.depth[0], sequence.flow[0]
        for number in np.unique(part[part > 0]):
            seen = part == number
            speed = np.nanmean(np.linalg.norm(flow[seen], axis=-1))
            print(f"  {meta.part_names[number - 1]:10} {seen.sum():6d} px, "
                  f"{depth[seen].mean():.2f} m away, {speed:.2f} px per frame")


if __name__ == "__main__":
    main()
