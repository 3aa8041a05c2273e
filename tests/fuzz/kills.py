"""Kills at random moments: workers, nodes, drivers, and the network of an S3 server.

A command is started again until it succeeds, again and again until so many kills have happened.
What a reader sees meanwhile, and everything in the end, must be what an undisturbed run makes. A
command must not be without progress for a minute, and must not print a traceback.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import gcbench as gb
from gcbench.renderer.runtime.object_store import list_folder, read_file, upload_file

from ..renderer.generate.test_generate import content, is_alone, until
from ..support.processes import children_of, command_of
from ..support.ray_nodes import Nodes, start_nodes
from ..support.s3_server import BUCKET, RemoteServer, server_variables

RENDER = ("render", "--robot", "owi535", "--frames", "2", "--width", "64", "--height", "48",
          "--keep-unobservable", "--n")
SILENCE = 60.0
"""s that a command may be without progress."""
_LARGEST = 2**26  # bytes of a file
_TIMES = ("seconds", "seconds_per_frame", "peak_memory")
_READ = """
import hashlib, sys
import numpy as np
import gcbench as gb
digest = hashlib.sha256()
try:
    for sequence in gb.open_dataset(sys.argv[1]):
        for name in ("rgb", "depth", "part", "flow", "flow_backward", "visibility"):
            digest.update(np.ascontiguousarray(getattr(sequence, name)[:]))
except gb.GcbenchError as error:
    sys.exit(f"gcbench: {error}")
print(digest.hexdigest())
"""


@dataclass
class Record:
    """What was done to the commands of a kind, and what they did wrong."""

    kind: str
    kills: int = 0
    commands: int = 0
    results: int = 0
    """Complete ones, each compared with that of an undisturbed run."""
    longest: float = 0.0
    """s without progress: a kill, the return of a server, another sequence, the end."""
    problems: list[str] = field(default_factory=list[str])


class Target:
    """A command and its result, and something that can be killed."""

    share = 0.3
    """Mean time between kills, as a share of the time that an undisturbed command takes."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng

    def renew(self) -> None:
        """Begin another result."""

    def start(self, log: Path) -> subprocess.Popen[bytes]:
        """Start the command, in a process group of its own."""
        raise NotImplementedError

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        """Kill something; return what it was, or nothing if there is nothing to kill yet."""
        raise NotImplementedError

    def mend(self, over: bool) -> bool:
        """Bring back what was stopped, if it is time to; return whether it did. `over`: now."""
        return False

    def look(self) -> tuple[int, list[str]]:
        """Return how many sequences can be seen, and what is wrong with them."""
        return 0, []

    def leftovers(self, run: subprocess.Popen[bytes]) -> str:
        """Return what a killed command has left running."""
        return "" if until(partial(is_alone, run.pid)) else "its processes go on"

    def differences(self) -> list[str]:
        """Return what differs in the end from the result of an undisturbed run."""
        raise NotImplementedError


def attack(target: Target, record: Record, count: int, seconds: float, log: Path) -> None:
    """Kill `count` times; an undisturbed command takes so many seconds."""
    while record.kills < count and not record.problems:
        target.renew()
        code = 1
        while code and not record.problems:
            code = _disturb(target, record, count, 2 * target.share * seconds, log)
        if not record.problems:
            record.results += 1
            record.problems += target.differences()


def _disturb(target: Target, record: Record, count: int, span: float, log: Path) -> int:
    """Run the command once, kill meanwhile, and return its exit code."""
    run = target.start(log)
    record.commands += 1
    struck: list[str] = []
    last = time.monotonic()
    moment, seen = last + target.rng.uniform(0, span), 0
    while run.poll() is None:
        now = time.monotonic()
        if target.mend(False):
            last = now
        elif record.kills < count and now >= moment and (what := target.strike(run)):
            record.kills += 1
            struck.append(what)
            last = time.monotonic()
            moment = last + target.rng.uniform(0, span)
        there, wrong = target.look()
        record.problems += wrong
        if there != seen:
            seen, last = there, now
        record.longest = max(record.longest, now - last)
        if now - last > SILENCE:
            os.killpg(run.pid, signal.SIGABRT)  # each process prints where it is
            run.wait()
            said = log.with_suffix(".err").read_text(errors="replace")
            record.problems.append(f"no progress for {SILENCE:g} s ({_told(struck)}): {said}")
        time.sleep(0.05)
    target.mend(True)
    code = run.wait()
    if record.problems:
        return code
    record.problems += [f"{problem} ({_told(struck)})" for problem in (
        *target.look()[1], *_complaints(code, log, struck), target.leftovers(run)) if problem]
    return code


