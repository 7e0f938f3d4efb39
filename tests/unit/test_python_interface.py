"""`import solmap`: quick, small, and the same numbers as the pipeline's own functions."""

import subprocess
import sys

import numpy as np
import pytest

import solmap
from solmap.photogrammetry.errors import AdjustmentError, PhotogrammetryError
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.products.errors import ProductError, ProductNotFoundError
from tests.support.old_store import unpack_old_store


@pytest.fixture(scope="module")
def world():
    return solmap.simulate(pairs=2, averaging=4, seed=1)


@pytest.fixture(scope="module")
def pair(world):
    return world.pairs[0]


def test_public_names_exist_and_are_documented():
    assert len(solmap.__all__) <= 14
    for name in solmap.__all__:
        assert getattr(solmap, name).__doc__
        assert name in dir(solmap)
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        solmap.nothing  # noqa: B018


def test_importing_the_package_loads_nothing_else():
    program = "import sys, solmap; print([n for n in sys.modules if n.partition('.')[0] in {%s}])"
    names = "'numpy', 'scipy', 'cv2', 'prefect', 'rasterio', 'pydantic'"
    command = [sys.executable, "-c", program % names]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


def test_images_are_read_from_files(pair, world, tmp_path):
    folder = world.write(tmp_path / "downlink")
    left, right = (next(folder.rglob(f"{one.id.lower()}.img")) for one in (pair.left, pair.right))
    read = solmap.StereoPair(left, str(right))
    assert read.id == pair.id
    np.testing.assert_array_equal(read.left.pixels, pair.left.pixels)
    np.testing.assert_array_equal(solmap.read_image(left).mask, pair.left.mask)
    with pytest.raises(OSError, match="No such file"):
        solmap.read_image(tmp_path / "x.img")
    with pytest.raises(PhotogrammetryError, match=r"truth\.json: camera_model_type"):
        solmap.read_image(folder / "truth" / "truth.json")


def test_cameras_take_lists_and_arrays(pair):
    camera, model = pair.left.camera, pair.left.record.camera
    points = [[5.0, 0.0, 0.0], [8.0, 1.0, 0.5], [-5.0, 0.0, 0.0]]
    pixels = camera.project(points)
    np.testing.assert_array_equal(pixels, model.project(np.array(points)))
    np.testing.assert_allclose(camera.project(points[0]), pixels[0], rtol=1e-12)
    np.testing.assert_allclose(camera.rays(pixels[:2].tolist()), model.rays(pixels[:2]), rtol=1e-12)
    assert camera.rays((10, 20)).shape == camera.centre.shape == (3,)
    with pytest.raises(ValueError, match=r"points of 3 coordinates are \(n, 3\), not \(2,\)"):
        camera.project([1, 2])


def test_matches_equal_those_of_the_pipeline(pair):
    match = pair.match()
    assert match is pair.match()
    np.testing.assert_array_equal(match.disparity_px, match_densely(pair.images).parallax_px)
    lines, samples = match.disparity_px.shape
    assert match.point_map().shape == (lines, samples, 3)
    points = match.points()
    assert points.shape == (len(match.sparse), 3)
    left = pair.images.geometry.cameras()[0].project(points)
    np.testing.assert_allclose(left, match.sparse.left, atol=1e-6)


def test_terrain_of_pairs_and_of_an_adjustment(world, pair):
    alone = solmap.build_dtm(pair, cell_m=0.08)
    both = solmap.build_dtm(world.pairs, cell_m=0.08)
    assert np.isfinite(alone.elevation).sum() < np.isfinite(both.elevation).sum()
    assert alone.grid.cell_m == 0.08
    adjusted = solmap.adjust(world.pairs)
    assert adjusted.positions.shape == adjusted.sigmas.shape == (1, 3)
    dtm = solmap.build_dtm(adjusted, cell_m=0.08)
    error = dtm.elevation - world.elevation(dtm.grid)
    assert np.nanmedian(abs(error)) < 0.05
    image = solmap.orthophoto(dtm, adjusted)
    assert image.grid.cell_m == 0.08
    assert image.brightness.shape == image.grid.shape
    assert np.isfinite(image.brightness).any()


def test_a_site_without_an_origin_is_named(world):
    with pytest.raises(AdjustmentError, match=r"of site 10, and no origin of that site is given"):
        solmap.adjust(world.pairs, {11: [0, 0, 0]})
    with pytest.raises(AdjustmentError, match="at least one stereo pair"):
        solmap.adjust([])


def test_a_store_returns_its_latest_products(tmp_path):
    store = solmap.open_store(unpack_old_store(tmp_path))
    layers = store.layers("dtm")
    sol = layers[0].sols[0]
    with store.latest("dtm", sol=sol, mission="Spirit") as raster:
        assert raster.count >= 2
        assert raster.crs is not None
    stop = layers[0].ref.scope.name
    place = "/".join(str(int(part)) for part in stop.split("-site")[1].split("-drive"))
    assert store.path("dtm", stop=place) == store.workspace.store.path(layers[0].ref)
    assert len(store.features("contours", sol=sol)) > 0
    assert store.positions()[0]["mission"] == "MER2"
    with pytest.raises(ProductNotFoundError, match="no dtm is in the store, sol 99999"):
        store.latest("dtm", sol=99999)
    with pytest.raises(ProductError, match="there is no kind 'dem'"):
        store.latest("dem")
    with pytest.raises(ProductNotFoundError, match="is not a store"):
        solmap.open_store(tmp_path / "absent")
    assert not (tmp_path / "absent").exists()
