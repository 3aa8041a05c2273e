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
import subprocess
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
from gcbench.renderer.generate import stream
from gcbench.renderer.generate.driver import plan_workers, render_dataset
from gcbench.renderer.scene.config import RenderConfig

TITLES = {
    "Pure": "in memory: all arrays of given scenes",
    "Shipped": "in memory: the same, with the sampling of motion and camera",
    "Streamed": "streamed by `gb.stream`",
    "Encoded": "written",
    "one": "written: 1 worker on one core",
    "local": "written: {} workers",
    "ray": "written: {} workers of Ray",
    "shards": "written: {} shards of 1 worker each",
    "stream": "streamed: {} workers of a `DataLoader`",
    "Pyrender": "pyrender script: all arrays of given scenes, not written",
    "Images": "RGB, depth and parts alone of given scenes",
    "Bullet": "PyBullet's TinyRenderer: RGB, depth, parts of the robot alone",
    "Mujoco": "MuJoCo: RGB, depth, parts of the robot alone",
}
"""Rows of the table: contenders, which take turns, and runs of several processes."""
RUNS = ("one", "local", "ray", "shards", "stream")
RATIOS = (("Images", "Bullet"), ("Images", "Mujoco"), ("local", "one"), ("ray", "local"),
          ("shards", "local"))


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
    for name in [name for name in TITLES if name not in RUNS]:
        try:
            running[name] = Child(name, config, shots)
        except ContenderError as error:
            print(f"left out: {name}: {error}")
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
                print(f"left out: {name}: {error}")
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
            print(f"left out: {name}: {error}")
            del running[name]
            continue
        robot = (ours[2] > 0) & (theirs[2] == ours[2])
        found = [f"parts equal {np.mean((theirs[2] > 0) == (ours[2] > 0)):.4f} of the pixels",
                 f"depth {_quantiles(np.abs(theirs[1] - ours[1])[robot] * 1e3)} mm"]
        if len(theirs) > 3:
            error = np.linalg.norm(theirs[3] - ours[3], axis=-1)[robot]
            found += [f"flow {_quantiles(error)} px",
                      f"visibility equal {np.mean(theirs[5] == ours[5]):.4f}"]
        lines.append(f"  {name:22} {', '.join(found)}")
    return "\n".join(lines)


def _quantiles(values: np.ndarray) -> str:
    return " ".join(f"{q:.1e}" for q in np.nanquantile(values, [0.5, 0.99]))


def run_all(config: RenderConfig, n: int, rounds: int, count: int) -> dict[str, list[float]]:
    """Frames/s of `count` processes of each kind, and of one that is bound to a core, by round.

    Starts do not count: the rate is that of the time in which all processes work.
    """
    missing = {"ray": "ray", "stream": "torch"}
    rates: dict[str, list[float]] = {}
    for kind in RUNS:
        if kind in missing and not find_spec(missing[kind]):
            print(f"left out: {kind}: not installed ({missing[kind]})")
        else:
            rates[kind] = []
    for turn in range(rounds):
        for kind in list(rates)[:: -1 if turn % 2 else 1]:
            ours, theirs = multiprocessing.Pipe()
            run = multiprocessing.get_context("spawn").Process(
                target=_time_run, args=(theirs, config, n, kind, count))
            run.start()
            theirs.close()
            try:
                rates[kind].append(ours.recv())
            except EOFError:
                print(f"left out: {kind}: a run failed")
                del rates[kind]
            run.join()
    return rates


def _time_run(pipe: Connection, config: RenderConfig, n: int, kind: str, count: int) -> None:
    """Send the rate of one run of n sequences; of half as many on one core."""
    cores = sorted(os.sched_getaffinity(0))
    if kind == "one":
        count, n = 1, n // 2
        os.sched_setaffinity(0, cores[:1])
    n = max(n, 2 * count + 2)
    with tempfile.TemporaryDirectory() as folder:
        if kind == "stream":
            times = _stream(config, n, count)
        else:
            if kind == "shards":
                _run_shards(config, n, folder, [cores[k::count] for k in range(count)])
            else:
                render_dataset(config, n, folder, progress=False,
                               workers=RayWorkers("local", count) if kind == "ray" else count)
            files = (Path(folder) / "sequences").glob("*.zip")
            times = sorted(path.stat().st_mtime for path in files)
    pipe.send(config.frames * (n - 2 * count) / (times[-1 - count] - times[count - 1]))


