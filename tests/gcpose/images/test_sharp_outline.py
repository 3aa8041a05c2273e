"""Outlines are sharp where the foreground stands out from a background that has been seen."""

from __future__ import annotations

import numpy as np
from gcbench.gcpose.images.settings import ImageSettings
from gcbench.gcpose.images.sharp_outline import sharp_outlines

SETTINGS = ImageSettings()


def moving_bar() -> tuple[np.ndarray, np.ndarray]:
    """Images [3 80 120 3] and true masks of a bar in columns 10 to 29, then 50 to 69 and 90 to
    109; the lower half of the background looks like the bar."""
    columns = np.arange(120) + np.zeros((80, 1), int)
    mask = np.stack([(columns >= c) & (columns < c + 20) for c in (10, 50, 90)])
    rgb = np.full((3, 80, 120, 3), 60, np.uint8)
    rgb[:, 40:] = 150
    rgb[mask] = 152
    return rgb, mask


def test_an_outline_is_sharp_where_the_background_differs() -> None:
    rgb, mask = moving_bar()
    sharp = sharp_outlines(rgb, mask, SETTINGS)
    for t, left in enumerate((10, 50, 90)):
        assert sharp[t, :37, [left, left + 19]].all()
        assert not sharp[t, 43:].any()


def test_a_wrong_outline_is_not_sharp() -> None:
    rgb, mask = moving_bar()
    large, small = mask.copy(), mask.copy()
    large[1, :, 70:78] = True
    small[1, :, 62:70] = False
    assert not sharp_outlines(rgb, large, SETTINGS)[1, :, 77].any()
    assert not sharp_outlines(rgb, small, SETTINGS)[1, :, 61].any()
    for wrong in (large, small):  # the other side is right
        assert sharp_outlines(rgb, wrong, SETTINGS)[1, :37, 50].all()


def test_no_outline_is_sharp_where_the_background_is_never_seen() -> None:
    rgb, mask = moving_bar()
    mask[:, :, :30] = True
    sharp = sharp_outlines(rgb, mask, SETTINGS)
    assert not sharp[:, :, :30].any() and sharp[1, :37, 50].all()
