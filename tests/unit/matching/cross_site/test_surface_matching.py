from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import projection_partials
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.cross_site import surface_matching
from solmap.photogrammetry.matching.cross_site.gate import level_pose
from solmap.photogrammetry.matching.cross_site.ground_grid import GroundGrid
from solmap.photogrammetry.matching.cross_site.surface_alignment import (
    SurfaceParams,
    register,
)
from solmap.photogrammetry.matching.cross_site.surface_matching import (
    CERTAIN,
    HYPOTHESIS_SIGMAS,
    SurfaceTieParams,
    significance,
    tie_by_surface,
    try_shapes,
)

PARAMS = SurfaceTieParams(least_cells=20)
PRIOR = np.diag(np.square(HYPOTHESIS_SIGMAS))


@pytest.fixture(scope="module")
def stops(first_stop, second_stop):
    return first_stop, second_stop


@pytest.fixture(scope="module")
def grids(stops):
    surface = PARAMS.surface
    first, second = (GroundGrid.of(s, surface.cell_m, surface.farthest_m) for s in stops)
    return first, second


@pytest.fixture(scope="module")
def true(stops, first_stand, second_stand):
    return level_pose(*stops, first_stand.true.inverse @ second_stand.true)


def moved(pose, *shift_m):
    return Pose(pose.target, pose.source, pose.rotation, pose.translation_m + np.array(shift_m))


@pytest.fixture(scope="module")
def found(grids, true):
    return register(*grids, moved(true, 0.2, -0.15, 0.1), PRIOR, PARAMS.surface)


def test_surface_matching_finds_the_true_position_of_the_stop(found, true):
    off_m = found.pose.translation_m - true.translation_m
    assert np.linalg.norm(off_m) < 0.06  # labels point 1 mrad wrong
    assert found.correlation > 0.8


def test_surface_matching_does_not_depend_on_its_start(grids, true, found):
    other = register(*grids, moved(true, -0.2, 0.1, -0.1), PRIOR, PARAMS.surface)
    apart_m = np.linalg.norm(other.pose.translation_m - found.pose.translation_m)
    assert apart_m < 0.01


def test_relief_distinguishes_the_true_place_from_others(grids, true):
    wrong = [moved(true, 2.5, 0, 0), moved(true, 0, -2.5, 0)]
    trial = try_shapes(grids, [wrong[0], true], wrong[1:], 1.5, PARAMS.surface)
    assert significance(trial.found) - trial.by_chance > CERTAIN
    assert np.linalg.norm(trial.found.pose.translation_m - true.translation_m) < 0.06


def test_wrong_places_alone_are_rejected(grids, true):
    wrong = [moved(true, 6, 0, 0), moved(true, 0, -6, 0), moved(true, -6, 0, 0)]
    assert try_shapes(grids, wrong[:2], wrong[2:], 1.5, PARAMS.surface) is None


def test_the_first_hypothesis_is_refused_below_its_threshold(grids, true):
    wrong = [moved(true, 2.5, 0, 0)]
    found = try_shapes(grids, [true], wrong, 1.5, PARAMS.surface)
    needed = significance(found.found) - found.by_chance + 0.1
    assert try_shapes(grids, [true], wrong, 1.5, PARAMS.surface, first_needs=needed) is None


def test_insignificant_relief_is_refused_at_the_only_hypothesis(grids, true, monkeypatch):
    found = try_shapes(grids, [true], [], 1.5, PARAMS.surface)
    assert found.by_chance == 0
    monkeypatch.setattr(surface_matching, "CERTAIN", significance(found.found) + 0.1)
    assert try_shapes(grids, [true], [], 1.5, PARAMS.surface) is None


def test_a_high_correlation_over_little_ground_does_not_count_as_more(found):
    little = replace(found, correlation=0.5, area_m2=5.0)
    much = replace(found, correlation=0.4, area_m2=300.0)
    assert significance(little) < 1 < CERTAIN < significance(much)


def test_blocks_become_ties_between_pairs_of_both_stops(stops, found):
    ties = tie_by_surface(stops, found, PARAMS)
    assert len(ties) >= PARAMS.least
    assert ties.surface_matched.all()
    ids = np.array(ties.pair_ids)
    assert set(ids[ties.first]) <= {pair.pair_id for pair in stops[0].pairs}
    assert set(ids[ties.second]) <= {pair.pair_id for pair in stops[1].pairs}
    rays = np.column_stack(
        [ties.second_sigma_px, ties.second_sigma_line_px, ties.second_sigma_parallax_px]
    )
    assert (rays > 0).all()


