"""The rover's own body in its images."""

import numpy as np

from solmap.photogrammetry.frames import Frame, FrameKind, Pose
from solmap.photogrammetry.terrain.dtm.records import TerrainView
from solmap.photogrammetry.terrain.dtm.rover_body import BODIES, mask_rover


def seen_from(scenes, forward_m, height_m, dip_deg, distance_m) -> TerrainView:
    """A camera in the rover frame that looks ahead and down on something flat, so far away."""
    geometry, lsl_from_pair = scenes.looking(0.0, dip_deg)
    in_rover = Pose(
        Frame(FrameKind.ROVER, (0, 0)),
        geometry.rover_from_pair.source,
        lsl_from_pair.rotation,
        np.array([forward_m, 0.0, 0.294 - height_m]),  # the frame's origin is above the ground
    )
    shape = (geometry.lines, geometry.samples)
    parallax = np.full(shape, geometry.focal_px * geometry.base_m / distance_m, np.float32)
    reported = type(geometry)(
        in_rover,
        geometry.base_m,
        geometry.focal_px,
        geometry.centre_px,
        geometry.samples,
        geometry.lines,
    )
    return TerrainView(
        "PAIR0", "NAVCAM", lsl_from_pair, reported, parallax, parallax, np.ones(shape, dtype=bool)
    )


def test_the_deck_below_the_mast_is_masked_and_the_ground_before_it_is_not(scenes):
    view = seen_from(scenes, forward_m=0.3, height_m=1.5, dip_deg=60.0, distance_m=1.5)
    masked = ~mask_rover(view, "MER2").mask
    # the deck's front edge is 0.5 m ahead of the mast and 0.9 m below it: at a dip of 61 degrees
    line = 127.5 + 300 * np.tan(np.arctan2(0.9, 0.5) - np.radians(60))
    assert abs(np.flatnonzero(masked[:, 128]).min() - line) <= 8
    assert masked[-1].all()
    assert not masked[: int(line) - 8].any()


def test_a_panorama_of_the_ground_keeps_every_pixel(scenes):
    view = seen_from(scenes, forward_m=0.3, height_m=1.5, dip_deg=18.0, distance_m=4.0)
    assert mask_rover(view, "MER2").mask.all()


def test_a_hazard_camera_below_the_deck_loses_only_matches_on_the_rover(scenes):
    ground = seen_from(scenes, forward_m=0.5, height_m=0.5, dip_deg=30.0, distance_m=2.0)
    wheel = seen_from(scenes, forward_m=0.5, height_m=0.5, dip_deg=30.0, distance_m=0.25)
    assert mask_rover(ground, "MER2").mask.all()
    assert not mask_rover(wheel, "MER2").mask[128, 128]


def test_an_unknown_rover_does_not_change_the_view(scenes):
    view = seen_from(scenes, forward_m=0.3, height_m=1.5, dip_deg=60.0, distance_m=1.5)
    assert mask_rover(view, "ZHURONG") is view


def test_the_boxes_have_positive_sizes():
    for body in BODIES.values():
        low, high = body.corners
        assert (low < high).all()
