"""Measure the renderer's frames per second beside other renderers (`make speed`).

Every contender renders the same sequences of one robot (motion, camera, lights, backgrounds) in its
own process. The contenders take turns, sequence by sequence, in alternating order. A ratio is the
median over the sequences of ratios of times that were measured seconds apart, so that other load
on the machine slows both. A contender that cannot start is left out, with one line that says why.

    make speed ARGS="--sequences 1 --worker-sequences 0"    # a short run
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import statistics
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib.metadata import version
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from gcbench.renderer.cluster import RayWorkers
from gcbench.renderer.generate.driver import plan_workers, render_dataset
from gcbench.renderer.scene.config import RenderConfig

TITLES = {
    "Shipped": "gcbench: all arrays, sampling included",
    "Encoded": "gcbench: the same, and written to disk",
    "Pure": "gcbench: all arrays of given scenes",
    "Images": "gcbench: RGB, depth, parts of given scenes",
    "Pyrender": "pyrender script: all arrays of given scenes",
    "Bullet": "PyBullet TinyRenderer: RGB, depth, parts",
    "Mujoco": "MuJoCo: RGB, depth, parts",
}
RATIOS = (
    ("Shipped", "Pyrender"), ("Encoded", "Pyrender"), ("Pure", "Pyrender"),
    ("Images", "Bullet"), ("Images", "Mujoco"),
)


@dataclass
class Turn:
    """One contender rendered one sequence."""

    contender: str
    sequence: int
    frames: int
    wall: float
    """s"""
    cpu: float
    """s, of all threads"""


class ContenderError(Exception):
    """A contender cannot go on; the message is one line."""


class Child:
    """A contender in a spawned process. Raises ContenderError if it cannot start."""

    def __init__(self, name: str, config: RenderConfig, shots: list) -> None:
        self.name = name
        self._pipe, theirs = multiprocessing.Pipe()
        self._process = multiprocessing.get_context("spawn").Process(
            target=_serve, args=(theirs, name, config, shots), daemon=True)
        self._process.start()
        theirs.close()
        self.versions: str = self._receive()

    def _receive(self) -> Any:
        try:
            done, answer = self._pipe.recv()
        except EOFError:
            self._process.join()
            done, answer = False, f"its process ended with {self._process.exitcode}"
        if not done:
            self.close()
            raise ContenderError(answer)
        return answer

    def turn(self, sequence: int) -> Turn:
        self._pipe.send(("turn", sequence))
        return Turn(self.name, sequence, *self._receive())

    def arrays(self, sequence: int) -> tuple:
        """The arrays of the second frame of a sequence."""
        self._pipe.send(("arrays", sequence))
        return self._receive()

    def close(self) -> None:
        self._pipe.close()
        self._process.join(5)
        self._process.terminate()


def _serve(pipe: Connection, name: str, config: RenderConfig, shots: list) -> None:
    try:
        from contenders import CONTENDERS

        contender = CONTENDERS[name](config, shots)
        pipe.send((True, contender.versions()))
        while True:
            pipe.send((True, _answer(contender, *pipe.recv())))
    except EOFError:
        return
    except ModuleNotFoundError as error:
        pipe.send((False, f"not installed ({error.name})"))
    except Exception as error:
        pipe.send((False, " ".join(f"{type(error).__name__}: {error}".split())))


def _answer(contender: Any, question: str, index: int) -> tuple:
    if question == "arrays":
        frame = list(contender.frames(index))[1]
        return frame if isinstance(frame, tuple) else tuple(vars(frame).values())
    wall, cpu = time.perf_counter(), time.process_time()
    frames = sum(1 for _ in contender.frames(index))
    return frames, time.perf_counter() - wall, time.process_time() - cpu


def _shots(pipe: Connection, config: RenderConfig, n: int) -> None:
    from contenders import draw_shots

    pipe.send(draw_shots(config, n))


def compare(config: RenderConfig, n: int, seconds: float) -> tuple[list[Turn], dict[str, str]]:
    """Turns of all contenders on sequences 1 .. n (0 warms up), and the versions of each."""
    ours, theirs = multiprocessing.Pipe()
    drawing = multiprocessing.get_context("spawn").Process(
        target=_shots, args=(theirs, config, n + 1))
    drawing.start()
    theirs.close()
    shots = ours.recv()
    drawing.join()
    running: dict[str, Child] = {}
    for name, title in TITLES.items():
        try:
            running[name] = Child(name, config, shots)
        except ContenderError as error:
            print(f"left out: {title.split(':')[0]}: {error}")
    versions = {name: child.versions for name, child in running.items()}
    if "Pure" in running:
        print(_agreement(running))
    turns: list[Turn] = []
    end = time.monotonic() + seconds
    for sequence in range(n + 1):
        if sequence > 3 and time.monotonic() > end:
            break
        for name in list(running)[:: 1 if sequence % 2 else -1]:
            try:
                turns.append(running[name].turn(sequence))
            except ContenderError as error:
                print(f"left out: {TITLES[name].split(':')[0]}: {error}")
                del running[name]
    for child in running.values():
        child.close()
    return [t for t in turns if t.sequence and t.contender in running], versions


def _agreement(running: dict[str, Child]) -> str:
    """How much the contenders' arrays of one frame differ from ours."""
    ours = running["Pure"].arrays(0)
    lines = ["agreement with gcbench's arrays where parts agree (median, 99 %):"]
    for name in ("Pyrender", "Bullet", "Mujoco"):
        if name not in running:
            continue
        try:
            theirs = running[name].arrays(0)
        except ContenderError as error:
            print(f"left out: {TITLES[name].split(':')[0]}: {error}")
            del running[name]
            continue
        robot = (ours[2] > 0) & (theirs[2] == ours[2])
        found = [f"parts equal {np.mean((theirs[2] > 0) == (ours[2] > 0)):.4f} of the pixels",
                 f"depth {_quantiles(np.abs(theirs[1] - ours[1])[robot] * 1e3)} mm"]
        if len(theirs) > 3:
            error = np.linalg.norm(theirs[3] - ours[3], axis=-1)[robot]
            found += [f"flow {_quantiles(error)} px",
                      f"visibility equal {np.mean(theirs[5] == ours[5]):.4f}"]
        lines.append(f"  {TITLES[name].split(':')[0]:22} {', '.join(found)}")
    return "\n".join(lines)


