"""Manual edits applied to automatic ties, with points as clicked in the original images."""

import re

import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import epipolar_pair
from solmap.photogrammetry.frames import Frame, FrameKind
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.matching.manual.editing import (
    EditAction,
    EditPoint,
    EditRequest,
    ManualImage,
    epipolar_point,
)
from solmap.photogrammetry.matching.manual.editing import apply_edits as carried_out
from solmap.photogrammetry.matching.records import Ties
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument, Pointing

STOP = StopId("MER2", 10, 0)
SIZE = (1024, 1024)


def body(name, number, azimuth):
    """A Navcam pair of Spirit with its original cameras."""
    rover_from_head = Pointing(azimuth, -0.3).rover_from_mast(STOP)
    left, right = (
        CAMERAS[Instrument.NAVCAM, eye].in_mast.transform(rover_from_head)
        for eye in (Eye.LEFT, Eye.RIGHT)
    )
    frame = Frame(FrameKind.PAIR, (10, 0, number))
    geometry = epipolar_pair(left, right, SIZE, SIZE, STOP.frame, frame)
    return ManualImage(name, geometry, left, right)


@pytest.fixture(scope="module")
def bodies():
    return {name: body(name, k, 0.6 * k) for k, name in enumerate("ABC")}


@pytest.fixture
def ground(bodies):
    """A point before the rover, and where the originals of A and B show it."""
    place = np.array([[4.0, 1.4, 0.2]])
    clicked = {
        name: tuple(tuple(camera.project(place)[0].tolist()) for camera in (some.left, some.right))
        for name, some in bodies.items()
    }
    return place, clicked


def edited(ties, edits, bodies):
    """All pairs are of one stop."""
    return carried_out(ties, edits, bodies, dict.fromkeys(bodies, str(STOP)))


def automatic(bodies, *points):
    """Ties of A with B at epipolar points, and one of B with C."""
    n = len(points)
    left = np.array(points, dtype=float)
    flat = np.full(n + 1, 0.2)
    return Ties(
        tuple(bodies),
        np.array([0] * n + [1], np.int32),
        np.array([1] * n + [2], np.int32),
        np.vstack([left, [[300.0, 300.0]]]),
        np.vstack([left + 7.0, [[200.0, 200.0]]]),
        *[flat * k for k in (100, 101, 1, 1, 2, 2, 1, 1)],
    )


@pytest.fixture
def ties(bodies):
    return automatic(bodies, (100.0, 200.0), (400.0, 500.0), (600.0, 650.0))


def edit(action, first, second, row="f, row 1", **more):
    return EditRequest(EditAction(action), first, second, row=row, **more)


@pytest.mark.parametrize("point", [(3.0, 5.0), (511.5, 511.5), (1000.0, 30.0), (640.0, 1015.0)])
def test_a_clicked_point_is_where_its_ray_meets_the_epipolar_image(bodies, point):
    some = bodies["A"]
    place = some.left.centre + 6.0 * some.left.rays(np.array([point]))
    in_pair = some.geometry.rover_from_pair.inverse.apply(place)
    left, _ = some.geometry.project(in_pair)
    np.testing.assert_allclose(epipolar_point(some.left, some.geometry, point), left[0], atol=1e-6)


def test_a_clicked_tie_gives_the_point_that_was_clicked(bodies, ground):
    place, clicked = ground
    first, second = (EditPoint(name, *clicked[name]) for name in "AB")
    found = edited([], [edit("add", first, second)], bodies)
    (made,) = found.ties
    assert found.added == 1
    assert found.notes == ()
    for side, name in (("first", "A"), ("second", "B")):
        assert made.pair_ids[getattr(made, side)[0]] == name
        g = bodies[name].geometry
        left, parallax = (getattr(made, f"{side}_{what}") for what in ("left", "parallax_px"))
        in_rover = g.rover_from_pair.apply(g.triangulate(left, parallax))
        np.testing.assert_allclose(in_rover, place, atol=1e-5)
    assert made.first_sigma_px[0] == 1.0


