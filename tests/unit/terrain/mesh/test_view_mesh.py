"""Models of what pairs see: on the surface, with faces that no map shows, and drawn once."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.mesh.surface_mesh import SurfaceMesh
from solmap.photogrammetry.terrain.mesh.view_mesh import ViewModelParams, view_meshes

NEAR = ViewModelParams(max_relative_sigma=0.03)  # the small camera of these tests sees 7 m


def corners(mesh: SurfaceMesh) -> np.ndarray:
    return mesh.points[mesh.triangles]


def areas(mesh: SurfaceMesh) -> np.ndarray:
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_a_plane_takes_few_triangles_at_its_true_place(scenes):
    (model,) = view_meshes([scenes.view_of(scenes.tilted)], NEAR)
    east, north, up = model.mesh.points.T
    np.testing.assert_allclose(up, scenes.tilted(east, north), atol=1e-4)
    squares = model.texture.size
    assert len(model.mesh) < squares / 10  # only the border of what is near enough is ragged
    steepness = np.array([-0.05, 0.1, 1.0])
    inner = model.mesh.normals @ (steepness / np.linalg.norm(steepness))
    assert np.median(inner) == pytest.approx(1.0, abs=1e-4)


def test_triangles_face_the_camera(scenes):
    (model,) = view_meshes([scenes.view_of(scenes.tilted)], NEAR)
    a, b, c = np.moveaxis(corners(model.mesh), 1, 0)
    toward = np.array([0.0, 0.0, scenes.MAST_M]) - a
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), toward) > 0).all()


def test_the_face_of_a_boulder_is_drawn_and_its_shadow_stays_open(scenes):
    (model,) = view_meshes([scenes.view_of(scenes.with_boulder)], NEAR)
    east, north, up = model.mesh.points.T
    face = (np.abs(north - 5) < 0.02) & (np.abs(east) < 0.45) & (up > 0.1) & (up < 0.4)
    assert face.sum() > 10
    tall = np.ptp(corners(model.mesh)[..., 2], axis=1) > 0.2
    assert tall.any()
    reach = corners(model.mesh)[tall][..., 1]  # some pixels of ground in front of it, and its top
    assert ((reach > 4.8) & (reach < 5.2)).all()  # but not the ground behind, seen from 6.5 m on


def test_ground_that_two_pairs_see_is_drawn_by_one(scenes):
    views = [scenes.view_of(scenes.level, azimuth, pair=i) for i, azimuth in enumerate((0, 20))]
    alone = [areas(view_meshes([view], NEAR)[0].mesh).sum() for view in views]
    halves = view_meshes(views, replace(NEAR, yield_to=1.0))
    together = [areas(model.mesh) for model in halves]
    field_deg = 2 * np.degrees(np.arctan(127.5 / 300))
    expected = alone[0] * (field_deg + 20) / field_deg  # sectors that overlap, seen as one
    assert sum(part.sum() for part in together) == pytest.approx(expected, rel=0.06)
    assert sum(alone) > 1.3 * expected


def test_the_texture_is_the_image_and_lies_on_its_pixels(scenes):
    def striped(_east, north):
        return np.where(north > 4.5, 200.0, 50.0)

    (model,) = view_meshes([scenes.view_of(scenes.level, albedo=striped)], NEAR)
    lines, samples = model.texture.shape
    col = np.rint(model.mesh.texture_at[:, 0] * samples - 0.5).astype(int)
    row = np.rint(model.mesh.texture_at[:, 1] * lines - 0.5).astype(int)
    bright = model.mesh.points[:, 1] > 4.5
    assert (model.texture[row, col][bright] == 255).all()
    assert (model.texture[row, col][~bright] == 0).all()


def test_specks_are_bridged_and_wider_gaps_stay_open(scenes):
    view = scenes.view_of(scenes.tilted)
    drawn = [areas(view_meshes([view], NEAR)[0].mesh).sum()]
    for side in (3, 12):
        gapped = view.parallax.copy()
        gapped[150 : 150 + side, 100 : 100 + side] = np.nan
        (model,) = view_meshes([replace(view, parallax=gapped)], NEAR)
        east, north, up = model.mesh.points.T
        np.testing.assert_allclose(up, scenes.tilted(east, north), atol=2e-3)
        drawn.append(areas(model.mesh).sum())
    whole, specked, gapped = drawn
    assert specked == pytest.approx(whole, rel=1e-4)
    assert gapped < whole * (1 - 1e-3)


def test_views_without_near_ground_are_refused(scenes):
    view = scenes.view_of(scenes.level, dip_deg=-40.0)
    with pytest.raises(TerrainError, match=r"none of the 1 views .* 1\.0% of its distance"):
        view_meshes([view], ViewModelParams())
