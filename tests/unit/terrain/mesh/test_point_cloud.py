"""Point clouds: on the surface within sigma, one point per cube, complete in their tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.mesh.point_cloud import (
    PointCloudParams,
    cloud_tiles,
    point_cloud,
)

NEAR = PointCloudParams(max_relative_sigma=0.03, spacing_m=0.05)  # the small camera sees 7 m
NOISE_PX = 0.2


@pytest.fixture(scope="module")
def noisy(scenes):
    """Two views of a tilted plane whose parallaxes have random errors of the stated size."""
    rng = np.random.default_rng(5)
    views = [scenes.view_of(scenes.tilted, azimuth, pair=i) for i, azimuth in enumerate((0, 20))]
    return [
        replace(
            view,
            parallax=(view.parallax + rng.normal(0, NOISE_PX, view.parallax.shape)).astype("f4"),
            sigma_px=np.full(view.parallax.shape, NOISE_PX, np.float32),
        )
        for view in views
    ]


@pytest.fixture(scope="module")
def cloud(noisy):
    return point_cloud(noisy, NEAR)


def test_points_are_on_the_ground_within_their_sigmas(scenes, cloud):
    """A point strays along its ray; of it, across the plane counts what points into that.

    The best known of a cube is nearer than the truth by a little, so they spread a sixth wider.
    """
    east, north, up = cloud.points.T
    ray = cloud.points - [0.0, 0.0, scenes.MAST_M]
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    normal = np.array([-0.05, 0.1, 1.0]) / np.linalg.norm([-0.05, 0.1, 1.0])
    away = (up - scenes.tilted(east, north)) * normal[2]
    in_sigmas = away / (np.abs(ray @ normal) * cloud.sigma_m)
    assert len(cloud) > 1000
    assert np.std(in_sigmas) == pytest.approx(1.0, abs=0.25)
    assert abs(np.median(in_sigmas)) < 0.2


def test_of_every_cube_the_most_certain_point_is_kept(noisy, cloud):
    cubes = np.floor(cloud.points / NEAR.spacing_m).astype(int)
    assert len(np.unique(cubes, axis=0)) == len(cubes)
    alone = point_cloud(noisy[:1], NEAR)
    both = {tuple(cube): sigma for cube, sigma in zip(cubes.tolist(), cloud.sigma_m, strict=True)}
    own = np.floor(alone.points / NEAR.spacing_m).astype(int).tolist()
    pairs = [(both[tuple(c)], s) for c, s in zip(own, alone.sigma_m, strict=True)]
    assert all(now <= before + 1e-5 for now, before in pairs)


def test_tiles_together_are_the_whole_cloud(cloud):
    tiles = list(cloud_tiles(cloud))
    together = np.concatenate([tile.cloud.points for tile in tiles])
    assert len(together) == len(cloud)
    np.testing.assert_array_equal(
        together[np.lexsort(together.T)], cloud.points[np.lexsort(cloud.points.T)]
    )
    levels = [tile.place.level for tile in tiles]
    assert levels[0] == max(levels) > 0
    assert levels == sorted(levels, reverse=True)
    assert sum(level == levels[0] for level in levels) == 1  # one root
    side = 256 * cloud.spacing_m
    for tile in tiles:
        span = np.ptp(tile.cloud.points[:, :2], axis=0).max()
        assert span <= side * 2**tile.place.level + 1e-9


def test_no_more_points_are_kept_than_requested(noisy):
    few = point_cloud(noisy, replace(NEAR, most_points=800))
    assert 100 < len(few) <= 800
    assert few.spacing_m > NEAR.spacing_m


def test_grey_values_are_those_of_the_image(scenes):
    def striped(_east, north):
        return np.where(north > 4.5, 200.0, 50.0)

    seen = point_cloud([scenes.view_of(scenes.level, albedo=striped)], NEAR)
    bright = seen.points[:, 1] > 4.5
    assert (seen.grey[bright] == 255).all()
    assert (seen.grey[~bright] == 0).all()


def test_the_absence_of_near_points_is_an_error(scenes):
    with pytest.raises(TerrainError, match="max_relative_sigma"):
        point_cloud([scenes.view_of(scenes.tilted)], replace(NEAR, max_relative_sigma=1e-6))
