import itertools
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.archive.partners import find_stereo_pairs
from solmap.photogrammetry.cameras.cahv import Cahv
from solmap.photogrammetry.frames import Pose, site_frame
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId

CAMERA = Cahv(np.zeros(3), np.eye(3)[0], np.array([500.0, 1000, 0]), np.array([500.0, 0, 1000]))


def frame(name: str, clock: float = 100.0, **changes) -> RoverImage:
    """A frame of the file name's kind: n (Navcam) or p (Pancam), product, eye, filter, version."""
    stop = changes.pop("stop", StopId("MER2", 137, 0))
    fields = {
        "id": name,
        "stop": stop,
        "sol": 1869,
        "instrument": {"N": "NAVCAM", "P": "PANCAM", "A": "MASTCAM", "M": "MI"}[name[1]],
        "eye": {"L": Eye.LEFT, "R": Eye.RIGHT, "M": Eye.MONO}[name[-4]],
        "filter_number": int(name[-3]) if name[1] in "PA" else None,
        "clock": clock,
        "motion_counter": (stop.site, stop.drive, 0, 13, 7),
        "sequence": "p0703",
        "product_type": name[11:14],
        "is_linearised": name[13] == "L",
        "lines": 1024,
        "samples": 1024,
        "camera": CAMERA,
        "site_from_rover": Pose.identity(site_frame(stop.site), stop.frame),
        "attitude_measured_by": "FINE",
        "local_solar_time": None,
        "start_time": None,
        "sun_azimuth": None,
        "sun_elevation": None,
    }
    return RoverImage(**{**fields, **changes})


def nav(eye: str, product: str = "EFF", version: str = "1", **changes) -> RoverImage:
    return frame(f"2N292280938{product}B100P0703{eye}0M{version}", **changes)


def pan(eye: str, filter_number: int, **changes) -> RoverImage:
    return frame(f"2P292280938EFFB100P2380{eye}{filter_number}M1", **changes)


def ids(pairing):
    return [(pair.left.id, pair.right.id) for pair in pairing.pairs]


def test_both_eyes_of_an_exposure_are_a_pair():
    left, right = nav("L"), nav("R", clock=100.4)
    pairing = find_stereo_pairs([right, left])
    assert ids(pairing) == [(left.id, right.id)]
    assert pairing.unpaired == {}


def test_a_frame_without_partner_has_a_reason():
    assert find_stereo_pairs([nav("L", clock=491020376.621)]).unpaired == {
        nav("L").id: "no right-eye partner within 1 s of clock 491020376"
    }
    assert find_stereo_pairs([nav("L", clock=100.0), nav("R", clock=101.5)]).unpaired == {
        nav("L").id: "no right-eye partner within 1 s of clock 100",
        nav("R").id: "no left-eye partner within 1 s of clock 101",
    }


def test_a_pair_needs_a_mast_that_did_not_move():
    pairing = find_stereo_pairs([nav("L"), nav("R", motion_counter=(137, 0, 0, 14, 7))])
    assert pairing.pairs == ()
    assert "has the motion counter (137, 0, 0, 14, 7), not" in pairing.unpaired[nav("L").id]


def test_two_rovers_or_two_instruments_are_not_a_pair():
    other = nav("R", stop=StopId("MER1", 137, 0))
    assert find_stereo_pairs([nav("L"), other]).pairs == ()
    assert find_stereo_pairs([nav("L"), pan("R", 2)]).pairs == ()


def test_pancam_filters_of_a_pair_must_have_one_band():
    assert len(find_stereo_pairs([pan("L", 2), pan("R", 2)]).pairs) == 1
    assert len(find_stereo_pairs([pan("L", 7), pan("R", 1)]).pairs) == 1
    pairing = find_stereo_pairs([pan("L", 2), pan("R", 1)])
    assert pairing.pairs == ()
    for reason in pairing.unpaired.values():
        assert reason.endswith("have different bands")
        assert "(L2)" in reason
        assert "(R1)" in reason


def test_eyes_of_different_focal_lengths_are_not_a_pair():
    names = [f"MA292280938EDRB100P2380{eye}0M1" for eye in "LR"]
    assert find_stereo_pairs([frame(n, stop=StopId("MSL", 3, 0)) for n in names]).pairs == ()