def _told(struck: list[str]) -> str:
    return f"after {', '.join(struck)}" if struck else "undisturbed"


def _complaints(code: int, log: Path, struck: list[str]) -> Generator[str]:
    """What is wrong with the end of a command."""
    lines = log.with_suffix(".err").read_text(errors="replace").strip().splitlines()
    last = lines[-1][:300] if lines else ""
    if any(line.startswith("Traceback") for line in lines):
        yield f"traceback: {last}"
    elif (code and not struck) or code not in (0, 1, 2, -signal.SIGKILL):
        yield f"exit code {code}: {last}"
    elif code > 0 and not last.startswith("gcbench: "):
        yield f"exit code {code} without a message: {last}"


def _launch(argv: tuple[str, ...], log: Path, **variables: str) -> subprocess.Popen[bytes]:
    with log.with_suffix(".out").open("wb") as out, log.with_suffix(".err").open("wb") as err:
        return subprocess.Popen(
            [sys.executable, *argv], stdout=out, stderr=err, stdin=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, "PYTHONFAULTHANDLER": "1", **variables})


# -- commands that write ----------------------------------------------------------------------


class Render(Target):
    """`gcbench render` into a folder or an address; its worker processes are killed."""

    def __init__(self, rng: random.Random, clean: Path, out: Path, *options: str) -> None:
        super().__init__(rng)
        self._clean, self._above, self._options = content(clean), out, options
        self._out, self._round = out, 0
        self._checked: set[str] = set()
        self.variables: dict[str, str] = {}

    def renew(self) -> None:
        self._round += 1
        self._out, self._checked = self._above / str(self._round), set()

    def start(self, log: Path) -> subprocess.Popen[bytes]:
        count = str(len(self._clean) - 1)
        return _launch(("-m", "gcbench", *RENDER, count, "--out", _address(self._out),
                        *self._options), log, **self.variables)

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        workers = [p for p in children_of(run.pid) if b"spawn_main" in command_of(p)]
        return self.kill_one("a worker", workers)

    def kill_one(self, name: str, processes: list[int]) -> str:
        """Kill one of some processes."""
        if not processes:
            return ""
        with suppress(ProcessLookupError):
            os.kill(self.rng.choice(processes), signal.SIGKILL)
        return name

    def look(self) -> tuple[int, list[str]]:
        files = {p.name: p for p in list_folder(self._out / "sequences") if p.suffix == ".zip"}
        new, wrong = files.keys() - self._checked, list[str]()
        for name in new:
            data = read_file(files[name], _LARGEST)
            if hashlib.sha256(data).hexdigest() != self._clean.get(f"sequences/{name}"):
                wrong.append(f"a reader sees another {name} of {len(data)} bytes")
        if new:
            try:
                gb.open_dataset(self._out)
            except gb.GcbenchError as error:
                wrong.append(f"a reader is refused: {error}")
        self._checked |= files.keys()
        return len(files), wrong

    def differences(self) -> list[str]:
        found = self.everything()
        return [f"{name} in the end: {'other' if name in found else 'no'} content"
                for name in sorted({*found, *self._clean})
                if found.get(name) != self._clean.get(name)]

    def everything(self) -> dict[str, str]:
        """Digests of all files of the result."""
        return content(self._out)


class Driver(Render):
    """The command is killed, alone or with all of its processes."""

    share = 0.5

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        alone = self.rng.random() < 0.5
        with suppress(ProcessLookupError):
            (os.kill if alone else os.killpg)(run.pid, signal.SIGKILL)
        return "the command" if alone else "the command and its processes"


