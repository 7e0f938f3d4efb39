import hashlib
import itertools

import numpy as np
import pytest
import rasterio
from rasterio.enums import ColorInterp
from rio_cogeo import cog_validate

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.products.crs import IAU_RADIUS_M, LandingPoint, local_crs
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.formats.raster.orthophoto import (
    read_textures,
    source_colour,
    write_brightness_blocks,
    write_orthophoto,
    write_sources,
)
from solmap.products.formats.raster.raster import (
    read_dtm,
    read_raster,
    summarise,
    write_dtm,
    write_raster,
)
from tests.support.product_readers import crs_of, read_orthophoto, read_sources, values_at

GUSEV = LandingPoint("floor of Gusev", 175.4729, -14.5692, 3_393_000.0, "a test")
ON_IAU = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, IAU_RADIUS_M, "a test")
CRS = local_crs(GUSEV)
GRID = MapGrid.covering((-5.0, -5.0, 5.0, 15.0), 0.02)


@pytest.fixture
def surface(rng):
    values = rng.normal(0.0, 2.0, GRID.shape).astype(np.float32)
    values[:300, :200] = np.nan
    return values


def test_a_written_raster_is_read_back(tmp_path, surface):
    bands = {"slope": surface, "aspect": surface * 2}
    write_raster(tmp_path / "a.tif", GRID, bands, CRS, unit="degree", tags={"BASELINE_M": "1.1"})
    grid, read = read_raster(tmp_path / "a.tif")
    assert grid == GRID
    assert list(read) == ["slope", "aspect"]
    for name, band in bands.items():
        np.testing.assert_array_equal(read[name], band)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        assert dataset.units == ("degree", "degree")
        assert dataset.tags()["BASELINE_M"] == "1.1"
        assert np.isnan(dataset.nodata)


@pytest.mark.parametrize("landing", [GUSEV, ON_IAU])
def test_a_geotiff_has_the_crs_of_mars(tmp_path, surface, landing):
    write_raster(tmp_path / "a.tif", GRID, {"x": surface}, local_crs(landing))
    crs = crs_of(tmp_path / "a.tif")
    assert crs.equals(local_crs(landing))
    assert crs.name == local_crs(landing).name
    assert crs.ellipsoid.semi_major_metre == landing.radius_m
    assert crs.to_epsg() is None


@pytest.mark.parametrize("is_image_file", [False, True])
def test_the_file_is_a_valid_cloud_optimised_geotiff_of_blocks_of_256(
    tmp_path, surface, is_image_file
):
    path = tmp_path / "a.tif"
    if is_image_file:
        write_orthophoto(path, GRID, surface, CRS)
    else:
        write_raster(path, GRID, {"x": surface}, CRS)
    is_valid, errors, warnings = cog_validate(path, strict=True)
    assert (is_valid, errors, warnings) == (True, [], [])
    with rasterio.open(path) as dataset:
        assert dataset.block_shapes == [(256, 256)]
        assert dataset.overviews(1) == [2, 4]
        assert dataset.crs.is_projected
    assert list(tmp_path.iterdir()) == [path]


