"""Images, files and truth of a world agree."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from solmap.photogrammetry.archive.file_names import parse_file_name
from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.archive.tables.vector_files import (
    best_poses,
    lsl_tree,
    parse_vector_file,
)
from solmap.photogrammetry.cameras.epipolar import epipolar_pair
from solmap.photogrammetry.errors import FrameError, PhotogrammetryError
from solmap.photogrammetry.frames import Frame, FrameKind, site_frame
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic import edr, lighting
from solmap.photogrammetry.synthetic.downlink import render_jobs, simulate_downlink, text_files
from solmap.photogrammetry.synthetic.lighting import Sun
from solmap.photogrammetry.synthetic.render import first_hits, photograph, view_of
from solmap.photogrammetry.synthetic.rig import GROUND_M, RigErrors
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world, realistic_params
from solmap.photogrammetry.synthetic.traverse import TraverseParams, sun_at
from solmap.photogrammetry.synthetic.truth import _beside_rover, true_parallax, truth_document
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

SMALL = WorldParams(
    terrain="hills",
    traverse=TraverseParams(stops=3, stops_per_site=2, slip=(0.05, 0.1)),
    pairs=2,
    pair_step=float(np.deg2rad(180)),
    pancam=True,
    averaging=4,
)
"""Three stops, images averaged over 4 x 4 pixels."""


@pytest.fixture(scope="module")
def small_world():
    return make_world(SMALL, rng_seed=7)


@pytest.fixture(scope="module")
def files(small_world):
    """Those of the first pair."""
    return [job.run(small_world) for job in render_jobs(small_world)[:2]]


@pytest.fixture(scope="module")
def pair(files):
    """The first pair as it is read back."""
    return [read_image(file.data, file.path.rsplit("/", 1)[-1]) for file in files]


def geometry_of(pair):
    left, right = pair
    size = (left.image.samples, left.image.lines)
    frame = Frame(FrameKind.PAIR, (1,))
    cameras = (left.image.camera, right.image.camera)
    return epipolar_pair(*cameras, size, size, left.image.stop.frame, frame)


@pytest.mark.usefixtures("unchecked")
def test_a_seed_repeats_a_downlink_bit_for_bit(small_world, files):
    one = [*text_files(small_world), *files]
    lighting._light.cache_clear()
    again = make_world(SMALL, rng_seed=7)
    with ThreadPoolExecutor(2) as threads:  # other order, other threads
        images = list(threads.map(lambda job: job.run(again), reversed(render_jobs(again)[:2])))
    assert one == [*text_files(again), *reversed(images)]


def test_a_downlink_is_delivered_file_by_file(small_world):
    texts = text_files(small_world)
    files = list(islice(simulate_downlink(SMALL, rng_seed=7), len(texts) + 1))
    assert files[:-1] == texts
    first = render_jobs(small_world)[0]
    assert files[-1].path == first.path(small_world)
    assert {file.path.split("/")[0] for file in files} == {"masters", "truth", "sol0155"}


def test_an_edr_is_read_back_as_rendered(small_world, pair):
    shot = small_world.shots[0]
    for eye, read in zip((Eye.LEFT, Eye.RIGHT), pair, strict=True):
        image, stop = read.image, small_world.stops[0]
        assert (image.stop, image.sol, image.eye) == (stop.id, stop.sol, eye)
        assert image.product_type == "EDN"
        assert read.mask.all()
        np.testing.assert_array_equal(read.pixels, photograph(small_world, shot, eye))
        assert image.sun_azimuth == pytest.approx(stop.sun.azimuth, abs=1e-5)
        assert image.sun_elevation == pytest.approx(stop.sun.elevation, abs=1e-5)
        reported = image.site_from_rover
        np.testing.assert_allclose(reported.rotation, stop.site_from_rover.rotation, atol=2e-6)


def test_the_label_camera_differs_from_the_true_one_by_the_mast_error(small_world, pair):
    shot = small_world.shots[0]
    lsl_from_label_rover = small_world.true_lsl_from_label_rover(shot)
    for eye, read in zip((Eye.LEFT, Eye.RIGHT), pair, strict=True):
        true = small_world.true_camera(shot, eye)
        moved = read.image.camera.transform(
            replace(lsl_from_label_rover, source=read.image.stop.frame)
        )
        points = true.centre + 7.0 * true.rays(
            np.array([[20.0, 200.0], [128.0, 90.0], [250.0, 240.0]])
        )
        # Six digits of C, H, V (0.01 px of the full frame, a quarter of it averaged).
        np.testing.assert_allclose(moved.project(points), true.project(points), atol=0.02)


def test_every_ray_meets_the_true_ground(small_world):
    shot = small_world.shots[0]
    view, _ = view_of(small_world, shot, Eye.LEFT)
    points = first_hits(small_world.ground(0), view)
    near = np.hypot(*(points[:, :2] - view.centre[:2]).T) < 20
    north, east, down = points[near].T
    gap = small_world.terrain.elevation(north, east) + down
    assert near.sum() > 20_000
    assert np.abs(gap).max() < 1e-3  # metres; the bisection ends below half a millimetre
    image_points = small_world.true_camera(shot, Eye.LEFT).project(points)
    line, sample = np.mgrid[:256, :256]
    known = np.isfinite(points[:, 0])
    miss = image_points[known] - np.column_stack([sample.ravel(), line.ravel()])[known]
    assert np.abs(miss).max() < 0.005  # rays in single precision


def test_no_ground_hides_a_visible_point(small_world):
    """The ray to a first hit runs above the ground all the way."""
    shot = small_world.shots[0]
    view, _ = view_of(small_world, shot, Eye.LEFT)
    points = first_hits(small_world.ground(0), view)
    reach = np.hypot(*(points[:, :2] - view.centre[:2]).T)
    chosen = np.flatnonzero((reach > 2) & (reach < 20))[::151]
    for share in (0.5, 0.9, 0.97, 0.99):
        on_the_way = view.centre + share * (points[chosen] - view.centre)
        z = small_world.terrain.elevation(on_the_way[:, 0], on_the_way[:, 1])
        above = -on_the_way[:, 2] - z
        assert np.mean(above > -0.002) > 0.995  # outlines: a quarter of a pixel of azimuth


def test_both_eyes_see_one_surface(small_world, pair):
    """Warped by the true parallax, the right image is the left one, to a twentieth of a pixel."""
    geometry = geometry_of(pair)
    parallax = true_parallax(small_world, 0, 0, geometry)
    line, sample = np.mgrid[: geometry.lines, : geometry.samples]
    known = np.isfinite(parallax) & (parallax > 5)  # nearer than 12 m
    left_points = np.column_stack([sample[known], line[known]]).astype(float)
    right_points = left_points - np.column_stack([parallax[known], np.zeros(known.sum())])
    grey = []
    for read, points in zip(pair, (left_points, right_points), strict=True):
        base = np.array([geometry.base_m if read is pair[1] else 0.0, 0.0, 0.0])
        centre = geometry.rover_from_pair.apply(base[None])[0]
        seen = read.image.camera.project(centre + 5 * geometry.directions(points))
        grey.append(_bicubic(read.pixels, seen))
    inside = np.isfinite(grey[0]) & np.isfinite(grey[1])
    a, b = grey[0][inside], grey[1][inside]
    assert inside.sum() > 10_000
    assert np.corrcoef(a, b)[0, 1] > 0.95
    # Least squares for the shift along the row: b - a = (da/dx) shift.
    ahead = _bicubic(
        pair[0].pixels,
        pair[0].image.camera.project(
            geometry.rover_from_pair.translation_m
            + 5 * geometry.directions(left_points + np.array([0.5, 0.0]))
        ),
    )[inside]
    slope = (ahead - a) / 0.5
    good = np.isfinite(slope)
    shift = np.sum(slope[good] * (b - a)[good]) / np.sum(slope[good] ** 2)
    assert abs(shift) < 0.05


def _bicubic(pixels, points):
    from scipy import ndimage  # noqa: PLC0415 - of this check alone

    inside = (points > 2).all(axis=1) & (points < 253).all(axis=1)
    at = np.where(inside[:, None], points, 2.0)
    grey = ndimage.map_coordinates(pixels, [at[:, 1], at[:, 0]], order=3)
    return np.where(inside, grey, np.nan)


def test_the_sky_has_no_parallax(small_world, pair):
    geometry = geometry_of(pair)
    parallax = true_parallax(small_world, 0, 0, geometry)
    up = geometry.directions(np.array([[geometry.samples / 2, 0.0]]))
    lsl_from_rover = small_world.true_lsl_from_label_rover(small_world.shots[0])
    assert np.nanmin(parallax) > 0
    if -lsl_from_rover.turn(up)[0, 2] > 0.15:  # 9 degrees: above all hills
        assert np.isnan(parallax[0, geometry.samples // 2])


def test_vector_files_contain_the_telemetry(small_world):
    files = {file.path: file.data.decode() for file in text_files(small_world)}
    read = [parse_vector_file(text, path) for path, text in files.items() if "masters" in path]
    tree = lsl_tree(best_poses(read))
    assert tree.origin_site == 0
    first = small_world.stops[0].id.site
    for stop in small_world.stops:
        site_from_rover = tree.tree.pose(site_frame(stop.id.site), stop.id.frame)
        reported = stop.site_from_rover
        np.testing.assert_allclose(site_from_rover.translation_m, reported.translation_m, atol=1e-4)
        np.testing.assert_allclose(site_from_rover.rotation, reported.rotation, atol=2e-6)
    assert {stop.id.site for stop in small_world.stops} == {first, first + 1}


def test_only_the_first_stop_is_exact(small_world):
    first, *others = small_world.stops
    np.testing.assert_array_equal(first.lsl_from_rover.translation_m, np.zeros(3))
    np.testing.assert_array_equal(
        first.lsl_from_rover.rotation, first.telemetry_lsl_from_rover.rotation
    )
    for stop in others:
        miss = stop.telemetry_lsl_from_rover.translation_m - stop.lsl_from_rover.translation_m
        assert 0.2 < np.linalg.norm(miss) < 6.0


def test_telemetry_counts_slip_as_distance():
    exact = TraverseParams(stops=2, slip=(0.1, 0.1), drift=0.0, tilt=0.0, position_m=0.0)
    world = make_world(WorldParams(traverse=exact, pairs=1), rng_seed=5)
    true, reported = (
        getattr(world.stops[1], name).translation_m
        for name in ("lsl_from_rover", "telemetry_lsl_from_rover")
    )
    np.testing.assert_allclose(reported, 1.1 * true, rtol=1e-12)


def test_the_rover_stands_on_the_ground(small_world):
    for stop in small_world.stops:
        feet = stop.lsl_from_rover.apply(np.array([[0.0, 0.0, GROUND_M]]))[0]
        ground = small_world.terrain.elevation(feet[0:1], feet[1:2])[0]
        assert -feet[2] == pytest.approx(ground, abs=0.12)  # six wheels bridge bumps


def test_the_truth_has_the_keys_of_the_rendered_traverse(small_world, husband):
    theirs = json.loads((husband / "truth" / "truth.json").read_text())
    ours = json.loads(json.dumps(truth_document(small_world)))
    assert theirs.keys() <= ours.keys()
    assert theirs["stops"][0].keys() <= ours["stops"][0].keys()
    assert theirs["images"][0].keys() <= ours["images"][0].keys()
    assert theirs["crs"] == ours["crs"]


def test_file_names_contain_site_drive_and_eye(small_world):
    for shot in small_world.shots:
        for eye, letter in ((Eye.LEFT, "L"), (Eye.RIGHT, "R")):
            exposure = small_world.exposure(shot, eye)
            name = parse_file_name(exposure.file_name)
            assert len(exposure.product_id) == 27
            assert (name.site, name.drive) == (exposure.stop.site, exposure.stop.drive)
            assert exposure.product_id[23] == letter
    assert len({small_world.exposure(s, Eye.LEFT).product_id for s in small_world.shots}) == len(
        small_world.shots
    )


def test_the_true_map_agrees_with_the_ground_under_the_stops(small_world):
    grid = MapGrid(west=-1.0, north=1.0, cell_m=0.5, rows=4, cols=4)
    elevation = small_world.true_elevation(grid)
    assert elevation.shape == grid.shape
    assert elevation.dtype == np.float32
    assert elevation.mean() == pytest.approx(-GROUND_M, abs=0.15)


def test_the_sun_is_in_the_north_at_noon_and_in_the_west_afterwards():
    noon, afternoon = sun_at(155, 12.0), sun_at(155, 15.5)
    assert min(noon.azimuth, 2 * np.pi - noon.azimuth) < 1e-9
    assert np.pi < afternoon.azimuth < 2 * np.pi
    assert noon.elevation > afternoon.elevation > 0.3


def test_shadows_point_away_from_the_sun():
    from solmap.photogrammetry.synthetic.lighting import SKY_LIGHT, ground_radiance  # noqa: PLC0415

    wall = np.zeros((60, 60), np.float32)
    wall[28:32, 28:32] = 0.2  # a post of 20 cm, nodes 2 cm apart
    png = ground_radiance(wall, 0.02, Sun(np.deg2rad(90), np.deg2rad(45)))  # the sun in the east
    assert png[30, 22] == pytest.approx(SKY_LIGHT, abs=0.02)  # west of it: sky light only
    assert png[30, 40] > 0.7
    assert png[30, 12] > 0.7  # 32 cm west: the shadow of 20 cm has ended


def test_ground_hidden_by_the_rover_has_no_truth(small_world, pair):
    geometry, rover = geometry_of(pair), small_world.stops[0].lsl_from_rover
    behind_panel, far_behind, ahead = [-1.5, 0.0, 0.294], [-6.0, 0.0, 0.294], [3.0, 0.0, 0.294]
    unknown = [np.nan, 0.0, 0.0]
    in_rover = np.array([behind_panel, far_behind, ahead, unknown])
    points = geometry.rover_from_pair.inverse.apply(in_rover)
    beside = _beside_rover(rover, rover @ geometry.rover_from_pair, geometry, points)
    assert beside.tolist() == [False, True, True, False]


def test_stops_have_the_requested_suns_in_turn():
    suns = tuple(Sun(*np.deg2rad(sun)) for sun in ((262.0, 30.0), (98.0, 32.0)))
    world = make_world(WorldParams(traverse=TraverseParams(stops=3, suns=suns), pairs=1), 5)
    assert [stop.sun for stop in world.stops] == [*suns, suns[0]]
    west, east, _ = (stop.local_solar_hour for stop in world.stops)
    assert (east, west) == pytest.approx((12 - 58 / 15, 12 + 60 / 15))


def test_a_bent_rig_moves_the_right_image_and_not_its_label():
    bend = (3e-4, -4e-4, 2e-4)
    rigs = (RigErrors(bend=bend), RigErrors())
    worlds = [make_world(replace(SMALL, rig=rig), 7) for rig in rigs]
    shot = worlds[0].shots[0]
    for eye in (Eye.LEFT, Eye.RIGHT):
        labels = [edr.label_bytes(world.exposure(shot, eye)) for world in worlds]
        assert labels[0] == labels[1]
        bent, straight = (world.true_camera(shot, eye) for world in worlds)
        pixels = np.array([[60.0, 60.0], [128.0, 190.0], [250.0, 128.0]])
        seen = bent.project(straight.centre + 9.0 * straight.rays(pixels)) - pixels
        turned_px = (np.array([-bend[2], bend[1]]) if eye is Eye.RIGHT else np.zeros(2)) * 306
        np.testing.assert_allclose(seen, np.tile(turned_px, (3, 1)), atol=0.06)  # roll at edges
    views = [view_of(world, shot, Eye.RIGHT)[1] for world in worlds]
    assert np.abs(views[0] - views[1]).max() == pytest.approx(np.linalg.norm(bend), rel=0.2)


def test_a_realistic_world_records_its_errors_in_its_truth():
    params = [realistic_params(SMALL, seed) for seed in (1, 1, 2)]
    assert params[0] == params[1] != params[2]
    for one in params:
        morning, afternoon, _ = one.traverse.suns
        assert morning.azimuth < np.pi < afternoon.azimuth
        assert 0.5 <= one.camera.psf_px <= 0.9
        assert 0.6 <= one.camera.bits_per_pixel <= 3.0
        assert 0 < np.linalg.norm(one.rig.bend) < 2e-3
    world = make_world(params[0], 1)
    truth = json.loads(json.dumps(truth_document(world)))
    assert truth["rig"]["bend"] == list(params[0].rig.bend)
    assert truth["camera"]["bits_per_pixel"] == params[0].camera.bits_per_pixel
    label = edr.label_bytes(world.exposure(world.shots[0], Eye.LEFT)).decode()
    assert f"INST_CMPRS_RATE                 = {params[0].camera.bits_per_pixel:.6g}" in label


def test_impossible_parameters_are_refused():
    with pytest.raises(PhotogrammetryError, match="no terrain 'sea'"):
        WorldParams(terrain="sea")
    with pytest.raises(PhotogrammetryError, match="1, 2 or 4"):
        WorldParams(averaging=3)
    with pytest.raises(FrameError, match="slip must run from low to high"):
        TraverseParams(slip=(0.2, 0.1))
