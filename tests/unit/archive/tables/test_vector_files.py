import csv
import sys

import numpy as np
import pytest

from solmap.photogrammetry.archive.tables.vector_files import (
    best_poses,
    join_priorities,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.errors import FrameError, VectorFileError
from solmap.photogrammetry.frames import LSL, FrameKind, Pose, rover_frame, site_frame


def solution(  # noqa: PLR0913, PLR0917 - one argument for each part of the element
    name="SITE_FRAME",
    counter=(11,),
    reference=10,
    offset=(1, 2, 3),
    solution_id="telemetry",
    added="2004-06-10T08:24:20Z",
    quaternion=(1, 0, 0, 0),
):
    index = " ".join(f'index{k}="{value}"' for k, value in enumerate(counter, start=1))
    x, y, z = offset
    s, v1, v2, v3 = quaternion
    return (
        f'<solution solution_id="{solution_id}" name="{name}" add_date="{added}" {index}>'
        f'<reference_frame name="SITE_FRAME" index1="{reference}"/>'
        f'<offset x="{x}" y="{y}" z="{z}"/>'
        f'<orientation s="{s}" v1="{v1}" v2="{v2}" v3="{v3}"/></solution>'
    )


def vector_file(*solutions, priority=("telemetry",), source="x.svf"):
    entries = "".join(f'<entry solution_id="{name}"/>' for name in priority)
    return parse_vector_file(
        '<?xml version="1.0" encoding="UTF-8"?>\n<rmc_file mission="MER2" variant="Master">'
        f"<priority>{entries}</priority>{''.join(solutions)}</rmc_file>",
        source,
    )


def test_a_site_vector_file_places_sites_in_sites():
    file = vector_file(solution(offset=(33.8124, 27.4237, -3.82462)))
    assert (file.mission, file.kind, file.priority) == ("MER2", "svf", ("telemetry",))
    (pose,) = best_poses([file])
    assert (pose.target, pose.source) == (site_frame(10), site_frame(11))
    np.testing.assert_array_equal(pose.translation_m, [33.8124, 27.4237, -3.82462])


def test_a_rover_vector_file_places_the_rover_in_its_site():
    file = vector_file(
        solution("ROVER_FRAME", (10, 64, 0, 4, 0), 10, quaternion=(0.9, 0.1, 0.0, 0.42))
    )
    assert file.kind == "rvf"
    (pose,) = best_poses([file])
    assert (pose.target, pose.source) == (site_frame(10), rover_frame(10, 64))


def test_the_order_of_priority_selects_among_solutions():
    telemetry = solution(offset=(1, 0, 0), added="2009-01-01")
    adjusted = solution(offset=(2, 0, 0), solution_id="adjusted")
    unlisted = solution(offset=(3, 0, 0), solution_id="other", added="2010-01-01")
    for order in ((telemetry, adjusted, unlisted), (unlisted, adjusted, telemetry)):
        (pose,) = best_poses([vector_file(*order, priority=("adjusted", "telemetry"))])
        assert pose.translation_m[0] == 2
        (pose,) = best_poses([vector_file(*order, priority=("telemetry", "adjusted"))])
        assert pose.translation_m[0] == 1


def test_the_priorities_of_several_files_are_merged():
    adjusted = vector_file(
        solution(offset=(2, 0, 0), solution_id="adjusted", added="2004"), priority=("adjusted",)
    )
    telemetry = vector_file(solution(offset=(1, 0, 0), added="2009"))
    (pose,) = best_poses([adjusted, telemetry])
    assert pose.translation_m[0] == 2
    (pose,) = best_poses([telemetry, adjusted])
    assert pose.translation_m[0] == 1


def test_a_solution_of_higher_priority_in_a_later_file_is_used():
    telemetry = vector_file(solution(offset=(1, 0, 0), added="2009"))
    localised = vector_file(
        solution(offset=(2, 0, 0), solution_id="localised"), priority=("localised", "telemetry")
    )
    for files in ([telemetry, localised], [localised, telemetry]):
        assert join_priorities(files) == ["localised", "telemetry"]
        (pose,) = best_poses(files)
        assert pose.translation_m[0] == 2


def test_at_one_stop_the_highest_motion_counter_counts_then_the_last_row():
    def stop(x, counter, added="2009"):
        return solution("ROVER_FRAME", counter, 10, offset=(x, 0, 0), added=added)

    file = vector_file(
        stop(1, (10, 64, 0, 9, 0)),
        stop(2, (10, 64, 1, 0, 0), "2009-05"),
        stop(3, (10, 64, 1, 0, 0), "2009-04"),
        stop(4, (10, 64, 0, 0, 0), "2010"),
    )
    (pose,) = best_poses([file])
    assert pose.translation_m[0] == 2


def test_the_landing_frame_is_site_zero():
    tree = lsl_tree(best_poses([vector_file(solution(counter=(10,), reference=0), solution())]))
    assert tree.origin_site == 0
    np.testing.assert_array_equal(tree.tree.pose(LSL, site_frame(11)).translation_m, [2, 4, 6])


def test_without_the_lander_the_landing_frame_starts_at_the_lowest_site_of_a_group():
    tree = lsl_tree(best_poses([vector_file(solution(), solution(counter=(12,), reference=11))]))
    assert tree.origin_site == 10
    np.testing.assert_array_equal(tree.tree.pose(LSL, site_frame(12)).translation_m, [2, 4, 6])


def test_unconnected_sites_are_separate_groups():
    chain = best_poses([vector_file(solution(), solution(counter=(30,), reference=29))])
    tree = lsl_tree(chain, sites=[10, 11, 30, 77])
    assert tree.origin_site == 10
    assert tree.origins == {10: 10, 11: 10, 29: 29, 30: 29, 77: 77}
    assert lsl_tree(chain, [10, 30], origin=29).tree.pose(LSL, site_frame(30)).source.index == (30,)
    with pytest.raises(FrameError, match="not connected"):
        tree.tree.pose(LSL, site_frame(30))


def test_poses_connect_sites_in_both_directions_by_priority():
    def pose(target: int, source: int, north_m: float) -> Pose:
        return Pose(
            site_frame(target), site_frame(source), np.eye(3), np.array([north_m, 0.0, 0.0])
        )

    tree = lsl_tree([pose(0, 12, 50), pose(11, 12, 7), pose(10, 11, 5), pose(10, 12, 99)])
    assert (tree.origin_site, set(tree.origins.values())) == (0, {0})
    for site, north_m in ((12, 50), (11, 43), (10, 38)):
        assert tree.tree.pose(LSL, site_frame(site)).translation_m[0] == north_m


def test_a_circular_chain_is_cut_and_the_others_are_kept():
    circle = [solution(counter=(31,), reference=30), solution(counter=(30,), reference=31)]
    tree = lsl_tree(best_poses([vector_file(solution(), *circle)]), sites=[11, 30])
    assert tree.origins == {10: 10, 11: 10, 30: 30, 31: 30}


def test_a_chain_longer_than_the_recursion_limit_has_one_origin():
    sites = range(2 * sys.getrecursionlimit())
    links = [Pose.identity(site_frame(site), site_frame(site + 1)) for site in sites]
    assert lsl_tree(links).origin_site == 0


def test_an_empty_input_has_no_landing_frame():
    assert lsl_tree([]).origin_site is None
    assert lsl_tree([], sites=[5]).origin_site == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "x.svf: not well-formed XML"),
        ("<a>", "x.svf: not well-formed XML"),
        ("<other/>", "expected <rmc_file>, found <other>"),
        ('<rmc_file mission="M"/>', "expected at least one <solution>, found none"),
        ("<!DOCTYPE rmc_file []><rmc_file/>", "line 1: <!DOCTYPE is not allowed"),
        ('<rmc_file>\n<!ENTITY a "b"></rmc_file>', "line 2: <!ENTITY is not allowed"),
        ("<rmc_file><solution/></rmc_file>", "<solution> lacks the attribute name"),
        (f"<rmc_file>{solution()}</rmc_file>", "<rmc_file> lacks the attribute mission"),
        (f"<rmc_file>{solution('MOON')}</rmc_file>", "expected SITE_FRAME with index1 or ROVER"),
        (f"<rmc_file>{solution('ROVER_FRAME')}</rmc_file>", "or ROVER_FRAME with index1 and"),
        (f"<rmc_file>{solution(counter=('x',))}</rmc_file>", "index1 of .* whole number"),
        (f"<rmc_file>{solution(offset=(1, 'nan', 2))}</rmc_file>", "y of .* should be a number"),
        (f"<rmc_file>{solution(quaternion=(0, 0, 0, 0))}</rmc_file>", "not a unit quaternion"),
        (f"<rmc_file>{solution(reference=11)}</rmc_file>", r"site\[11\] refers to itself"),
        (
            f"<rmc_file>{solution().replace('<offset', '<of')}</rmc_file>",
            "<solution name=SITE_FRAME index1=11> lacks <offset>",
        ),
    ],
)
def test_a_broken_file_is_refused_with_its_element(text, message):
    with pytest.raises(VectorFileError, match=message) as caught:
        parse_vector_file(text, "x.svf")
    assert str(caught.value).startswith("x.svf: ")
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def spirit(shared_data):
    folder = shared_data / "traverse" / "mer_spirit"
    return [
        parse_vector_file((folder / name).read_text(), name)
        for name in ("mer2_master.svf", "mer2_site_137_master.rvf")
    ]


