"""Other machines: commands that work on shards, as jobs of a scheduler."""

from __future__ import annotations

from .submission import Submission, SubmitConfig, submit_shards
from .waiting import wait_for_shards

__all__ = ["Submission", "SubmitConfig", "submit_shards", "wait_for_shards"]
