"""How fast pairs and stops are tied, beside SIFT with the ratio test on the same images."""

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image_record
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import (
    CrossSiteParams,
    tie_cross_site,
)
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo
from solmap.photogrammetry.matching.records import MatchedStop
from tests.support.rendered_stops import matched_pairs


@pytest.fixture(scope="module")
def stops(husband):
    """The first two stops, Navcam only, matched once."""
    found = []
    for sol, drive in ((155, 0), (156, 64)):
        files = sorted((husband / f"sol0{sol}" / "edr").glob("2n*.img"))
        pairs = matched_pairs(files)
        pose = read_image_record(files[0].read_bytes(), files[0].name).site_from_rover
        stop = StopId("MER2", 10, drive)
        found.append(MatchedStop(stop, pairs, pose, np.zeros((6, 6))))
    return found


def test_tying_the_pairs_of_a_panorama(benchmark, stops):
    found = benchmark.pedantic(
        tie_inter_stereo, (stops[0], InterStereoParams()), rounds=2, iterations=1
    )
    benchmark.extra_info["ties"] = len(found.ties)
    assert not found.untied


def test_linking_two_stops(benchmark, stops):
    params = CrossSiteParams()

    def link():
        return tie_cross_site(*(StopViews.of(stop, params.birds_eye) for stop in stops), params)

    found = benchmark.pedantic(link, rounds=2, iterations=1)
    benchmark.extra_info["ties"] = len(found.ties)
    assert found.linked


def test_sift_with_the_ratio_test_between_neighbouring_pairs(benchmark, stops):
    def eight_bits(pair):
        return cv2.normalize(pair.left, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)

    def match_all():
        sift, matcher = cv2.SIFT_create(5000), cv2.BFMatcher()
        described = [sift.detectAndCompute(eight_bits(p), None)[1] for p in stops[0].pairs]
        neighbours = zip(described, described[1:] + described[:1], strict=True)
        return sum(
            sum(one.distance < 0.8 * two.distance for one, two in matcher.knnMatch(a, b, 2))
            for a, b in neighbours
        )

    matched = benchmark.pedantic(match_all, rounds=2, iterations=1)
    benchmark.extra_info["ties"] = matched
    assert matched > 0