def test_all_138_sites_of_spirit_compose_to_the_offsets_of_the_facts(spirit, test_vectors):
    assert len(spirit[0].solutions) == 138
    lsl = lsl_tree(best_poses(spirit))
    assert lsl.origin_site == 0
    chain = test_vectors["site_chain"]
    for site, expected in chain["cumulative_site_origin_in_lsl_north_east_down"].items():
        found = lsl.tree.pose(LSL, site_frame(int(site))).translation_m
        np.testing.assert_allclose(found, expected, atol=1e-6)
    for site, expected in chain["offset_from_previous_site"].items():
        previous = site_frame(int(site) - 1)
        found = lsl.tree.pose(previous, site_frame(int(site))).translation_m
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_spirit_declared_site_138_at_its_position(spirit):
    stops = [pose for pose in best_poses(spirit) if pose.source.kind is FrameKind.ROVER]
    assert {pose.target for pose in stops} == {site_frame(137)}
    declared = next(p for p in best_poses(spirit) if p.source == site_frame(138)).translation_m
    stood = next(p for p in stops if p.source == rover_frame(137, 249)).translation_m
    # Telemetry is given to 1e-4 m or better; the two solutions were written at different times.
    np.testing.assert_allclose(stood, declared, atol=2e-3)


def test_the_traverse_of_spirit_agrees_with_the_site_chain(spirit, shared_data):
    """Raw positions of the Analyst's Notebook: east, north in metres from the landing point."""
    lsl = lsl_tree(best_poses(spirit)).tree
    path = shared_data / "traverse" / "mer_spirit" / "MERA-MER2-Spirit_traverse_path.csv"
    with path.open() as stream:
        starts = [row for row in csv.DictReader(stream) if row["DRIVE"] == "0"]
    differences, lsl_from_site = {}, {0: lsl.pose(LSL, site_frame(0))}
    for site in range(1, 139):
        lsl_from_site[site] = lsl_from_site[site - 1] @ lsl.parent_from[site_frame(site)]
    for row in starts:
        site = int(row["SITE"])
        north, east, _ = lsl_from_site[site].translation_m
        differences[site] = max(abs(float(row["RAW_X"]) - east), abs(float(row["RAW_Y"]) - north))
    assert len(differences) == 134
    apart = {site: metres for site, metres in differences.items() if metres > 5.1e-4}
    # The table is rounded to 1 mm. It has the rover 6 cm south of the lander's origin at sites 0-2,
    # which the site chain cannot show, and an entry of its own for site 133.
    assert apart.keys() == {0, 1, 2, 133}
    assert apart[133] < 2e-3


