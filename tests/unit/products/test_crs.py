import numpy as np
import pytest
import rasterio
from hypothesis import assume, given
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from solmap.products.crs import (
    IAU_RADIUS_M,
    MARS,
    LandingPoint,
    crs_text,
    east_north,
    height_reference,
    local_crs,
    local_proj4,
    lon_lat,
    untied_origin,
)
from solmap.products.errors import ProductError

SPIRIT = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, IAU_RADIUS_M, "a test")
GUSEV = LandingPoint("floor of Gusev", 175.4729, -14.5692, 3_393_000.0, "a test")
PROJ_SEES_NO_NEARER_M = 1e-10 * 3.4e6
"""PROJ takes what is nearer to the landing point, on a sphere of radius 1, for the point itself."""
within_10_km = st.floats(-10_000.0, 10_000.0)


def test_an_untied_map_has_an_engineering_crs_that_states_it():
    untied = SPIRIT.untied("site 137")
    name = "origin: site 137, not tied to the lander"
    crs = local_crs(untied)
    assert (crs.name, crs.is_engineering, crs.to_epsg()) == (f"{name} (east, north)", True, None)
    assert untied_origin(crs) == name
    assert untied_origin(local_crs(SPIRIT)) is None
    assert height_reference(crs) == f"metres above the {name}"
    assert local_proj4(untied) is None
    assert crs_text(untied).startswith(f'ENGCRS["{name}')
    assert np.isnan(lon_lat(untied, np.zeros(3), np.zeros(3))).all()
    assert np.isnan(east_north(untied, 175.0, -14.0)).all()
    assert SPIRIT.untied("site 10") != untied


def test_the_sites_of_spirit_agree_with_an_independent_computation(test_vectors):
    for point in test_vectors["map_coordinates"]["points"]:
        longitude, latitude = lon_lat(SPIRIT, *point["east_north_m"])
        # The vectors are given to 1e-12 degrees; 1e-10 degrees are six micrometres.
        np.testing.assert_allclose([longitude[0], latitude[0]], point["lon_lat_deg"], atol=1e-10)


@given(east=within_10_km, north=within_10_km)
def test_conversion_to_degrees_and_back_is_exact(east, north):
    assume(np.hypot(east, north) > PROJ_SEES_NO_NEARER_M)
    back = east_north(GUSEV, *lon_lat(GUSEV, east, north))
    np.testing.assert_allclose(np.concatenate(back), [east, north], atol=1e-7)


@given(east=within_10_km, north=within_10_km)
def test_east_and_north_are_those_of_the_tangent_plane(east, north):
    assume(np.hypot(east, north) > PROJ_SEES_NO_NEARER_M)
    longitude, latitude = np.radians(np.concatenate(lon_lat(GUSEV, east, north)))
    middle_lon, middle_lat = np.radians([GUSEV.longitude, GUSEV.latitude])
    place = GUSEV.radius_m * np.array(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    eastward = np.array([-np.sin(middle_lon), np.cos(middle_lon), 0.0])
    northward = np.array(
        [
            -np.sin(middle_lat) * np.cos(middle_lon),
            -np.sin(middle_lat) * np.sin(middle_lon),
            np.cos(middle_lat),
        ]
    )
    # A metre of Mars in double precision: 3.4e6 m times 2.2e-16, and some.
    np.testing.assert_allclose([place @ eastward, place @ northward], [east, north], atol=1e-7)


def test_the_wrong_radius_is_metres_off_seven_kilometres_from_the_lander():
    seven_km = (4_950.0, 4_950.0)
    on_iau_sphere = east_north(GUSEV, *lon_lat(SPIRIT, *seven_km))
    off = np.hypot(*(np.concatenate(on_iau_sphere) - seven_km))
    assert off == pytest.approx(7_000 * (1 - 3_393_000.0 / IAU_RADIUS_M), rel=1e-3)
    assert off > 6.0


def test_the_map_of_a_point_on_the_iau_sphere_is_on_the_iau_mars():
    assert local_crs(SPIRIT).geodetic_crs.to_authority() == ("IAU_2015", "49900")
    assert local_crs(SPIRIT).geodetic_crs.equals(CRS(MARS), ignore_axis_order=True)


def test_a_landing_point_with_its_own_radius_has_a_sphere_named_after_it():
    crs = local_crs(GUSEV)
    assert crs.ellipsoid.semi_major_metre == 3_393_000.0
    assert "floor of Gusev" in crs.geodetic_crs.name
    assert crs.axis_info[0].direction == "east"


@pytest.mark.parametrize("landing", [SPIRIT, GUSEV])
def test_the_crs_is_of_mars_and_has_no_transformation_to_earth(landing):
    to_mars = Transformer.from_crs(local_crs(landing), MARS, always_xy=True)
    np.testing.assert_allclose(
        to_mars.transform(1000.0, 2000.0), np.concatenate(lon_lat(landing, 1000.0, 2000.0))
    )
    with pytest.raises(ProjError, match="celestial body"):
        Transformer.from_crs(local_crs(landing), "EPSG:4326")


@pytest.mark.parametrize("landing", [SPIRIT, GUSEV])
def test_the_proj_string_is_the_same_map(landing):
    same = Transformer.from_crs(local_proj4(landing), local_crs(landing), always_xy=True)
    np.testing.assert_allclose(same.transform(7000.0, -3000.0), (7000.0, -3000.0), atol=1e-9)


@pytest.mark.parametrize("landing", [SPIRIT, GUSEV])
def test_rasterio_understands_the_crs(landing):
    crs = rasterio.CRS.from_wkt(local_crs(landing).to_wkt())
    assert crs.is_projected
    assert crs.linear_units == "metre"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"longitude": 400.0}, "not on a globe"),
        ({"latitude": -91.0}, "not on a globe"),
        ({"radius_m": 3393.0}, "metres near 3396190"),
        ({"radius_m": 6_371_000.0}, "no ground"),
        ({"name": 'a "quoted" name'}, "cannot name"),
    ],
)
def test_an_impossible_landing_point_is_refused_with_the_reason(wrong, message):
    good = {"name": "x", "longitude": 1.0, "latitude": 1.0, "radius_m": 3.39e6, "source": "t"}
    with pytest.raises(ProductError, match=message):
        LandingPoint(**{**good, **wrong})
