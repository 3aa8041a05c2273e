"""Round trips of the images of a dataset, for any content and size."""

from __future__ import annotations

import numpy as np
import pytest
from gcbench import DatasetError
from gcbench.renderer.dataset import codec
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9))


def images(dtype: type, elements: st.SearchStrategy, *channels: int) -> st.SearchStrategy:
    return SHAPES.flatmap(lambda shape: arrays(dtype, (*shape, *channels), elements=elements))


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, width=32)


def size_of(image: NDArray) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


@given(rgb=images(np.uint8, st.integers(0, 255), 3))
def test_colors_are_kept(rgb: NDArray) -> None:
    assert np.array_equal(codec.decode_rgb(codec.encode_rgb(rgb), size_of(rgb), ""), rgb)


@given(part=images(np.uint16, st.integers(0, 65535)), wide=st.booleans())
def test_part_numbers_are_kept(part: NDArray, wide: bool) -> None:
    part = part if wide else part % 256
    parts = 65535 if wide else 255
    png = codec.encode_part(part, wide)
    assert np.array_equal(codec.decode_part(png, size_of(part), "", parts), part)
    if not wide:
        wider = codec.decode_part(codec.widen_part(png), size_of(part), "", 256)
        assert np.array_equal(wider, part)
    if (part % 256).any():
        with pytest.raises(DatasetError, match="part number"):
            codec.decode_part(codec.encode_part(part % 256), size_of(part), "", 0)


@given(labels=images(np.uint8, st.integers(0, 3)))
def test_visibility_is_kept(labels: NDArray) -> None:
    png = codec.encode_labels(labels)
    assert np.array_equal(codec.decode_visibility(png, size_of(labels), ""), labels)


@given(depth=images(np.float32, floats(0, 60)), exponent=st.integers(-3, 0))
def test_depth_is_rounded_to_its_unit(depth: NDArray, exponent: int) -> None:
    unit = 10.0**exponent
    depth = np.minimum(depth, np.float32(65000 * unit))
    found = codec.decode_depth(codec.encode_depth(depth, unit), size_of(depth), "", unit)
    assert np.abs(found - depth).max() <= 0.5 * unit + 1e-6 * depth.max()
    assert not found[depth == 0].any()


@given(flow=images(np.float32, floats(-511, 511) | st.just(np.nan), 2))
def test_flow_is_rounded_to_64ths_of_a_pixel(flow: NDArray) -> None:
    found = codec.decode_flow(codec.encode_flow(flow), size_of(flow), "")
    known = np.isfinite(flow).all(axis=2)
    assert np.array_equal(np.isfinite(found).all(axis=2), known)
    assert (np.abs(found - flow)[known] <= 0.5 / 64).all()


@given(vector=images(np.float32, floats(-1, 1), 3))
def test_normals_are_rounded_to_16_bits(vector: NDArray) -> None:
    length = np.linalg.norm(vector, axis=2, keepdims=True)
    normal = np.where(length > 1e-3, vector / np.maximum(length, 1e-3), np.nan).astype(np.float32)
    found = codec.decode_normal(codec.encode_normal(normal), size_of(normal), "")
    assert np.array_equal(np.isnan(found), np.isnan(normal))
    assert np.nanmax(np.abs(found - normal), initial=0) <= 1.6e-5


@given(rgb=images(np.uint8, st.integers(0, 255), 3), at=st.floats(0, 1, exclude_max=True))
def test_a_cut_png_is_refused(rgb: NDArray, at: float) -> None:
    png = codec.encode_rgb(rgb)
    with pytest.raises(DatasetError, match="here"):
        codec.decode_rgb(png[: int(at * len(png))], size_of(rgb), "here")


@given(rgb=images(np.uint8, st.integers(0, 255), 3), width=st.integers(1, 9))
def test_another_size_is_refused(rgb: NDArray, width: int) -> None:
    if width != rgb.shape[1]:
        with pytest.raises(DatasetError, match="here"):
            codec.decode_rgb(codec.encode_rgb(rgb), (width, rgb.shape[0]), "here")
