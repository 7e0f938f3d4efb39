"""Files for other programs agree with the network; our own parsers read them back."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rasterio
from scipy.spatial.transform import Rotation

from solmap.flows.cli.inspection import InspectionError, inspect_file, write_points
from solmap.flows.cli.inspection_text import report_of
from solmap.photogrammetry.archive.images.derived_rasters import RasterKind, read_raster
from solmap.photogrammetry.frames import site_frame
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.mars import map_from_lsl
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import lon_lat
from solmap.products.errors import ProductNotFoundError
from solmap.products.export.contents import export
from solmap.products.export.pair_rasters import WINDOW_PX, surface_normals, vicar_bytes
from solmap.products.export.selection import Selection
from solmap.products.formats.mesh.ply import read_ply
from tests.unit.gis_server.conftest import build
from tests.unit.gis_server.stereo.stereo_store import (
    LANDING,
    TIE_SIGMA_PX,
)

TRUE_PX = 3 * TIE_SIGMA_PX
"""Ties of the store have this much noise, in sample, line and parallax."""


@pytest.fixture(scope="module")
def exported(stereo, tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("export") / "out"
    kinds = frozenset({"colmap", "asp", "isis", "pds"})
    export(target, Selection(kinds=kinds), stereo.workspace)
    return target


def read_colmap(folder: Path) -> SimpleNamespace:
    """A COLMAP model in text, by its documentation and nothing of ours."""

    def rows(name):
        lines = (folder / name).read_text().splitlines()
        return [line for line in lines if not line.startswith("#")]

    cameras = {int(w[0]): (w[1], *map(float, w[2:])) for w in map(str.split, rows("cameras.txt"))}
    images, lines = {}, rows("images.txt")
    for head, seen in zip(lines[::2], lines[1::2], strict=True):
        words = head.split()
        points = np.array(seen.split(), float).reshape(-1, 3)
        pose = np.array(words[1:8], float)
        images[int(words[0])] = SimpleNamespace(
            turn=Rotation.from_quat(pose[:4], scalar_first=True).as_matrix(),
            shift=pose[4:],
            camera=int(words[8]),
            name=words[9],
            at=points[:, :2],
            point=points[:, 2].astype(int),
        )
    points = {}
    for words in map(str.split, rows("points3D.txt")):
        track = np.array(words[8:], int).reshape(-1, 2)
        points[int(words[0])] = np.array(words[1:4], float), float(words[7]), track
    return SimpleNamespace(cameras=cameras, images=images, points=points)


def test_a_colmap_model_projects_its_points_to_where_they_were_measured(exported):
    model = read_colmap(exported / "colmap" / "MER2")
    assert len(model.images) == 12
    assert {model.cameras[one.camera][0] for one in model.images.values()} == {"PINHOLE"}
    off = []
    for image in model.images.values():
        _, _, _, fx, fy, cx, cy = model.cameras[image.camera]
        seen = np.array([model.points[k][0] for k in image.point]) @ image.turn.T + image.shift
        projected = seen[:, :2] / seen[:, 2:] * [fx, fy] + [cx, cy]
        off.append(image.at - projected)
    assert np.abs(np.concatenate(off)).max() < 6 * TIE_SIGMA_PX
    assert np.concatenate(off).std() < 1.5 * TIE_SIGMA_PX
    assert np.abs(np.median(np.concatenate(off), axis=0)).max() < TIE_SIGMA_PX / 2


def test_tracks_of_a_colmap_model_name_the_observations_of_their_points(exported):
    model = read_colmap(exported / "colmap" / "MER2")
    for number, (_, error, track) in model.points.items():
        assert len(track) >= 2
        assert error < 6 * TIE_SIGMA_PX
        assert all(model.images[image].point[index] == number for image, index in track)
    seen = sum(len(image.point) for image in model.images.values())
    assert seen == sum(len(track) for *_, track in model.points.values())


def test_images_have_the_size_of_their_cameras(exported):
    model = read_colmap(exported / "colmap" / "MER2")
    for image in model.images.values():
        png = cv2.imread(str(exported / "epipolar" / "MER2" / image.name), -1)
        _, width, height, *_ = model.cameras[image.camera]
        assert png.shape == (height, width)
        assert (png > 0).mean() > 0.5


def test_pycolmap_reads_the_model(exported):
    pycolmap = pytest.importorskip("pycolmap", reason="`make peers` installs pycolmap")
    model = pycolmap.Reconstruction(str(exported / "colmap" / "MER2"))
    ours = read_colmap(exported / "colmap" / "MER2")
    assert (model.num_images(), model.num_points3D()) == (12, len(ours.points))
    assert model.compute_mean_reprojection_error() < TRUE_PX


def read_tsai(path: Path) -> dict[str, np.ndarray]:
    version, kind, *lines, lens = path.read_text().splitlines()
    assert (version, kind, lens) == ("VERSION_4", "PINHOLE", "NULL")
    pairs = (line.split(" = ") for line in lines)
    return {key: np.array(value.split(), float) for key, value in pairs}


def test_cameras_for_asp_equal_those_of_the_colmap_model(exported):
    model = read_colmap(exported / "colmap" / "MER2")
    for image in model.images.values():
        reported = read_tsai(exported / "asp" / "MER2" / image.name.replace(".png", ".tsai"))
        world_from_camera = reported["R"].reshape(3, 3)
        _, _, _, fx, _, cx, cy = model.cameras[image.camera]
        np.testing.assert_allclose(world_from_camera, image.turn.T, atol=1e-12)
        np.testing.assert_allclose(-image.turn @ reported["C"], image.shift, atol=1e-9)
        assert reported["fu"] == reported["fv"] == fx
        assert (reported["cu"] + 0.5, reported["cv"] + 0.5) == pytest.approx((cx, cy))


def csm_image_points(text: str, places: np.ndarray) -> np.ndarray:
    """(sample, line) of body-fixed places, as `groundToImage` of USGSCSM has them."""
    name, _, document = text.partition("\n")
    state = json.loads(document)
    assert name == state["m_modelName"] == "USGS_ASTRO_FRAME_SENSOR_MODEL"
    assert (state["m_distortionType"], set(state["m_opticalDistCoeffs"])) == (0, {0.0})
    *centre, x, y, z, w = state["m_currentParameterValue"]
    seen = (places - centre) @ Rotation.from_quat([x, y, z, w]).as_matrix()
    plane = state["m_focalLength"] * seen[:, :2] / seen[:, 2:]
    pixels = []
    for trans, centre_of_axis, start, summing in (
        ("m_iTransS", state["m_ccdCenter"][1], "m_startingDetectorSample", "Sample"),
        ("m_iTransL", state["m_ccdCenter"][0], "m_startingDetectorLine", "Line"),
    ):
        offset, of_x, of_y = state[trans]
        at = offset + plane @ [of_x, of_y] + centre_of_axis
        pixels.append((at - state[start]) / state[f"m_detector{summing}Summing"])
    return np.column_stack(pixels)


def test_csm_states_project_the_body_fixed_points_to_their_measurements(exported):
    model = read_colmap(exported / "colmap" / "MER2")
    text = (exported / "isis" / "MER2_control.pvl").read_text()
    places = np.array(
        [re.findall(rf"Adjusted{axis} = (\S+) <meters>", text) for axis in "XYZ"], float
    ).T
    for image in model.images.values():
        state = (exported / "asp" / "MER2" / image.name.replace(".png", ".json")).read_text()
        at = csm_image_points(state, places[image.point - 1])  # CSM and COLMAP count alike
        _, _, _, fx, fy, cx, cy = model.cameras[image.camera]
        seen = np.array([model.points[k][0] for k in image.point]) @ image.turn.T + image.shift
        projected = seen[:, :2] / seen[:, 2:] * [fx, fy] + [cx, cy]
        np.testing.assert_allclose(at, projected, atol=0.01)  # places are rounded to 10 micrometres
        assert np.abs(at - image.at).max() < 6 * TIE_SIGMA_PX


def test_an_isis_network_has_the_same_points_on_mars(exported):
    text = (exported / "isis" / "MER2_control.pvl").read_text()
    model = read_colmap(exported / "colmap" / "MER2")
    assert text.count("Object = ControlPoint\n") == len(model.points)
    assert text.count("Group = ControlMeasure\n") == sum(len(t) for *_, t in model.points.values())
    assert text.count("Reference = True") == len(model.points)
    assert "TargetName = Mars" in text
    assert text.rstrip().endswith("End_Object\nEnd")
    places = {
        axis: np.array(re.findall(rf"Adjusted{axis} = (\S+) <meters>", text), float)
        for axis in "XYZ"
    }
    x, y, z = places.values()
    radius = np.sqrt(x * x + y * y + z * z)
    east, north, up = np.array([xyz for xyz, *_ in model.points.values()]).T
    np.testing.assert_allclose(radius - LANDING.radius_m, up, atol=1e-3)
    lon, lat = lon_lat(LANDING, east, north)
    np.testing.assert_allclose(np.degrees(np.arctan2(y, x)), lon, atol=1e-8)
    np.testing.assert_allclose(np.degrees(np.arcsin(z / radius)), lat, atol=1e-8)


def test_xyz_of_a_pair_equals_the_true_ground(exported, stereo):
    files = sorted((exported / "pds" / "MER2").glob("*XYL*.img"))
    assert len(files) == 6
    for file in files:
        raster = read_raster(file.read_bytes(), file.name)
        assert raster.kind is RasterKind.XYZ
        shot, _ = stereo.shot(file.stem.replace("XYL", "EDN"))
        stop = stereo.world.stops[shot.stop]
        assert raster.frame == site_frame(stop.id.site)
        image = stereo.world.exposure(shot, Eye.LEFT)
        in_site = raster.bands[:, raster.mask].T.astype(np.float64)
        in_rover = image.site_from_rover.inverse.apply(in_site)
        on_map = map_from_lsl(stop.lsl_from_rover.apply(in_rover))
        near = np.linalg.norm(in_rover, axis=1) < 12
        off = on_map[near, 2] - stereo.elevation(on_map[near, :2])
        assert np.nanmedian(np.abs(off)) < 0.02
        assert np.isfinite(off).sum() > 1000


def test_ranges_normals_and_slopes_of_a_pair_agree_with_its_xyz(exported):
    (file, *_) = sorted((exported / "pds" / "MER2").glob("*XYL*.img"))
    xyz, rng, normal, slope = (
        read_raster(path.read_bytes(), path.name)
        for path in (
            file.with_name(file.name.replace("XYL", k)) for k in ("XYL", "RNL", "UVL", "SLL")
        )
    )
    assert (rng.kind, normal.kind, slope.kind) == ("range", "surface normal", "slope")
    np.testing.assert_array_equal(rng.mask, xyz.mask)
    lengths = np.linalg.norm(normal.bands[:, normal.mask], axis=0)
    np.testing.assert_allclose(lengths, 1.0, atol=1e-6)
    both = normal.mask & slope.mask
    tilt = np.degrees(np.arccos(-normal.bands[2, both].astype(float)))
    np.testing.assert_allclose(slope.bands[0, both], tilt, atol=0.05)


@pytest.mark.parametrize(
    ("letters", "names", "unit"),
    [
        ("XYL", ["north", "east", "down"], "m"),
        ("RNL", ["range"], "m"),
        ("UVL", ["angle between normals"], "degree"),
        ("SLL", ["slope"], "degree"),
    ],
)
def test_an_archived_raster_is_compared_with_that_of_the_store(
    exported, stereo, letters, names, unit
):
    """With ours as archived ones there is no difference but that of six digits."""
    (file, *_) = sorted((exported / "pds" / "MER2").glob(f"*{letters}*.img"))
    found = inspect_file(file, stereo.workspace.store.root)["beside_store"]
    assert found["image_id"] == file.stem.replace(letters, "EDN")
    assert found["share"] > 0.9
    assert [one["name"] for one in found["differences"]] == names
    for one in found["differences"]:
        assert one["unit"] == unit
        assert abs(one["median"]) < (0.05 if unit == "degree" else 0.002)
        assert one["spread"] < (0.5 if unit == "degree" else 0.01)
    lines = report_of(inspect_file(file, stereo.workspace.store.root))
    assert any("archived less ours" in line for line in lines)


def test_the_error_of_an_archived_raster_is_found(exported, stereo, tmp_path):
    (file, *_) = sorted((exported / "pds" / "MER2").glob("*XYL*.img"))
    raster = read_raster(file.read_bytes(), file.name)
    data = file.read_bytes()
    shift = np.array([0.0, 0.0, 0.05], dtype="<f4")[:, None, None] * raster.mask
    moved = raster.bands + shift
    altered = tmp_path / file.name
    altered.write_bytes(data[: len(data) - moved.nbytes] + moved.astype("<f4").tobytes())
    near = inspect_file(altered, stereo.workspace.store.root)["beside_store"]["differences"]
    assert near[2]["median"] == pytest.approx(0.05, abs=0.03)  # the ground moves below the ray
    elsewhere = tmp_path / "empty"
    Workspace.open(elsewhere)
    with pytest.raises(InspectionError, match=r"no stereo pair of mer2-site.* `solmap run`"):
        inspect_file(file, elsewhere)


def test_points_of_an_xyz_raster_are_written_as_ply(exported, tmp_path):
    (file, *_) = sorted((exported / "pds" / "MER2").glob("*XYL*.img"))
    raster = read_raster(file.read_bytes(), file.name)
    write_points(file, tmp_path / "points.ply")
    rows = read_ply(tmp_path / "points.ply")
    assert len(rows) == raster.mask.sum()
    np.testing.assert_array_equal(rows["z"], -raster.bands[2, raster.mask].astype(float))
    range_file = file.with_name(file.name.replace("XYL", "RNL"))
    with pytest.raises(InspectionError, match="is not an XYZ raster"):
        write_points(range_file, tmp_path / "none.ply")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(("driver", "suffix"), [("VICAR", ".img"), ("PDS4", ".xml")])
@pytest.mark.parametrize("letters", ["XYL", "RNL", "UVL", "SLL"])
def test_gdal_reads_a_raster_of_a_pair_by_both_labels(exported, driver, suffix, letters):
    (file, *_) = sorted((exported / "pds" / "MER2").glob(f"*{letters}*.img"))
    ours = read_raster(file.read_bytes(), file.name)
    with rasterio.open(file.with_suffix(suffix), driver=driver) as dataset:
        np.testing.assert_array_equal(dataset.read(), ours.bands)


def test_the_normals_of_a_plane_are_exact():
    lines, samples = np.indices((60, 80), dtype=np.float64)
    x, y = 5.0 + 0.01 * samples, -3.0 + 0.02 * lines
    z = 0.3 * x - 0.1 * y + 2.0
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    measured = np.ones((60, 80), bool)
    measured[:, :20] = False
    points[~measured.ravel()] = np.nan
    normals = surface_normals(points, measured)
    expected = np.array([0.3, -0.1, -1.0]) / np.linalg.norm([0.3, -0.1, -1.0])
    inside = normals[:, WINDOW_PX:-WINDOW_PX, 20 + WINDOW_PX : -WINDOW_PX]
    np.testing.assert_allclose(inside - expected[:, None, None], 0.0, atol=1e-9)
    assert np.isnan(normals[:, :, :20]).all()


def test_a_vicar_label_fills_whole_records():
    data = vicar_bytes(np.zeros((1, 2, 3), np.float32), {"A": {"TEXT": "it's", "LIST": (1, 2.5)}})
    size = int(re.match(rb"LBLSIZE=(\d+)", data)[1])
    assert size % 12 == 0
    assert len(data) == size + 24
    assert b"TEXT='it''s' LIST=(1,2.5)" in data[:size]


def test_a_map_without_a_network_has_no_exports_for_other_programs(tmp_path):
    world = build(tmp_path / "store")
    workspace = Workspace(world.store, world.catalogue)
    with pytest.raises(ProductNotFoundError, match="no network of MER2 has been adjusted"):
        export(tmp_path / "out", Selection(kinds=frozenset({"colmap"})), workspace)