def test_an_overview_is_the_mean_of_measured_cells(tmp_path, surface):
    write_raster(tmp_path / "a.tif", GRID, {"x": surface}, CRS)
    surface[301, 201] = np.nan
    write_raster(tmp_path / "b.tif", GRID, {"x": surface}, CRS)
    blocks = surface.reshape(GRID.rows // 2, 2, GRID.cols // 2, 2)
    some = np.isfinite(blocks).any(axis=(1, 3))
    with rasterio.open(tmp_path / "b.tif", overview_level=0) as dataset:
        half = dataset.read(1)
    np.testing.assert_array_equal(np.isfinite(half), some)
    expected = np.nanmean(np.where(some[:, None, :, None], blocks, 0.0), axis=(1, 3))
    np.testing.assert_allclose(half[some], expected[some], atol=1e-5)  # single precision


@pytest.mark.parametrize("kind", ["float32", "uint8"])
def test_a_last_row_without_a_neighbour_does_not_stretch_an_overview(tmp_path, kind):
    odd = GRID.window(slice(0, 301), slice(0, 515))
    cells = (np.indices(odd.shape).sum(axis=0) % 97 + 1).astype(kind)
    if kind == "uint8":
        write_orthophoto(tmp_path / "a.tif", odd, cells, CRS)
    else:
        write_raster(tmp_path / "a.tif", odd, {"x": cells}, CRS)
    with rasterio.open(tmp_path / "a.tif") as dataset:
        padded = np.pad(dataset.read(1).astype(float), ((0, 1), (0, 1)), mode="edge")
    expected = padded.reshape(151, 2, 258, 2).mean(axis=(1, 3))
    with rasterio.open(tmp_path / "a.tif", overview_level=0) as dataset:
        np.testing.assert_allclose(dataset.read(1), expected, atol=0.5 if kind == "uint8" else 1e-5)


def test_an_overview_of_directions_takes_one_of_them_rather_than_the_mean(tmp_path):
    around_north = np.where(np.indices(GRID.shape).sum(axis=0) % 2, 359.0, 1.0).astype(np.float32)
    write_raster(tmp_path / "a.tif", GRID, {"aspect": around_north}, CRS)
    with rasterio.open(tmp_path / "a.tif", overview_level=0) as dataset:
        assert set(np.unique(dataset.read(1))) <= {1.0, 359.0}


def test_the_same_raster_is_written_as_the_same_bytes(tmp_path, surface):
    digests = set()
    for name in ("a.tif", "b.tif"):
        write_raster(tmp_path / name, GRID, {"x": surface}, CRS, tags={"A": "b"})
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1


def test_blocks_without_measurements_take_no_space(tmp_path, surface):
    write_raster(tmp_path / "full.tif", GRID, {"x": surface}, CRS)
    surface[256:] = np.nan
    write_raster(tmp_path / "sparse.tif", GRID, {"x": surface}, CRS)
    assert (tmp_path / "sparse.tif").stat().st_size < 0.4 * (tmp_path / "full.tif").stat().st_size
    np.testing.assert_array_equal(read_raster(tmp_path / "sparse.tif")[1]["x"], surface)


def test_a_terrain_model_is_read_back_unchanged(tmp_path, surface, rng):
    seen = np.isfinite(surface)
    ground = np.where(seen, GroundClass.MEASURED, GroundClass.UNSEEN).astype(np.uint8)
    sigma = np.where(seen, np.float32(0.01), np.float32(np.nan))
    counts = rng.integers(0, 9, GRID.shape).astype(np.float32)
    dtm = Dtm(GRID, surface, sigma, counts, ground, sigma / 2)
    write_dtm(tmp_path / "dtm.tif", dtm, CRS)
    dtm = read_dtm(tmp_path / "dtm.tif")
    np.testing.assert_array_equal(dtm.pose_sigma_m, sigma / 2)
    assert dtm.grid == GRID
    np.testing.assert_array_equal(dtm.elevation, surface)
    np.testing.assert_array_equal(dtm.sigma_m, sigma)
    np.testing.assert_array_equal(dtm.observations, counts)
    np.testing.assert_array_equal(dtm.ground, ground)


def test_a_raster_without_a_terrain_model_is_named(tmp_path, surface):
    write_raster(tmp_path / "slope.tif", GRID, {"slope": surface}, CRS)
    with pytest.raises(ProductError, match=r"slope\.tif is not a terrain model.*elevation"):
        read_dtm(tmp_path / "slope.tif")


def test_an_orthophoto_keeps_brightness_to_half_a_grey_step_inside_its_stretch(tmp_path, surface):
    write_orthophoto(tmp_path / "o.tif", GRID, surface, CRS, stretch=(-3.0, 3.0))
    grid, brightness = read_orthophoto(tmp_path / "o.tif")
    assert grid == GRID
    np.testing.assert_array_equal(np.isnan(brightness), np.isnan(surface))
    seen = np.isfinite(surface)
    off = np.abs(brightness[seen] - np.clip(surface[seen], -3.0, 3.0))
    assert off.max() <= 0.5 * 6.0 / 254 + 1e-5
    with rasterio.open(tmp_path / "o.tif") as dataset:
        assert dataset.dtypes == ("uint8",)
        np.testing.assert_array_equal(dataset.read_masks(1) > 0, seen)


def test_a_texture_is_the_mean_of_the_image_and_grey_beyond_it(tmp_path, rng):
    grid = MapGrid(0.0, 0.0, 0.01, 1024, 1024)
    image = rng.uniform(0, 100, grid.shape).astype(np.float32)
    write_orthophoto(tmp_path / "o.tif", grid, image, CRS, stretch=(0.0, 100.0))
    [(texture, bounds)] = read_textures(tmp_path / "o.tif", [(-5.12, -5.12, 5.12, 5.12)], 256)
    mean = 1 + 2.54 * image[:512, :512].reshape(128, 4, 128, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(texture[128:, 128:], mean, atol=1.5)  # rounded in two overviews
    assert (texture[:120] == 128).all()
    assert (texture[:, :120] == 128).all()
    assert bounds == pytest.approx((-5.12, -5.12, 5.12, 5.12))


def test_an_orthophoto_without_any_view_is_empty_rather_than_an_error(tmp_path):
    write_orthophoto(tmp_path / "o.tif", GRID, np.full(GRID.shape, np.nan, np.float32), CRS)
    assert np.isnan(read_orthophoto(tmp_path / "o.tif")[1]).all()
    assert summarise(tmp_path / "o.tif")[1][0].range is None


def test_a_place_has_the_value_of_its_cell(tmp_path, surface):
    write_raster(tmp_path / "a.tif", GRID, {"x": surface}, CRS)
    east, north = GRID.centres()
    value = values_at(tmp_path / "a.tif", east[250] + 0.009, north[400] - 0.009)
    assert value == {"x": float(surface[400, 250])}
    assert np.isnan(values_at(tmp_path / "a.tif", east[10], north[10])["x"])
    assert values_at(tmp_path / "a.tif", 5000.0, 0.0) is None


def test_the_summary_gives_true_values_and_units(tmp_path):
    column = np.linspace(0.0, 100.0, GRID.cols, dtype=np.float32)
    field = np.broadcast_to(column, GRID.shape).copy()
    write_raster(tmp_path / "a.tif", GRID, {"slope": field}, CRS, unit="degree")
    write_orthophoto(tmp_path / "o.tif", GRID, field, CRS, stretch=(0.0, 100.0))
    for name, unit in (("a.tif", "degree"), ("o.tif", "")):
        grid, (band,) = summarise(tmp_path / name)
        assert grid == GRID
        assert band.unit == unit
        assert band.range == pytest.approx((1.0, 99.0), abs=0.5)


def test_bands_that_do_not_fit_are_refused_before_anything_is_written(tmp_path, surface):
    with pytest.raises(ProductError, match="band x has"):
        write_raster(tmp_path / "a.tif", GRID, {"x": surface[1:]}, CRS)
    with pytest.raises(ProductError, match="float32 or all uint8"):
        write_raster(tmp_path / "a.tif", GRID, {"x": surface.astype(np.float64)}, CRS)
    assert not list(tmp_path.iterdir())


def test_a_missing_and_a_broken_file_are_distinguished(tmp_path, surface):
    with pytest.raises(ProductNotFoundError, match="does not exist"):
        read_raster(tmp_path / "a.tif")
    write_raster(tmp_path / "a.tif", GRID, {"x": surface}, CRS)
    whole = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "b.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ProductError, match="broken"):
        read_raster(tmp_path / "b.tif")
    (tmp_path / "c.tif").write_text("no raster")
    with pytest.raises(ProductError, match="cannot be read"):
        read_raster(tmp_path / "c.tif")


def test_the_sources_of_an_orthophoto_are_read_back_with_names_and_colours(tmp_path, rng):
    names = tuple(f"2N{number:09}" for number in range(40))
    source = rng.integers(0, 41, GRID.shape).astype(np.uint8)
    write_sources(tmp_path / "s.tif", GRID, source, names, CRS, tags={"INPUTS": "a b"})
    grid, read, known = read_sources(tmp_path / "s.tif")
    assert (grid, known) == (GRID, names)
    np.testing.assert_array_equal(read, source)
    assert cog_validate(tmp_path / "s.tif", strict=True) == (True, [], [])
    with rasterio.open(tmp_path / "s.tif") as dataset:
        assert dataset.colorinterp == (ColorInterp.palette,)
        assert dataset.nodata == 0
        assert dataset.tags()["INPUTS"] == "a b"
        assert "#{:02x}{:02x}{:02x}".format(*dataset.colormap(1)[7][:3]) == source_colour(7)
    with rasterio.open(tmp_path / "s.tif", overview_level=1) as dataset:
        assert set(np.unique(dataset.read(1))) <= set(range(41))


def test_adjacent_images_of_a_panorama_have_different_colours():
    colours = [tuple(bytes.fromhex(source_colour(n)[1:])) for n in range(1, 40)]
    for a, b in itertools.pairwise(colours):
        assert np.abs(np.subtract(a, b)).sum() > 100


def test_more_images_than_a_source_layer_can_number_are_an_error(tmp_path):
    source = np.zeros(GRID.shape, np.uint8)
    with pytest.raises(ProductError, match="256 images, but only 255 can be distinguished"):
        write_sources(tmp_path / "s.tif", GRID, source, ["a"] * 256, CRS)


def test_a_colour_image_is_written_block_by_block(tmp_path, rng):
    red = rng.uniform(0.0, 100.0, (3, 256, 512)).astype(np.float32)
    red[:, :10, :10] = np.nan
    stretches = [(0.0, 100.0), (0.0, 200.0), (-50.0, 100.0)]
    write_brightness_blocks(tmp_path / "c.tif", GRID, [(256, 0, red)], CRS, stretches=stretches)
    assert cog_validate(tmp_path / "c.tif", strict=True) == (True, [], [])
    with rasterio.open(tmp_path / "c.tif") as dataset:
        assert dataset.colorinterp == (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
        assert dataset.descriptions == ("red", "green", "blue")
        stored = dataset.read()
        assert not stored[:, :256].any()
        assert not stored[:, 256:266, :10].any()
        for band, (low, high), scale, offset in zip(
            range(3), stretches, dataset.scales, dataset.offsets, strict=True
        ):
            there = stored[band, 266:512, :512]
            assert there.all()
            error = there * scale + offset - red[band, 10:]
            assert np.abs(error).max() <= 0.51 * (high - low) / 254  # half a step, and rounding
