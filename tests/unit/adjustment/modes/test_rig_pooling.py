"""One rotation a camera set: found from the rows and ties of stops, applied where significant."""

from dataclasses import fields, replace

import numpy as np
import pytest

from solmap.photogrammetry.adjustment.modes.rig_pooling import (
    CALIBRATION_SIGMA_RAD,
    CameraRows,
    RigRotation,
    StopRig,
    add_toe_in,
    correction_to_apply,
    pooled_rotations,
    stop_normal_equations,
    weigh_by_cells,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.matching.stereo.orientation import RowCells, VerticalParallax
from solmap.photogrammetry.synthetic.networks import simulate_network
from tests.support.adjustment.bent_rigs import with_bent_rig

FOCAL = {"NAVCAM": 1200.0, "PANCAM": 3600.0}
BENT = np.array([0.54e-3, 0.3e-3, -0.2e-3])
"""Radians: 0.65 rows and 0.36 of parallax in a Navcam, three times that in a Pancam."""
LABELS = np.zeros(3)


def rows_of(rng, camera, rotation, lens_px=0.0, points=700, noise=0.06):
    """The rows of a pair whose right camera is turned, and whose lenses bend rows by so much."""
    f = FOCAL[camera]
    frames = rover_frame(1, 0), Frame(FrameKind.PAIR, (0,))
    geometry = EpipolarPair(
        Pose(*frames, np.eye(3), np.zeros(3)), 0.2, f, (511.5, 511.5), 1024, 1024
    )
    left = rng.uniform(0, 1023, (points, 2))
    x, y = ((left - 511.5) / f).T
    vertical = f * (rotation[0] * (1 + y * y) - rotation[1] * x * y - rotation[2] * x)
    vertical += rng.normal(0, noise, points) + lens_px * np.cos(4 * np.pi * x * y * f**2 / 1024**2)
    return CameraRows(
        RowCells.of(VerticalParallax(left, vertical, np.zeros(points), geometry)), 1, f, 1024
    )


def stop_of(rng, bends, pairs=10, **options):
    """A stop of some camera sets, by their rotation."""
    rows = {}
    for camera, bend in bends.items():
        some = [rows_of(rng, camera, bend, **options) for _ in range(pairs)]
        rows[camera] = replace(some[0], cells=RowCells.together([one.cells for one in some]))
    return StopRig(rows)


def test_rigs_that_agree_with_their_labels_are_not_corrected(rng):
    off = []
    for _ in range(8):
        stops = {
            f"s{k}": stop_of(rng, {"NAVCAM": LABELS, "PANCAM": LABELS}, pairs=3) for k in range(2)
        }
        for name, cameras in pooled_rotations(stops).items():
            for camera, found in cameras.items():
                assert not correction_to_apply(found, LABELS, stops[name].rows[camera]).any()
                off.append(found.rotation / found.sigmas)
    assert np.sqrt(np.mean(np.square(off), axis=0)).max() < 1.3


@pytest.mark.parametrize("rows_px", [0.1, 0.3, 0.63])
def test_offsets_below_half_a_row_are_corrected(rng, rows_px):
    bend = np.array([rows_px / FOCAL["NAVCAM"], 0.0, 0.0])
    stop = stop_of(rng, {"NAVCAM": bend})
    found = pooled_rotations({"stop": stop})["stop"]["NAVCAM"]
    applied = correction_to_apply(found, LABELS, stop.rows["NAVCAM"])
    assert abs(applied[0] - bend[0]) * FOCAL["NAVCAM"] < 0.005
    assert abs(applied[1]) * FOCAL["NAVCAM"] < 0.06  # toe-in, from the rows of one stop alone
    assert abs(applied[1]) < 4 * found.toe_in_sigma(applied)


def test_toe_in_that_rows_cannot_show_has_the_sigma_of_the_other_rotations(rng):
    straight, bent = (
        pooled_rotations({"stop": stop_of(rng, {"PANCAM": bend}, pairs=1)})["stop"]["PANCAM"]
        for bend in (LABELS, BENT)
    )
    assert straight.sigmas[1] <= 1.01 * CALIBRATION_SIGMA_RAD
    assert CALIBRATION_SIGMA_RAD < bent.sigmas[1] < 0.6e-3


def test_lens_errors_are_not_mistaken_for_toe_in(rng):
    good, bad = (
        pooled_rotations({"stop": stop_of(rng, {"NAVCAM": LABELS}, lens_px=px)})["stop"]["NAVCAM"]
        for px in (0.0, 0.2)
    )
    assert bad.sigmas[1] > 3 * good.sigmas[1]
    assert abs(bad.rotation[1]) < 3 * bad.sigmas[1]


def test_a_rig_that_bends_with_temperature_has_one_rotation_per_stop(rng):
    bends = [BENT * share for share in (0.2, 0.6, 1.0, 1.4)]
    stops = {f"s{k}": stop_of(rng, {"NAVCAM": bend}) for k, bend in enumerate(bends)}
    found = pooled_rotations(stops)
    for k, bend in enumerate(bends):
        one = found[f"s{k}"]["NAVCAM"]
        off = one.rotation - bend
        assert np.abs(off[::2]).max() * FOCAL["NAVCAM"] < 0.02
        assert abs(off[1]) < 3 * one.sigmas[1]
    steady = pooled_rotations(dict.fromkeys(stops, stops["s3"]))
    assert steady["s3"]["NAVCAM"].sigmas[1] < 0.7 * found["s3"]["NAVCAM"].sigmas[1]


def at_celsius(stop, celsius):
    return StopRig({name: replace(rows, celsius=celsius) for name, rows in stop.rows.items()})


def test_a_temperature_model_predicts_the_rotation_at_a_new_temperature(rng):
    """Toe-in too, which the rows of a cold stop show worse than the law from warm ones."""
    per_kelvin = np.array([8e-6, 5e-6, -6e-6])
    celsius = [-60.0, -45.0, -30.0, -20.0, -5.0, 5.0]
    stops = {
        f"s{k}": stop_of(rng, {"NAVCAM": BENT + per_kelvin * t}, pairs=4 if k else 1)
        for k, t in enumerate(celsius)
    }
    reported = {name: at_celsius(stops[name], t) for name, t in zip(stops, celsius, strict=True)}
    without, found = (pooled_rotations(some)["s0"]["NAVCAM"] for some in (stops, reported))
    off = found.rotation - (BENT + per_kelvin * celsius[0])
    assert np.abs(off[::2]).max() * FOCAL["NAVCAM"] < 0.02
    assert abs(off[1]) < 3 * found.sigmas[1]
    assert found.sigmas[1] < 0.8 * without.sigmas[1]


def test_temperature_explains_nothing_where_rows_do_not_follow_it(rng):
    stops = {f"s{k}": stop_of(rng, {"NAVCAM": BENT}, pairs=2) for k in range(5)}
    celsius = rng.permutation([-60.0, -40.0, -20.0, 0.0, 20.0])
    reported = {
        name: at_celsius(one, t) for (name, one), t in zip(stops.items(), celsius, strict=True)
    }
    for name, cameras in pooled_rotations(reported).items():
        np.testing.assert_array_equal(
            cameras["NAVCAM"].rotation, pooled_rotations(stops)[name]["NAVCAM"].rotation
        )


def test_a_correction_stays_until_it_is_significantly_and_noticeably_wrong(rng):
    rows = stop_of(rng, {"NAVCAM": LABELS}, pairs=1).rows["NAVCAM"]
    px = 1.0 / FOCAL["NAVCAM"]

    def applied(found_px, sigma_px, before_px):
        found = RigRotation(np.array([0.0, found_px * px, 0.0]), np.eye(3) * (sigma_px * px) ** 2)
        return correction_to_apply(found, np.array([0.0, before_px * px, 0.0]), rows)[1] / px

    assert applied(0.2, 0.08, 0.0) == 0  # labels may be right
    assert applied(0.3, 0.08, 0.0) == pytest.approx(0.3)
    assert applied(0.3, 0.08, 0.25) == pytest.approx(0.25)  # within what is known
    assert applied(0.3, 0.001, 0.285) == pytest.approx(0.285)  # would not matter
    assert applied(0.3, 0.02, 0.25) == pytest.approx(0.3)


@pytest.mark.usefixtures("unchecked")
def test_ties_within_a_stop_determine_toe_in_independently_of_the_applied_correction(rng, params):
    network, truth = simulate_network(rng, stops=1, inter_ties=150, intra_ties=20)
    bent = with_bent_rig(network, truth, np.array([0.0, 0.4e-3, 0.0]), 0.0)
    instruments = {pair.pair_id: "NAVCAM" for pair in network.pairs}
    before = np.array([0.0, -0.1e-3, 0.0])
    turned, as_labelled = (
        stop_normal_equations(bent, instruments, applied, params)
        for applied in ({"NAVCAM": before}, {})
    )
    stop = stop_of(rng, {"NAVCAM": LABELS})
    blind = pooled_rotations({"stop": stop})["stop"]["NAVCAM"]
    seen, shifted = (
        pooled_rotations({"stop": StopRig({"NAVCAM": rows}, ties)})["stop"]["NAVCAM"]
        for rows, ties in (
            (rows_of(rng, "NAVCAM", [0, 0.4e-3, 0]), as_labelled),
            (rows_of(rng, "NAVCAM", [0, 0.3e-3, 0]), turned),
        )
    )
    assert blind.sigmas[1] > 0
    assert abs(seen.rotation[1] - 0.4e-3) < 4 * seen.sigmas[1]
    assert abs(shifted.rotation[1] - 0.3e-3) < 4 * shifted.sigmas[1]
    alone = pooled_rotations({"stop": replace(stop, rows={"NAVCAM": rows_of(rng, "NAVCAM", BENT)})})
    assert seen.sigmas[1] < alone["stop"]["NAVCAM"].sigmas[1]


def ties_of_five():
    """Four ties on one cell of the first pair, one elsewhere; all sigmas are 1."""
    columns = {f.name: getattr(Ties.none(()), f.name) for f in fields(Ties) if f.name != "pair_ids"}
    five = {name: np.ones((5, *old.shape[1:]), old.dtype) for name, old in columns.items()}
    five["first"] = np.zeros(5, np.int32)
    five["first_left"][4] = 200.0
    five["second_left"] += 100.0 * np.arange(5)[:, None]
    return Ties(("a", "b"), **five)


def test_ties_on_one_cell_weigh_as_one():
    np.testing.assert_allclose(weigh_by_cells(ties_of_five()).second_sigma_px, [2, 2, 2, 2, 1])


def test_ties_between_stops_do_not_average_out_uncertainty_of_toe_in():
    ties = add_toe_in(ties_of_five(), {"b": 0.1})
    np.testing.assert_allclose(ties.first_sigma_parallax_px, 1.0)
    np.testing.assert_allclose(ties.second_sigma_parallax_px**2, 1.0 + 5 * 0.1**2)
