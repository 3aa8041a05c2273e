"""A Ray cluster of several nodes on this machine: real raylets, small and with few CPUs."""

from __future__ import annotations

import os
import signal
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

from .processes import children_of, command_of

STORE = 80 * 2**20  # bytes


class Nodes:
    """The nodes of a cluster; the first is its head, and outlives the others."""

    def __init__(self, count: int, **of_head: int) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        from ray.cluster_utils import Cluster

        self._cluster: Any = Cluster(
            initialize_head=True,
            head_node_args={"num_cpus": 1, "object_store_memory": STORE,
                            "include_dashboard": False, **of_head})
        self._others: list[Any] = []
        for _ in range(count - 1):
            self.add()

    @property
    def address(self) -> str:
        """HOST:PORT, for drivers."""
        return self._cluster.address

    def add(self) -> None:
        """Start another node."""
        self._others.append(self._cluster.add_node(
            num_cpus=1, object_store_memory=STORE))

    def kill(self, number: int = -1, whole: bool = True) -> None:
        """Kill a node but the head, as a machine that loses its power.

        Unless `whole`, only its main process: its workers have to notice it.
        """
        node = self._others.pop(number)
        raylet = _raylet(node)
        for process in (raylet, *(children_of(raylet) if whole else ())):
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        self._cluster.remove_node(node, allow_graceful=False)

    def actors(self) -> list[int]:
        """The processes of actors on the nodes."""
        nodes = [self._cluster.head_node, *self._others]
        return [child for node in nodes for child in children_of(_raylet(node))
                if command_of(child).startswith(b"ray::ActorHost")]

    def close(self) -> None:
        """End all nodes."""
        self._cluster.shutdown()


def _raylet(node: Any) -> int:
    """The main process of a node, which starts its workers."""
    return node.all_processes["raylet"][0].process.pid


@contextmanager
def start_nodes(count: int, **of_head: int) -> Generator[Nodes]:
    """Start a cluster, and end it when the block ends; `of_head` are resources of its head."""
    nodes = Nodes(count, **of_head)
    try:
        yield nodes
    finally:
        nodes.close()