def _quantiles(values: np.ndarray) -> str:
    return " ".join(f"{q:.1e}" for q in np.nanquantile(values, [0.5, 0.99]))


def workers(config: RenderConfig, n: int, rounds: int) -> dict[str, tuple[float, float]]:
    """Median frames/s of `render_dataset`, and s until its first sequence, by kind of workers.

    The first is bound to one core.
    """
    cores = sorted(os.sched_getaffinity(0))
    setups: list[tuple[str, int | RayWorkers, list[int]]] = [("1 on one core", 1, cores[:1])]
    setups += [(str(count), count, cores) for count in range(1, len(cores) + 2)]
    default = plan_workers(len(cores), None)[0]
    if find_spec("ray"):
        setups.append((f"{default} of Ray", RayWorkers("local", default), cores))
    else:
        print("left out: Ray: not installed")
    found: dict[str, list[tuple[float, float]]] = {name: [] for name, _, _ in setups}
    for turn in range(rounds):
        for name, count, held in setups[:: -1 if turn % 2 else 1]:
            with tempfile.TemporaryDirectory() as folder:
                ours, theirs = multiprocessing.Pipe()
                run = multiprocessing.get_context("spawn").Process(
                    target=_generate, args=(theirs, config, n, folder, count, held))
                run.start()
                theirs.close()
                found[name].append(ours.recv())
                run.join()
    return {name: (statistics.median(rates), statistics.median(starts))
            for name, (rates, starts) in ((k, zip(*v, strict=True)) for k, v in found.items())}


def _generate(
    pipe: Connection, config: RenderConfig, n: int, folder: str, workers: int | RayWorkers,
    cores: list[int],
) -> None:
    """Frames/s while all workers run: from the times at which the files were finished."""
    count = (workers if isinstance(workers, int) else workers.count) or 1
    n = max(n, 2 * count + 2)
    os.sched_setaffinity(0, cores)
    began = time.time()
    render_dataset(config, n, Path(folder), workers=workers, progress=False)
    times = sorted(p.stat().st_mtime for p in (Path(folder) / "sequences").glob("*.zip"))
    rate = config.frames * (n - 2 * count) / (times[-1 - count] - times[count - 1])
    pipe.send((rate, times[0] - began))