def _stream(config: RenderConfig, n: int, count: int) -> list[float]:
    """The times at which sequences come from the workers of a DataLoader."""
    from torch.utils.data import DataLoader

    sequences = stream(config, count=n, pairs=False)
    loader = DataLoader(
        sequences, batch_size=None, num_workers=count, multiprocessing_context="spawn")
    return [time.time() for _ in loader]


def _run_shards(config: RenderConfig, n: int, folder: str, cores: list[list[int]]) -> None:
    """Render with a command for each shard, which has its share of the cores."""
    command = [sys.executable, "-m", "gcbench", "render", "--robot", config.robot, "--frames",
               str(config.frames), "--n", str(n), "--workers", "1", "--out", folder, "--quiet"]
    shards: list[subprocess.Popen[bytes]] = []
    for k, own in enumerate(cores):
        shard = [*command, "--shard", f"{k}/{len(cores)}"]
        shards.append(subprocess.Popen(shard, stdout=subprocess.DEVNULL))
        os.sched_setaffinity(shards[-1].pid, own or cores[0])
    assert not any(shard.wait() for shard in shards)


def compare_times(
    turns: list[Turn], rates: dict[str, list[float]], of: str, to: str
) -> list[float] | None:
    """How many times faster `of` is than `to`, sorted: in each turn, or each round.

    A run is compared with the median of a contender. None if one of both was left out.
    """
    times: dict[str, dict[int, float]] = {of: {}, to: {}}
    for turn in turns:
        if turn.contender in times:
            times[turn.contender][turn.sequence] = turn.wall / turn.frames
    for name in times:
        times[name] |= {k: 1 / rate for k, rate in enumerate(rates.get(name, []))}
    if of in rates and to not in rates and times[to]:
        times[to] = dict.fromkeys(times[of], statistics.median(times[to].values()))
    both = times[of].keys() & times[to].keys()
    return sorted(times[to][k] / times[of][k] for k in both) or None


def report(
    turns: list[Turn], rates: dict[str, list[float]], count: int
) -> dict[str, list[float]]:
    """Print the table of `docs/benchmark/performance.md`, and ratios; return these."""
    ratios: dict[str, list[float]] = {}

    def ratio(of: str, to: str) -> str:
        if (found := compare_times(turns, rates, of, to)) is None:
            return ""
        ratios[f"{of}/{to}"] = found
        return f"{statistics.median(found):.2f} ({found[0]:.2f} to {found[-1]:.2f})"

    print(f"\nmedians of {len({t.sequence for t in turns})} sequences, and of "
          f"{max(map(len, rates.values()), default=0)} runs\n")
    print("| | frames/s | times the script (range) | CPU time a frame |\n|---|---|---|---|")
    for name, title in TITLES.items():
        own = [t for t in turns if t.contender == name]
        found = rates.get(name) or [t.frames / t.wall for t in own]
        cpu = f"{1e3 * statistics.median(t.cpu / t.frames for t in own):.0f} ms" if own else ""
        if found:
            print(f"| {title.format(count)} | {statistics.median(found):.1f} | "
                  f"{ratio(name, 'Pyrender')} | {cpu} |")
    print("\nfrom turns and runs beside each other (range):\n")
    for of, to in RATIOS:
        if said := ratio(of, to):
            print(f"* {TITLES[of].format(count)}: {said} times {TITLES[to].format(count)}")
    return ratios


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--robot", default="ur5")
    parser.add_argument("--sequences", type=int, default=20, help="at most; one more warms up")
    parser.add_argument("--frames", type=int, default=15, help="of a sequence")
    parser.add_argument("--seconds", type=float, default=85.0, help="at most, for the contenders")
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
    count = plan_workers(cores, None)[0]
    turns, versions = compare(config, options.sequences, options.seconds)
    for name, said in versions.items():
        print(f"{name}: {said}")
    rates = run_all(config, options.worker_sequences, options.rounds, count) \
        if options.worker_sequences else {}
    ratios = report(turns, rates, count)
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
