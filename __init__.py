"""gcbench: synthetic videos of articulated objects with exact ground truth, and their benchmark.

Conventions, everywhere (docs and files included):

* Metres, radians, seconds.
* `a_from_b` is a 4x4 matrix that takes points of frame b to frame a.
* Camera frame as in OpenCV: x right, y down, z forward. Depth is z in the camera frame.
* Images are `[row, column]`; pixel coordinates are `(u, v)` = (column, row); the centre of the
  top-left pixel is (0, 0).
* Flow is `(du, dv)` in pixels, `x_other - x_this`, sampled at `x_this`; unknown is NaN.
* Parts are numbered from 1 in `part_names` order; 0 is background.

This module imports nothing but the errors, so that `import gcbench` and `gcbench --help` are
immediate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .errors import GcbenchError

if TYPE_CHECKING:
    from .renderer.dataset import open_dataset as open_dataset

__version__ = "0.1.0"
__all__ = ["GcbenchError", "open_dataset"]


def __getattr__(name: str) -> Any:
    if name == "open_dataset":
        from .renderer.dataset import open_dataset

        return open_dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
