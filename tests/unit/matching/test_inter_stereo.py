from dataclasses import replace

import numpy as np
import pytest

from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import AlignmentParams, align
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo

MATCHES = ("left", "parallax_px", "sigma_px")


@pytest.fixture(scope="module")
def tied(first_stop):
    return tie_inter_stereo(first_stop, InterStereoParams())


def test_all_neighbouring_pairs_of_a_panorama_are_tied(tied):
    assert [(link.first_id[-1], link.second_id[-1]) for link in tied.links] != []
    neighbours = {frozenset({link.first_id, link.second_id}) for link in tied.links}
    assert neighbours == {frozenset({f"P00{k}", f"P00{k + 1}"}) for k in range(3)}
    assert tied.untied == ()
    assert min(link.ties for link in tied.links) >= 6


@pytest.mark.parametrize("kept", [1 / 25, 0.0])
def test_ground_with_few_interest_points_is_tied_by_corners(first_stop, kept):
    def thinned(pair):
        rows = np.arange(len(pair.matches))[: round(kept * len(pair.matches))]
        few = {name: getattr(pair.matches, name)[rows] for name in MATCHES}
        return replace(pair, matches=replace(pair.matches, **few))

    bland = replace(first_stop, pairs=tuple(map(thinned, first_stop.pairs)))
    found = tie_inter_stereo(bland, InterStereoParams(cell_px=20))  # images are 256 pixels wide
    assert len(found.links) == 3
    assert min(link.ties for link in found.links) >= 6


def test_ties_show_the_same_ground_in_both_pairs(tied, first_stop):
    # the labels have errors of 1 mrad: the images have the true pointing
    geometries = {pair.pair_id: pair.geometry for pair in first_stop.pairs}
    for k in range(len(tied.ties)):
        one, other = (
            geometries[tied.ties.pair_ids[index[k]]]
            for index in (tied.ties.first, tied.ties.second)
        )
        places = [
            g.rover_from_pair.apply(g.triangulate(left[k : k + 1], parallax[k : k + 1]))[0]
            for g, left, parallax in (
                (one, tied.ties.first_left, tied.ties.first_parallax_px),
                (other, tied.ties.second_left, tied.ties.second_parallax_px),
            )
        ]
        distance = np.linalg.norm(places[0])
        # 1 mrad of pointing each, and a parallax of 0.2 px, three times over
        range_sigma = 0.2 * distance**2 / (320 * 0.4)
        assert np.linalg.norm(places[0] - places[1]) < 3 * (0.002 * distance + 2 * range_sigma)


def test_pointing_after_tying_leaves_less_than_half_a_pixel(tied):
    assert tied.rms_px < 0.5


def test_ties_displaced_by_some_pixels_are_rejected(tied, first_stop):
    moved = np.zeros(len(tied.ties), dtype=bool)
    moved[::7] = True
    damaged = replace(tied.ties, second_left=tied.ties.second_left + 4.0 * moved[:, None])
    geometries = {pair.pair_id: pair.geometry for pair in first_stop.pairs}
    rover = first_stop.stop.frame
    found = align(damaged, geometries, Pose.identity(rover, rover), None, AlignmentParams())
    assert not found.agrees[moved].any()
    assert found.agrees[~moved].mean() > 0.95


def test_pairs_that_do_not_overlap_are_not_matched(first_stop):
    apart = replace(first_stop, pairs=(first_stop.pairs[0], first_stop.pairs[3]))
    found = tie_inter_stereo(apart, InterStereoParams())
    assert found.links == ()
    assert len(found.ties) == 0
    assert np.isnan(found.rms_px)


def test_parameters_without_candidates_are_refused():
    with pytest.raises(MatchingError, match="more candidates than the least overlap"):
        InterStereoParams(candidates=3)


def test_relief_enlarges_sigmas_of_samples_and_parallaxes_but_not_of_lines(tied, first_stop):
    rough = replace(first_stop, pairs=tuple(_roughened(pair) for pair in first_stop.pairs))
    seen = tie_inter_stereo(rough, InterStereoParams()).ties
    sample, line, parallax = (
        np.median(getattr(seen, f"second_{name}")) / np.median(getattr(tied.ties, f"second_{name}"))
        for name in ("sigma_px", "sigma_line_px", "sigma_parallax_px")
    )
    assert parallax > 1.5 * line
    assert sample > 1.1 * line
    assert line < 1.1


def _roughened(pair):
    """The pair with dense parallax that scatters by a quarter of a pixel about the ground."""
    noise = np.random.default_rng(5).normal(0, 0.25, pair.parallax.shape).astype(np.float32)
    return replace(pair, parallax=pair.parallax + noise)