def test_radiometrically_corrected_products_of_both_eyes_are_preferred():
    eff, ilf, rad = ([nav(eye, kind) for eye in "LR"] for kind in ("EFF", "ILF", "RAD"))
    pairing = find_stereo_pairs([*eff, *ilf, *rad])
    assert ids(pairing) == [(rad[0].id, rad[1].id)]
    assert pairing.unpaired[ilf[0].id] == f"RAD {rad[0].id} of the same exposure is used instead"
    assert len(pairing.unpaired) == len(pairing.repeats) == 4
    pairing = find_stereo_pairs([*eff, *ilf, rad[0]])
    assert ids(pairing) == [(ilf[0].id, ilf[1].id)]


def test_one_product_is_used_of_an_exposure_without_partner():
    levels = [nav("L", kind) for kind in ("EFF", "RAD", "RSL", "FFL")]
    later = [nav("L", kind, clock=200.0) for kind in ("RSL", "EFF")]
    for images in (levels, levels[::-1]):
        pairing = find_stereo_pairs(images)
        assert pairing.repeats == {levels[k].id: levels[1].id for k in (0, 2, 3)}
        assert pairing.unpaired[levels[1].id].startswith("no right-eye partner")
    both = [replace(image, id=f"{image.id}{image.clock:.0f}") for image in (*levels, *later)]
    assert set(find_stereo_pairs(both).repeats.values()) == {both[1].id, both[5].id}


def test_a_separate_filter_and_a_neighbouring_tile_are_separate_observations():
    assert find_stereo_pairs([pan("L", 2), pan("L", 5)]).repeats == {}
    right_of_it = replace(CAMERA, h=CAMERA.h - 1100 * CAMERA.a)
    tile = nav("L", version="2", camera=right_of_it)
    assert find_stereo_pairs([nav("L"), tile]).repeats == {}
    part = nav("L", "ESF", lines=384, samples=640)
    assert find_stereo_pairs([nav("L"), part]).repeats == {part.id: nav("L").id}


def test_raw_frames_are_preferred_to_linearised_ones():
    ffl, rad = ([nav(eye, kind) for eye in "LR"] for kind in ("FFL", "RAD"))
    assert ids(find_stereo_pairs([*ffl, *rad])) == [(rad[0].id, rad[1].id)]
    assert ids(find_stereo_pairs(ffl)) == [(ffl[0].id, ffl[1].id)]
    mixed = find_stereo_pairs([ffl[0], rad[1]])
    assert mixed.pairs == ()
    assert mixed.unpaired[ffl[0].id].endswith("is a raw RAD, this one a linearised FFL")


def test_the_highest_version_of_each_eye_is_used():
    versions = [nav("L", version=v) for v in "19A"] + [nav("R", version=v) for v in "12"]
    pairing = find_stereo_pairs(versions)
    assert ids(pairing) == [(nav("L", version="A").id, nav("R", version="2").id)]
    assert len(pairing.unpaired) == 3


def test_a_sub_frame_of_one_eye_is_paired_with_the_full_frame_of_the_other():
    left, right = nav("L"), nav("R", "ESF", lines=384, samples=640)
    assert ids(find_stereo_pairs([left, right])) == [(left.id, right.id)]
    full = nav("R")
    assert ids(find_stereo_pairs([left, right, full])) == [(left.id, full.id)]


def test_a_camera_with_one_eye_gives_that_as_the_reason():
    (reason,) = find_stereo_pairs([frame("2M292280938EFFB100P0703M0M1")]).unpaired.values()
    assert reason == "MI has one eye"


def test_every_frame_is_in_a_pair_or_has_a_reason(rng):
    images = [
        nav(eye, kind, version, clock=100.0 + 60 * number)
        for number, (eye, kind, version) in enumerate(itertools.product("LR", ("EFF", "ILF"), "12"))
    ]
    for _ in range(20):
        chosen = [images[k] for k in rng.permutation(len(images))[: rng.integers(1, 8)]]
        pairing = find_stereo_pairs(chosen)
        paired = {image for pair in ids(pairing) for image in pair}
        assert paired | set(pairing.unpaired) == {image.id for image in chosen}
        assert not paired & set(pairing.unpaired)


