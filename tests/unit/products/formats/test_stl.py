"""Terrain models as solids: watertight, as large as they are, and written as STL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.mesh.solid import SolidParams, build_solid
from solmap.products.formats.mesh.stl import stl_bytes
from tests.support.bowl_store import dtm
from tests.support.product_readers import read_stl

RADIUS_M = 38.0
TOLERANCE_M = 0.02
FINE_M = 0.005
"""Whole bowls differ by less than a hole then."""


@pytest.fixture(scope="module")
def bowl():
    return build_solid(dtm(), SolidParams(TOLERANCE_M, base_m=1.0))


def test_the_solid_of_a_bowl_is_watertight(bowl):
    assert bowl.is_watertight
    edges = np.sort(np.vstack([bowl.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]))
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()


def test_it_encloses_the_volume_of_the_bowl(bowl):
    """Under z = d^2 / 100 and over a base 1 m below: pi r^4 / 200 + pi r^2."""
    true = np.pi * RADIUS_M**4 / 200 + np.pi * RADIUS_M**2
    rim = 2 * np.pi * RADIUS_M * 0.08 * (RADIUS_M**2 / 100 + 1)  # a cell of the model
    assert bowl.volume_m3 == pytest.approx(true, abs=rim + np.pi * RADIUS_M**2 * TOLERANCE_M)


def test_ground_with_holes_makes_a_solid_with_holes():
    model = dtm()
    ground = model.elevation.copy()
    ground[400:500, 400:500] = np.nan
    whole, holed = (
        build_solid(replace(model, elevation=one), SolidParams(FINE_M, base_m=1.0))
        for one in (model.elevation, ground)
    )
    assert holed.is_watertight
    rows = 101 * 0.08
    north, east = model.grid.north - 450 * 0.08, model.grid.west + 450 * 0.08
    lost = rows**2 * ((east**2 + north**2 + rows**2 / 6) / 100 + 1)
    assert whole.volume_m3 - holed.volume_m3 == pytest.approx(lost, rel=0.02)


def test_without_a_base_it_is_the_surface_alone():
    surface = build_solid(dtm(), SolidParams(TOLERANCE_M, base_m=0.0))
    assert not surface.is_watertight
    a, b, c = np.moveaxis(surface.corners, 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_stl_holds_every_triangle(bowl):
    corners = read_stl(stl_bytes(bowl))
    assert corners.shape == (len(bowl.triangles), 3, 3)
    a, b, c = np.moveaxis(corners.astype(np.float64), 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(bowl.volume_m3, rel=1e-4)


def test_a_model_without_ground_gives_no_solid():
    model = dtm()
    nothing = replace(model, elevation=np.full_like(model.elevation, np.nan))
    with pytest.raises(TerrainError):
        build_solid(nothing, SolidParams())