class OnRay(Render):
    """`gcbench render --executor ray`; its actors are killed."""

    def __init__(self, rng: random.Random, clean: Path, out: Path, nodes: Nodes) -> None:
        super().__init__(rng, clean, out, "--executor", "ray", "--address", nodes.address)
        self.nodes = nodes

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        return self.kill_one("an actor", self.nodes.actors())

    def leftovers(self, run: subprocess.Popen[bytes]) -> str:
        return "" if until(lambda: not self.nodes.actors(), SILENCE) else "its actors go on"


class Node(OnRay):
    """A node is killed, with all of its processes or only the main one, and another one joins."""

    share = 0.5

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        if not self.nodes.actors():
            return ""
        whole = self.rng.random() < 0.5
        self.nodes.kill(self.rng.randrange(2), whole)
        self.nodes.add()
        return "a node" if whole else "the main process of a node"


class RayDriver(OnRay):
    """The command is killed."""

    share = 0.5

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        return self.kill_one("the command", [run.pid])


# -- an S3 server -----------------------------------------------------------------------------


class Network:
    """The way to a server, which breaks or falls silent for a while, or until a command ends."""

    def __init__(self, server: RemoteServer, rng: random.Random) -> None:
        self._server, self._rng = server, rng
        self._back: Callable[[], None] | None = None
        self._until = 0.0

    @property
    def is_up(self) -> bool:
        return self._back is None

    def stop(self) -> str:
        """Stop the server or its network."""
        if self._back:
            return ""
        seconds = self._rng.choice([*self._rng.sample(range(1, 9), 3), SILENCE + 1])
        freezes = self._rng.random() < 0.5
        (self._server.freeze if freezes else self._server.disconnect)()
        self._back = self._server.thaw if freezes else self._server.connect
        self._until = time.monotonic() + seconds
        what = "a silent server" if freezes else "a broken network"
        return what + (f" for {seconds} s" if seconds < SILENCE else " until it ended")

    def mend(self, over: bool) -> bool:
        """Bring it back if its time is over, or the command is."""
        if self._back is None or (not over and time.monotonic() < self._until):
            return False
        self._back()
        self._back = None
        return True


class Stored(Render):
    """`gcbench render` to an address; the server or its network stops."""

    share = 0.4

    def __init__(
        self, rng: random.Random, clean: Path, cache: Path, server: RemoteServer
    ) -> None:
        super().__init__(rng, clean, Path(f"s3://{BUCKET}/out"), "--workers", "2")
        self._network = Network(server, rng)
        self.variables = server_variables(server.relay_port, cache)

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        return self._network.stop()

    def mend(self, over: bool) -> bool:
        return self._network.mend(over)

    def look(self) -> tuple[int, list[str]]:
        return super().look() if self._network.is_up else (len(self._checked), [])

    def everything(self) -> dict[str, str]:
        import fsspec

        files, above = fsspec.filesystem("s3", skip_instance_cache=True), _address(self._out)
        return {key.partition(above.partition("//")[2] + "/")[2]:
                hashlib.sha256(files.cat_file(key)).hexdigest() for key in files.find(above)}


