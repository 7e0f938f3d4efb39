"""Frames of real mast swings, tied and adjusted without a stereo partner."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.cameras.epipolar import single_image
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import Eye, StereoMatches
from solmap.photogrammetry.matching.conjugates import View
from solmap.photogrammetry.matching.resampling import resample
from solmap.photogrammetry.matching.single.search import MonoParams, SingleView
from solmap.photogrammetry.matching.single.two_views import TwoViews
from solmap.photogrammetry.matching.single.tying import tie_single_images
from solmap.photogrammetry.matching.tracks import TrackParams, build_tie_points

SPIRIT = ("mer_spirit_sol1869_troy", "2n292280{}effb100p0703l0m1.img", ("938", "989"))
OPPORTUNITY = (
    "mer_opportunity_sol4084_4090",
    "1N49102{}ILFCNY9P0706L0M1.IMG",
    ("0376", "0519", "0834", "0993", "1154"),
)


@dataclass(frozen=True)
class Adjusted:
    """A panorama after adjustment, and every link's distances from the epipolar lines."""

    tied: object
    report: object
    pairs: tuple
    across: dict
    """(label, adjusted) distances in pixels by the last digits of the two clocks."""
    ranges_m: np.ndarray


def frame(path, number):
    read = read_image(path.read_bytes(), path.name)
    image = read.image
    own = Frame(FrameKind.PAIR, (number,))
    geometry = single_image(image.camera, (image.samples, image.lines), image.stop.frame, own)
    grey, mask = resample(read.pixels, read.mask, image.camera, geometry, Eye.LEFT)
    return image, SingleView(image.id, geometry, View.of(grey, mask))


def panorama(folder, which):
    name, pattern, clocks = which
    frames = [frame(folder / name / pattern.format(c), k) for k, c in enumerate(clocks)]
    images, views = zip(*frames, strict=True)
    stop = images[0].stop
    tied = tie_single_images(stop, views, MonoParams())
    nothing = np.zeros(0)
    alone = [StereoMatches(v.image_id, np.zeros((0, 2)), nothing, nothing) for v in views]
    site = images[0].site_from_rover
    network = Network(
        (StopPrior(stop, Pose(LSL, stop.frame, site.rotation, site.translation_m)),),
        tuple(
            PairGeometry(
                view.image_id,
                stop,
                replace(view.geometry, mast_in_rover=image.mast_in_rover),
            )
            for image, view in frames
        ),
        build_tie_points(alone, [tied.ties], TrackParams()),
    )
    adjusted, report = adjust(network, {stop}, AdjustmentParams())
    across = {}
    for link in tied.links:
        one, other = (
            next(k for k, v in enumerate(views) if v.image_id == n)
            for n in (link.first_id, link.second_id)
        )
        rows = (tied.ties.first == one) & (tied.ties.second == other)
        label, turned = (
            TwoViews(
                replace(views[one].geometry, rover_from_pair=poses[one]),
                replace(views[other].geometry, rover_from_pair=poses[other]),
            ).epipolar_distance(
                tied.ties.first_left[rows], tied.ties.second_left[rows], np.zeros(3)
            )
            for poses in (
                [v.geometry.rover_from_pair for v in views],
                [p.rover_from_pair for p in adjusted.pairs],
            )
        )
        across[clocks[one], clocks[other]] = label, turned
    eye = adjusted.pairs[0].lsl_from_pair.translation_m
    ranges = np.linalg.norm(adjusted.ties.points - eye, axis=1)
    return Adjusted(tied, report, adjusted.pairs, across, ranges)


@pytest.fixture(scope="module")
def spirit(shared_data):
    return panorama(shared_data, SPIRIT)


@pytest.fixture(scope="module")
def opportunity(shared_data):
    return panorama(shared_data, OPPORTUNITY)


def relative_turn_deg(adjusted, one, other):
    return np.degrees(np.linalg.norm(adjusted.pairs[other].pointing - adjusted.pairs[one].pointing))


def test_two_frames_of_spirit_agree_better_than_the_reference(spirit):
    label, left = spirit.across["938", "989"]
    assert spirit.report.converged
    assert len(label) > 423  # the data README's inliers
    assert abs(np.median(label)) == pytest.approx(1.9, abs=0.3)  # README: -1.9 px
    assert np.median(np.abs(left)) < 0.12  # README
    assert relative_turn_deg(spirit, 0, 1) == pytest.approx(0.18, abs=0.02)  # README: about 0.18
    assert np.percentile(spirit.ranges_m, 5) == pytest.approx(2.5, abs=0.3)  # README: 2.5-14 m
    assert np.percentile(spirit.ranges_m, 95) == pytest.approx(14, abs=2)


@pytest.mark.parametrize(
    ("clocks", "ties", "left_px"),
    [(("0376", "0519"), 274, 0.22), (("0834", "0993"), 961, 0.14), (("0993", "1154"), 305, 0.14)],
)
def test_frames_of_opportunity_agree_as_well_as_the_reference(opportunity, clocks, ties, left_px):
    label, left = opportunity.across[clocks]
    assert opportunity.report.converged
    assert len(label) > ties  # the data README's
    assert np.median(np.abs(label)) > 0.5  # pointing by the labels leaves most of a pixel
    assert np.median(np.abs(left)) < left_px  # README: 0.14-0.22 px


def test_mast_corrections_of_opportunity_have_a_plausible_size(opportunity):
    turns = [relative_turn_deg(opportunity, *two) for two in ((0, 1), (2, 3), (3, 4))]
    assert 0.05 < min(turns) < max(turns) < 0.3  # README: 0.1-0.2 degrees
    assert np.nanpercentile(opportunity.ranges_m, 5) > 2.0  # README: 2-10 m
    assert np.nanpercentile(opportunity.ranges_m, 95) < 12.0


def test_frames_without_common_ground_are_not_tied(opportunity):
    assert set(opportunity.across) == {("0376", "0519"), ("0834", "0993"), ("0993", "1154")}


def test_navcam_and_pancam_frames_that_hardly_overlap_are_not_tied(shared_data):
    folder = shared_data / "mer_spirit_sol1900"
    names = ("2n295043924fflb1dnp1979l0m1.img", "2p295043688fflb1dnp2380l2m1.img")
    frames = [frame(folder / name, k) for k, name in enumerate(names)]
    tied = tie_single_images(frames[0][0].stop, [view for _, view in frames], MonoParams())
    assert len(tied.ties) == 0
