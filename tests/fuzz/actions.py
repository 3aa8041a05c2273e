"""Each command is killed, or its disk fails, at every change of a file; then it runs again."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import get_args

from gcbench.robots.catalog import entries
from gcbench.robots.files import WheelFiles

from ..robots.files.test_download import make_wheel
from .cases import Files, read_tree, write
from .data import EVALUATE, dataset_files, results_files
from .faults import Fault, Schedule
from .sandbox import Command, Outcome, Sandbox, run

FAULTS: tuple[Fault, ...] = get_args(Fault)
Digest = dict[str, object]
_RENDER = """render --robot ../input/arm.urdf --n 2 --frames 2 --width 32 --height 24 --samples 1
    --workers 1 --out out"""
_TRAIN = """train flow --data ../input/d --out out --steps 2 --batch 1 --crop 48 48 --device cpu
    --threads 1 --minutes 0 --precision float32 --iterations 1"""
_SCORE = """score --predictions ../input/p.csv --data ../input/d --keep-unobservable
    --results results"""


@dataclass(frozen=True)
class Action:
    """A command, what it reads, and what in the end must be the same in all ways to get there."""

    argv: str
    files: Callable[[], Files]
    digest: Callable[[Sandbox], Digest]
    disk: str = "work"
    """The folder that the command fills."""
    prepare: Callable[[], None] = lambda: None
    """Called in the process before the command."""


def _bytes_below(box: Sandbox) -> Digest:
    """Every file that the command has made."""
    return {
        name: hashlib.sha256(data).hexdigest()
        for name, data in {
            **read_tree(box.work, "work"),
            **read_tree(box.root / "cache", "cache"),
        }.items()
        if isinstance(data, bytes) and not re.search(r"\.lock$|^cache/.*\.part/", name)
    }


def _without_times(box: Sandbox) -> Digest:
    """The same without the seconds and the memory of a method, and without the report of them."""
    out: Digest = {}
    for name, data in read_tree(box.work, "work").items():
        assert isinstance(data, bytes)
        if name.startswith("work/results/report/"):
            continue
        if name.endswith(".csv"):
            rows = csv.reader(io.StringIO(data.decode()))
            out[name] = [
                row
                for row in rows
                if row[14] not in ("seconds", "seconds_per_frame", "peak_memory")
            ]
        elif name.endswith(".zip"):
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                told = json.loads(archive.read("estimate.json"))
                out[name] = (told["status"], archive.read("estimate.npz"))
        else:
            out[name] = data
    return out


def _weights(box: Sandbox) -> Digest:
    return {"weights": hashlib.sha256((box.work / "out/raft.safetensors").read_bytes()).hexdigest()}


def _dataset() -> Files:
    return dict(dataset_files())


def _train_data() -> Files:
    """The dataset as one of the stream "train"."""
    files = dict(dataset_files())
    data = files["d/dataset.json"]
    assert isinstance(data, bytes)
    return {**files, "d/dataset.json": data.replace(b'"stream": "test"', b'"stream": "train"')}


def _predictions() -> Files:
    rows = [f"{s:06d},{t},{j},0.1" for s in (0, 1) for t in (1, 2) for j in (1, 2)]
    head = [
        "# method: mine",
        "# inputs: rgbd",
        "# knowledge: free",
        "# training: none",
        "sequence,frame,joint,displacement",
    ]
    return {**dataset_files(), "p.csv": "\n".join([*head, *rows]).encode()}


@cache
def _wheel() -> tuple[bytes, WheelFiles]:
    """A wheel with a robot, and its pin."""
    with tempfile.TemporaryDirectory() as folder:
        files = make_wheel(Path(folder))
        return next(Path(folder).glob("*.whl")).read_bytes(), files


def _in_the_catalogue() -> None:
    """Let the catalogue hold nothing but the robot of the wheel, and pip find it."""
    entry = entries.find_robot("ur5")
    assert isinstance(entry, entries.FetchedRobot)
    entries.CATALOG = (replace(entry, name="toy", files=_wheel()[1]),)
    os.environ["PIP_FIND_LINKS"] = str(Path("../input").resolve())


ACTIONS = {
    "render": Action(_RENDER, _dataset, _bytes_below),
    "eval": Action(" ".join(EVALUATE), _dataset, _without_times),
    "score": Action(_SCORE, _predictions, _without_times),
    "report": Action(
        "report results --no-pictures --out report",
        lambda: {**dataset_files(), **results_files()},
        _bytes_below,
    ),
    "show": Action(
        "show ../input/d --out a.html --contact-sheet b.png --gif c.gif", _dataset, _bytes_below
    ),
    "train": Action(_TRAIN, _train_data, _weights),
    "fetch": Action(
        "robots fetch toy",
        lambda: {"gcbench_toy-1.0-py3-none-any.whl": _wheel()[0]},
        _bytes_below,
        disk="cache",
        prepare=_in_the_catalogue,
    ),
} | {
    f"export {name}": Action(
        f"export ../input/d --format {name} --out out --allow-model", _dataset, _bytes_below
    )
    for name in ("kitti", "bop", "coco", "webdataset", "tapvid", "hf")
}
"""The commands that change files."""


@contextmanager
def mounted(folder: Path) -> Generator[Callable[[str], None]]:
    """Mount a file system in memory; yield a function that mounts it anew with other options.

    Raises CalledProcessError where that is not permitted.
    """
    def mount(*options: str) -> None:
        words = ["mount", "-t", "tmpfs", "-o", *options, "tmpfs", str(folder)]
        subprocess.run(words, check=True, capture_output=True)

    mount("size=64m")
    try:
        yield lambda option: mount(f"remount,{option}")
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def check_disk(name: str, box: Sandbox) -> Iterator[str]:
    """Yield what goes wrong on a real disk that is full or read-only, and in the run after it."""
    action = ACTIONS[name]
    command = Command(
        tuple(action.argv.split()), (0, 2), quiet=False, fetches=True, prepare=action.prepare
    )
    _prepared(action, box, command)
    expected = action.digest(box)
    for free in (1, 2, 8, 32, None):  # blocks; None: read-only
        box.reset()
        with mounted(box.root / action.disk) as mount:
            write(action.files(), box)
            disk = os.statvfs(box.root / action.disk)
            used = disk.f_blocks - disk.f_bfree
            mount("ro" if free is None else f"size={(used + free) * disk.f_frsize}")
            broken = run(command, box)
            mount("rw,size=64m")
            wrong = [p for p in broken.problems if not re.match(r"left .*\.part", p)]
            wrong += ["succeeds"] * (not broken.code and free in (1, None))
            wrong += _run_again(action, box, command, broken, expected)
        where = "a read-only disk" if free is None else f"a disk with {free} blocks left"
        yield from (f"{name} on {where}: {line}" for line in wrong)


def check_action(name: str, box: Sandbox, faults: tuple[Fault, ...], at: int = 0) -> Iterator[str]:
    """Yield what goes wrong when faults happen at each change, or only at change `at`."""
    action = ACTIONS[name]
    command = Command(
        tuple(action.argv.split()), (0,), quiet=False, fetches=True, prepare=action.prepare
    )
    first = _prepared(action, box, command)
    if first.problems or first.code:
        yield f"{name}: {'; '.join(first.problems)}: {first.stderr[-300:]}"
        return
    expected = action.digest(box)
    for fault in faults:
        where = at or 1
        while True:
            said, changes = _with_fault(action, box, command, fault, where, expected)
            for line in said:
                yield (
                    f"python -m tests.fuzz --faults '{name}' --fault {fault} --at {where}  # {line}"
                )
            if at or changes < where or fault == "read-only":
                break
            where += 1


def _prepared(action: Action, box: Sandbox, command: Command) -> Outcome:
    box.reset()
    write(action.files(), box)
    return run(command, box)


def _with_fault(
    action: Action, box: Sandbox, command: Command, fault: Fault, at: int, expected: Digest
) -> tuple[list[str], int]:
    """What goes wrong with a fault and in the run after it, and the number of changes."""
    folders = tuple((box.root / name).resolve() for name in ("work", "cache"))
    schedule = Schedule(fault, at, folders)

    def prepare() -> None:
        action.prepare()
        schedule.install()

    codes = (0, 2) if fault != "kill" else (0, -9)
    broken = _prepared(action, box, replace(command, codes=codes, prepare=prepare))
    expectable = ("was killed by SIGKILL",) if fault == "kill" else ()
    left = {"kill": "left ", "full": r"left .*\.part", "read-only": "left "}[fault]
    wrong = [
        p
        for p in broken.problems
        if p not in expectable and not (re.match(left, p) and not p.startswith("left a process"))
    ]
    return wrong + _run_again(action, box, command, broken, expected), schedule.count


def _run_again(
    action: Action, box: Sandbox, command: Command, broken: Outcome, expected: Digest
) -> list[str]:
    """What goes wrong when a command continues."""
    shutil.rmtree(box.root / "tmp")
    (box.root / "tmp").mkdir()
    # a run that needed no more changes is complete: `export` would refuse to run again
    again = run(replace(command, codes=(0,)), box) if broken.code else replace(broken, problems=())
    wrong = [f"afterwards: {problem}" for problem in again.problems]
    if not again.code and (found := action.digest(box)) != expected:
        names = {k for k in {*found, *expected} if found.get(k) != expected.get(k)}
        wrong.append(f"afterwards: other content: {', '.join(sorted(names)[:5])}")
    return wrong
