"""Box projection keeps every triangle where it is, and lengths in the plane of its projection."""

import numpy as np
import pytest
from gcbench.renderer.scene.box_mapping import split_by_axis


def box_projection(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, scale: float
) -> tuple[np.ndarray, ...]:
    old, split, uv = split_by_axis(vertices, faces, scale)
    return vertices[old], split, normals[old], uv


def _mesh(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    vertices, normals = rng.normal(size=(200, 3)), rng.normal(size=(200, 3))
    return vertices, rng.integers(0, 150, (400, 3)).astype(np.int32), normals


@pytest.mark.parametrize("seed", range(3))
def test_corners_keep_positions_and_normals(seed: int) -> None:
    vertices, faces, normals = _mesh(seed)
    v, f, n, uv = box_projection(vertices, faces, normals, 0.3)
    assert f.dtype == np.int32
    assert f.shape == faces.shape
    assert np.array_equal(v[f], vertices[faces])
    assert np.array_equal(n[f], normals[faces])
    assert len(v) == len(n) == len(uv) <= 3 * len(vertices)
    assert np.array_equal(np.unique(f), np.arange(len(v)))  # none unused


@pytest.mark.parametrize("scale", [0.05, 1.0, 3.0])
def test_uv_is_an_isometry_of_each_projected_face(scale: float) -> None:
    vertices, faces, normals = _mesh(0)
    v, f, _, uv = box_projection(vertices, faces, normals, scale)
    edges = v[np.roll(f, -1, 1)] - v[f]
    axis = np.abs(np.cross(edges[:, 0], edges[:, 1])).argmax(1)
    edges[np.arange(len(f)), :, axis] = 0
    lengths = np.linalg.norm(uv[np.roll(f, -1, 1)] - uv[f], axis=-1) * scale
    assert np.allclose(lengths, np.linalg.norm(edges, axis=-1))


def test_a_cube_is_split_along_its_edges_and_its_sides_differ() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    quads = [[0, 1, 3, 2], [0, 4, 5, 1], [0, 2, 6, 4]]  # the sides that meet at corner 0
    faces = np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])], np.int32)
    v, f, _, uv = box_projection(corners, faces, corners, 1.0)
    assert len(v) == 12  # four corners a side
    at_corner = uv[(v == 0).all(1)]
    assert len(np.unique(at_corner % 1, axis=0)) == 3
    assert len(np.unique(f[:2])) == 4


def test_scale_only_scales() -> None:
    one, two = (box_projection(*_mesh(1), s) for s in (1.0, 2.0))
    first = one[1][:, 0]
    assert np.allclose((one[3][one[1][:, 1]] - one[3][first]) / 2,
                       two[3][two[1][:, 1]] - two[3][first])


def test_degenerate_input() -> None:
    empty = np.zeros((0, 3))
    v, f, n, uv = box_projection(empty, np.zeros((0, 3), np.int32), empty, 1.0)
    assert (v.shape, f.shape, n.shape, uv.shape) == ((0, 3), (0, 3), (0, 3), (0, 2))
    sliver = np.zeros((3, 3))
    *_, uv = box_projection(sliver, np.array([[0, 1, 2]], np.int32), sliver, 1.0)
    assert np.isfinite(uv).all()
    with pytest.raises(ValueError, match="positive"):
        box_projection(empty, np.zeros((0, 3), np.int32), empty, 0.0)