def report(turns: list[Turn], versions: dict[str, str]) -> dict[str, dict[str, float]]:
    """Print both tables; returns the ratios."""
    wall = {(t.contender, t.sequence): t.wall / t.frames for t in turns}
    cpu = {(t.contender, t.sequence): t.cpu / t.frames for t in turns}
    print(f"\n{'':46} frames/s  CPU ms/frame  (medians of "
          f"{len({t.sequence for t in turns})} sequences)")
    for name, title in TITLES.items():
        own = [key for key in wall if key[0] == name]
        if own:
            print(f"{title:46} {1 / statistics.median(wall[k] for k in own):8.1f}  "
                  f"{1e3 * statistics.median(cpu[k] for k in own):12.1f}  {versions[name]}")
    print(f"\n{'ratio':66} frames/s   (range)       CPU time")
    ratios: dict[str, dict[str, float]] = {}
    for a, b in RATIOS:
        both = [s for n, s in wall if n == a and (b, s) in wall]
        if not both:
            continue
        by_wall = sorted(wall[b, s] / wall[a, s] for s in both)
        by_cpu = statistics.median(cpu[b, s] / cpu[a, s] for s in both)
        ratios[f"{a}/{b}"] = {"wall": statistics.median(by_wall), "cpu": by_cpu}
        pair = f"{TITLES[a]} / {TITLES[b].split(':')[0]}"
        print(f"{pair:66} {statistics.median(by_wall):6.2f}  "
              f"({by_wall[0]:.2f}-{by_wall[-1]:.2f})  {by_cpu:6.2f}")
    return ratios


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robot", default="ur5")
    parser.add_argument("--sequences", type=int, default=25, help="at most; one more warms up")
    parser.add_argument("--frames", type=int, default=15, help="of a sequence")
    parser.add_argument("--seconds", type=float, default=110.0, help="at most, for the contenders")
    parser.add_argument("--worker-sequences", type=int, default=12, help="of a run; 0: no runs")
    parser.add_argument("--rounds", type=int, default=3, help="of the runs with workers")
    parser.add_argument("--json", type=Path, help="write all numbers to this file")
    options = parser.parse_args()
    config = RenderConfig(robot=options.robot, frames=options.frames)
    cores = len(os.sched_getaffinity(0))
    facts = {
        "machine": f"{platform.platform()}, {_cpu()}, {cores} cores",
        "packages": ", ".join([
            f"Python {platform.python_version()}",
            *(f"{name} {version(name)}" for name in ("numpy", "opencv-python-headless"))]),
        "llvmpipe threads": os.environ.get("LP_NUM_THREADS", "Mesa's default")
        + " (each worker: one core's)",
        "load before": f"{os.getloadavg()[0]:.2f}",
    }
    print(f"{options.robot}, {config.width} x {config.height}, {config.frames} frames a sequence")
    for name, value in facts.items():
        print(f"{name}: {value}")
    turns, versions = compare(config, options.sequences, options.seconds)
    ratios = report(turns, versions)
    print("PyBullet and MuJoCo draw the robot alone; gcbench draws its backgrounds too.")
    rates: dict[str, tuple[float, float]] = {}
    if options.worker_sequences:
        rates = workers(config, options.worker_sequences, options.rounds)
        one, default = rates["1 on one core"][0], str(plan_workers(cores, None)[0])
        print("\nworkers, frames/s on disk, start not counted (ratio to one on one core), "
              "s until the first sequence")
        for name, (rate, start) in rates.items():
            print(f"  {name:14} {rate:6.1f}  ({rate / one:.2f})  {start:5.1f}"
                  f"{'  default' if name == default else ''}")
    if options.json:
        options.json.write_text(json.dumps({
            **facts, "contenders": versions, "ratios": ratios, "workers": rates,
            "turns": [asdict(t) for t in turns]}, indent=1))


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()


if __name__ == "__main__":
    sys.exit(main())
