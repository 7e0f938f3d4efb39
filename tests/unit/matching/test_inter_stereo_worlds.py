"""Inter-stereo ties in rendered panoramas: every overlap tied, within pixels of the truth.

Three terrains with suns of their own, Navcam and Pancam (three times the scale, toed in).
"""

from itertools import combinations

import numpy as np
import pytest
from scipy import ndimage

from solmap.photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo
from solmap.photogrammetry.matching.records import MatchedStop
from solmap.photogrammetry.synthetic.rig import Instrument
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.terrain import TERRAINS
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.synthetic.truth import true_parallax
from tests.support import simulated_stops
from tests.support.rendered_stops import rendered_stop

pytestmark = pytest.mark.slow

SHARED = 0.02
"""Share of an image; less in common does not count as overlap."""
LEAST_TIES = 20


class Panorama:
    """The pairs of a simulated stop around its Pancam pairs, with all that is true of them."""

    def __init__(self, terrain, seed):
        traverse = TraverseParams(stops=2, first_site=10 * seed, first_sol=40 * seed)
        world = make_world(WorldParams(terrain, traverse, pancam=True), seed)
        shots = [shot for shot in world.shots if shot.stop == 0]
        towards = [s.pointing.azimuth for s in shots if s.instrument is Instrument.PANCAM]
        self.shots = [s for s in shots if min(turn(s.pointing.azimuth, a) for a in towards) < 50]
        pairs = tuple(simulated_stops._matched(world, shot) for shot in self.shots)
        stop = world.stops[0]
        reported = stop.telemetry_lsl_from_rover
        self.stop = MatchedStop(stop.id, pairs, reported, np.zeros((6, 6)))
        self.geometries = [pair.geometry for pair in pairs]
        self.truth = [
            (
                world.true_lsl_from_label_rover(shot) @ geometry.rover_from_pair,
                true_parallax(world, 0, shot.pair, geometry),
            )
            for shot, geometry in zip(self.shots, self.geometries, strict=True)
        ]

    def seen(self, one, other, left):
        """(image point, parallax) that the second pair truly has of points of the first."""
        (pose, parallax), (other_pose, _) = self.truth[one], self.truth[other]
        at = ndimage.map_coordinates(parallax.astype(float), left.T[::-1], order=1, cval=np.nan)
        points = pose.apply(self.geometries[one].triangulate(left, at))
        return self.geometries[other].project(other_pose.inverse.apply(points))

    def shared(self, one, other):
        """The share of a pair's image that another one truly shows, ground up to 100 m."""
        g, to = self.geometries[one], self.geometries[other]
        x, y = np.meshgrid(np.arange(8.0, g.samples - 8, 8), np.arange(8.0, g.lines - 8, 8))
        left, parallax = self.seen(one, other, np.column_stack([x.ravel(), y.ravel()]))
        near = parallax > to.focal_px * to.base_m / 100.0
        inside = (left >= 10) & (left <= np.array([to.samples, to.lines]) - 11)
        return float((inside.all(axis=1) & near).mean())


def turn(one, other):
    """Between two azimuths, degrees."""
    return abs(np.degrees(np.angle(np.exp(1j * (one - other)))))


@pytest.fixture(
    scope="module", params=list(zip(TERRAINS, (31, 32, 33), strict=True)), ids=list(TERRAINS)
)
def panorama(request):
    return Panorama(*request.param)


@pytest.fixture(scope="module")
def tied(panorama):
    return tie_inter_stereo(panorama.stop, InterStereoParams())


def test_all_pairs_that_overlap_are_tied(panorama, tied):
    ids = [pair.pair_id for pair in panorama.stop.pairs]
    counts = {frozenset(two): n for two, n in tied.ties.counts().items()}
    overlapping = [
        (a, b)
        for a, b in combinations(range(len(ids)), 2)
        if max(panorama.shared(a, b), panorama.shared(b, a)) > SHARED
    ]
    scales = {len({panorama.shots[k].instrument for k in two}) for two in overlapping}
    assert scales == {1, 2}  # within an instrument and across
    assert len(overlapping) >= 6
    few = [two for two in overlapping if counts.get(frozenset(ids[k] for k in two), 0) < LEAST_TIES]
    assert few == []


def test_ties_are_at_their_true_places(panorama, tied):
    off, off_parallax = [], []
    for one, other in {*zip(tied.ties.first.tolist(), tied.ties.second.tolist(), strict=True)}:
        rows = (tied.ties.first == one) & (tied.ties.second == other)
        left, parallax = panorama.seen(one, other, tied.ties.first_left[rows])
        off.append(np.linalg.norm(tied.ties.second_left[rows] - left, axis=1))
        off_parallax.append(np.abs(tied.ties.second_parallax_px[rows] - parallax))
    off = np.concatenate(off)
    off = off[np.isfinite(off)]
    assert len(off) > 300
    assert np.median(off) < 0.1
    assert (off < 0.3).mean() > 0.97
    assert (off < 1.0).mean() > 0.995
    assert np.nanmedian(np.concatenate(off_parallax)) < 0.1


@pytest.mark.parametrize(("number", "pancams"), [(0, 2), (1, 4), (2, 2)])
def test_every_neighbour_in_the_rendered_panoramas_is_tied(husband, number, pancams):
    stop = rendered_stop(husband, number).matched
    counts = tie_inter_stereo(stop, InterStereoParams()).ties.counts()
    navcams = [pair for pair in stop.pairs if pair.instrument == "NAVCAM"]
    others = [pair for pair in stop.pairs if pair.instrument == "PANCAM"]
    assert (len(navcams), len(others)) == (10, pancams)
    joined = {frozenset(two) for two, n in counts.items() if n >= LEAST_TIES}
    azimuth = {p.pair_id: azimuth_of(p) for p in navcams}
    around = sorted(azimuth, key=azimuth.__getitem__)
    neighbours = {frozenset({a, b}) for a, b in zip(around, [*around[1:], around[0]], strict=True)}
    assert neighbours <= joined
    for pair in others:
        near = min(azimuth, key=lambda name: turn(azimuth[name], azimuth_of(pair)))
        assert frozenset({pair.pair_id, near}) in joined


def azimuth_of(pair):
    ahead = pair.geometry.rover_from_pair.rotation[:, 2]
    return np.arctan2(ahead[1], ahead[0])
