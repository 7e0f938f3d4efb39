"""Which orientations a stop is mapped with, whatever way its network came."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedPair
from solmap.photogrammetry.adjustment.quality.movement import ReissueParams
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.height_bias import USUAL_BIAS, HeightBias
from solmap.tasks.network.orientations import (
    MappedStop,
    Orientation,
    choose_for_stop,
    height_bias_of,
)

STOP = StopId("MER2", 10, 64)
NAME = str(STOP)
EXPECTED = HeightBias(0.4, 0.25)
PARAMS = ReissueParams(range_m=10.0, shift_m=0.02)


def pair(number: int, azimuth: float, north_m: float = 0.0) -> AdjustedPair:
    frame = Frame(FrameKind.PAIR, (10, 64, 0, number))
    rotation = Rotation.from_rotvec([0.0, 0.0, azimuth]).as_matrix()
    return AdjustedPair(
        f"PAIR{number}",
        STOP,
        Pose(LSL, frame, rotation, np.array([north_m, 0.0, 0.0])),
        Pose(STOP.frame, frame, np.eye(3), np.zeros(3)),
        np.zeros(3),
        np.zeros((6, 6)),
        np.zeros((3, 3)),
        9,
    )


def mapped(*pairs: AdjustedPair) -> MappedStop:
    return choose_for_stop(NAME, list(pairs), None, PARAMS)


def test_a_new_stop_is_mapped_as_adjusted():
    assert mapped(pair(1, 0.1)) == MappedStop(
        NAME, (Orientation.of(pair(1, 0.1)),), None, is_new=True
    )


def test_a_stop_that_moved_by_less_than_the_threshold_is_not_remapped():
    before = mapped(pair(1, 0.1), pair(2, 0.7))
    now = choose_for_stop(NAME, [pair(1, 0.1, 0.004), pair(2, 0.7 + 0.0015)], before, PARAMS)
    assert now.orientations == before.orientations
    assert not now.is_new
    np.testing.assert_allclose(now.moved_m, 0.015, rtol=1e-6)  # 10 m * 1.5 mrad, chord for arc


def test_one_moved_pair_remaps_the_whole_stop():
    before = mapped(pair(1, 0.1), pair(2, 0.7))
    moved = [pair(1, 0.1, 0.004), pair(2, 0.7 + 0.0025)]
    now = choose_for_stop(NAME, moved, before, PARAMS)
    assert now.orientations == tuple(Orientation.of(p) for p in moved)
    assert now.is_new


def link(earlier: str, later: str, lines: float | None, sigma: float | None) -> dict:
    figures = {"height_bias_lines": lines, "height_bias_sigma": sigma}
    figures |= {"expected_bias_lines": EXPECTED.lines, "expected_bias_sigma": EXPECTED.sigma}
    return {"earlier": earlier, "later": later, "figures": figures}


def test_the_height_bias_of_a_stop_pools_its_links_with_one_prior():
    links = [
        link("A", "B", 0.8, 0.1),
        link("B", "C", 0.3, 0.2),
        link("A", "C", None, None),  # by images alone
        {"earlier": "A", "later": "B", "figures": {}},  # of an older version
    ]
    alone = height_bias_of("A", links)
    np.testing.assert_allclose((alone.lines, alone.sigma), (0.8, 0.1))
    found = height_bias_of("B", links)
    prior = EXPECTED.sigma**-2
    weight = 1 / 0.1**2 + 1 / 0.2**2 - prior
    lines = (0.8 / 0.1**2 + 0.3 / 0.2**2 - prior * EXPECTED.lines) / weight
    np.testing.assert_allclose((found.lines, found.sigma), (lines, weight**-0.5))
    assert height_bias_of("D", links) == USUAL_BIAS
    vague = height_bias_of("E", [link("E", "F", 0.1, 2 * EXPECTED.sigma)])
    np.testing.assert_allclose(vague.lines, 0.1)
    assert height_bias_of("E", [link("E", "F", -0.1, 0.1)]).lines == 0.0


def test_a_stop_is_remapped_when_its_height_bias_changed_significantly():
    before = mapped(pair(1, 0.1))
    little = choose_for_stop(NAME, [pair(1, 0.1)], before, PARAMS, None, HeightBias(0.1, 0.1))
    assert little.height_bias == HeightBias()
    assert not little.is_new
    now = choose_for_stop(NAME, [pair(1, 0.1)], before, PARAMS, None, HeightBias(0.6, 0.1))
    assert now.height_bias == HeightBias(0.6, 0.1)
    assert now.is_new
    again = choose_for_stop(NAME, [pair(1, 0.1)], now, PARAMS, None, HeightBias(0.5, 0.08))
    assert not again.is_new
    assert again.height_bias == HeightBias(0.6, 0.1)


def test_small_movements_add_up_to_a_new_map():
    stands, remade = mapped(pair(1, 0.0)), []
    for step in range(1, 11):
        stands = choose_for_stop(NAME, [pair(1, 0.0, 0.009 * step)], stands, PARAMS)
        remade.append(stands.is_new)
    assert remade == [False, False, True] * 3 + [False]


def test_an_additional_pair_remaps_the_whole_stop():
    before = mapped(pair(1, 0.1))
    now = choose_for_stop(NAME, [pair(2, 0.7), pair(1, 0.1)], before, PARAMS)
    assert [o.pair_id for o in now.orientations] == ["PAIR1", "PAIR2"]
    assert now.is_new
    assert now.moved_m is None


def test_without_a_threshold_any_movement_remaps():
    before = mapped(pair(1, 0.1))
    none = replace(PARAMS, shift_m=0.0)
    assert choose_for_stop(NAME, [pair(1, 0.1, 1e-9)], before, none).is_new
    assert not choose_for_stop(NAME, [pair(1, 0.1)], before, none).is_new