def test_without_a_right_point_the_dense_parallax_is_used(bodies, ground):
    _, clicked = ground
    points = [EditPoint(name, clicked[name][0]) for name in "AB"]
    a, b = bodies["A"], bodies["B"]
    dense = np.full((a.geometry.lines, a.geometry.samples), 33.0, np.float32)
    known = ManualImage(a.name, a.geometry, a.left, a.right, dense)
    (made,) = edited([], [edit("add", *points)], {"A": known, "B": b}).ties
    assert made.first_parallax_px[0] == 33.0
    assert np.isnan(made.second_parallax_px[0])
    assert np.isnan(made.second_sigma_parallax_px[0])


def original(bodies, name, epipolar):
    """Where a person would click to mean an epipolar point."""
    some = bodies[name]
    ground = some.left.centre + 5.0 * some.geometry.directions(np.array([epipolar]))
    return tuple(some.left.project(ground)[0].tolist())


def test_a_veto_drops_only_the_tie_at_the_point(bodies, ties):
    click = EditPoint("A", original(bodies, "A", (401.0, 501.5)))
    found = edited([ties], [edit("veto", click, EditPoint("B"))], bodies)
    assert found.vetoed == 1
    assert found.ties[0].first_left[:, 0].tolist() == [100.0, 600.0, 300.0]


def test_a_veto_applies_from_either_side(bodies, ties):
    click = EditPoint("B", original(bodies, "B", (407.0, 507.0)))
    found = edited([ties], [edit("veto", click, EditPoint("A"))], bodies)
    assert found.vetoed == 1
    assert 400.0 not in found.ties[0].first_left[:, 0]


def test_a_veto_of_two_images_drops_all_between_them(bodies, ties):
    found = edited([ties], [edit("veto", EditPoint("B"), EditPoint("A"))], bodies)
    assert found.vetoed == 3
    assert len(found.ties[0]) == 1


def test_a_veto_of_a_stop_with_itself_drops_its_inter_stereo_ties(bodies, ties):
    stop = EditPoint(str(STOP))
    assert edited([ties], [edit("veto", stop, stop)], bodies).vetoed == 4
    other = EditPoint("mer2-site0010-drive0064")
    found = edited([ties], [edit("veto", stop, other)], bodies)
    assert found.vetoed == 0
    assert found.notes == ("f, row 1: no automatic tie here to veto",)


def test_a_veto_without_second_image_drops_all_ties_from_its_point(bodies, ties):
    click = EditPoint("B", original(bodies, "B", (300.0, 300.0)))
    found = edited([ties], [edit("veto", click, EditPoint(""))], bodies)
    assert found.vetoed == 1
    assert 300.0 not in found.ties[0].first_left[:, 0]


def test_a_moved_tie_goes_to_the_second_point(bodies, ties):
    first = EditPoint("A", original(bodies, "A", (400.0, 500.0)))
    second = EditPoint("B", original(bodies, "B", (450.0, 520.0)))
    found = edited([ties], [edit("move", first, second)], bodies)
    assert (found.added, found.moved, found.vetoed) == (0, 1, 0)
    kept, new = found.ties
    assert 400.0 not in kept.first_left[:, 0]
    np.testing.assert_allclose(new.second_left, [[450.0, 520.0]], atol=1e-6)
    assert str(found) == "manual ties: 0 added, 1 moved, 0 vetoed"


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (EditPoint("A", (500.0, 500.0)), EditPoint("X", (5.0, 5.0)), "X is not a left"),
        (EditPoint("A", (-900.0, 5.0)), EditPoint("B", (5.0, 5.0)), "lies outside the usable"),
        (
            EditPoint("A", (500.0, 500.0), (600.0, 500.0)),
            EditPoint("B", (500.0, 500.0)),
            "cannot be the same feature: parallax -",
        ),
        (
            EditPoint("A", (500.0, 500.0), (450.0, 580.0)),
            EditPoint("B", (500.0, 500.0)),
            "cannot be the same feature: .* px apart",
        ),
    ],
)
def test_an_edit_that_cannot_be_placed_is_reported_and_the_rest_applied(
    bodies, ties, ground, first, second, message
):
    good = [EditPoint(name, *ground[1][name]) for name in "AB"]
    edits = [edit("add", first, second), edit("add", *good, row="f, row 2")]
    found = edited([ties], edits, bodies)
    assert found.added == 1
    (note,) = found.notes
    assert note.startswith("f, row 1: ")
    assert re.search(message, note)
    assert len(found.ties[0]) == len(ties)
