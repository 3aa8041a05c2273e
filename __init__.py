"""gcbench: synthetic videos of articulated objects with exact ground truth, and their benchmark.

    import gcbench as gb

    gb.render_dataset(gb.RenderConfig(robot="ur5", seed=7), n=20, out="data/ur5")
    for sequence in gb.open_dataset("data/ur5"):
        ...

Conventions (docs and files included):

* Metres, radians, seconds.
* `a_from_b` is a 4x4 matrix that takes points of frame b to frame a.
* Camera frame as in OpenCV: x right, y down, z forward. Depth is z in the camera frame.
* Images are `[row, column]`; pixel coordinates are `(u, v)` = (column, row); the center of the
  top-left pixel is (0, 0).
* Flow is `(du, dv)` in pixels, `x_other - x_this`, sampled at `x_this`; unknown is NaN.
* Parts are numbered from 1 in `part_names` order; 0 is background.

The public names below are imported on first use (PEP 562), so that `import gcbench` is immediate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .errors import (
    ConfigError,
    DatasetError,
    GcbenchError,
    MethodError,
    ModelError,
    RenderError,
    StorageError,
)

if TYPE_CHECKING:
    from .benchmark.methods import list_methods
    from .benchmark.report import ReportOptions, report
    from .benchmark.results import Results
    from .benchmark.run import EvalConfig, evaluate, export_observations, list_suites, score
    from .gcpose.method import GCPose
    from .renderer.cluster import RayWorkers
    from .renderer.dataset import Dataset, open_dataset
    from .renderer.doctor import doctor
    from .renderer.export import export_dataset
    from .renderer.generate import render_dataset, render_sequence, stream
    from .renderer.runtime import Shard
    from .renderer.scene import RenderConfig
    from .renderer.show import show
    from .renderer.types import Camera, Estimate, Frame, Method, Observation, Sequence
    from .renderer.verify import VerifyReport, merge_verification, verify_dataset, verify_shard
    from .robots.catalog import fetch_robot, list_robots, load_robot
    from .robots.model import ArticulatedModel, JointType, Link
    from .robots.motion import JointTrajectory

__version__ = "0.1.0"
__all__ = [
    "ArticulatedModel", "Camera", "ConfigError", "Dataset", "DatasetError", "Estimate",
    "EvalConfig", "Frame", "GCPose", "GcbenchError", "JointTrajectory", "JointType", "Link",
    "Method", "MethodError", "ModelError", "Observation", "RayWorkers", "RenderConfig",
    "RenderError", "ReportOptions", "Results", "Sequence", "Shard", "StorageError", "VerifyReport",
    "doctor", "evaluate", "export_dataset", "export_observations", "fetch_robot", "list_methods",
    "list_robots", "list_suites", "load_robot", "merge_verification", "open_dataset",
    "render_dataset", "render_sequence", "report", "score", "show", "stream", "verify_dataset",
    "verify_shard",
]

_HOMES = {
    "robots.catalog": "fetch_robot list_robots load_robot",
    "robots.model": "ArticulatedModel JointType Link",
    "robots.motion": "JointTrajectory",
    "renderer.types": "Camera Estimate Frame Method Observation Sequence",
    "renderer.scene": "RenderConfig",
    "renderer.cluster": "RayWorkers",
    "renderer.dataset": "Dataset open_dataset",
    "renderer.generate": "render_dataset render_sequence stream",
    "renderer.runtime": "Shard",
    "renderer.verify": "VerifyReport merge_verification verify_dataset verify_shard",
    "renderer.show": "show",
    "renderer.export": "export_dataset",
    "renderer.doctor": "doctor",
    "gcpose.method": "GCPose",
    "benchmark.methods": "list_methods",
    "benchmark.results": "Results",
    "benchmark.run": "EvalConfig evaluate export_observations list_suites score",
    "benchmark.report": "ReportOptions report",
}
"""Where each lazy public name is defined."""


if not TYPE_CHECKING:  # with it, a type checker would accept every name

    def __getattr__(name: str) -> Any:
        from importlib import import_module

        for home, names in _HOMES.items():
            if name in names.split():
                globals()[name] = value = getattr(import_module(f".{home}", __name__), name)
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
