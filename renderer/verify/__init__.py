"""Verify datasets by a second implementation of their ground truth, pixel by pixel.

On purpose this sub-package has its own matrix exponential, projections and reading of URDFs, and
does not use those of `robots.geometry`, `robots.urdf` and `renderer.truth`: a mistake made once
must not be found right by the same code. It shares the records of sequences and models, the
hardened XML parser, and the code that places what an animation or a skin moves.
"""

from __future__ import annotations

from .checks import CheckResult, VerifyReport
from .driver import verify_dataset
from .shards import merge_verification, verify_shard

__all__ = ["CheckResult", "VerifyReport", "merge_verification", "verify_dataset", "verify_shard"]
