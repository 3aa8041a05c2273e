"""Compare the encoding of a dataset's images with OpenCV's encoder and decoder.

CPU time, with the conversion to integers and back, is the least of five turns of each image; sizes
are of the files. Both write the same pixels. OpenCV has the fastest settings that keep its files
as small: zlib's level 1, run-length matching for RGB and labels, a filter for each kind.

    python tests/speed/codec_speed.py --robots ur5 microwave --sequences 2
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import gcbench as gb
import numpy as np
from gcbench.renderer.dataset import codec, codes
from gcbench.renderer.generate.worker_process import keep_freed_memory

RLE, DEFAULT = cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_STRATEGY_DEFAULT
Image = np.ndarray[Any, Any]


def opencv(image: Image, strategy: int, filtered: str) -> bytes:
    """The PNG of OpenCV."""
    settings = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, strategy]
    if hasattr(cv2, "IMWRITE_PNG_FILTER"):  # older versions always take SUB
        settings += [cv2.IMWRITE_PNG_FILTER, getattr(cv2, f"IMWRITE_PNG_FILTER_{filtered}")]
    return cv2.imencode(".png", image, settings)[1].tobytes()


def decode_png(png: bytes) -> Image:
    """The pixels that OpenCV reads."""
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED))


def jobs(sequence: gb.Sequence, t: int) -> Iterator[tuple[str, tuple[Callable[..., Any], ...]]]:
    """Of each kind of image of frame t: our encoder and decoder, and those of OpenCV."""
    frame, size, unit = sequence.frame(t), sequence.meta.width, sequence.meta.depth_unit
    where = ((size, sequence.meta.height), "here")
    yield "RGB", (lambda: codec.encode_rgb(frame.rgb), lambda png: codec.decode_rgb(png, *where),
                  lambda: opencv(cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR), RLE, "AVG"),
                  lambda png: cv2.cvtColor(decode_png(png), cv2.COLOR_BGR2RGB))
    yield "depth", (lambda: codec.encode_depth(frame.depth, unit),
                    lambda png: codec.decode_depth(png, *where, unit),
                    lambda: opencv(codes.depth_codes(frame.depth, unit), DEFAULT, "UP"),
                    lambda png: codes.depth_of_codes(decode_png(png), unit))
    yield "part", (lambda: codec.encode_part(frame.part),
                   lambda png: codec.decode_part(png, *where, 255),
                   lambda: opencv(frame.part.astype(np.uint8), RLE, "NONE"),
                   lambda png: decode_png(png).astype(np.uint16))
    for kind, flow in (("flow", frame.flow), ("flow_backward", frame.flow_backward)):
        yield kind, (lambda flow=flow: codec.encode_flow(flow),
                     lambda png: codec.decode_flow(png, *where),
                     lambda flow=flow: opencv(codes.flow_codes(flow), DEFAULT, "UP"),
                     lambda png: codes.flow_of_codes(decode_png(png)))
    yield "visibility", (lambda: codec.encode_labels(frame.visibility),
                         lambda png: codec.decode_visibility(png, *where),
                         lambda: opencv(frame.visibility, RLE, "NONE"), decode_png)


def least(function: Callable[[], Any]) -> tuple[float, Any]:
    """CPU time of a call in ms, and what it returns."""
    times: list[float] = []
    for _ in range(5):
        start = time.process_time()
        result = function()
        times.append(time.process_time() - start)
    return 1e3 * min(times), result


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robots", nargs="+", default=["ur5", "microwave"])
    parser.add_argument("--sequences", type=int, default=2, help="with an image, and with a room")
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=480)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    keep_freed_memory()
    rows: dict[str, list[list[float]]] = defaultdict(list)
    for robot, room, number in ((robot, room, k) for robot in options.robots for room in (0.0, 1.0)
                                for k in range(options.sequences)):
        config = gb.RenderConfig(robot, frames=4, width=options.width, height=options.height)
        background = replace(config.randomization.background, room=room)
        config = replace(config, randomization=replace(
            config.randomization, background=background))
        sequence = gb.render_sequence(config, number)
        for t in (1, 2):
            for kind, (encode, decode, encode_theirs, decode_theirs) in jobs(sequence, t):
                (ms, png), (ms_theirs, theirs) = least(encode), least(encode_theirs)
                assert np.array_equal(decode_png(png), decode_png(theirs))
                rows[kind].append([
                    ms_theirs, ms, len(theirs) / 1024, len(png) / 1024,
                    least(lambda f=decode_theirs, x=theirs: f(x))[0],
                    least(lambda f=decode, x=png: f(x))[0]])
    means = {kind: [statistics.mean(column) for column in zip(*values, strict=True)]
             for kind, values in rows.items()}
    means["all six"] = [sum(column) for column in zip(*means.values(), strict=True)]
    print(f"{' and '.join(options.robots)}, {options.width}x{options.height}, "
          f"{len(rows['RGB'])} frames, load {os.getloadavg()[0]:.1f}")
    print("| image | encode: OpenCV | gcbench | size: OpenCV | gcbench "
          "| decode: OpenCV | gcbench |")
    print("|---|---|---|---|---|---|---|")
    for kind, (a, b, c, d, e, f) in means.items():
        print(f"| {kind} | {a:.1f} ms | {b:.1f} ms | {c:.0f} KiB | {d:.0f} KiB "
              f"| {e:.1f} ms | {f:.1f} ms |")


if __name__ == "__main__":
    main()
