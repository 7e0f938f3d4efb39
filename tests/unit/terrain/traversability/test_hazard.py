"""Hazards of surfaces whose tilt, steps and roughness are known."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.terrain.dtm import parts
from solmap.photogrammetry.terrain.traversability.hazard import Hazard, HazardParams, hazards

PARAMS = HazardParams()


def plane(slope_deg, azimuth_deg=70.0):
    """A plane that falls towards the azimuth."""
    g, a = np.tan(np.radians(slope_deg)), np.radians(azimuth_deg)
    return lambda east, north: -g * (np.sin(a) * east + np.cos(a) * north)


def rock(height_m, slope_deg=0.0):
    """A block 0.5 m wide in the middle of a plane."""
    below = plane(slope_deg)

    def surface(east, north):
        on = (np.abs(east) < 0.25) & (np.abs(north) < 0.25)
        return below(east, north) + np.where(on, height_m, 0.0)

    return surface


def evaluated(scenes, surface, params=PARAMS, side=512):
    dtm = scenes.dtm_of(surface, side=side)
    return hazards(dtm, params)


def middle(classes, grid, radius_m):
    east, north = np.meshgrid(*grid.centres())
    return classes[np.hypot(east, north) < radius_m]


def test_level_ground_is_traversable(scenes):
    classes, grid = evaluated(scenes, scenes.level)
    assert (middle(classes, grid, 8.0) == Hazard.TRAVERSABLE).all()


@pytest.mark.parametrize(
    ("slope_deg", "found"), [(19.0, Hazard.TRAVERSABLE), (21.0, Hazard.STEEP), (45.0, Hazard.STEEP)]
)
def test_ground_is_steep_beyond_the_largest_tilt(scenes, slope_deg, found):
    classes, grid = evaluated(scenes, plane(slope_deg))
    assert (middle(classes, grid, 8.0) == found).all()


@pytest.mark.parametrize("slope_deg", [0.0, 15.0])
def test_a_rock_higher_than_a_wheel_can_pass_blocks_the_whole_rover(scenes, slope_deg):
    classes, grid = evaluated(scenes, rock(0.26, slope_deg))
    east, north = np.meshgrid(*grid.centres())
    away = np.hypot(east, north)
    assert (classes[away < 1.2] == Hazard.STEP).all()
    assert (classes[(away > 2.2) & (away < 8.0)] == Hazard.TRAVERSABLE).all()


def test_a_rock_that_a_wheel_can_pass_does_not_block(scenes):
    classes, grid = evaluated(scenes, rock(0.15, 15.0))
    assert (middle(classes, grid, 8.0) == Hazard.TRAVERSABLE).all()


def test_dunes_without_steps_or_tilt_are_rough(scenes):
    # two dunes in a rover's window: the plane through them is level, and a cell's rise below a step
    def dunes(east, north):
        return 0.17 * np.sin(2 * np.pi * east / 1.36) + 0.0 * north

    classes, grid = evaluated(scenes, dunes, replace(PARAMS, highest_step_m=0.5))
    assert (middle(classes, grid, 5.0) == Hazard.ROUGH).all()
    classes, grid = evaluated(scenes, dunes, replace(PARAMS, highest_step_m=0.5, roughest_m=0.13))
    assert (middle(classes, grid, 5.0) == Hazard.TRAVERSABLE).all()


def test_unseen_ground_and_its_border_are_unknown(scenes):
    dtm = scenes.dtm_of(scenes.level, side=512)
    dtm.elevation[:, 256:] = np.nan
    classes, grid = hazards(dtm, PARAMS)
    east, north = np.meshgrid(*grid.centres())
    inside = np.abs(north) < 8
    assert (classes[inside & (east > 0)] == Hazard.UNKNOWN).all()
    assert (classes[inside & (east < 0) & (east > -0.4)] == Hazard.UNKNOWN).all()
    assert (classes[inside & (east < -1) & (east > -8)] == Hazard.TRAVERSABLE).all()


def test_a_hazard_beside_unseen_ground_is_marked(scenes):
    dtm = scenes.dtm_of(rock(0.4), side=512)
    east, _ = np.meshgrid(*dtm.grid.centres())
    dtm.elevation[east > 0.3] = np.nan
    classes, grid = hazards(dtm, PARAMS)
    east, north = np.meshgrid(*grid.centres())
    assert (classes[(np.abs(north) < 0.5) & (east < 0) & (east > -0.5)] == Hazard.STEP).all()


def test_ground_too_uncertain_for_a_step_is_unknown(scenes):
    dtm = scenes.dtm_of(scenes.level, side=512)
    poor = replace(dtm, sigma_m=np.full(dtm.grid.shape, 0.1, np.float32))
    classes, _ = hazards(poor, PARAMS)
    assert (classes == Hazard.UNKNOWN).all()
    shared = replace(poor, pose_sigma_m=np.full(dtm.grid.shape, 0.098, np.float32))
    classes, grid = hazards(shared, PARAMS)
    assert (middle(classes, grid, 8.0) == Hazard.TRAVERSABLE).all()


def test_strips_of_a_large_map_have_no_seams(scenes, rng, monkeypatch):
    dtm = scenes.dtm_of(plane(8.0), side=1024)
    rocks = rng.random((32, 32)) < 0.02
    dtm.elevation[:] += np.kron(rocks, np.ones((32, 32))).astype(np.float32) * 0.3
    whole, _ = hazards(dtm, PARAMS)
    monkeypatch.setattr(parts, "STRIP", 1)
    strips, _ = hazards(dtm, PARAMS)
    assert len(np.unique(whole)) > 2
    np.testing.assert_array_equal(strips, whole)


def test_a_limit_of_zero_is_an_error():
    with pytest.raises(TerrainError, match="must be above zero"):
        HazardParams(highest_step_m=0.0)
