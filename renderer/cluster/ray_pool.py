"""Ray actors that share a list of tasks: start, hand out, recycle, deaths, the end.

As the pool of processes of this machine, this one knows nothing of the work. An actor that dies is
replaced, on another node if its own is gone, and its task is tried again. The pool does this, and
not Ray's `max_task_retries`: while Ray takes a lost node for alive, it uses these up within
milliseconds; and a task that kills its actors shall not do so for ever. Only small records travel:
tasks to the actors, and what they return.
"""

from __future__ import annotations

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from ... import __version__
from ...errors import ConfigError, GcbenchError
from ..runtime import Problem, say
from .ray_cluster import RayCluster, describe_death

_Task = TypeVar("_Task")
_TRIES = 4
"""Of a task whose actors die, because it kills them, or because their nodes are lost."""
_MAX_LOST = 3  # tasks lost for good, after which the others are not tried
_PATIENCE = 30.0
"""s until a run whose workers have not begun says so."""
_END_LIMIT = 10.0  # s


class TaskRunner(Protocol):
    """What works in an actor."""

    @property
    def hello(self) -> Any:
        """What the driver gets before the first task."""
    def run(self, task: Any, /) -> Any:
        """Work on a task, and return a small record."""


@dataclass(frozen=True)
class ActorWork(Generic[_Task]):
    """What the actors of a pool do."""

    target: str
    """"module:function" that is called in each actor with `arguments`, and returns a TaskRunner."""
    arguments: tuple[Any, ...]
    describe: Callable[[_Task], str]
    """The name of a task, for messages."""
    error: type[GcbenchError]
    """What is raised if a task is lost."""
    lifetime: int | None = None
    """Tasks of one actor; a new one has none of the memory that the old one leaked."""


@dataclass(eq=False)
class _Slot:
    """An actor of the pool."""

    actor: Any
    finished: int = 0


def run_on_ray(
    work: ActorWork[_Task], tasks: Iterable[_Task], cluster: RayCluster
) -> Generator[tuple[_Task | None, Any]]:
    """Yield each finished task with the record that its actor returned, in no order.

    The hello of an actor is yielded with None, before it gets a task. Close the iterator to stop
    at once: no actor outlives it, nor the driver.

    Raises:
        GcbenchError: That of an actor; `work.error` if tasks are lost because their actors died
            again and again, after the other tasks are done.
        RuntimeError: With the traceback of a bug in an actor.
    """
    todo = deque(tasks)
    if not todo:
        return
    pool = _ActorPool(work, todo, cluster)
    try:
        yield from pool.run()
    finally:
        pool.stop()


