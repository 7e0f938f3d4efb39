"""Curiosity and Perseverance, from the archive's or the public site's server to a terrain model.

The servers are laid out like PDS's and mars.nasa.gov's; images are simulated ones of Spirit with
labels and names of the other missions.
"""

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import ReadImage, read_image
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.scene import WorldParams
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.raster import read_dtm
from solmap.products.model import ProductKind
from solmap.tasks.images.ingest import ingest_downlink
from tests.support.other_missions import (
    instrument_of,
    json_bytes,
    name_of,
    pds3_file,
    pds4_product,
    raw_image,
)
from tests.support.small_downlink import rendered_images

LISTS = {"MSL": ("items", "/api/v1/raw_image_items/"), "M20": ("images", "/rss/api/")}
SORRY = b"<!DOCTYPE html><html>PDS: this page moved</html>"


@dataclass
class Site:
    """A web server: files by path, lists of raw images by path and key."""

    files: dict[str, bytes] = field(default_factory=dict)
    lists: dict[str, tuple[str, list[dict]]] = field(default_factory=dict)
    requested: list[str] = field(default_factory=list)
    url: str = ""

    def answer(self, address: str) -> bytes:
        """What the archive answers to a wrong address is a page, with the status of a right one."""
        self.requested.append(address)
        parts = urlsplit(address)
        if parts.path not in self.lists:
            return self.files.get(parts.path, SORRY)
        key, items = self.lists[parts.path]
        query = {name: values[0] for name, values in parse_qs(parts.query).items()}
        size, page = int(query.get("per_page", query.get("num"))), int(query["page"])
        low, high = (int(query[f"condition_{n}"].partition(":")[0]) for n in (2, 3))
        cameras = query["search"].split("|")
        found = [
            item
            for item in items
            if low <= item["sol"] <= high
            and item.get("camera", item).get("instrument", item.get("instrument")) in cameras
        ]
        shown = found[page * size : (page + 1) * size]
        return json_bytes({key: shown, "page": page, "more": len(found) > (page + 1) * size})


@pytest.fixture
def site(monkeypatch) -> Iterator[Site]:
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    site = Site()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            body = site.answer(self.path)
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_args):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    site.url = f"http://127.0.0.1:{server.server_port}"
    yield site
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(scope="module")
def images() -> list[tuple[bytes, ReadImage]]:
    """Two stereo pairs of one stop, left before right."""
    params = WorldParams("plains", TraverseParams(stops=1), pairs=2, averaging=4)
    files = rendered_images(params, 21)
    return [(file.data, read_image(file.data, Path(file.path).name)) for file in files]


@pytest.fixture
def fetch(tmp_path, monkeypatch):
    """Calls the flow's function; its tasks run without the engine."""
    from solmap.flows import fetch as flow  # noqa: PLC0415 - slow to import

    for task in ("fetch_index", "fetch_images", "find_raw_images", "fetch_raw_images"):
        monkeypatch.setattr(flow, task, getattr(flow, task).fn)
    file = tmp_path / "archive.toml"

    def call(mission: str, sol: int, tables: str, **options: Any):
        file.write_text(
            "[transfer]\nattempts = 2\nfirst_wait_s = 0.01\ntimeout_s = 5.0\n"
            f'[missions.{mission}]\ntitle = "Rover"\n{tables}'
        )
        return flow.fetch_archive.fn(
            mission, str(sol), ["navcam"], tmp_path / "out", archive_file=file, **options
        )

    return call


def ingested(folder: Path, store: Path) -> Workspace:
    workspace = Workspace.open(store)
    assert not ingest_downlink.fn(folder, workspace).faults
    return workspace


