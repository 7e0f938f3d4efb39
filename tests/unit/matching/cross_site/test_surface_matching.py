from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    Ground,
    GroundPair,
    SurfaceParams,
    SurfaceView,
)
from solmap.photogrammetry.matching.cross_site.surface_matching import (
    SurfaceTieParams,
    tie_by_surface,
)
from solmap.photogrammetry.matching.parallax_planes import EVERY, parallax_facets
from tests.support.rolling_stops import (
    TOWARDS_FIRST,
    TOWARDS_SECOND,
    camera,
)

PARAMS = SurfaceTieParams(surface=SurfaceParams(step_px=2), block_m=2.0, largest_sigma_m=0.05)
"""Images of 256 pixels over ground without stones: every second pixel is needed."""
ALL_PAIRS = np.radians(-16)
ACROSS = np.array([-6.0, 7.0, 0.0]) / np.hypot(6.0, 7.0)
"""Of the way from the earlier stop to the later one."""


def seen(stop, stand, azimuths, moved=None):
    """Surfaces of a stop in the LSL, its pairs as they truly pointed, perhaps moved as a whole."""
    truth = [camera(stop.stop, k, angle, ALL_PAIRS) for k, angle in enumerate(azimuths)]
    pose = moved @ stand.true if moved else stand.true
    return {
        pair.pair_id: SurfaceView.of(
            pair.images.geometry, pair.parallax, pose @ true.rover_from_pair, 5
        )
        for pair, true in zip(stop.pairs, truth, strict=True)
    }


@pytest.fixture(scope="module")
def earlier(first_stop, first_stand):
    return seen(first_stop, first_stand, TOWARDS_SECOND)


@pytest.fixture(scope="module")
def later(second_stop, second_stand):
    return seen(second_stop, second_stand, TOWARDS_FIRST)


def misplaced(stop, stand, across_m, azimuth_deg):
    """The later stop as ties by looks may leave it: moved across the view, and turned."""
    turn = Rotation.from_euler("z", np.radians(azimuth_deg)).as_matrix()
    lsl, about = stand.true.target, stand.true.translation_m
    move = Pose(lsl, lsl, turn, about - turn @ about + across_m * ACROSS)
    return seen(stop, stand, TOWARDS_FIRST, move)


def off_px(ties, earlier, later):
    """Where the later pairs of the ties truly see the points, less where the ties say so."""
    off = np.full((len(ties), 3), np.nan)
    for k in range(len(ties)):
        one = earlier[ties.pair_ids[ties.first[k]]]
        other = later[ties.pair_ids[ties.second[k]]]
        place = one.place(ties.first_left[k : k + 1], ties.first_parallax_px[k : k + 1])
        left, parallax = other.geometry.project((place - other.centre) @ other.rotation)
        off[k] = [*(ties.second_left[k] - left[0]), ties.second_parallax_px[k] - parallax[0]]
    return off


@pytest.mark.parametrize(("across_m", "azimuth_deg"), [(0.1, -0.15), (-0.1, 0.15), (0.1, 0.0)])
def test_blocks_lead_back_to_where_the_stop_truly_stood(
    earlier, later, second_stop, second_stand, across_m, azimuth_deg
):
    wrong = misplaced(second_stop, second_stand, across_m, azimuth_deg)
    ties = tie_by_surface(earlier, wrong, PARAMS)
    assert len(ties) >= PARAMS.least
    weight = ties.second_sigma_px**-2
    off, assumed = (
        np.average(off_px(ties, earlier, views)[:, 0], weights=weight) for views in (later, wrong)
    )
    assert abs(off) < 0.35 * abs(assumed)  # some 1 and 5 pixels


def test_bearings_are_known_and_ranges_are_not(earlier, later):
    ties = tie_by_surface(earlier, later, PARAMS)
    z = off_px(ties, earlier, later) / np.column_stack(
        [ties.second_sigma_px, ties.second_sigma_line_px, ties.second_sigma_parallax_px]
    )
    assert (np.percentile(np.abs(z), 68, axis=0) < 1.2).all()
    range_m = 320.0 * 0.4 / ties.second_parallax_px
    sigma_range_m = range_m * ties.second_sigma_parallax_px / ties.second_parallax_px
    across_m = ties.second_sigma_px / 320.0 * range_m
    assert np.median(across_m) < 0.1
    assert np.median(sigma_range_m) > 3 * np.median(across_m)


def test_a_block_becomes_one_tie_by_the_pairs_most_certain_of_it(earlier, later):
    few = tie_by_surface(earlier, later, replace(PARAMS, most=10))
    assert len(few) == 10
    places = np.array(
        [earlier[few.pair_ids[few.first[k]]].place(few.first_left[k : k + 1],
         few.first_parallax_px[k : k + 1])[0] for k in range(10)]
    )  # fmt: skip
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 10 * np.eye(10)
    assert apart.min() > 0.2  # the middles of blocks a metre wide


