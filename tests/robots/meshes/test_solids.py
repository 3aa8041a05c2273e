"""Solids are closed, their triangles look outward, and their volumes are those of closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from gcbench.errors import ModelError
from gcbench.robots.meshes.solids import SIDES, bar, block, circle, hull, plate, rod, round_corners
from gcbench.robots.model import TriangleSurface


def volume(solid: TriangleSurface) -> float:
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    mesh.merge_vertices(merge_norm=True)
    assert mesh.is_watertight and mesh.is_winding_consistent
    return float(mesh.volume)  # negative if it were inside out


POLYGON = SIDES / 2 * np.sin(2 * np.pi / SIDES)
"""Area of what stands for a circle of radius 1."""


def test_volumes_are_those_of_the_books() -> None:
    assert volume(block([1, 2, 3], [2, 4, 6])) == pytest.approx(6)
    assert volume(rod([1, 0, 0], [1, 3, 4], 2)) == pytest.approx(POLYGON * 4 * 5)
    cone = POLYGON * 5 / 3 * (4 + 2 + 1)
    assert volume(rod([0, 0, 0], [0, 0, 5], 2, 1)) == pytest.approx(cone)
    tetrahedron = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]]
    assert volume(hull(tetrahedron)) == pytest.approx(1 / 6)


def test_a_rounded_block_loses_its_edges() -> None:
    a, b, c, r = 2.0, 3.0, 4.0, 0.5
    i, j, k = a - 2 * r, b - 2 * r, c - 2 * r
    exact = (i * j * k + 2 * r * (i * j + j * k + k * i) + np.pi * r**2 * (i + j + k)
             + 4 / 3 * np.pi * r**3)
    assert volume(block([0, 0, 0], [a, b, c], r)) == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize("axis", "xyz")
def test_a_plate_has_holes_and_stands_where_it_should(axis: str) -> None:
    corners = [(0, 0), (9, 0), (9, 4), (4, 4), (4, 6), (0, 6)]
    solid = plate(corners, (-1, 2), [circle((2, 3), 1), circle((7, 2), 1.5)], axis)
    assert volume(solid) == pytest.approx(3 * (36 + 8 - POLYGON * (1 + 1.5**2)))
    low, high = solid.vertices.min(0), solid.vertices.max(0)
    across = [i for i in range(3) if i != "xyz".index(axis)]
    assert (low["xyz".index(axis)], high["xyz".index(axis)]) == (-1, 2)
    assert low[across].tolist() == [0, 0] and high[across].tolist() == [9, 6]


def test_outlines() -> None:
    square = round_corners([(0, 0), (4, 0), (4, 4), (0, 4)], 1)
    assert volume(plate(square, (0, 1))) == pytest.approx(12 + np.pi, rel=0.01)
    notch = round_corners([(0, 0), (6, 0), (6, 2), (2, 2), (2, 6), (0, 6)], 0.5)
    # five corners lose what the inner one wins
    assert volume(plate(notch, (0, 1))) == pytest.approx(20 - 4 * 0.25 * (1 - np.pi / 4), rel=0.002)
    straight = bar((0, 0), (3, 4), 1.0)
    assert volume(plate(straight, (0, 1))) == pytest.approx(10 + np.pi, rel=0.01)
    waisted = bar((0, 0), (3, 4), 1.0, 1.0, 0.5)
    assert 8 < volume(plate(waisted, (0, 1))) < volume(plate(straight, (0, 1)))


def test_loops_that_do_not_make_a_plate_are_refused() -> None:
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4)])
    for outline, holes in ((square[::-1], []), (square, [circle((0, 2), 1)])):
        with pytest.raises(ModelError, match="loops of a plate"):
            plate(outline, (0, 1), holes)