def index_of_curiosity(rows: list[tuple[str, ...]]) -> tuple[bytes, bytes]:
    """Label and table of INDEX/ in a volume of Curiosity's engineering cameras."""
    columns = {
        "VOLUME_ID": 12,
        "PATH_NAME": 30,
        "FILE_NAME": 45,
        "INSTRUMENT_ID": 14,
        "PLANET_DAY_NUMBER": 8,
        "PRODUCT_ID": 45,
    }
    start, blocks = 1, []
    for name, width in columns.items():
        blocks.append(
            f"OBJECT = COLUMN\n NAME = {name}\n START_BYTE = {start + 1}\n BYTES = {width}\n"
            "END_OBJECT = COLUMN"
        )
        start += width + 3
    lines = [
        ",".join(f'"{value:<{width}}"' for value, width in zip(row, columns.values(), strict=True))
        for row in rows
    ]
    head = 'PDS_VERSION_ID = PDS3\n^INDEX_TABLE = "INDEX.TAB"\nOBJECT = INDEX_TABLE'
    blocks.insert(0, f"ROWS = {len(rows)}")
    label = "\n".join([head, f"ROW_BYTES = {start}", *blocks, "END_OBJECT = INDEX_TABLE", "END"])
    return label.encode(), "".join(f"{line}\r\n" for line in lines).encode()


def test_pairs_of_curiosity_are_found_in_the_volume_s_index(site, fetch, images, tmp_path):
    sol, rows, files = images[0][1].image.sol, [], {}
    for data, read in images:
        name = name_of(read, "MSL")
        folder = f"DATA/SOL{sol:05d}/"
        camera = instrument_of(read, "MSL")
        rows.append(("MSLNAV_0XXX", f"/{folder}", f"{name}.LBL", camera, str(sol), name))
        thumbnail = name.replace("EDR_F", "EDR_T")
        rows.append(("MSLNAV_0XXX", f"/{folder}", f"{thumbnail}.LBL", camera, str(sol), thumbnail))
        files[f"{name}.IMG"] = pds3_file(data, read, "MSL")
        site.files[f"/msl/MSLNAV_0XXX/{folder}{name}.IMG"] = files[f"{name}.IMG"]
    label, table = index_of_curiosity(rows)
    site.files["/msl/MSLNAV_0XXX/INDEX/INDEX.LBL"] = label
    site.files["/msl/MSLNAV_0XXX/INDEX/INDEX.TAB"] = table
    tables = (
        f'base_urls = ["{site.url}/moved", "{site.url}/msl"]\nindex = "INDEX/INDEX.LBL"\n'
        'volumes = { navcam = "MSLNAV_0XXX" }\n'
    )
    report = fetch("MSL", sol, tables)
    assert report.succeeded, report.failures
    assert (report.pairs, report.unpaired, report.fetched) == (2, 0, 4)
    here = tmp_path / "out" / f"sol{sol:04d}"
    assert {path.name: path.read_bytes() for path in here.iterdir()} == files
    assert fetch("MSL", sol, tables).already_here == 4
    entries = ingested(here, tmp_path / "store").catalogue.images("MSL")
    assert [entry.partner is not None for entry in entries] == [True] * 4


def test_pairs_of_perseverance_are_found_in_the_collection_s_inventory(
    site, fetch, images, tmp_path
):
    """Each tile is a product; documents and thumbnails are in the inventory, too."""
    sol, files = images[0][1].image.sol, {}
    lines = ["P,urn:nasa:pds:mars2020_navcam_ops_raw:document:sis::1.0"]
    collection = "urn:nasa:pds:mars2020_navcam_ops_raw:data:"
    for data, read in images:
        for part in ("01_0", "02_0"):
            name = name_of(read, "M20", part)
            lines.append(f"P,{collection}{name.lower()[:-2]}::1.0")
            lines.append(f"P,{collection}{name.lower()[:-2].replace('ecm_n', 'ecm_t')}::1.0")
            files[f"{name}.IMG"] = pds3_file(data, read, "M20")
    bundle = "/mars2020/mars2020_navcam_ops_raw/data"
    site.files[f"{bundle}/collection_data_inventory.csv"] = "\r\n".join([*lines, ""]).encode()
    for name, data in files.items():
        site.files[f"{bundle}/sol/{sol:05d}/ids/edr/ncam/{name}"] = data
    tables = (
        f'base_urls = ["{site.url}/moved", "{site.url}/mars2020"]\n'
        'index = "data/collection_data_inventory.csv"\n'
        'volumes = { navcam = "mars2020_navcam_ops_raw" }\n'
    )
    assert len(fetch("M20", sol, tables, dry_run=True).files) == 8
    report = fetch("M20", sol, tables)
    assert report.succeeded, report.failures
    assert (report.pairs, report.unpaired, report.fetched) == (4, 0, 8)
    here = tmp_path / "out" / f"sol{sol:04d}"
    assert {path.name: path.read_bytes() for path in here.iterdir()} == files


