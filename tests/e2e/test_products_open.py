"""Every raster of a run opens where other people would open it: as a COG, in GDAL, from STAC."""

import json
import re
import shutil
import subprocess

import pystac
import pytest
import rasterio
from rio_cogeo import cog_validate

from solmap.products.formats.raster.raster import class_names
from solmap.products.model import ProductKind

PANORAMAS = {"panorama", "panorama-ground"}
"""Rasters of directions and not of places on the map."""


def rasters(mapped):
    return sorted((mapped.store / "products").glob("*/*/*.tif"))


def is_map(path):
    return path.parts[-3] not in PANORAMAS


def is_one_tile_wide(path, error):
    """Whether an overview is called untiled only because it is as wide as its square tiles.

    rasterio distinguishes tiles from strips by their width; such an overview has tiles by its
    blocks.
    """
    found = re.fullmatch(r"Overview of index (\d+) is not tiled", error)
    if found is None:
        return False
    with rasterio.open(path, OVERVIEW_LEVEL=int(found[1])) as overview:
        return set(overview.block_shapes) == {(overview.width, overview.width)}


def test_every_raster_is_a_valid_cog_with_its_description(mapped):
    assert len(rasters(mapped)) > 8
    for path in rasters(mapped):
        _, errors, warnings = cog_validate(path, strict=True)
        assert not [error for error in errors if not is_one_tile_wide(path, error)], path
        assert not warnings, path
        with rasterio.open(path) as dataset:
            assert all(dataset.descriptions), path
            assert dataset.nodata is not None, path
            assert dataset.crs.is_projected == is_map(path), path
            tags = dataset.tags()
            assert tags["PRODUCT"].split("/")[0] == path.parts[-3]
            assert tags["TIFFTAG_SOFTWARE"].startswith("solmap ")
            assert tags["INPUTS"], path
            assert (tags["MISSION"], tags["INSTRUMENT"]) == ("MER2", "NAVCAM"), path
            assert all(tags[name] for name in ("SOL", "SITE", "DRIVE", "LOCAL_TIME")), path


def test_terrain_and_orthophoto_of_a_stop_name_the_same_adjustment(mapped):
    named = {}
    for layer in mapped.workspace.catalogue.layers():
        if layer.ref.kind in {ProductKind.DTM, ProductKind.ORTHOPHOTO, ProductKind.SOURCES}:
            with rasterio.open(mapped.workspace.store.path(layer.ref)) as dataset:
                adjustment = dataset.tags()["ADJUSTMENT"]
            named.setdefault(layer.ref.scope.name, []).append(adjustment)
    assert len(named) == 2
    for adjustments in named.values():
        assert len(adjustments) == 3
        assert len(set(adjustments)) == 1


def test_classes_have_names_and_colours(mapped):
    classes = 0
    for path in rasters(mapped):
        with rasterio.open(path) as dataset:
            names = class_names(dataset)
            if names:
                classes += 1
                colours = dataset.colormap(1)
                assert len({colours[value] for value in names}) > len(names) / 2
    assert classes


def test_gdal_reads_every_raster(mapped):
    gdalinfo = shutil.which("gdalinfo")
    if gdalinfo is None:
        pytest.skip("gdalinfo is not installed: the package gdal-bin has it")
    for path in rasters(mapped):
        reported = subprocess.run([gdalinfo, "-json", str(path)], capture_output=True, check=True)
        seen = json.loads(reported.stdout)
        assert seen["metadata"]["IMAGE_STRUCTURE"]["LAYOUT"] == "COG"
        expected = "Orthographic" if is_map(path) else "Azimuth and elevation"
        assert expected in seen["coordinateSystem"]["wkt"]
        assert all(band["description"] for band in seen["bands"])


def test_stac_links_to_every_layer_of_the_catalogue(mapped):
    catalogue = pystac.Catalog.from_file(str(mapped.store / "stac" / "catalog.json"))
    items = {item.id: item for item in catalogue.get_items(recursive=True)}
    layers = mapped.workspace.catalogue.layers()
    assert {f"{layer.ref.scope}-{layer.ref.kind}" for layer in layers} == items.keys()
    for item in items.values():
        for asset in item.assets.values():
            assert (mapped.store / "stac" / "MER2" / asset.href).resolve().is_file()
        assert item.properties["solmap:adjustment"], item.id
