"""Runs a command line in a forked process under limits, and tells what it did that it must not.

The parent has imported everything, so that a run costs milliseconds, and each run begins with a
fresh state. The worker processes of a command are forked too, so that limits and the audit hook
hold in them. The parent never renders: OpenGL does not survive a fork.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.context import ForkContext
from pathlib import Path
from typing import Any

MEMORY = 2 * 2**30
"""Bytes that a command may take."""
FILE = 2**28
"""Bytes of a file that a command may write; the folders may lie in memory."""
CPU_SECONDS = 20
WALL_SECONDS = 120.0
"""A busy machine must not look like a hang; nothing that a command waits for takes so long."""
_GRACE = 3.0  # s, for helpers of a process that has ended
_FINDINGS = 200  # number of the descriptor for what the audit hook finds
_PR_SET_CHILD_SUBREAPER = 36


@dataclass(frozen=True)
class Command:
    """A command line of `gcbench`, and the exit codes that it may have."""

    argv: tuple[str, ...]
    codes: tuple[int, ...] = (0, 2)
    quiet: bool = True
    """Whether stderr holds nothing but `gcbench: ` lines; methods and formats have more to say."""
    fetches: bool = False
    """Whether it may start pip, because the user names a robot of the catalogue."""
    foreign: bool = False
    """Whether it runs a method of the user, which may start programs and print tracebacks."""
    prepare: Callable[[], None] | None = None
    """Called in the process before the command."""


@dataclass(frozen=True)
class Outcome:
    """What a command did."""

    code: int
    """Exit code; -N after signal N."""
    stdout: str
    stderr: str
    seconds: float
    memory: float
    """Peak, MiB."""
    problems: tuple[str, ...] = ()
    """What it must not do, a line each."""


@dataclass(frozen=True)
class Sandbox:
    """The folders of a run. `input` may be read only; `secret` may not be touched."""

    root: Path
    readable: tuple[Path, ...] = ()
    """Further folders that may be read."""
    folders: tuple[str, ...] = field(default=("input", "work", "tmp", "home", "cache"))

    @classmethod
    @contextmanager
    def temporary(cls) -> Iterator[Sandbox]:
        """A sandbox for the time of a block; in memory where Linux has such a file system."""
        memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        with tempfile.TemporaryDirectory(prefix="fuzz-", dir=memory) as folder:
            yield cls(Path(folder).resolve() / "box")

    def reset(self) -> None:
        """Empty all folders."""
        shutil.rmtree(self.root, ignore_errors=True)
        for name in (*self.folders, "secret", "log"):
            (self.root / name).mkdir(parents=True)

    @property
    def input(self) -> Path:
        """What the command reads."""
        return self.root / "input"

    @property
    def work(self) -> Path:
        """The current folder of the command."""
        return self.root / "work"


def adopt_orphans() -> None:
    """Make orphaned grandchildren children of this process (Linux)."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def run(command: Command, box: Sandbox) -> Outcome:
    """Run a command in a forked process and check what it did."""
    log = box.root / "log"
    before = children()
    started = time.monotonic()
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if not pid:
        _child(command, box, log)
    status, usage, late = _wait(pid, started)
    seconds = time.monotonic() - started
    left = [f"no end within {WALL_SECONDS:g} s"] * late + leftover_processes(before)
    ended = os.waitstatus_to_exitcode(status), seconds, usage.ru_maxrss / 1024
    return judge(command, box, ended, left)


def judge(
    command: Command, box: Sandbox, ended: tuple[int, float, float], problems: list[str]
) -> Outcome:
    """Check what a command did that ended with (code, seconds, MiB) and has `problems`."""
    code, seconds, memory = ended
    log = box.root / "log"
    out, err = ((log / name).read_text(errors="replace") for name in ("stdout", "stderr"))
    if memory > MEMORY / 2**20:
        problems.append(f"took {memory:.0f} MiB")
    problems += sorted(set((log / "audit").read_text(errors="replace").splitlines()))
    problems += _text_problems(command, code, out, err)
    problems += _leftover_files(box)
    return Outcome(code, out, err, seconds, memory, tuple(problems))


def _wait(pid: int, started: float) -> tuple[int, Any, bool]:
    """Wait status, usage, and whether the process had to be killed."""
    pause, late = 0.001, False
    while True:
        found, status, usage = os.wait4(pid, os.WNOHANG)
        if found:
            return status, usage, late
        if not late and time.monotonic() - started > WALL_SECONDS:
            late = True
            with suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
        time.sleep(pause)
        pause = min(2 * pause, 0.02)


def children() -> set[int]:
    task = Path(f"/proc/self/task/{os.getpid()}/children")
    return {int(pid) for pid in task.read_text().split()}