@pytest.mark.parametrize("mission", ["MSL", "M20"])
def test_public_raw_images_are_fetched_with_their_metadata(site, fetch, images, tmp_path, mission):
    key, address = LISTS[mission]
    sol, items, bitmaps = images[0][1].image.sol, [], {}
    for number, (_, read) in enumerate(images):
        name, image, item = raw_image(read, mission)
        url = f"{site.url}/surface/sol/{sol:05d}/{name}"
        place = {"https_url": url} if mission == "MSL" else {"image_files": {"full_res": url}}
        site.files[f"/surface/sol/{sol:05d}/{name}"] = image
        items.append({**item, **place})
        bitmaps[name] = image
        small = {"is_thumbnail": True} if mission == "MSL" else {"sample_type": "Thumbnail"}
        items.append({**item, **place, **small, "imageid": f"{item['imageid']}{number}"})
    bare = {**items[0], "attitude": None, "imageid": "WITHOUT_ATTITUDE"}
    elsewhere = {"https_url": "http://elsewhere.example/X.JPG"} | {
        "image_files": {"full_res": "http://elsewhere.example/X.png"}
    }
    items += [bare, {**items[0], **elsewhere, "imageid": "ELSEWHERE"}]
    filler = {**items[1], "sol": sol}  # thumbnails enough for a second page
    site.lists[address] = (key, [*[filler] * 120, *items])
    tables = f'base_urls = ["{site.url}"]\nraw_images = "{site.url}{address}"\nvolumes = {{}}\n'
    report = fetch(mission, sol, tables, raw=True)
    assert report.succeeded, report.failures
    assert (report.pairs, report.unpaired, report.fetched) == (2, 0, 4)
    (warning,) = report.warnings
    assert warning.startswith("2 raw images cannot be placed; the first: ")
    assert "no attitude of the rover" in warning
    here = tmp_path / "out" / f"sol{sol:04d}"
    assert {path.name: path.read_bytes() for path in here.iterdir() if path.suffix != ".json"} == (
        bitmaps
    )
    entries = ingested(here, tmp_path / "store").catalogue.images(mission)
    assert len(entries) == 4
    assert all(entry.partner for entry in entries)
    site.requested.clear()
    assert fetch(mission, sol, tables, raw=True).already_here == 4
    assert {urlsplit(requested).path for requested in site.requested} == {address}


def test_a_rover_without_a_public_list_is_refused(fetch, site):
    from solmap.config.records import ConfigError  # noqa: PLC0415

    tables = f'base_urls = ["{site.url}"]\nvolumes = {{}}\n'
    with pytest.raises(ConfigError, match="Rover has no list of public raw images"):
        fetch("MER2", 5, tables, raw=True)


FORMS = ("MER2 PDS3", "MSL PDS3", "MSL raw", "M20 PDS4", "M20 raw")


