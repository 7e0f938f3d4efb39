"""How fast pairs and stops are tied, beside SIFT with the ratio test on the same images."""

import cv2
import numpy as np
import pytest

from photogrammetry.imagery import StopId
from photogrammetry.matching.cross_site import CrossSiteParams, StopViews, tie_cross_site
from photogrammetry.matching.dense import match_densely
from photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo
from photogrammetry.matching.records import MatchedPair, MatchedStop
from photogrammetry.matching.sparse import SparseParams, match_sparsely
from photogrammetry.pds3.partners import find_stereo_pairs
from photogrammetry.pds3.reading import read_image
from tasks.match import geometry_of
from tasks.pairs import resampled


@pytest.fixture(scope="module")
def stops(husband):
    """The first two stops, Navcam only, matched once."""
    found = []
    for sol, drive in ((155, 0), (156, 64)):
        files = sorted((husband / f"sol0{sol}" / "edr").glob("2n*.img"))
        reads = {r.image.id: r for r in (read_image(f.read_bytes(), f.name) for f in files)}
        pairs = []
        for pair in find_stereo_pairs([r.image for r in reads.values()]).pairs:
            left, right = reads[pair.left.id], reads[pair.right.id]
            images = resampled(left, right, geometry_of(left.image, right.image))
            matches = match_sparsely(pair.id, images, SparseParams())
            pairs.append(MatchedPair(pair.id, "NAVCAM", images, matches, match_densely(images)))
        pose = pair.left.site_from_rover
        stop = StopId("MER2", 10, drive)
        found.append(MatchedStop(stop, tuple(pairs), pose, np.zeros((6, 6))))
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
        return cv2.normalize(pair.images.left, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)

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
