from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose
from solmap.photogrammetry.matching.cross_site.tie_weights import (
    SHARED_HEIGHT_M,
    SHARED_LIGHT,
    SHARED_PARALLAX_PX,
    add_shared_errors,
    inflate_sigmas,
    overlap_counts,
    select_spread,
)
from solmap.photogrammetry.matching.records import Ties


def some_ties(n):
    whole, points, flat = np.zeros(n, np.int32), np.zeros((n, 2)), np.full(n, 0.1)
    return Ties(("a", "b"), whole, whole + 1, points, points + 1, *[flat] * 8)


def grid_of(side, step_m):
    north, east = np.meshgrid(np.arange(side) * step_m, np.arange(side) * step_m)
    return np.column_stack([north.ravel(), east.ravel()])


def test_ties_of_the_same_ground_count_as_one():
    np.testing.assert_allclose(overlap_counts(np.zeros((4, 2)), np.full(4, 1.4)), 4.0)


def test_ties_of_separate_ground_count_fully():
    np.testing.assert_allclose(overlap_counts(grid_of(3, 2.0), np.full(9, 1.9)), 1.0)


def test_two_patches_that_share_half_of_their_ground_count_half_for_each_other():
    places = np.array([[0.0, 0.0], [0.0, 0.7]])
    np.testing.assert_allclose(overlap_counts(places, np.full(2, 1.4)), 1.5)


def test_the_mean_of_overlapping_patches_scatters_as_their_weights_state(rng):
    cells, width, step = 60, 8, 4  # patches of 8 x 8 cells of white noise, every 4 cells
    corners = grid_of((cells - width) // step + 1, step).astype(int)
    means = []
    for _ in range(400):
        noise = rng.normal(size=(cells, cells)) * width  # a patch's mean has sigma 1
        means.append([noise[i : i + width, j : j + width].mean() for i, j in corners])
    k = overlap_counts(corners.astype(float), np.full(len(corners), float(width)))
    scatter = np.std(np.average(means, axis=1, weights=1 / k))
    # 400 draws: 3.5 % of scatter; borders, which are weighted by less than their information: some
    # more
    assert scatter == pytest.approx(1 / np.sqrt((1 / k).sum()), rel=0.12)
    assert scatter > 1.8 / np.sqrt(len(corners))  # far from independent


def test_lower_weights_enlarge_every_standard_deviation():
    ties = inflate_sigmas(some_ties(3), np.array([1.0, 4.0, 0.5]))
    for name in ("first_sigma_px", "second_sigma_px", "second_sigma_parallax_px"):
        np.testing.assert_allclose(getattr(ties, name), [0.1, 0.2, 0.1])


def test_selected_ties_are_apart_and_include_the_most_precise(rng):
    places, width_m = rng.uniform(0, 20, (300, 2)), rng.uniform(1.0, 2.0, 300)
    kept = select_spread(places, width_m, 0.75, at_least=10)
    assert kept[np.argmin(width_m)]
    apart = np.abs(places[kept][:, None] - places[kept]).max(axis=2)
    least = 0.75 * np.maximum(width_m[kept][:, None], width_m[kept])
    assert (apart >= least)[~np.eye(kept.sum(), dtype=bool)].all()
    closer = np.abs(places[:, None] - places[kept]).max(axis=2) < 0.75 * width_m[:, None]
    assert closer.any(axis=1).all()  # no room was left


def test_closer_ties_are_selected_rather_than_too_few():
    assert select_spread(grid_of(5, 0.2), np.full(25, 1.0), 0.75, at_least=20).sum() >= 20
    assert select_spread(np.zeros((3, 2)), np.ones(3), 0.75, at_least=20).sum() >= 1


def test_a_common_error_makes_the_mean_of_all_ties_uncertain():
    frame = Frame(FrameKind.PAIR, (1, 0, 0, 0))
    pose = Pose(Frame(FrameKind.ROVER, (1, 0)), frame, np.eye(3), np.zeros(3))
    pair = EpipolarPair(pose, 0.2, 1200.0, (512.0, 512.0), 1024, 1024)
    ties = some_ties(40)
    ties = replace(
        ties, first_parallax_px=np.full(40, 48.0), second_parallax_px=np.full(40, 16.0)
    )  # at 5 and at 15 m
    weighed = add_shared_errors(ties, {"a": pair, "b": pair}, np.zeros((40, 2, 3)))
    np.testing.assert_array_equal(weighed.first_sigma_line_px, ties.first_sigma_line_px)
    of_mean_m = weighed.second_sigma_line_px / 40**0.5 * 15.0 / 1200.0
    np.testing.assert_allclose(of_mean_m, SHARED_HEIGHT_M, rtol=0.01)
    assert (weighed.first_sigma_parallax_px / 40**0.5 > SHARED_PARALLAX_PX).all()


def test_different_suns_make_the_mean_of_all_ties_as_uncertain_as_their_shadows():
    frame = Frame(FrameKind.PAIR, (1, 0, 0, 0))
    pose = Pose(Frame(FrameKind.ROVER, (1, 0)), frame, np.eye(3), np.zeros(3))
    pair = EpipolarPair(pose, 0.2, 1200.0, (512.0, 512.0), 1024, 1024)
    ties, displaced = some_ties(30), np.zeros((30, 2, 3))
    displaced[:, 1] = 8.0, -2.0, 1.0
    geometries = {"a": pair, "b": pair}
    reported = add_shared_errors(ties, geometries, displaced)
    blind = add_shared_errors(ties, geometries, 0 * displaced)
    np.testing.assert_array_equal(reported.first_sigma_px, blind.first_sigma_px)
    step, weight = displaced[0, 1], np.zeros(3)
    for k, name in enumerate(("sigma_px", "sigma_line_px", "sigma_parallax_px")):
        weight[k] = (getattr(reported, f"second_{name}") ** -2.0).sum()
    sigma_shares = 1 / np.sqrt((weight * step**2).sum())  # of the displacement, by all ties
    assert sigma_shares == pytest.approx(SHARED_LIGHT, rel=0.05)
