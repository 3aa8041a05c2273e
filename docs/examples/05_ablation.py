"""An ablation of GC-Pose: one setting of the method, changed for a run.

    python 05_ablation.py --out data/ablation --small

The same from the command line:

    gcbench eval --method gcpose --inputs rgbd --knowledge axes --data data/ablation/owi535 \\
        --set rgbd.candidates=300
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gcbench as gb

CHANGES = ((), ("rgbd.candidates=300",))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("data/ablation"))
    parser.add_argument("--small", action="store_true", help="few small images")
    options = parser.parse_args()

    size = {"frames": 6, "width": 240, "height": 180} if options.small else {}
    data = options.out / "owi535"
    gb.render_dataset(gb.RenderConfig(robot="owi535", seed=2, **size),
                      n=2 if options.small else 20, out=data)

    for change in CHANGES:
        config = gb.EvalConfig(method=("gcpose",), set=change, inputs=("rgbd",),
                               knowledge=("axes",), data=(data,), results=options.out / "results")
        frame = gb.evaluate(config).frame
        mean = frame.groupby("metric").value.mean()
        print(f"{' '.join(change) or 'defaults':25} {mean.final_error:7.3f} deg, "
              f"{mean.seconds_per_frame:.2f} s per frame")


if __name__ == "__main__":
    main()