def test_the_rendered_chain_reaches_the_lander(husband):
    files = [
        parse_vector_file(path.read_text(), path.name)
        for path in sorted((husband / "masters").glob("*.?vf"))
    ]
    lsl = lsl_tree(best_poses(files))
    assert lsl.origin_site == 0
    assert lsl.tree.pose(LSL, rover_frame(11, 0)).translation_m == pytest.approx(
        [33.8124, 27.4237, -3.82462]
    )


def test_the_traverse_agrees_with_every_stop_of_the_vector_files(spirit, shared_data):
    """Site 137 is the one whose rover vector file is available: 131 stops, 133 rows of the table.

    The table has the pose of arrival, the lowest motion counter of a stop; `best_poses` takes the
    highest, which is 44 cm from it at drive 166, where the rover sank in later.
    """
    lsl = lsl_tree(best_poses(spirit)).tree
    lsl_from_site = lsl.pose(LSL, site_frame(137))
    arrivals = {}
    for solution in sorted(spirit[1].solutions, key=lambda s: s.counter, reverse=True):
        arrivals[solution.counter[1]] = (lsl_from_site @ solution.pose).translation_m
    path = shared_data / "traverse" / "mer_spirit" / "MERA-MER2-Spirit_traverse_path.csv"
    with path.open() as stream:
        rows = [row for row in csv.DictReader(stream) if row["SITE"] == "137"]
    apart_m = [
        max(abs(float(row["RAW_X"]) - east), abs(float(row["RAW_Y"]) - north))
        for row in rows
        for north, east, _ in [arrivals[int(row["DRIVE"])]]
    ]
    assert (len(arrivals), len(apart_m)) == (131, 133)
    assert max(apart_m) < 5.1e-4  # the table is rounded to 1 mm


def test_between_sites_the_table_has_the_declaration_or_the_next_drive(spirit, shared_data):
    """Of 135 sites the last row is within 1.1 mm of the next site's origin for 74.

    At the others the rover drove on within the site before it declared the next one, or a drive
    was entered late: no vector file decides it.
    """
    lsl = lsl_tree(best_poses(spirit)).tree
    path = shared_data / "traverse" / "mer_spirit" / "MERA-MER2-Spirit_traverse_path.csv"
    with path.open() as stream:
        last = {int(row["SITE"]): row for row in csv.DictReader(stream)}
    exact, lsl_from_site = 0, lsl.pose(LSL, site_frame(3))
    for site in range(3, 138):
        lsl_from_site = lsl_from_site @ lsl.parent_from[site_frame(site + 1)]
        if site in last:
            north, east, _ = lsl_from_site.translation_m
            row = last[site]
            apart_m = max(abs(float(row["RAW_X"]) - east), abs(float(row["RAW_Y"]) - north))
            exact += apart_m < 1.1e-3
    assert exact >= 70