def test_level_ground_has_no_shape_to_tie_by(earlier, later):
    def levelled(views):
        out = {}
        for name, view in views.items():
            line, sample = np.indices(view.parallax.shape, dtype=float)
            points = np.column_stack([sample.ravel(), line.ravel()])
            down = (view.geometry.rays(points) @ view.rotation.T)[:, 2]
            depth = -view.centre[2] / np.where(down > 0.03, down, np.nan)
            parallax = view.geometry.focal_px * view.geometry.base_m / depth
            parallax = parallax.reshape(view.parallax.shape).astype(np.float32)
            out[name] = replace(view, parallax=parallax)
        return out

    assert len(tie_by_surface(levelled(earlier), levelled(later), PARAMS)) == 0


def test_stops_that_share_no_ground_are_not_tied(earlier, later):
    away = {
        name: replace(v, centre=v.centre + np.array([200.0, 0, 0])) for name, v in later.items()
    }
    ties = tie_by_surface(earlier, away, PARAMS)
    assert len(ties) == 0
    assert ties.pair_ids == (*earlier, *later)


def test_the_motion_between_two_pairs_is_found(earlier, second_stop, second_stand):
    wrong = misplaced(second_stop, second_stand, 0.06, 0.15)
    one = Ground.of(earlier["P001"], wrong["P012"].centre, PARAMS.surface)
    other = Ground.of(wrong["P012"], earlier["P001"].centre, PARAMS.surface)
    couple = GroundPair.of(one, other, PARAMS.surface)
    assert couple is not None
    motion = couple.align(PARAMS.surface)
    there = np.array([7.0, 6.0, 0.0])
    turn = np.radians(0.15) * np.array([0, 0, 1.0])
    back = -(0.06 * ACROSS + np.cross(turn, couple.middle - there))
    assert np.linalg.norm(back) > 0.04
    assert motion[3:] @ couple.across == pytest.approx(back @ couple.across, abs=0.015)


def test_misfits_follow_a_shift_as_their_derivatives_say(earlier, later):
    target = later["P012"]
    ground = Ground.of(earlier["P001"], target.centre, PARAMS.surface)
    rest = np.zeros((len(ground), 3))
    here = ground.compare(target, rest, PARAMS.surface)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-5
        there = ground.compare(target, rest + step, PARAMS.surface)
        both, i, j = np.intersect1d(here.row, there.row, return_indices=True)
        slope = (there.misfit_px[j] - here.misfit_px[i]) / 1e-5
        same = np.abs(slope - here.by_shift[i, axis]) < 0.02 * np.abs(slope) + 0.05
        assert len(both) > 50
        assert same.mean() > 0.97  # the others crossed into the next facet


def test_facets_of_a_plane_of_parallax_are_that_plane(rng):
    line, sample = np.indices((64, 80), dtype=float)
    parallax = (20 + 0.03 * sample - 0.2 * line).astype(np.float32)
    parallax[:20, :30] = np.nan
    value, along, down, residual = parallax_facets(parallax, 5)
    assert np.isnan(value[0, 0])
    known = np.isfinite(value)
    assert known.mean() > 0.7
    plane = 20 + 0.03 * sample - 0.2 * line
    np.testing.assert_allclose(value[known], plane[::EVERY, ::EVERY][known], atol=1e-4)
    np.testing.assert_allclose(along[known], 0.03, atol=1e-4)
    np.testing.assert_allclose(down[known], -0.2, atol=1e-4)
    assert residual[known].max() < 1e-2
    noisy = parallax_facets((parallax + rng.normal(0, 0.3, parallax.shape)).astype(np.float32), 5)
    assert np.median(noisy[3][known]) == pytest.approx(0.3, rel=0.15)


def test_level_ground_is_seen_under_the_angle_of_the_ray(earlier):
    view = next(iter(earlier.values()))
    places = view.centre + np.array([[10.0, 0.0, 1.5], [3.0, 0.0, 1.5]])
    down = np.tile([0.0, 0.0, 1.0], (2, 1))
    np.testing.assert_allclose(
        view.facing(down, places), 1.5 / np.hypot([10.0, 3.0], 1.5), rtol=1e-12
    )
    assert (view.facing(-down, places) < 0).all()


@pytest.mark.parametrize("wrong", [{"block_m": 0.0}, {"least_points": 0}, {"most": 3}])
def test_blocks_have_a_size_points_and_a_number(wrong):
    with pytest.raises(MatchingError, match="above zero"):
        SurfaceTieParams(**wrong)


@pytest.mark.parametrize("wrong", [{"step_px": 0}, {"correlated": 0.5}, {"rounds": 0}])
def test_ground_is_compared_in_steps_and_rounds(wrong):
    with pytest.raises(MatchingError, match="at least one"):
        SurfaceParams(**wrong)
