"""Ground under two suns: how it is relit, and what that does to ties between stops."""

from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.matching.cross_site import light
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from tests.support import rolling_stops
from tests.unit.matching.cross_site.test_linking import PARAMS


def sun_at(azimuth_deg, elevation_deg):
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])


MORNING, EVENING = sun_at(90, 32), sun_at(270, 28)


def sunlit(north, east, sun, step_m=0.01):
    """Expected shading of the rolling ground, from its true slopes."""
    rise = [
        (
            rolling_stops.elevation(north + n, east + e)
            - rolling_stops.elevation(north - n, east - e)
        )
        / (2 * step_m)
        for n, e in ((step_m, 0.0), (0.0, step_m))
    ]
    length = np.sqrt(1 + rise[0] ** 2 + rise[1] ** 2)
    direct = (-rise[0] * sun[0] - rise[1] * sun[1] - sun[2]) / length
    return np.maximum(direct, 0) + light.SKY_LIGHT * (1 + 1 / length) / 2


@pytest.fixture(scope="module")
def dusty_stops(first_stand, second_stand):
    """Two stops on ground of little albedo, the first in the morning, the second in the evening."""
    patch = pytest.MonkeyPatch()
    made = []
    looks = (
        (first_stand, rolling_stops.TOWARDS_SECOND[1:3], MORNING),
        (second_stand, rolling_stops.TOWARDS_FIRST[1:3], EVENING),
    )
    grey = rolling_stops.ground_grey
    for stand, azimuths, sun in looks:

        def lit(seed, north, east, _, sun=sun):
            albedo = grey(seed, north, east, 0.0) / 1000
            return 1000 * (1 + 0.15 * (albedo - 1)) * sunlit(north, east, sun)

        patch.setattr(rolling_stops, "ground_grey", lit)
        stop = rolling_stops.photographed(stand, azimuths)
        pairs = tuple(replace(pair, sun=sun) for pair in stop.pairs)
        made.append(replace(stop, pairs=pairs, lsl_from_rover=stand.true))
    patch.undo()
    return made


def test_relit_ground_resembles_an_image_under_the_other_sun(rng):
    places = rng.uniform(-10, 10, (2, 500))
    rise = [
        (rolling_stops.elevation(*(places + d)) - rolling_stops.elevation(*(places - d))) / 0.02
        for d in ([[0.01], [0.0]], [[0.0], [0.01]])
    ]
    seen, requested = (sunlit(*places, sun) for sun in (MORNING, EVENING))
    brighter = light.relighting(*np.float32(rise), MORNING, EVENING)
    np.testing.assert_allclose(seen * brighter, requested, rtol=1e-3)
    assert np.corrcoef(seen, requested)[0, 1] < -0.5  # lit faces and shaded ones change places


def test_relighting_under_the_same_sun_changes_nothing(rng):
    rise = np.float32(rng.normal(0, 0.3, (2, 50)))
    np.testing.assert_array_equal(light.relighting(*rise, EVENING, EVENING), 1.0)
    np.testing.assert_array_equal(light.shadow_difference(EVENING, EVENING), 0.0)


def test_slopes_rise_towards_north_and_east_and_are_level_where_unknown():
    row, col = np.mgrid[:9, :9].astype(np.float32)
    elevation = (0.1 * (8 - row) * 0.5 + 0.2 * col * 0.5).astype(np.float32)
    elevation[0, 0] = np.nan
    north, east = light.slopes(elevation, 0.5)
    np.testing.assert_allclose([north[4, 4], east[4, 4]], [0.1, 0.2], rtol=1e-5)
    assert np.isfinite([north, east]).all()


def test_shadows_of_a_stone_under_opposite_suns_differ_by_both_lengths():
    apart = light.shadow_difference(MORNING, EVENING)
    both = 1 / np.tan(np.radians(32)) + 1 / np.tan(np.radians(28))
    np.testing.assert_allclose(apart, [0.0, -both], atol=1e-9)
    low = light.shadow_difference(sun_at(90, -3), EVENING)
    assert np.isfinite(low).all()


def test_relit_patches_resemble_those_of_the_other_stop(dusty_stops, second_stand):
    one, other = (StopViews.of(stop, PARAMS.birds_eye) for stop in dusty_stops)
    places = np.stack(np.meshgrid(np.arange(2, 6, 0.5), np.arange(1.5, 5, 0.5)), axis=-1)
    places, cells = places.reshape(-1, 2), np.tile(0.12 * np.eye(2), (places.size // 2, 1, 1))
    there = places - second_stand.true.translation_m[:2]
    alike = {"as seen": [], "relit": []}
    for here in one.views:
        for view in other.views:
            requested, visible = view.draw_patches(there, cells, 6, 6)
            for look, sun in (("as seen", None), ("relit", view.sun)):
                drawn, whole = here.draw_patches(places, cells, 6, 6, sun)
                alike[look] += [
                    np.corrcoef(drawn[k].ravel(), requested[k].ravel())[0, 1]
                    for k in np.flatnonzero(whole & visible)
                ]
    assert len(alike["relit"]) > 20
    assert np.median(alike["as seen"]) < 0.2
    assert np.median(alike["relit"]) > 0.6


def test_relief_of_a_patch_is_its_height_above_its_mean_plane(dusty_stops):
    stop = StopViews.of(dusty_stops[0], PARAMS.birds_eye)
    view, step = stop.views[1], np.arange(-6, 7) * 0.12
    place = np.array([4.0, 3.0])
    north, east = np.meshgrid(place[0] + step, place[1] + step, indexing="ij")
    up = rolling_stops.elevation(north, east).ravel()
    design = np.column_stack([np.ones(up.size), north.ravel(), east.ravel()])
    rest = up - design @ np.linalg.lstsq(design, up, rcond=None)[0]
    relief_m = view.relief_m(place[None], 0.12 * np.eye(2)[None], 6)
    assert relief_m[0] == pytest.approx(rest.std(), rel=0.25)
