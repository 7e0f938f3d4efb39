"""A stereo rig that differs from its labels is measured in the images and corrected."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.rig_pooling import (
    correction_to_apply,
    pooled_rotations,
    stop_normal_equations,
    weigh_by_cells,
)
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.matching.inter_stereo import InterStereoParams, tie_inter_stereo
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.matching.stereo.orientation import (
    rig_rotation,
    rows_of_rig,
    vertical_parallax,
)
from solmap.photogrammetry.matching.stereo.sparse import match_sparsely
from solmap.photogrammetry.matching.tracks import TrackParams, build_tie_points
from solmap.photogrammetry.synthetic.downlink import render_jobs
from solmap.photogrammetry.synthetic.rig import CALIBRATED_AT_C, rig_temperature
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world, realistic_params
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.formats.documents.rig import (
    PairRows,
    RigProduct,
    read_rig,
    write_pair_rows,
    write_rig,
)
from solmap.products.model import ProductKind, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import pair_geometry, turn_right_camera
from solmap.tasks.network.match import rows_of_pair
from solmap.tasks.network.rig import pool_rig, turn_of_pair
from solmap.tasks.scopes import pair_scope
from tests.support.small_downlink import rendered_images
from tests.support.stereo_pairs import resample_pair

BEND = np.array([0.6e-3, 0.1e-3, -0.5e-3])
"""Of the right camera in the frame of the pair, radians: 0.7 rows."""


@pytest.fixture(scope="module")
def pair():
    files = rendered_images(WorldParams("plains", TraverseParams(stops=1), pairs=1), 8)
    return [read_image(file.data, file.path.rpartition("/")[2]) for file in files]


def measured(left, right, name="pair", stop="stop"):
    images = epipolar(left, right)
    rows = rows_of_rig(images, partial(turned_images, left, right))
    turn = images.geometry.rover_from_pair.rotation
    return PairRows(name, stop, "NAVCAM", str(rows), turn, rows_of_pair(rows))


def epipolar(left, right):
    return resample_pair(left, right, pair_geometry(left.image, right.image))


def turned_images(left, right, rotation):
    return epipolar(left, turned(left, right, rotation))


def turned(left, right, rotation):
    """The right image with its camera rotated about the axes of the pair."""
    turn = pair_geometry(left.image, right.image).rover_from_pair.rotation @ rotation
    return turn_right_camera(right, tuple(turn.tolist()))


@pytest.fixture(scope="module")
def bent(pair):
    left, right = pair
    return left, turned(left, right, BEND)


@pytest.mark.slow
def test_rows_half_a_pixel_apart_determine_the_rig_without_bias():
    world = make_world(realistic_params(WorldParams("hills", TraverseParams(stops=3)), 7), 7)
    jobs = [job for job in render_jobs(world) if job.shot.stop == 0 and job.shot.pair < 2]
    files = [job.run(world) for job in jobs]
    reads = [read_image(file.data, file.path.rpartition("/")[2]) for file in files]
    once, twice = [], []
    for left, right in zip(reads[::2], reads[1::2], strict=True):
        images = epipolar(left, right)
        rows = rows_of_rig(images, partial(turned_images, left, right))
        assert 0.4 < abs(rows.median_px) < 0.6
        once.append(rig_rotation(vertical_parallax(images)))
        twice.append(rig_rotation(rows))
    kelvin = rig_temperature(world.stops[0].local_solar_hour) - CALIBRATED_AT_C
    rig = world.params.rig
    _, down, forward = np.add(rig.bend, np.multiply(rig.bend_per_kelvin, kelvin))[[1, 2, 0]]
    assert np.mean(once, axis=0)[2] - forward > 2e-5
    assert np.mean(twice, axis=0)[2] - forward == pytest.approx(0.0, abs=1.2e-5)
    assert abs(np.mean(twice, axis=0)[1] - down) < abs(np.mean(once, axis=0)[1] - down)


@pytest.fixture
def pooled(tmp_path):
    """What is known after some pairs, each sol a call."""
    store = ProductStore(tmp_path)
    known = [None]

    def pool(*pairs):
        refs = tuple(
            store.make(
                Recipe(ProductKind.VERTICAL_PARALLAX, pair_scope(pair.pair_id)),
                lambda path, pair=pair: write_pair_rows(path, pair),
            )
            for pair in pairs
        )
        known.append(pool_rig.fn("MER2", len(known), refs, known[-1], store))
        return read_rig(store.path(known[-1]))

    return pool


def test_a_straight_rig_is_not_corrected(pair, pooled):
    rows = measured(*pair)
    rig = pooled(rows)
    assert not rig.applied
    assert turn_of_pair(rows, rig) == (None, False)
    assert rig.toe_in_sigmas("stop")["NAVCAM"] < 1e-4


def test_a_bent_rig_is_measured_to_a_hundredth_of_a_row(bent, pooled):
    left, right = bent
    rows = measured(left, right)
    rig = pooled(rows)
    x, toe_in, z = rig.applied_at("stop", "NAVCAM") + BEND
    assert abs(x) < 1e-5
    assert abs(z) < 4e-5  # 0.02 px at the edge of the image
    assert abs(toe_in) < 4 * rig.toe_in_sigmas("stop")["NAVCAM"]
    turn, is_own = turn_of_pair(rows, rig)
    assert not is_own
    straight = turn_right_camera(right, turn)
    images = resample_pair(left, straight, pair_geometry(left.image, straight.image))
    assert abs(vertical_parallax(images).median_px) < 0.01


def test_images_of_different_exposures_keep_their_labels(pair, pooled, rng):
    left, right = pair
    noise = rng.normal(1000.0, 50.0, right.pixels.shape).astype(np.float32)
    rows = measured(left, replace(right, pixels=noise))
    assert rows.rows is None
    assert turn_of_pair(rows, pooled(rows)) == (None, False)


def test_a_pair_that_contradicts_the_others_is_rotated_by_its_own_rows(pair, bent, pooled):
    odd = replace(measured(*bent), pair_id="odd")
    good = measured(*pair)
    others = [replace(good, pair_id=name) for name in ("one", "two", "three")]
    rig = pooled(*others, odd)
    assert not rig.applied
    assert turn_of_pair(others[0], rig) == (None, False)
    turn, is_own = turn_of_pair(odd, rig)
    assert is_own
    np.testing.assert_allclose((odd.rover_from_pair.T @ turn)[::2], -BEND[::2], atol=5e-5)


def test_later_stops_reuse_an_unchanged_correction(bent, pooled):
    rows = measured(*bent)
    first = pooled(rows)
    again = pooled(replace(rows, pair_id="later", stop="next"))
    np.testing.assert_array_equal(
        again.applied_at("next", "NAVCAM"), first.applied_at("stop", "NAVCAM")
    )
    np.testing.assert_array_equal(
        again.applied_at("stop", "NAVCAM"), first.applied_at("stop", "NAVCAM")
    )
    assert again.toe_in_sigmas("next")["NAVCAM"] < first.toe_in_sigmas("stop")["NAVCAM"]


def test_estimates_of_rigs_are_read_back_from_their_file(bent, pooled, tmp_path):
    rig = pooled(measured(*bent))
    write_rig(tmp_path / "again.json", rig)
    again = read_rig(tmp_path / "again.json")
    assert again.toe_in_sigmas("stop") == rig.toe_in_sigmas("stop")
    write_rig(tmp_path / "none.json", RigProduct())
    assert read_rig(tmp_path / "none.json").toe_in_sigmas("stop") == {}


class Stop:
    """A stop of `rendered_husband` whose labels have the right cameras turned."""

    def __init__(self, folder, bend):
        reads = [read_image(path.read_bytes(), path.name) for path in sorted(folder.glob("*.img"))]
        by_id = {read.image.id: read for read in reads}
        self.pairs = {}
        for pair in find_stereo_pairs([read.image for read in reads]).pairs:
            left, right = by_id[pair.left.id], by_id[pair.right.id]
            turn = pair_geometry(left.image, right.image).rover_from_pair.rotation @ bend
            self.pairs[pair.id] = left, turn_right_camera(right, tuple(turn.tolist()))
        self.id = left.image.stop
        self.rows = [
            replace(measured(*eyes, name, str(self.id)), instrument=eyes[0].image.instrument)
            for name, eyes in self.pairs.items()
        ]

    def matched(self, rig):
        """The pairs, matched with the rotations that stand."""
        pairs = []
        for one in self.rows:
            left, right = self.pairs[one.pair_id]
            turned = turn_right_camera(right, turn_of_pair(one, rig)[0])
            images = resample_pair(left, turned, pair_geometry(left.image, turned.image))
            matches = match_sparsely(one.pair_id, images)
            parallax = match_densely(images).parallax_px
            pairs.append(MatchedPair.of(one.pair_id, one.instrument, images, matches, parallax))
        pose = Pose(LSL, self.id.frame, np.eye(3), np.zeros(3))
        return MatchedStop(self.id, tuple(pairs), pose, np.zeros((6, 6)))


def parallax_error_px(rows, rotation):
    """RMS over the image of what a rotation of the right camera moves points along rows by."""
    u = np.linspace(-0.5, 0.5, 21) * rows.samples / rows.focal_px
    x, y = np.meshgrid(u, u)
    off = rotation[1] * (1 + x * x) - rotation[2] * y - rotation[0] * x * y
    return rows.focal_px * float(np.sqrt(np.mean(off**2)))


def ties_of_stop(stop, rig):
    """Information of ties within a stop whose pairs were matched with the applied rotations."""
    matched = stop.matched(rig)
    ties = weigh_by_cells(tie_inter_stereo(matched, InterStereoParams()).ties)
    network = Network(
        (StopPrior(stop.id, matched.lsl_from_rover),),
        tuple(PairGeometry(pair.pair_id, stop.id, pair.geometry) for pair in matched.pairs),
        build_tie_points([pair.matches for pair in matched.pairs], [ties], TrackParams()),
    )
    return stop_normal_equations(
        network,
        {pair.pair_id: pair.instrument for pair in matched.pairs},
        rig.applied[str(stop.id)],
        AdjustmentParams(),
    )


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_parallaxes_of_a_bent_rig_are_correct_after_two_stops(husband, pooled):
    """A Pancam's toe-in from ties: of two pairs to 0.07 px, of six to 0.04 px, one sigma.

    The first stop misses its bound: a Navcam's toe-in, known to 0.011 px, has 4.5 times the effect.
    """
    bend = np.array([0.54e-3, 0.3e-3, -0.2e-3])  # 0.63 and 1.9 rows
    known, too_large = {}, {}
    for sol, stated_px, pancam_px in (("sol0155", 0.08, 0.1), ("sol0156", 0.05, 0.05)):
        stop = Stop(husband / sol / "edr", bend)
        name, rig = str(stop.id), pooled(*stop.rows)
        known[name] = replace(rig.stops[name], ties=ties_of_stop(stop, rig))
        for camera, worst_px in (("NAVCAM", 0.02), ("PANCAM", pancam_px)):
            rows = known[name].rows[camera]
            before = rig.applied_at(name, camera)
            found = pooled_rotations(known)[name][camera]
            applied = correction_to_apply(found, before, rows)
            assert parallax_error_px(rows, bend) > 0.35
            error_px = parallax_error_px(rows, bend + applied)
            if error_px >= worst_px:
                too_large[sol, camera] = error_px
            assert abs(bend[1] + applied[1]) < 3 * found.toe_in_sigma(applied)
            assert found.toe_in_sigma(applied) * rows.focal_px < stated_px
    assert not too_large
