"""The standard deviation with depth: by what is known of the axes, and by the noise."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench.gcpose.rgbd.pipeline import calibrate_sigma
from gcbench.gcpose.rgbd.settings import RgbdSettings

SETTINGS = RgbdSettings()


@pytest.mark.parametrize(("joints", "axis_dof", "noisy", "factor"), [
    (1, 2, False, SETTINGS.sigma_factor_known_directions),
    (3, 4, False, SETTINGS.sigma_factor_free),
    (1, 0, True, SETTINGS.sigma_factor_noisy),
    (3, 2, True, SETTINGS.sigma_factor_noisy),
    (1, 2, True, SETTINGS.sigma_factor_noisy_vague),
    (3, 4, True, SETTINGS.sigma_factor_noisy_vague),
])
def test_noise_counts_more_where_little_holds_the_axes(
    joints: int, axis_dof: int, noisy: bool, factor: float
) -> None:
    formal = np.full((4, joints), 1e-3)
    found = calibrate_sigma(formal, axis_dof, noisy, False, SETTINGS)
    floor = SETTINGS.sigma_floor_noisy if noisy else 0.0
    assert found.shape == (5, joints) and (found[0] == 0).all()
    assert found[1:] == pytest.approx(np.hypot(factor * formal, floor))


def test_an_unreliable_estimate_has_a_large_deviation() -> None:
    found = calibrate_sigma(np.full((4, 1), 1e-6), 2, False, True, SETTINGS)
    assert (found[1:] >= SETTINGS.sigma_unreliable).all()
