"""Other machines: commands that work on shards as jobs of a scheduler, and workers of Ray."""

from __future__ import annotations

from .ray_cluster import ExecutorOptions, RayCluster, RayWorkers, connect_to_ray
from .ray_pool import ActorWork, run_on_ray
from .submission import Submission, SubmitConfig, submit_shards
from .waiting import wait_for_shards

__all__ = [
    "ActorWork", "ExecutorOptions", "RayCluster", "RayWorkers", "Submission",
    "SubmitConfig", "connect_to_ray", "run_on_ray", "submit_shards", "wait_for_shards",
]
