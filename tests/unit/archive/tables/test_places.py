import re

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.places import (
    parse_localisations,
    parse_locations,
    parse_places,
)
from solmap.photogrammetry.archive.tables.vector_files import (
    best_poses,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.errors import VectorFileError
from solmap.photogrammetry.frames import LSL, FrameKind, rover_frame, site_frame

HEADER = (
    "frame,site,drive,pose,landing_x,landing_y,landing_z,northing,easting,elevation,"
    "roll,pitch,yaw,quat_s,quat_v1,quat_v2,quat_v3,sclk,sol"
)
SITE_3 = "SITE,3,-1,-1,10.5,-4.25,0.5,-271.0,8146.0,-4500,0,0,0,1,0,0,0,,16"
ROVER_3 = "ROVER,3,308,2,12.5,-1.25,0.75,-269.0,8149.0,-4500,,,,0.8,0,0,0.6,399621413,24"


def table(*rows):
    return parse_localisations("\n".join([HEADER, *rows]) + "\n", "localized_interp.csv")


def test_a_places_table_gives_sites_and_stops_in_the_landing_frame():
    file = table(SITE_3, ROVER_3)
    site, rover = file.solutions
    assert (site.kind, site.counter, site.reference_site) == (FrameKind.SITE, (3,), 0)
    assert (rover.kind, rover.counter) == (FrameKind.ROVER, (3, 308, 2))
    tree = lsl_tree(best_poses([file])).tree
    np.testing.assert_array_equal(tree.pose(LSL, site_frame(3)).translation_m, [10.5, -4.25, 0.5])
    lsl_from_rover = tree.pose(LSL, rover_frame(3, 308))
    np.testing.assert_array_equal(lsl_from_rover.translation_m, [12.5, -1.25, 0.75])
    np.testing.assert_allclose(lsl_from_rover.quaternion, [0.8, 0, 0, 0.6], atol=1e-15)


def test_a_localised_stop_has_priority_over_its_telemetry():
    telemetry = parse_vector_file(
        '<rmc_file mission="MSL"><priority><entry solution_id="telemetry"/></priority>'
        '<solution solution_id="telemetry" name="ROVER_FRAME" index1="3" index2="308" index3="9">'
        '<reference_frame name="SITE_FRAME" index1="3"/><offset x="2" y="3" z="0"/>'
        '<orientation s="1" v1="0" v2="0" v3="0"/></solution></rmc_file>',
        "x.rvf",
    )
    for files in ([telemetry, table(ROVER_3)], [table(ROVER_3), telemetry]):
        (pose,) = best_poses(files)
        assert pose.target == site_frame(0)
        assert pose.translation_m[0] == 12.5
    tactical = parse_places(
        f"{HEADER}\n{ROVER_3}", "best_tactical.csv", mission="MSL", solution_id="telemetry"
    )
    (pose,) = best_poses([tactical, telemetry])
    assert pose.translation_m[0] == 2  # of one rank, the higher motion counter


def test_rows_without_a_place_or_an_attitude_give_no_poses():
    unplaced = ROVER_3.replace("12.5,-1.25,0.75", ",,")
    unturned = ROVER_3.replace("0.8,0,0,0.6", ",,,")
    assert len(table(SITE_3, unplaced, unturned).solutions) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a PLACES table: its first line lacks frame, site, drive, landing_x"),
        ("frame,site\nSITE,1", "lacks drive, landing_x, landing_y, landing_z"),
        (f"{HEADER}\n", "expected at least one pose, found none"),
        (f"{HEADER}\n{SITE_3.replace('SITE,3', 'SITE,x')}", "line 2: site should be a whole"),
        (f"{HEADER}\n{SITE_3.replace('10.5', 'nan')}", "line 2: landing_x, y, z should be numbers"),
        (f"{HEADER}\n{SITE_3}\n{ROVER_3.replace('0.8', '0.0').replace('0.6', '0')}", "line 3: .*n"),
        (f"{HEADER}\n{SITE_3.replace('SITE', 'MOON')}", "frame should be SITE or ROVER, but is 'M"),
        (f"{HEADER}\n{ROVER_3.replace('308', '-308')}", "should not be negative"),
        ("<other/>", "expected <msl>, found <other>"),
        ("<msl/>", "no <location> of site 0"),
        ("<msl><location><site>0</site></location></msl>", "drive should be a whole number"),
        ("<!DOCTYPE msl []><msl/>", "<!DOCTYPE is not allowed"),
    ],
)
def test_a_broken_table_is_refused_with_its_line(text, message):
    with pytest.raises(VectorFileError, match=message) as caught:
        parse_localisations(text, "x.csv")
    assert str(caught.value).startswith("x.csv: ")
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def locations(shared_data):
    return (shared_data / "traverse" / "msl" / "locations.xml").read_text()


def test_the_location_file_of_curiosity_places_its_sites(locations):
    file = parse_localisations(locations, "locations.xml")
    assert (file.mission, file.kind) == ("MSL", "svf")
    tree = lsl_tree(best_poses([file]))
    assert tree.origin_site == 0
    assert {solution.counter[0] for solution in file.solutions} == {1, 2, 3, 4, 5}
    lander, site_5 = (
        np.radians([float(re.search(rf"<{tag}>(.*?)</{tag}>", place)[1]) for tag in ("lon", "lat")])
        for place in (
            next(p for p in locations.split("<location>")[1:] if f"<itemName>{name}<" in p)
            for name in ("0000000000", "0000500000")
        )
    )
    east, north = 3_396_190 * (site_5 - lander) * [np.cos(lander[1]), 1.0]
    found = tree.tree.pose(LSL, site_frame(5)).translation_m[:2]
    np.testing.assert_allclose(found, [north, east], atol=2e-3)  # x, y and lon, lat in one file


def test_localised_stops_have_no_attitude_and_are_used_only_on_request(locations):
    file = parse_locations(locations, "locations.xml", mission="MSL", keep_without_attitude=True)
    stops = [solution for solution in file.solutions if solution.kind is FrameKind.ROVER]
    assert len(stops) > 250
    assert file.kind == "rvf"