class Reading(Target):
    """Commands and a program that read a stored dataset, in turn."""

    share = 0.5

    def __init__(self, rng: random.Random, clean: Path, cache: Path, server: RemoteServer) -> None:
        super().__init__(rng)
        self._network, self._results, self._log = Network(server, rng), cache / "results", cache
        place = Path(f"s3://{BUCKET}/clean")
        for path in clean.rglob("*.*"):
            if path.is_file() and path.name != ".lock":
                upload_file(path, place / path.relative_to(clean))
        self._variables = server_variables(server.relay_port, cache) | {
            "GCBENCH_OBJECT_CACHE": "0"}
        self._commands = [
            ("-m", "gcbench", "verify", _address(place), "--quiet"),
            ("-m", "gcbench", "eval", "--method", "hold-still", "--data", _address(place),
             "--inputs", "rgbd", "--keep-unobservable", "--quiet"),
            ("-c", _READ, _address(place))]
        self._round = -1
        self._expected = [self._undisturbed(cache / "log") for _ in self._commands]

    def _undisturbed(self, log: Path) -> Any:
        self.renew()
        code = self.start(log).wait()
        assert code == 0, log.with_suffix(".err").read_text()
        return self._found()

    def renew(self) -> None:
        self._round += 1

    def start(self, log: Path) -> subprocess.Popen[bytes]:
        self._log = log
        argv = self._commands[self._round % len(self._commands)]
        more = ("--results", str(self._results / str(self._round))) if "eval" in argv else ()
        return _launch((*argv, *more), log, **self._variables)

    def strike(self, run: subprocess.Popen[bytes]) -> str:
        return self._network.stop()

    def mend(self, over: bool) -> bool:
        return self._network.mend(over)

    def _found(self) -> Any:
        """What the command has printed, and of an evaluation its scores."""
        scores = sorted((self._results / str(self._round)).rglob("scores.csv"))
        rows = [row for path in scores for row in csv.reader(io.StringIO(path.read_text()))
                if not {*_TIMES} & {*row}]
        return rows or self._log.with_suffix(".out").read_text()

    def differences(self) -> list[str]:
        number = self._round % len(self._commands)
        return [] if self._found() == self._expected[number] else [
            f"{' '.join(self._commands[number][-1:])}: another result: {str(self._found())[-300:]}"]


# -- the kinds --------------------------------------------------------------------------------


def _address(path: Path) -> str:
    return str(path).replace("s3:/", "s3://", 1)


@contextmanager
def _on_ray(kind: type[OnRay], rng: random.Random, clean: Path, out: Path) -> Generator[Target]:
    with start_nodes(3) as nodes:
        yield kind(rng, clean, out, nodes)


@contextmanager
def _on_server(
    kind: type[Stored | Reading], rng: random.Random, clean: Path, out: Path
) -> Generator[Target]:
    import fsspec

    server = RemoteServer()
    out.mkdir()
    before = dict(os.environ)
    os.environ.update(server_variables(server.port, out / "own"), GCBENCH_OBJECT_CACHE="0")
    try:
        fsspec.filesystem("s3", skip_instance_cache=True).mkdir(BUCKET)
        yield kind(rng, clean, out, server)
    finally:
        os.environ.clear()
        os.environ.update(before)
        server.close()


@contextmanager
def _here(kind: type[Render], rng: random.Random, clean: Path, out: Path) -> Generator[Target]:
    yield kind(rng, clean, out, "--workers", "2")


KILLS: dict[str, Callable[[random.Random, Path, Path], Any]] = {
    "worker": partial(_here, Render),
    "driver": partial(_here, Driver),
    "actor": partial(_on_ray, OnRay),
    "node": partial(_on_ray, Node),
    "ray-driver": partial(_on_ray, RayDriver),
    "server": partial(_on_server, Stored),
    "reader": partial(_on_server, Reading),
}
"""What is killed: worker processes; the command; actors, nodes and the command on a Ray cluster of
this machine; the network of an S3 server while a command writes, or while commands read."""


def check_kills(kinds: list[str], count: int, seed: int, sequences: int) -> Generator[Record]:
    """Yield what `count` kills of each kind did to datasets of so many sequences."""
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        folder = Path(name)
        clean, log = folder / "clean", folder / "log"
        started = time.monotonic()
        made = _launch(("-m", "gcbench", *RENDER, str(sequences), "--workers", "2", "--out",
                        str(clean)), log)
        assert made.wait() == 0, log.with_suffix(".err").read_text()
        seconds = time.monotonic() - started
        for sequence in gb.open_dataset(clean):
            assert all(frame.rgb.any() for frame in sequence)
        for kind in kinds:
            record = Record(kind)
            rng = random.Random(f"{seed} {kind}")
            with KILLS[kind](rng, clean, folder / kind) as target:
                attack(target, record, count, seconds, log)
            yield record
