"""The connection to a Ray cluster, and how many workers it has room for."""

from __future__ import annotations

import math
import os
import re
import socket
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

from ...errors import ConfigError
from ..runtime import cpu_count

_STORE = 100 * 2**20
"""Bytes of shared memory of a Ray that gcbench starts: results are small records."""

_PATIENCE = 10.0
"""s for a cluster to answer."""
_MESSAGES = ("ray._private.worker", "_worker_logs_enabled")
"""Whether Ray prints messages about its nodes, to stdout."""
_NETWORK = ("ray._private.ray_constants", "ENABLE_RAY_CLUSTER")
"""Whether a Ray that is started listens to other machines, which could run anything in it."""
_NETWORK_VARIABLE = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""The same for the processes of Ray; in spite of its name also on Linux."""


@dataclass(frozen=True)
class RayWorkers:
    """Workers on a Ray cluster, in the place of processes of this machine.

    The nodes must have this version of gcbench, and see the folders under the same paths.

    Args:
        address: "auto": the cluster that this machine belongs to, or that `RAY_ADDRESS` names;
            "local": a Ray of this machine, started for one call; or "HOST:PORT".
        count: Number of workers; 0 and None: one for each CPU (or share of a GPU) of the cluster.
        gpus: GPUs of each worker; 0.25 puts four workers on a GPU. 0: none.

    Raises:
        ConfigError: If a number is out of range, or the address is one of Ray's client.

    Example:
        >>> gb.RayWorkers("local", count=2)
        RayWorkers(address='local', count=2, gpus=0.0)
    """

    address: str = "auto"
    count: int | None = None
    gpus: float = 0.0

    def __post_init__(self) -> None:
        if self.count is not None and self.count < 0:
            raise ConfigError(f"--workers {self.count}: give 1 or more, or 0 for one for each CPU")
        share = 0 <= self.gpus <= 1
        if not share and not (math.isfinite(self.gpus) and self.gpus == round(self.gpus) > 0):
            raise ConfigError(f"--gpus {self.gpus:g}: give a share of a GPU, or a number of them")
        if not re.fullmatch(r"auto|local|[^\s/]+:\d{1,5}", self.endpoint, re.ASCII):
            raise ConfigError(f"--address {self.endpoint[:60]!a}: give auto or HOST:PORT, on a "
                              "node of the cluster, or local")

    @property
    def endpoint(self) -> str:
        """The address; in the place of "auto" that of `RAY_ADDRESS`, if it is set."""
        there = os.environ.get("RAY_ADDRESS", "")
        return there if there and self.address == "auto" else self.address


@dataclass(frozen=True, kw_only=True)
class ExecutorOptions:
    """Options of commands that may run on a Ray cluster."""

    executor: Literal["local", "ray"] = "local"
    """ray: work on the nodes of a Ray cluster, with --workers in all."""
    address: str = ""
    """Ray cluster: auto (the one of this machine or of RAY_ADDRESS; default), HOST:PORT, or local
    (Ray on this machine, for this run)."""
    gpus: float = 0.0
    """GPUs of each worker of Ray; 0.25 puts four workers on a GPU. 0: none."""

    def choose_workers(self, count: int | None) -> int | RayWorkers | None:
        """Return the workers that the options name; `count` are those of --workers.

        Raises:
            ConfigError: If an option needs another executor, or is out of range.
        """
        if self.executor == "ray":
            return RayWorkers(self.address or "auto", count, self.gpus)
        for option, given in (("--address", self.address), ("--gpus", self.gpus)):
            if given:
                raise ConfigError(f"{option} is for --executor ray; add it, or leave {option} out")
        return count


@dataclass(frozen=True)
class RayCluster:
    """A cluster that this process is connected to."""

    workers: RayWorkers
    nodes: tuple[Mapping[str, float], ...]
    """Resources of each node: CPU, GPU."""

    def plan(self, tasks: int | None = None) -> tuple[int, int]:
        """Return the number of workers for a number of tasks, and the CPUs of each.

        Raises ConfigError if no node has what a worker needs.
        """
        room = self._room(1)
        if not room and self.workers.gpus:
            raise ConfigError(f"--gpus {self.workers.gpus:g}: no node of the Ray cluster has so "
                              "many; start nodes with ray start --num-gpus, or leave it out")
        count = self.workers.count or room
        if not count:
            raise ConfigError("the Ray cluster has no CPUs yet; give the number of --workers, "
                              "which it may start nodes for")
        count = count if tasks is None else max(1, min(count, tasks))
        cpus = 1
        while self._room(cpus + 1) >= count:
            cpus += 1
        return count, cpus

    def _room(self, cpus: int) -> int:
        """The number of workers of so many CPUs that the nodes hold."""
        gpus = self.workers.gpus
        return sum(
            min(int(node.get("CPU", 0) // cpus),
                int(node.get("GPU", 0) / gpus + 1e-6) if gpus else 10**9)
            for node in self.nodes)


@contextmanager
def connect_to_ray(workers: RayWorkers) -> Generator[RayCluster]:
    """Connect to a cluster, or start one on this machine, while the block runs.

    A connection that the caller has made by `ray.init` is used, and stays.

    Raises:
        ConfigError: If Ray is missing, or there is no such cluster.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent that nobody asked for
    try:
        import ray
    except ImportError as error:
        raise ConfigError(
            f"--executor ray needs {error.name}: pip install '.[cluster]'") from error
    if ray.is_initialized():
        yield _describe(ray, workers)
        return
    with ExitStack() as stack:
        stack.enter_context(_switch_off(*_MESSAGES))
        if workers.address == "local":
            stack.enter_context(_switch_off(*_NETWORK))
            os.environ[_NETWORK_VARIABLE] = "0"
            stack.callback(os.environ.pop, _NETWORK_VARIABLE)
        stack.callback(ray.shutdown)
        _connect(ray, workers)
        yield _describe(ray, workers)


@contextmanager
def _switch_off(module: str, name: str) -> Generator[None]:
    """Set a variable of a module of Ray's to False while the block runs; Ray has no option for it.
    """
    variables = vars(import_module(module))
    before = variables.get(name)
    variables[name] = False
    try:
        yield
    finally:
        variables[name] = before


def _describe(ray: Any, workers: RayWorkers) -> RayCluster:
    return RayCluster(workers, tuple(n["Resources"] for n in ray.nodes() if n["Alive"]))


def _connect(ray: Any, workers: RayWorkers) -> None:
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    if workers.address == "local":
        options |= {
            "num_cpus": max(cpu_count(), workers.count or 0), "object_store_memory": _STORE,
            "include_dashboard": False,
        }
    try:
        _knock(workers.endpoint)
        ray.init(address=workers.address, **options)
    except (ConnectionError, RuntimeError, ValueError, OverflowError, OSError) as error:
        said = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise ConfigError(
            f"no connection to Ray at {workers.endpoint} ({said}); start a cluster by ray start "
            "--head, give its --address HOST:PORT, or give --address local") from error


def _knock(address: str) -> None:
    """Raise OSError if nothing listens at HOST:PORT; Ray itself would try for ten minutes."""
    host, colon, port = address.rpartition(":")
    if colon:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=_PATIENCE):
            pass


def describe_death(error: BaseException) -> str:
    """Return in one line why Ray lost a worker."""
    text = " ".join(str(error).split())
    for mark in ("Worker exit detail:", "The actor is dead because", "death_cause="):
        with suppress(ValueError):
            text = text[text.index(mark) + len(mark):]
    return text.strip()[:200]
