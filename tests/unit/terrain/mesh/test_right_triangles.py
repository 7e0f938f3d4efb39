"""Right-triangulated networks: a bounded error, no cracks, and holes that stay holes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.mesh.right_triangles import GridMesh, RightTriangles


def rough(seed: int, shape=(37, 50)) -> np.ndarray:
    """Terrain with steps of every size, and some points missing."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=shape).cumsum(axis=0).cumsum(axis=1) / 10 + rng.normal(size=shape) / 20
    steps[rng.random(shape) < 0.01] = np.nan
    return steps.astype(np.float32)


def deviations(mesh: GridMesh, values: np.ndarray) -> np.ndarray:
    """Distance from the triangle's plane at every grid point inside every triangle."""
    found = []
    corners = np.stack([mesh.row, mesh.col], axis=1)[mesh.triangles].astype(float)
    for corner, height in zip(corners, values[mesh.row, mesh.col][mesh.triangles], strict=True):
        low, high = corner.min(axis=0).astype(int), corner.max(axis=0).astype(int)
        row, col = (grid.ravel() for grid in np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1])
        ones = np.vstack([np.ones(3), corner.T])
        weight = np.linalg.solve(ones, np.vstack([np.ones(len(row)), row, col]))
        inside = (weight > -1e-9).all(axis=0)
        found.append(np.abs(height @ weight - values[row, col])[inside])
    return np.concatenate(found)


def doubled_areas(mesh: GridMesh) -> np.ndarray:
    """Twice the area of every triangle in squares; positive if counter-clockwise."""
    x, y = mesh.col[mesh.triangles].astype(int), -mesh.row[mesh.triangles].astype(int)
    return (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])


@pytest.mark.usefixtures("unchecked")
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), tolerance=st.floats(0.01, 3.0))
def test_no_grid_point_is_farther_from_the_mesh_than_the_tolerance(seed, tolerance):
    values = rough(seed)
    mesh = RightTriangles.of(values, levels=4).mesh(tolerance)
    off = deviations(mesh, values)
    assert np.isfinite(off).all()
    assert off.max() <= tolerance * (1 + 1e-5)  # single precision of the prepared errors


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), tolerance=st.floats(0.01, 3.0))
def test_the_mesh_covers_every_whole_square_once_and_no_hole(seed, tolerance):
    prepared = RightTriangles.of(rough(seed), levels=4)
    area = doubled_areas(prepared.mesh(tolerance))
    assert (area > 0).all()
    assert area.sum() == 2 * prepared.whole.sum()


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), tolerance=st.floats(0.01, 3.0))
def test_edges_are_shared_by_two_triangles_or_border_a_hole(seed, tolerance):
    prepared = RightTriangles.of(rough(seed), levels=4)
    mesh = prepared.mesh(tolerance)
    directed = np.concatenate([mesh.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    there = {tuple(edge) for edge in directed.tolist()}
    assert len(there) == len(directed)
    alone = np.array([edge for edge in there if edge[::-1] not in there])
    holes = np.pad(~prepared.whole, 1, constant_values=True)
    for a, b in alone:  # the square to the right of an edge that runs counter-clockwise
        row, col = (mesh.row[a] + mesh.row[b]) / 2, (mesh.col[a] + mesh.col[b]) / 2
        down, across = mesh.row[b] - mesh.row[a], mesh.col[b] - mesh.col[a]
        length = max(abs(int(down)), abs(int(across)))
        outside = row + 0.5 * across / length, col - 0.5 * down / length
        assert holes[int(np.floor(outside[0] + 1)), int(np.floor(outside[1] + 1))]


def test_a_plane_has_two_triangles_per_root_square():
    row, col = np.mgrid[:33, :65]
    prepared = RightTriangles.of((0.25 * row - 0.5 * col).astype(np.float32), levels=5)
    assert len(prepared.mesh(1e-3)) == 2 * 2
    assert prepared.roots == (1, 2)


def test_a_break_between_surfaces_is_not_bridged():
    values = np.zeros((9, 9), np.float32)
    values[:, 5:] = 10.0
    whole = np.abs(np.diff(values, axis=1))[:-1] < 1
    mesh = RightTriangles.of(values, whole, levels=3).mesh(0.1)
    across = mesh.col[mesh.triangles]
    assert ((across <= 4).all(axis=1) | (across >= 5).all(axis=1)).all()
    assert doubled_areas(mesh).sum() == 2 * (9 - 1) * (9 - 2)


def test_separately_drawn_parts_meet_along_their_border():
    prepared = RightTriangles.of(np.nan_to_num(rough(7, (33, 65))), levels=5)
    left, right = (prepared.mesh(0.3, (slice(None), slice(i, i + 1))) for i in (0, 1))
    whole = prepared.mesh(0.3)
    assert len(left) + len(right) == len(whole)
    assert set(left.row[left.col == 32]) == set(right.row[right.col == 32])


def test_a_tolerance_of_zero_is_refused():
    with pytest.raises(TerrainError, match="tolerance above zero, not 0"):
        RightTriangles.of(rough(1)).mesh(0.0)
