"""Where telemetry has stops: in the frame of their group, and how well that is known."""

from __future__ import annotations

import numpy as np
import pytest

from solmap.config.landing import landing_site
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.archive.tables.places import LOCALISED
from solmap.photogrammetry.archive.tables.vector_files import (
    Solution,
    VectorFile,
    parse_vector_file,
)
from solmap.photogrammetry.frames import FrameKind, Pose, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.traverse.sources import parse_mission_table
from solmap.products.crs import east_north
from solmap.tasks.images.telemetry import LOCALISED_SIGMA_M, read_telemetry
from tests.unit.archive.test_partners import nav

SLIP = AdjustmentParams().slip


def at(site: int, drive: int = 0, north_m: float = 0.0):
    """An image from so far north of its site's origin."""
    stop = StopId("MER2", site, drive)
    pose = Pose(site_frame(site), stop.frame, np.eye(3), np.array([north_m, 0.0, 0.0]))
    return nav("L", stop=stop, site_from_rover=pose)


def stated(kind: FrameKind, counter: tuple[int, ...], north_m: float, name: str = LOCALISED):
    level = np.array([1.0, 0.0, 0.0, 0.0])
    return Solution(name, kind, counter, 0, np.array([north_m, 0.0, 0.0]), level, "")


def places(*solutions: Solution) -> VectorFile:
    return VectorFile("places", "MER2", "rvf", (LOCALISED, "telemetry"), solutions)


def test_a_localised_stop_ties_its_site_to_the_lander():
    images = [at(137), at(137, 231, 30.0), at(140)]
    alone = read_telemetry(images, [])
    assert set(alone.origins.items()) >= {(137, 137), (140, 140)}
    tied = read_telemetry(images, [places(stated(FrameKind.ROVER, (137, 231), 3000.0))])
    assert (tied.origins[137], tied.origins[140]) == (0, 140)
    norths = {one.stop.drive: one.lsl_from_rover.translation_m[0] for one in tied.stops}
    assert norths == {0: 2970.0, 231: 3000.0}
    assert tied.sigma_from_origin_m(StopId("MER2", 137, 231), SLIP) == LOCALISED_SIGMA_M
    near = tied.sigma_from_origin_m(StopId("MER2", 137, 0), SLIP)
    assert near == pytest.approx(np.hypot(LOCALISED_SIGMA_M, 3.0))


def test_a_site_vector_has_priority_over_a_localised_stop_of_the_site():
    known = places(
        stated(FrameKind.SITE, (137,), 2965.0, "telemetry"),
        stated(FrameKind.ROVER, (137, 231), 3000.0),
    )
    (stop,) = read_telemetry([at(137, 231, 30.0)], [known]).stops
    assert stop.lsl_from_rover.translation_m[0] == 2995.0


def test_the_map_of_one_stop_begins_at_its_rover():
    (stop,) = read_telemetry([at(137, 231, 30.0)], [], (137, 231)).stops
    np.testing.assert_array_equal(stop.lsl_from_rover.translation_m, 0.0)


def test_sites_of_spirit_are_within_their_sigma_of_the_localised_ones(shared_data):
    """Relative to the lander, and on Mars with the sigma of the landing point itself."""
    folder = shared_data / "traverse" / "mer_spirit"
    svf, csv = folder / "mer2_master.svf", folder / "MERA-MER2-Spirit_traverse_path.csv"
    file = parse_vector_file(svf.read_text(), svf.name)
    table = parse_mission_table(csv.read_text(), csv.name)
    landing = landing_site("MER2").landing
    places_m = np.column_stack(east_north(landing, *table.localised_deg.T))
    first: dict[int, np.ndarray] = {}
    for name, place in zip(table.telemetry().stops, places_m, strict=True):
        site, drive, *_ = map(int, name.split("/"))
        if drive == 0:
            first.setdefault(site, place)
    sites = sorted(first.keys() & {one.counter[0] for one in file.solutions})[::3]
    telemetry = read_telemetry([at(site) for site in sites], [file])
    assert len(telemetry.stops) == len(sites) > 40
    shares = []
    for one in telemetry.stops:
        north, east, _ = one.lsl_from_rover.translation_m
        sigma_m = telemetry.sigma_from_origin_m(one.stop, SLIP)
        off_m = np.array([east, north]) - (first[one.stop.site] - first[0])
        assert np.abs(off_m).max() <= sigma_m + 0.5, one.stop  # positions are given to the metre
        on_mars_m = np.array([east, north]) - first[one.stop.site]
        assert np.abs(on_mars_m).max() <= np.hypot(sigma_m, landing.sigma_m), one.stop
        shares.append(np.abs(off_m).max() / max(sigma_m, 1.0))
    assert max(shares) < 0.7  # 0.67 at site 42, 0.59 at the median, 266 of 550 m at the last
    assert 0.3 < np.median(shares) < 1.0  # neither too small nor many times too large