def deliver(form: str, data: bytes, read: ReadImage, folder: Path) -> None:
    """Write an image in one of the forms that its mission's come in."""
    mission, _, kind = form.partition(" ")
    match kind:
        case "PDS3":
            name = name_of(read, mission) if mission != "MER2" else read.image.id
            file = data if mission == "MER2" else pds3_file(data, read, mission)
            (folder / f"{name}.IMG").write_bytes(file)
        case "PDS4":
            label, pixels = pds4_product(read)
            name = name_of(read, mission)
            (folder / f"{name}.xml").write_bytes(label)
            (folder / f"{name}.IMG").write_bytes(pixels)
        case _:
            name, image, item = raw_image(read, mission)
            (folder / name).write_bytes(image)
            (folder / Path(name).with_suffix(".json").name).write_text(json.dumps(item))


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_an_image_is_read_as_the_same_image(form, images, tmp_path):
    (data, left), (_, right) = images[0], images[1]
    for data, read in images[:2]:
        deliver(form, data, read, tmp_path)
    mission = form.partition(" ")[0]
    workspace = ingested(tmp_path, tmp_path / "store")
    entries = {entry.eye: entry for entry in workspace.catalogue.images(mission)}
    assert set(entries) == {Eye.LEFT, Eye.RIGHT}
    assert entries[Eye.LEFT].partner == entries[Eye.RIGHT].id
    points = np.array([[10.0, 20.0], [128.0, 128.0], [250.0, 200.0]])
    for read in (left, right):
        record = image_record(entries[read.image.eye], workspace)
        assert (record.stop.site, record.stop.drive) == (
            read.image.stop.site,
            read.image.stop.drive,
        )
        apart = record.camera.rays(points) - read.image.camera.rays(points)
        assert np.abs(apart).max() < 2e-5  # six digits of H and V: 0.01 px of some 300
        np.testing.assert_allclose(
            record.site_from_rover.rotation, read.image.site_from_rover.rotation, atol=1e-5
        )


def test_images_stored_under_m2020_move_when_delivered_again(images, tmp_path):
    downlink = tmp_path / "downlink"
    downlink.mkdir()
    for data, read in images[:2]:
        deliver("M20 raw", data, read, downlink)
    catalogue = ingested(downlink, tmp_path / "store").catalogue
    of_old = [
        replace(entry, mission="M2020", stop=entry.stop.replace("m20-", "m2020-"))
        for entry in catalogue.images("M20")
    ]
    catalogue.publish(images=of_old)
    assert len(catalogue.images("M2020")) == 2
    ingested(downlink, tmp_path / "store")
    assert not catalogue.images("M2020")
    assert all(entry.partner for entry in catalogue.images("M20"))


@pytest.mark.slow
@pytest.mark.usefixtures("engine")
def test_every_form_gives_the_same_terrain_model(images, tmp_path):
    """Through the whole pipeline: PDS3, PDS4, and eight-bit images with their JSON."""
    from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - needs the engine's settings

    models = {}
    for form in FORMS:
        downlink = tmp_path / form
        downlink.mkdir()
        for data, read in images:
            deliver(form, data, read, downlink)
        report = process_downlink(downlink, tmp_path / f"store {form}")
        assert report.succeeded, (form, report.failures)
        workspace = Workspace.open(tmp_path / f"store {form}")
        mission = form.partition(" ")[0]
        (group,) = workspace.catalogue.maps_of(mission)
        (layer,) = [
            layer
            for layer in workspace.catalogue.layers(group)
            if layer.ref.kind is ProductKind.DTM
        ]
        models[form] = read_dtm(workspace.store.path(layer.ref))
    truth = models.pop("MER2 PDS3")
    for form, model in models.items():
        assert model.grid.cell_m == truth.grid.cell_m, form
        common = np.abs(_differences(truth, model))
        assert common.size > 0.9 * np.isfinite(truth.elevation).sum(), form
        assert np.median(common) < 0.005, (form, np.median(common))
        assert np.percentile(common, 90) < 0.05, (form, np.percentile(common, 90))


def _differences(one, other) -> np.ndarray:
    """Elevations of `other` less those of `one` in the cells that both have."""
    a, b = one.grid, other.grid
    east, north = round((b.west - a.west) / a.cell_m), round((a.north - b.north) / a.cell_m)
    rows = slice(max(0, north), min(a.rows, north + b.rows))
    columns = slice(max(0, east), min(a.cols, east + b.cols))
    there = (
        slice(rows.start - north, rows.stop - north),
        slice(columns.start - east, columns.stop - east),
    )
    apart = other.elevation[there] - one.elevation[rows, columns]
    return apart[np.isfinite(apart)]
