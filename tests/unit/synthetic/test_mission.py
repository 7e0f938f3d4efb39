"""A mission at full scale, simulated as a network: it has its stated properties."""

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.datum import with_control
from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust_overall
from solmap.photogrammetry.archive.images.reading import read_image, read_image_record
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.synthetic.edr import label_bytes
from solmap.photogrammetry.synthetic.mission import (
    CONTROL_SIGMA_M,
    GAP_DRIVES,
    LEAST_SLIP,
    MOST_SLIP,
    MissionPlan,
    exposures,
    mission_names,
    simulate_mission,
)

PLAN = MissionPlan(
    stops=40, distance_m=560.0, pairs_per_stop=6, inter_ties=6, intra_ties=2, gaps=2,
    terrain_stops=5,
)  # fmt: skip


@pytest.fixture(scope="module")
def mission():
    return simulate_mission(np.random.default_rng(3), PLAN, MAP, mission_names(PLAN))


def test_wheels_slip_by_terrain_within_the_plan(mission):
    reported = np.array([stop.lsl_from_rover.translation_m for stop in mission.network.stops])
    driven = np.linalg.norm(np.diff(reported, axis=0), axis=1)
    true = np.diff(mission.along_m)
    assert (mission.slips >= LEAST_SLIP).all()
    assert (mission.slips <= MOST_SLIP).all()
    # what wheels counted is too far by the slip; chance adds 1 % of a drive and a decimetre
    off = driven / true - 1 - mission.slips
    assert np.abs(off).max() < 4 * (LEAST_SLIP + 0.1 / true.min())
    by_ground = mission.slips[: 7 * 5].reshape(7, 5)
    assert by_ground.mean(axis=1).std() > by_ground.std(axis=1).mean()


def test_no_tie_crosses_a_gap_and_every_other_drive_is_tied(mission):
    assert len(mission.untied) == PLAN.gaps * GAP_DRIVES
    ties = mission.network.ties
    number = {prior.stop: k for k, prior in enumerate(mission.network.stops)}
    of_pair = {pair.pair_id: number[pair.stop] for pair in mission.network.pairs}
    stops = np.array([of_pair[name] for name in ties.pair_ids])[ties.pair]
    low, high = np.full(ties.point.max() + 1, 1 << 30), np.zeros(ties.point.max() + 1, int)
    np.minimum.at(low, ties.point, stops)
    np.maximum.at(high, ties.point, stops)
    bridged = {k for a, b in zip(low, high, strict=True) for k in range(a + 1, b + 1)}
    assert bridged == set(range(1, PLAN.stops)) - mission.untied


def test_control_bounds_the_error_that_grows_with_images_alone(mission):
    params = AdjustmentParams()
    true = np.array([pose.translation_m for pose in mission.truth.lsl_from_rover])

    def errors(network):
        stops = adjust_overall(network, params)[0].stops
        off = np.array([stop.lsl_from_rover.translation_m for stop in stops]) - true
        return np.linalg.norm(off[:, :2], axis=1)

    alone = errors(mission.network)
    held = errors(with_control(mission.network, (MAP,), mission.control.control, params))
    assert held.max() < 4 * CONTROL_SIGMA_M
    assert alone.max() > held.max()


def test_simulated_labels_describe_all_but_the_pixels(mission):
    left, right = next(exposures(mission, PLAN))
    data = label_bytes(left)
    image = read_image_record(data, left.file_name)
    assert image.id == mission.network.pairs[0].pair_id
    assert image.stop == mission.network.stops[0].stop
    assert (image.samples, image.lines) == (1024, 1024)
    assert right.product_id != left.product_id
    with pytest.raises(PhotogrammetryError):
        read_image(data, left.file_name)


def test_every_image_has_a_unique_name():
    plan = MissionPlan(stops=500, gaps=0)
    names = mission_names(plan)
    some = [*range(40), *range(460, 500)]
    assert len({names.pair(k, i) for k in some for i in range(10)}) == 800
    assert len({names.stop(k) for k in range(500)}) == 500


def test_an_impossible_plan_is_refused():
    with pytest.raises(PhotogrammetryError, match="10 gaps of 2 drives need 42 stops, not 12"):
        MissionPlan(stops=12)
    with pytest.raises(PhotogrammetryError, match="500 stops of a site, not 501"):
        mission_names(MissionPlan(stops=501))