def leftover_processes(before: set[int]) -> list[str]:
    """What a command has started and left running; it is killed."""
    end = time.monotonic() + _GRACE
    while True:
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        left = children() - before
        if not left:
            return []
        if time.monotonic() > end:
            break
        time.sleep(0.005)
    said: list[str] = []
    for pid in left:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:80]
        said.append(f"left a process: {words}")
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    return said


# -- in the process ---------------------------------------------------------------------------


def _child(command: Command, box: Sandbox, log: Path) -> None:
    """Run the command and exit; never returns."""
    code = 70
    try:
        os.setsid()
        enter(box)
        limit_memory()
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 2))
        _fork_workers()
        if command.prepare is not None:
            command.prepare()
        auditor = Auditor(box)
        sys.addaudithook(auditor)
        auditor.command = command
        code = call(command)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def enter(box: Sandbox) -> None:
    """Let this process be in the sandbox: its folder, its environment, its output in files."""
    for number, name in ((1, "stdout"), (2, "stderr"), (_FINDINGS, "audit")):
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND
        file = os.open(box.root / "log" / name, flags, 0o600)
        os.dup2(file, number)
        os.close(file)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.set_inheritable(_FINDINGS, True)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", errors="backslashreplace", closefd=False)
    os.chdir(box.work)
    _set_environment(box)


def call(command: Command) -> int:
    """Run a command in this process; return its exit code."""
    from gcbench.__main__ import main

    code = 70
    try:
        code = main(list(command.argv))
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    except BaseException:
        traceback.print_exc()
    with suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    return code


def _set_environment(box: Sandbox) -> None:
    shaders = os.environ.get("XDG_CACHE_HOME", str(Path("~/.cache").expanduser()))
    for name in [n for n in os.environ if n.startswith(("PARTNET", "SAPIEN", "ROS_", "XDG_"))]:
        del os.environ[name]
    os.environ.setdefault("MESA_SHADER_CACHE_DIR", shaders)  # compiled once, not per command
    os.environ |= {
        "HOME": str(box.root / "home"), "TMPDIR": str(box.root / "tmp"),
        "GCBENCH_CACHE": str(box.root / "cache"), "PIP_NO_INDEX": "1",
        "PIP_CONFIG_FILE": os.devnull,
        "TORCHINDUCTOR_CACHE_DIR": str(box.root / "cache"),
    }  # fmt: skip
    tempfile.tempdir = None
    sys.dont_write_bytecode = True


def limit_memory() -> None:
    """Limit the memory of this process beyond what it has, and its files."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE, FILE))


class Forks(ForkContext):
    """Forks where the package asks for fresh processes; a fork drops its parent's pipe ends."""

    def __init__(self) -> None:
        self._mine: list[Any] = []

    def Pipe(self, duplex: bool = True) -> Any:  # noqa: N802
        mine, its = super().Pipe(duplex)
        self._mine.append(mine)
        return mine, its

    def Process(self, target: Any, args: Any, daemon: bool) -> Any:  # noqa: N802
        def run(*given: Any) -> None:
            for connection in self._mine:
                connection.close()
            target(*given)

        return multiprocessing.get_context("fork").Process(target=run, args=args, daemon=daemon)


def _fork_workers() -> None:
    forks, get_context = Forks(), multiprocessing.get_context
    multiprocessing.get_context = lambda method=None: (  # type: ignore[assignment]
        forks if method == "spawn" else get_context(method)
    )


