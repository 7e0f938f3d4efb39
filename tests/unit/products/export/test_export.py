"""An exported folder has readable names, describes itself, and is opened by other programs."""

import io
import json
import re
import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import geopandas
import numpy as np
import pystac
import pytest
import rasterio
from pyproj import CRS as ProjCrs

from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError
from solmap.products.export.contents import export
from solmap.products.export.qgis_project import MapFile, project_bytes
from solmap.products.export.selection import Selection, stop_named
from solmap.products.formats.raster.styles import VIRIDIS
from solmap.products.model import ProductKind
from tests.unit.gis_server.conftest import CRS, LANDING, build, elevation_at, haven, ref_of

STOP = "MER2_sol0156_site010_drive0064"
DTM = f"maps/{STOP}_dtm_8cm.tif"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return build(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def workspace(world):
    return Workspace(world.store, world.catalogue)


@pytest.fixture(scope="module")
def exported(workspace, tmp_path_factory) -> Path:
    target = tmp_path_factory.mktemp("export") / "out"
    export(target, Selection(), workspace)
    return target


def test_exported_files_have_readable_names(exported):
    names = {path.name for path in (exported / "maps").iterdir()}
    assert {f"{STOP}_dtm_8cm.tif", f"{STOP}_slope_8cm.tif", "MER2_sol0156_havens.geojson"} <= names
    assert not [name for name in names if re.search(r"[0-9a-f]{16}", name)]
    readme = (exported / "README.md").read_text()
    assert all(f"`{name}`" in readme for name in names)
    assert "Columbia Memorial Station" in readme
    assert "`MER2.qgz`" in readme


def test_products_are_exported_unchanged(exported, world):
    path = world.store.path(ref_of(world, ProductKind.DTM))
    assert (exported / DTM).read_bytes() == path.read_bytes()


def test_rasterio_and_geopandas_open_the_maps_on_mars(exported):
    with rasterio.open(exported / DTM) as dataset:
        assert ProjCrs.from_wkt(dataset.crs.to_wkt(version="WKT2_2019")).equals(CRS)
        (value,) = next(dataset.sample([(10.04, 4.04)], indexes=[1]))
    assert value == pytest.approx(elevation_at(10.04, 4.04), abs=1e-4)
    frame = geopandas.read_file(exported / "maps" / "MER2_sol0156_havens.geojson")
    assert frame.crs.ellipsoid.semi_major_metre == 3_396_190.0
    np.testing.assert_allclose(frame.to_crs(CRS).area, [haven().shape.area], rtol=1e-5)


def test_pystac_reads_the_catalogue_and_finds_every_file(exported):
    catalogue = pystac.Catalog.from_file(str(exported / "stac" / "catalog.json"))
    items = list(catalogue.get_items(recursive=True))
    assert len(items) == len(list((exported / "maps").iterdir()))
    for item in items:
        assert item.get_parent().id == "MER2"
        for asset in item.assets.values():
            assert Path(asset.get_absolute_href()).is_file()
    (dtm,) = (item for item in items if item.id.endswith("drive0064-dtm"))
    assert dtm.properties["title"].endswith("sol 156, site 10 drive 64, 8 cm")


def test_a_second_export_changes_nothing(exported, workspace):
    done, names = export(exported, Selection(), workspace)
    assert (done.written, done.unchanged, done.removed) == (0, len(names), 0)


def test_a_zip_holds_the_same_files(exported, workspace, tmp_path):
    export(tmp_path / "mars.zip", Selection(), workspace)
    with zipfile.ZipFile(tmp_path / "mars.zip") as archive:
        held = {name.removeprefix("mars/"): archive.read(name) for name in archive.namelist()}
    files = {str(p.relative_to(exported)): p for p in exported.rglob("*") if p.is_file()}
    assert held.keys() == files.keys()
    assert all(held[name] == path.read_bytes() for name, path in files.items())


@pytest.mark.parametrize(
    ("selection", "kept"),
    [
        (Selection(kinds=frozenset({"dtm"})), {f"{STOP}_dtm_8cm.tif"}),
        (Selection(stops=frozenset({(10, 64)}), kinds=frozenset({"dtm", "havens"})), {DTM[5:]}),
        (Selection(mission="MER2", sols=frozenset({156}), kinds=frozenset({"dtm"})), {DTM[5:]}),
    ],
)
def test_the_selection_is_exported(workspace, tmp_path, selection, kept):
    export(tmp_path / "out", selection, workspace)
    assert {path.name for path in (tmp_path / "out" / "maps").iterdir()} == kept


@pytest.mark.parametrize(
    "selection",
    [
        Selection(sols=frozenset({157})),
        Selection(stops=frozenset({(11, 64)})),
        Selection(mission="MER1"),
        Selection(kinds=frozenset({"dtm"}), since=datetime.now(UTC) + timedelta(days=1)),
    ],
)
def test_an_empty_selection_is_an_error(workspace, tmp_path, selection):
    with pytest.raises(ProductError, match=r"nothing is selected; .* contains MER2"):
        export(tmp_path / "out", selection, workspace)
    assert not (tmp_path / "out").exists()


def test_a_wrong_kind_or_stop_is_refused_with_the_existing_ones():
    with pytest.raises(ProductError, match="there is no kind dem; there are maps"):
        Selection(kinds=frozenset({"dem"}))
    with pytest.raises(ProductError, match="'south' does not name a stop; SITE/DRIVE is expected"):
        stop_named("south")
    for text in (
        "10/64",
        "10-64",
        "mer2-site0010-drive0064",
        "site010_drive0064".replace("_", "-"),
    ):
        assert stop_named(text) == (10, 64)


def test_a_qgis_project_names_files_beside_it_and_colours_them_as_the_server(exported):
    with zipfile.ZipFile(exported / "MER2.qgz") as archive:
        root = ElementTree.fromstring(archive.read("project.qgs"))  # noqa: S314 - our own
    layers = {one.findtext("datasource"): one for one in root.iterfind("projectlayers/maplayer")}
    assert all((exported / source).is_file() for source in layers)
    ramp = layers[f"./{DTM}"].iterfind("pipe/rasterrenderer/rastershader/colorrampshader/item")
    assert tuple(item.get("color") for item in ramp) == VIRIDIS
    wkt = root.findtext("projectCrs/spatialrefsys/wkt")
    assert ProjCrs.from_wkt(wkt).equals(CRS)
    tree = {node.get("id") for node in root.iter("layer-tree-layer")}
    assert tree == {one.findtext("id") for one in layers.values()}
    assert all(len(name) > 10 for name in tree)  # QGIS gives shorter ones another name


def test_the_project_of_an_untied_map_states_so(world):
    layer = world.catalogue.layer("mer2-site0010-drive0064", ProductKind.DTM)
    untied = LANDING.untied("site 10")
    files = [MapFile(layer, world.store.path(layer.ref), "./maps/a.tif")]
    with zipfile.ZipFile(io.BytesIO(project_bytes("A map", untied, files))) as archive:
        text = archive.read("project.qgs").decode()
    assert "not tied to the lander" in text


def test_items_describe_how_their_files_were_made(exported):
    notes = json.loads((exported / "stac" / "MER2" / f"{STOP}_dtm_8cm_provenance.json").read_text())
    assert notes["recipe"]["kind"] == "dtm"