def test_pairs_are_in_the_order_of_the_clock():
    images = [
        frame(f"2N{clock:09d}EFFB100P0703{eye}0M1", clock=float(clock))
        for clock in (300, 100, 200)
        for eye in "RL"
    ]
    assert [pair.left.clock for pair in find_stereo_pairs(images).pairs] == [100, 200, 300]


def test_a_thousand_frames_are_paired():
    images = [
        frame(f"2N{clock:09d}EFFB100P0703{eye}0M1", clock=float(clock))
        for clock in range(0, 6_680, 10)
        for eye in "LR"[: 1 + clock % 20 // 10]
    ]
    pairing = find_stereo_pairs(images)
    assert len(pairing.pairs) == 334
    assert len(pairing.unpaired) == 334


def tile(eye: str, number: int, averaging: int = 1, **changes) -> RoverImage:
    """Part of a Navcam frame of Perseverance: of 16 tiles, four averaged ones, or the whole one."""
    across = {1: 4, 2: 2, 4: 1}[averaging]
    column, row = (number - 1) % across, (number - 1) // across
    level = {1: 0, 2: 1, 4: 2}[averaging]
    name = f"N{eye}F_0670_0726421423_362ECM_N0320604NCAM08111_{number:02d}_{level}95J01"
    focal, middle = 3000.0 / averaging, (2560.0 / averaging, 1920.0 / averaging)
    camera = Cahv(
        np.zeros(3),
        np.eye(3)[0],
        np.array([middle[0] - 1280 * column, focal, 0]),
        np.array([middle[1] - 960 * row, 0, focal]),
    )
    stop = StopId("M20", 32, 604)
    given = {"id": name, "stop": stop, "motion_counter": (32, 604), "lines": 960, "samples": 1280}
    template = nav(eye, camera=camera)
    return replace(
        template,
        **given,
        product_type="ECM",
        site_from_rover=Pose.identity(site_frame(32), stop.frame),
        **changes,
    )


def test_tiles_of_a_frame_are_paired_with_the_same_tiles_of_the_other_eye():
    """Perseverance's Navcam at full resolution comes down in 16 parts; one part is lost."""
    images = [tile(eye, number) for eye in "LR" for number in range(1, 17)]
    lost = images.pop(20)
    pairing = find_stereo_pairs(images)
    assert len(pairing.pairs) == 15
    for pair in pairing.pairs:
        assert pair.left.id[1:] != pair.right.id[1:]
        assert pair.left.id[2:] == pair.right.id[2:]
    (alone,) = pairing.unpaired
    assert alone == "NL" + lost.id[2:]
    assert f"no right-eye frame of its tile {int(lost.id[45:47])}" in pairing.unpaired[alone]


def test_a_complete_set_of_tiles_counts_as_the_averaged_frame():
    whole = [tile(eye, 1, averaging=4) for eye in "LR"]
    tiles = [tile(eye, number) for eye in "LR" for number in range(1, 17)]
    pairing = find_stereo_pairs([*whole, *tiles])
    assert len(pairing.pairs) == 16
    assert set(pairing.repeats) == {image.id for image in whole}
    few = [image for image in tiles if image.id[45:47] in {"06", "07"}]
    (pair,) = find_stereo_pairs([*whole, *few]).pairs
    assert [pair.left.id, pair.right.id] == [image.id for image in whole]


def test_zoom_lenses_are_paired_at_one_focal_length():
    """Each focal length of Mastcam-Z is a rig of its own."""

    def zoomed(eye: str, millimetres: int) -> RoverImage:
        name = f"Z{eye}0_0670_0726421423_362ECM_N0320604ZCAM08111_{millimetres:03d}095J01"
        return replace(tile(eye, 1), id=name, instrument="MASTCAM", filter_number=0)

    (pair,) = find_stereo_pairs([zoomed("L", 34), zoomed("R", 34)]).pairs
    assert [pair.left.id[1], pair.right.id[1]] == ["L", "R"]
    apart = find_stereo_pairs([zoomed("L", 34), zoomed("R", 110)])
    assert not apart.pairs
    assert all("focal length 034" in reason for reason in apart.unpaired.values())