def weight_of(ties, stops, found):
    """Information of all ties on the pose of the later stop: the inverse of its covariance."""
    later, skipped = stops[1], len(stops[0].pairs)
    sigmas = np.column_stack(
        [ties.second_sigma_px, ties.second_sigma_line_px, ties.second_sigma_parallax_px]
    )
    known = np.zeros((6, 6))
    for k, pair in enumerate(later.pairs):
        rows, g = ties.second == k + skipped, pair.geometry
        in_pair = g.triangulate(ties.second_left[rows], ties.second_parallax_px[rows])
        turn = found.pose.rotation @ later.lsl_from_rover.rotation
        arms = g.rover_from_pair.apply(in_pair) @ turn.T
        by_shift = projection_partials(in_pair, g.focal_px, g.base_m)
        by_shift = by_shift @ (turn @ g.rover_from_pair.rotation).T
        by_pose = np.concatenate([np.cross(arms[:, None], by_shift), by_shift], axis=2)
        weighed = (by_pose / sigmas[rows, :, None]).reshape(-1, 6)
        known += weighed.T @ weighed
    return known


def directions(true):
    """Partial motions of the later stop: azimuth, range, shift across."""
    ahead = np.array([*true.translation_m[:2], 0.0]) / np.linalg.norm(true.translation_m[:2])
    azimuth = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    across = np.array([-ahead[1], ahead[0], 0.0])
    return np.array([azimuth, [0, 0, 0, *ahead], [0, 0, 0, *across]])


def test_ties_determine_the_pose_as_well_as_the_registration(stops, found, true):
    ties = tie_by_surface(stops, found, PARAMS)
    by_ties = np.linalg.inv(weight_of(ties, stops, found))
    some = directions(true)
    stated, reached = (
        np.sqrt(np.diag(some @ covariance @ some.T)) for covariance in (found.covariance, by_ties)
    )
    assert (np.abs(np.log(reached / stated)) < np.log(1.55)).all()
    loose = tie_by_surface(stops, replace(found, covariance=100 * found.covariance), PARAMS)
    np.testing.assert_allclose(loose.second_sigma_px, 10 * ties.second_sigma_px)


def points_of(ties, pairs, which):
    """Points of ties in the rover frame, by their first or second measurement."""
    number, left, parallax_px = (
        getattr(ties, name.format(which)) for name in ("{}", "{}_left", "{}_parallax_px")
    )
    shapes = [pairs[k].geometry for k in number]
    return np.array(
        [
            g.rover_from_pair.apply(g.triangulate(p[None], d[None]))[0]
            for g, p, d in zip(shapes, left, parallax_px, strict=True)
        ]
    )


def test_ties_lie_at_the_registered_pose(stops, found):
    ties = tie_by_surface(stops, found, PARAMS)
    pairs = [pair for stop in stops for pair in stop.pairs]
    first, second = (
        points_of(ties, pairs, which) @ stop.lsl_from_rover.rotation.T
        for which, stop in zip(("first", "second"), stops, strict=True)
    )
    np.testing.assert_allclose(found.pose.apply(second), first, atol=1e-6)


def test_stops_without_common_ground_are_not_aligned(grids, true):
    assert register(*grids, moved(true, 60, 0, 0), PRIOR, PARAMS.surface) is None


def levelled(grids, **changes):
    return [
        replace(grid, up=np.where(np.isfinite(grid.up), 0.0, np.nan).astype(np.float32), **changes)
        for grid in grids
    ]


def test_level_ground_determines_no_place(grids, true):
    laid = register(*levelled(grids, brightness=None), true, PRIOR, PARAMS.surface)
    assert np.sqrt(laid.covariance[3, 3]) > 0.2


def test_brightness_of_level_ground_determines_its_place(grids, true):
    start = moved(true, 0.03, -0.02, 0.0)
    laid = register(*levelled(grids), start, PRIOR, PARAMS.surface)
    across = np.array([-true.translation_m[1], true.translation_m[0], 0.0])
    across /= np.linalg.norm(across)
    off_m = across @ (laid.pose.translation_m - true.translation_m)
    sigma_m = np.sqrt(across @ laid.covariance[3:, 3:] @ across)
    assert sigma_m < 0.03
    assert abs(off_m) < 3 * sigma_m


@pytest.mark.parametrize("wrong", [{"block_m": 0.0}, {"least_cells": 0}, {"most": 3}])
def test_block_parameters_have_limits(wrong):
    with pytest.raises(MatchingError, match="above zero"):
        SurfaceTieParams(**wrong)


def test_ground_is_compared_in_rounds():
    with pytest.raises(MatchingError, match="at least one round"):
        SurfaceParams(rounds=0)