class Auditor:
    """Audit hook: writes a line for each file that must not be opened or changed, and the like.

    Libraries in C that open files by themselves are not seen; the package gives them bytes.
    """

    command: Command | None = None
    """What runs; None while none does."""

    def __init__(self, box: Sandbox) -> None:
        import gcbench

        package = Path(str(gcbench.__file__)).resolve().parent
        numba = os.environ.get("NUMBA_CACHE_DIR", "")
        mine = [box.root / name for name in box.folders]
        system = [
            sys.prefix,
            sys.base_prefix,
            "/usr",
            "/lib",
            "/proc",
            "/sys",
            "/dev/null",
            "/dev/urandom",
            "/dev/zero",
            "/etc/ld.so.cache",
            "/etc/os-release",
            "/etc/mime.types",
        ]
        self.reads = _prefixes([*mine, *box.readable, *system, package, *filter(None, [numba])])
        self.package, self.box = f"{package}/", box.root
        self.writes = _prefixes([*mine[1:], "/dev/null", "/dev/zero", *filter(None, [numba])])
        self.busy = False

    def __call__(self, event: str, args: tuple[Any, ...]) -> None:
        command = self.command
        if command is None or self.busy or event not in _EVENTS:
            return
        self.busy = True
        try:
            for line in self._violations(event, args, command):
                os.write(_FINDINGS, (ascii(line)[1:-1] + "\n").encode())
        finally:
            self.busy = False

    def _violations(
        self, event: str, args: tuple[Any, ...], command: Command
    ) -> Iterator[str]:
        if event == "open":
            path, _, flags = args
            writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
            yield from self._path("writes" if writes else "reads", path)
        elif event in ("os.rename", "os.link"):
            yield from self._path("changes", args[0], args[2])
            yield from self._path("changes", args[1], args[3])
        elif event == "os.symlink":
            yield from self._path("changes", args[1], args[2])
        elif event in _CHANGES:
            folder = -1 if event == "os.truncate" else args[-1]
            yield from self._path("changes", args[0], folder)
        elif event.startswith("socket"):
            yield f"uses the network: {event} {args[1:]}"
        else:
            words = args[1] if event == "subprocess.Popen" else args[0]
            programs = ["uname"]  # platform.processor()
            programs += ["pip"] * command.fetches + [""] * command.foreign
            if not any(program in str(words) for program in programs):
                yield f"starts a program: {words}"

    def _path(self, what: str, path: Any, folder: Any = -1) -> Iterator[str]:
        if isinstance(path, int):
            return
        name = os.fsdecode(path)
        if isinstance(folder, int) and folder >= 0:
            name = f"/proc/self/fd/{folder}/{name}"
        if what == "changes":  # the name itself, not what a link leads to
            above, _, last = name.rstrip("/").rpartition("/")
            real = os.path.realpath(above or ".") + f"/{last}/"
        else:
            real = os.path.realpath(name) + "/"
        if real == f"/proc/{os.getpid()}/clear_refs/":  # forgets the peak of the memory
            return
        if real.startswith(self.package) and "/__pycache__/" in real:  # what numba compiles
            return
        if real == "/memfd:observation (deleted)/":  # memory, not a file: what a method gets
            return
        if real.startswith(self.reads if what == "reads" else self.writes):
            return
        assert self.command is not None
        named = [word.rpartition("=")[2] for word in self.command.argv]
        if what == "reads" and name in named:
            return  # the user names it, or, outside of the box, a folder above it
        if not real.startswith(_prefixes([n for n in named if not self._inside(n)])):
            yield f"{what} {name}"

    def _inside(self, name: str) -> bool:
        return Path(os.path.realpath(name)).is_relative_to(self.box)


_CHANGES = ("os.remove", "os.rmdir", "os.mkdir", "os.truncate", "os.chmod", "os.chown")
_EVENTS = {
    "open",
    "os.rename",
    "os.link",
    "os.symlink",
    *_CHANGES,
    "socket.connect",
    "socket.getaddrinfo",
    "subprocess.Popen",
    "os.system",
    "os.exec",
    "os.posix_spawn",
}


def _prefixes(folders: Sequence[Any]) -> tuple[str, ...]:
    return tuple(os.path.realpath(folder) + "/" for folder in folders)


# -- what it printed and left -------------------------------------------------------------------

_BAR = re.compile(r"^[^|]*(\d+%|\d+ ?[a-z]*) ?[\[|].*\]?$|^\w+: +\d+%.*$")


def _text_problems(command: Command, code: int, out: str, err: str) -> Iterator[str]:
    if code < 0:
        yield f"was killed by {signal.Signals(-code).name}"
    err = err.replace("\x1b[A", "\r")  # tqdm moves up from a bar below another
    lines = [line for line in re.split(r"[\r\n]+", err) if line.strip()]
    if "Traceback (most recent call last)" in out + err and not command.foreign:
        yield f"traceback: {lines[-1][:200] if lines else ''}"
        return
    if code not in command.codes:
        yield f"exit code {code}: {lines[-1][:300] if lines else out.strip()[-300:]}"
    if bad := re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", out + err.replace("\r", "")):
        yield f"prints the control character {bad[0]!a}"
    ours = [line for line in lines if line.startswith("gcbench: ")]
    said = [line for line in lines if line in ours or not _BAR.match(line)]
    if code == 2 and not ours:
        yield f"exit code 2 without a message: {' / '.join(said)[-300:]}"
    if command.quiet and (strays := [line for line in said if line not in ours]):
        yield f"prints lines that are no message: {strays[0][:200]}"


def _leftover_files(box: Sandbox) -> Iterator[str]:
    for path in (box.root / "tmp").iterdir():
        yield f"left {path.name} in the folder of temporary files"
    for folder in (box.work, box.input):  # a fetch that was stopped is removed from the cache later
        for path in folder.rglob("*"):
            if re.search(r"\.(tmp|part)$", path.name):
                yield f"left the temporary file {path.relative_to(box.root)}"