class _ActorPool(Generic[_Task]):
    def __init__(self, work: ActorWork[_Task], todo: deque[_Task], cluster: RayCluster) -> None:
        import ray

        self._ray: Any = ray
        self._work, self._todo = work, todo
        self._count, cpus = cluster.plan(len(self._todo))
        self._actors = ray.remote(ActorHost).options(
            num_cpus=cpus, num_gpus=cluster.workers.gpus, scheduling_strategy="SPREAD")
        # a list hides the reference from Ray, so that versions are compared before it is read
        self._arguments = [ray.put((*work.arguments, cpus))]
        self._slots = set[_Slot]()
        self._pending: dict[Any, tuple[_Slot, _Task | None]] = {}
        self._deaths = Counter[_Task | None]()
        self._lost: list[str] = []

    def run(self) -> Generator[tuple[_Task | None, Any]]:
        for _ in range(self._count):
            self._start()
        is_waiting, began = True, time.monotonic()
        while self._todo or any(task is not None for _, task in self._pending.values()):
            ready, _ = self._ray.wait(list(self._pending), timeout=_PATIENCE)
            if is_waiting and not ready and time.monotonic() - began >= _PATIENCE:
                is_waiting = False
                say("no worker has begun yet; they load, or wait for free CPUs of the cluster")
            for reference in ready:
                is_waiting = False
                slot, task = self._pending.pop(reference)
                try:
                    answer = self._ray.get(reference)
                except self._ray.exceptions.RayError as error:
                    self._bury(slot, task, error)
                    continue
                if isinstance(answer, Problem):
                    answer.throw("" if task is None else f"{self._work.describe(task)}: ")
                yield task, answer
                slot.finished += task is not None
                del self._deaths[None]  # actors do start
                self._hand_out(slot)
        if self._lost:
            raise self._work.error("; ".join(self._lost) + "; the same command tries again")

    def stop(self) -> None:
        """Kill the actors, and wait until they have gone."""
        for slot in list(self._slots):
            self._end(slot)
        if self._pending:
            self._ray.wait(list(self._pending), num_returns=len(self._pending), timeout=_END_LIMIT)

    def _start(self) -> None:
        slot = _Slot(self._actors.remote(__version__, str(Path.cwd()), self._work.target))
        self._slots.add(slot)
        self._pending[slot.actor.open.remote(self._arguments)] = slot, None

    def _end(self, slot: _Slot) -> None:
        self._slots.discard(slot)
        with suppress(self._ray.exceptions.RayError):
            self._ray.kill(slot.actor)

    def _hand_out(self, slot: _Slot) -> None:
        """Give an idle actor its next task, or replace it, or end it."""
        if self._todo and slot.finished != self._work.lifetime:
            task = self._todo.popleft()
            self._pending[slot.actor.run.remote(self._arguments, task)] = slot, task
            return
        self._end(slot)
        if self._todo:
            self._start()

    def _bury(self, slot: _Slot, task: _Task | None, error: Exception) -> None:
        """Replace an actor that has died; another one tries its task again, up to a limit."""
        if missing := _find_missing_package(error):
            raise ConfigError(f"a node of the Ray cluster lacks {missing}: install gcbench "
                              f"{__version__} there") from error
        if isinstance(error, self._ray.exceptions.RayTaskError):
            raise RuntimeError(str(error)) from error
        self._end(slot)
        where = "a worker before its first task" if task is None \
            else f"{self._work.describe(task)}: its worker"
        self._deaths[task] += 1
        # a node that is lost takes all of its actors with it, perhaps while they start
        again = self._deaths[task] < _TRIES + (self._count if task is None else 0)
        say(f"{where} died; {'tried again' if again else 'given up'} ({describe_death(error)})")
        if not again:
            self._lost.append(f"{where} died {self._deaths[task]} times")
            if task is None or len(self._lost) >= _MAX_LOST:
                self._todo.clear()
        elif task is not None:
            self._todo.appendleft(task)
        if self._todo:
            self._start()


def _find_missing_package(error: Exception) -> str:
    """Return the name of a module that a node could not import; empty if that is not the error."""
    _, found, rest = str(error).partition("No module named ")
    return rest.split()[0].strip("'\"") if found else ""


# -- in the actor -----------------------------------------------------------------------------


class ActorHost:
    """The actor; a new process of Ray, on any node."""

    def __init__(self, version: str, folder: str, target: str) -> None:
        """Keep what `open` needs: an error here would be a traceback of Ray's.

        Args:
            version: That of the driver's gcbench.
            folder: In which the driver runs, so that relative paths mean the same.
            target: That of the work.
        """
        self._version, self._folder, self._target = version, folder, target
        self._runner: TaskRunner | None = None

    def open(self, arguments: list[Any]) -> Any:
        """Return the hello of the runner, or a Problem. `arguments` holds a reference to them.
        """
        try:
            return self._open(arguments).hello
        except Exception as error:
            return Problem.describe(error, _here())

    def run(self, arguments: list[Any], task: Any) -> Any:
        """Return the record of a task, or a Problem; a restarted actor opens its runner first."""
        try:
            return self._open(arguments).run(task)
        except Exception as error:
            return Problem.describe(error, _here())

    def _open(self, arguments: list[Any]) -> TaskRunner:
        if self._runner is None:
            import ray

            if self._version != __version__:
                raise ConfigError(f"has gcbench {__version__}, and the driver {self._version}; "
                                  "install one version on all nodes")
            with suppress(OSError):
                os.chdir(self._folder)
            module, _, function = self._target.partition(":")
            runner: TaskRunner = getattr(import_module(module), function)(*ray.get(arguments)[0])
            self._runner = runner
        return self._runner


def _here() -> str:
    import ray

    return f"node {ray.util.get_node_ip_address()}: "
