"""The bounds of the checks that follow the flow."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from gcbench.renderer.verify.correspondence import _parallax
from gcbench.robots.geometry import apply, inverse, pinhole, rotation_about, transform


def test_parallax_is_exact_for_depths_that_are_far_apart() -> None:
    """As beside an edge: with the slope at one of them, a right dataset of a ur5 was refused."""
    rng = np.random.default_rng(3)
    intrinsics = np.array([[600.0, 0.2, 320.0], [0.0, 605.0, 240.0], [0.0, 0.0, 1.0]])
    motions = np.stack([
        transform(rotation_about(np.array([1, 2, 2]) / 3, angle), [0.05, -0.02, 0.08 * angle])
        for angle in (0.0, 0.1, -0.2)])
    part = rng.integers(0, 3, 50)
    uv = rng.uniform([[100], [100]], [[500], [400]], (2, 50))
    z, other = rng.uniform(0.4, 1.5, (2, 50))

    def way_back(depth: np.ndarray) -> np.ndarray:
        points = pinhole.unproject(intrinsics, uv.T, depth)
        back = apply(inverse(motions)[part], points[:, None])[:, 0]
        return (back @ intrinsics.T)[:, :2] / back[:, 2:]

    step = SimpleNamespace(
        here=SimpleNamespace(sequence=SimpleNamespace(
            state=SimpleNamespace(intrinsics=intrinsics))), motions=motions)
    found = _parallax(cast("Any", step), part, uv, z, other) * np.abs(z - other)
    apart = np.linalg.norm(way_back(z) - way_back(other), axis=1)
    assert np.allclose(found, apart, rtol=1e-9) and apart.max() > 5
