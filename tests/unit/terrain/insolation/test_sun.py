"""The sun of Mars and its dusty sky, against published figures."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.mars import planetographic
from solmap.photogrammetry.terrain.insolation.sun import (
    SOL_HOURS,
    Season,
    beam_share,
    diffuse_share,
    half_day,
    local_winter,
    net_flux,
    sun_directions,
)
from tests.support.terrain.insolation import daily_insolation_above

VIKING_1 = math.radians(22.3)
MARS_HOURS = 24 / SOL_HOURS
"""The tables count 24 hours a sol, each as long as 1.027 of the clock's."""


@pytest.mark.parametrize(
    ("ls_deg", "published"), [(69, 4136), (120, 4442), (153, 4620), (249, 3449), (299, 3350)]
)
def test_daily_insolation_above_the_atmosphere_equals_the_published(ls_deg, published):
    # Appelbaum and Flood 1990, table II; their perihelion (248) and obliquity (24.94) are 3 and
    # 0.25 degrees from ours
    ours = daily_insolation_above(VIKING_1, Season(float(ls_deg))) * MARS_HOURS
    assert ours == pytest.approx(published, rel=0.008)


def day_on_level_ground(ls_deg, optical_depth, tilt=0.0):
    """Beam on ground tilted to the equator and diffuse light on level ground, Wh/m2 a Mars day."""
    season = Season(ls_deg)
    half = half_day(VIKING_1, season.declination)
    hours = np.linspace(-half, half, 721)
    north, _, up = sun_directions(VIKING_1, season.declination, hours).T
    incidence = np.maximum(up * math.cos(tilt) - north * math.sin(tilt), 0)
    across = season.irradiance * beam_share(np.maximum(up, 0), optical_depth)
    beam = np.trapezoid(across * incidence, hours) * 12 / math.pi
    sky = season.irradiance * diffuse_share(np.maximum(up, 0), optical_depth)
    return beam, np.trapezoid(sky, hours) * 12 / math.pi


@pytest.mark.parametrize(
    ("ls_deg", "optical_depth", "published"),
    [(69, 0.65, 1768), (120, 0.4, 2534), (153, 0.5, 2308), (249, 1.4, 314), (299, 3.25, 12)],
)
def test_the_beam_on_the_ground_equals_the_published(ls_deg, optical_depth, published):
    beam, _ = day_on_level_ground(float(ls_deg), optical_depth)
    assert beam == pytest.approx(
        published, rel=0.025, abs=22
    )  # table V, read to two optical depths


@pytest.mark.parametrize(
    ("ls_deg", "beam_level", "all_level", "beam_tilted"),
    [(120.0, 2621.38, 3996.85, 2318.9), (180.0, 1610.06, 3601.57, 1736.1)],
)
def test_diffuse_light_and_light_on_tilted_ground_equal_the_published(
    ls_deg, beam_level, all_level, beam_tilted
):
    # Appelbaum and Landis 1991 (table V) and Appelbaum, Flood and Norambuena 1993 (table II) for
    # Viking 1; the optical depth of the day follows from the beam on level ground
    depth = brentq(lambda tau: day_on_level_ground(ls_deg, tau)[0] - beam_level, 0.1, 3.0)
    beam, sky = day_on_level_ground(ls_deg, depth)
    assert beam + sky == pytest.approx(all_level, rel=0.03)
    assert day_on_level_ground(ls_deg, depth, tilt=VIKING_1)[0] == pytest.approx(
        beam_tilted, rel=0.02
    )


def test_at_noon_of_the_equinox_the_sun_is_over_the_equator():
    direction = sun_directions(math.radians(-14.6), 0.0, np.zeros(1))[0]
    np.testing.assert_allclose(
        direction, [math.sin(math.radians(14.6)), 0, math.cos(0.25482)], 1e-4
    )


def test_the_sun_rises_in_the_east_and_is_a_unit_vector():
    directions = sun_directions(-0.25, 0.3, np.linspace(-2, 2, 41))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert directions[0, 1] > 0.5 > -0.5 > directions[-1, 1]


@pytest.mark.parametrize(
    ("latitude_deg", "ls_deg", "hours"), [(0.0, 17.0, 12.0), (70.0, 90.0, 24.0), (70.0, 270.0, 0.0)]
)
def test_day_length_follows_the_season(latitude_deg, ls_deg, hours):
    half = half_day(math.radians(latitude_deg), Season(ls_deg).declination)
    assert 24 * half / math.pi == pytest.approx(hours)


def test_winter_is_when_the_sun_is_over_the_other_hemisphere():
    assert local_winter(-0.25).ls_deg == 90.0
    assert local_winter(0.3).ls_deg == 270.0


def test_the_plumb_line_of_gusev_deviates_by_a_sixth_of_a_degree():
    centric = math.radians(-14.5692)
    assert math.degrees(planetographic(centric) - centric) == pytest.approx(-0.166, abs=0.001)


def test_without_dust_all_light_is_beam():
    cosines = np.cos(np.radians([0.0, 40.0, 80.0]))
    np.testing.assert_allclose(beam_share(cosines, 0.0), 1.0)
    np.testing.assert_allclose(diffuse_share(cosines, 0.0), 0.0, atol=1e-12)


def test_net_flux_equals_the_table_and_is_interpolated_between():
    assert net_flux(np.array([60.0]), 0.5)[0] == pytest.approx(0.708)
    assert net_flux(np.array([65.0]), 0.45)[0] == pytest.approx((0.740 + 0.667 + 0.708 + 0.628) / 4)


def test_more_dust_than_in_the_table_is_an_error():
    with pytest.raises(TerrainError, match=r"an optical depth of 9\.0 is outside .* 0\.0 to 6\.0"):
        net_flux(np.array([10.0]), 9.0)
