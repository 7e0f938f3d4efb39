"""Products in an object store: what is made, read and served, and what happens when it fails."""

from __future__ import annotations

import json
import os
import pickle
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from solmap.gis_server.app import create_app
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, ProductNotFoundError, StoreAwayError
from solmap.products.formats.mesh.tiles3d import TilesetWriter
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore
from solmap.tasks.mission.publish import update_stac
from tests.support.bowl_store import GRID, REGION, fill
from tests.support.decoded_answers import unpacked
from tests.support.object_store import (
    NoObjectStoreError,
    ObjectStore,
    Wire,
    environment,
    environment_of,
    forget_copies,
    running_object_store,
    wire_to,
)
from tests.support.small_downlink import write_coarse_pipeline, write_small_downlink
from tests.support.tile_at import tile_at

LARGE = 40 << 20
"""Bytes of a product that is sent in parts."""
IMAGE = Scope(ScopeLevel.IMAGE, "2n140")
MAKER = """
import sys
from pathlib import Path
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore

store = ProductStore.open(Path(sys.argv[1]), ObjectStorage(sys.argv[2]))
first, count = int(sys.argv[3]), int(sys.argv[4])
print("ready", flush=True)
for number in range(first, first + count):
    size = 20_000_000 if number % 2 else 3_000_000
    recipe = Recipe(ProductKind.IMAGE, Scope(ScopeLevel.IMAGE, "2n140"), params=(number,))
    store.make(recipe, lambda path: path.write_bytes(number.to_bytes(4, "little") * (size // 4)))
    print(number, flush=True)
"""


@pytest.fixture(scope="module")
def objects(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObjectStore]:
    """An S3 server, and the environment that leads to it; skips where there is none."""
    try:
        with (
            running_object_store(tmp_path_factory.mktemp("s3")) as store,
            environment(**environment_of(store.address)),
        ):
            yield store
    except NoObjectStoreError as error:
        pytest.skip(str(error))


@pytest.fixture
def url(objects: ObjectStore, request: pytest.FixtureRequest) -> str:
    """The URL of an empty prefix in a bucket of its own."""
    return objects.bucket(f"b{abs(hash(request.node.name)):x}")


@pytest.fixture
def wire(objects: ObjectStore) -> Iterator[Wire]:
    """A way to the server that can be cut; the environment leads there."""
    with wire_to(objects) as found, environment(**environment_of(found.address)):
        yield found


@dataclass(frozen=True)
class Worlds:
    """The same maps in a folder and in an object store."""

    here: Workspace
    there: Workspace

    def clients(self) -> tuple[TestClient, TestClient]:
        here = TestClient(create_app(self.here.store.root))
        return here, TestClient(
            create_app(self.there.store.root, object_storage=self.there.store.object_storage)
        )


@pytest.fixture(scope="module")
def worlds(objects: ObjectStore, tmp_path_factory: pytest.TempPathFactory) -> Worlds:
    url = objects.bucket("worlds")
    here = Workspace.open(tmp_path_factory.mktemp("here"))
    there = Workspace.open(tmp_path_factory.mktemp("there"), object_storage=ObjectStorage(url))
    for workspace in (here, there):
        build(workspace)
    return Worlds(here, there)


def build(workspace: Workspace) -> None:
    fill(workspace)
    tileset = workspace.store.make(Recipe(ProductKind.TILESET, REGION), write_tileset)
    layer = Layer(
        tileset, "MER2", "3D", "model", GRID.bounds, None, None, None, (155,), "2026-01-01"
    )
    workspace.catalogue.publish(layers=[layer])
    mission = workspace.catalogue.mission("MER2")
    update_stac(mission, workspace.catalogue.layers("MER2", [ProductKind.DTM]), workspace)


def write_tileset(path: Path) -> None:
    from solmap.photogrammetry.terrain.mesh.surface_mesh import TilePlace  # noqa: PLC0415

    with TilesetWriter(path, {}) as writer:
        for place in (TilePlace(0, 0, 0), TilePlace(1, 0, 0)):
            points = np.array([[0.0, 0.0, 0.0], [10.0, -10.0, 1.0]])
            writer.add(place, f"tile {place}".encode() * 1000, points, 0.1)


def image(number: int) -> Recipe:
    return Recipe(ProductKind.IMAGE, IMAGE, params=(number,))


def writing(body: bytes):
    return lambda path: path.write_bytes(body)


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_products_in_an_object_store_are_byte_for_byte_the_same(worlds):
    here, there = worlds.here.store, worlds.there.store
    refs = list(here.refs())
    assert len(refs) > 20
    assert list(there.refs()) == refs
    forget_copies(there.root)
    for ref in refs:
        assert there.path(ref).read_bytes() == here.path(ref).read_bytes()
        one, other = here.provenance(ref), there.provenance(ref)
        assert (one["recipe"], one["sha256"]) == (other["recipe"], other["sha256"])
    assert files_below(there.root / "products") == []
    assert files_below(there.root / "stac") == []


def questions(layers: list[Layer]) -> Iterator[str]:
    """Addresses of everything that is served of some layers."""
    for layer in layers:
        ref = layer.ref
        place = f"{ref.scope.name}/{ref.kind}/{ref.digest}"
        yield f"/download/{place}"
        if layer.type == "raster":
            yield f"/download/{place}/clip?bbox=-5,-5,5,5"
            for zoom in (14, 16, 18):
                at = tile_at(3.0, -4.0, zoom)
                yield f"/tiles/{place}/{zoom}/{at.column}/{at.row}.png"
        elif layer.type == "vector":
            yield f"/api/layers/{place}/features.geojson"
        else:
            yield f"/models/{ref.scope.name}/tileset/{ref.digest}/tileset.json"
            yield f"/models/{ref.scope.name}/tileset/{ref.digest}/1/0-0.glb"
    yield from ("/api/missions/MER2/identify?east=3&north=-4", "/stac/catalog.json")
    yield "/api/missions/MER2/tileset.json"


def test_the_server_gives_the_same_answers_from_the_object_store(worlds):
    here, there = worlds.clients()
    forget_copies(worlds.there.store.root)
    layers = worlds.here.catalogue.layers("MER2")
    requested = list(questions(layers))
    for address in requested:
        one, other = here.get(address), there.get(address)
        assert one.status_code == other.status_code == 200, address
        assert unpacked(one.content) == unpacked(other.content), address
    assert len(requested) > 30


def test_tiles_are_read_in_place_by_a_few_requests(worlds, objects):
    _, there = worlds.clients()
    forget_copies(worlds.there.store.root)
    dtm = next(x for x in worlds.there.catalogue.layers("MER2") if x.ref.kind is ProductKind.DTM)
    at = tile_at(3.0, -4.0, 18)
    place = f"{dtm.ref.scope.name}/{dtm.ref.kind}/{dtm.ref.digest}"
    before = len(objects.requests)
    for _ in range(5):
        assert there.get(f"/tiles/{place}/18/{at.column}/{at.row}.png").status_code == 200
    assert len(objects.requests) - before <= 6
    assert files_below(worlds.there.store.root / "cache") == []


@pytest.mark.parametrize(
    "range_", ["bytes=0-99", "bytes=100-", "bytes=-50", "bytes=0-", "bytes=5-1,7-9", "lines=1-2"]
)
def test_a_range_of_a_download_equals_that_part_of_the_file(worlds, range_):
    here, there = worlds.clients()
    dtm = next(x for x in worlds.there.catalogue.layers("MER2") if x.ref.kind is ProductKind.DTM)
    address = f"/download/{dtm.ref.scope.name}/{dtm.ref.kind}/{dtm.ref.digest}"
    whole = here.get(address).content
    answer = there.get(address, headers={"range": range_})
    first, _, last = answer.headers.get("content-range", f"bytes 0-{len(whole) - 1}/").partition(
        "-"
    )
    part = whole[int(first.split()[1]) : int(last.split("/")[0]) + 1]
    assert answer.content == part
    assert answer.headers["content-length"] == str(len(part))
    beyond = there.get(address, headers={"range": f"bytes={len(whole)}-"})
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, f"bytes */{len(whole)}")


@pytest.mark.parametrize("inside", ["..%2f..%2fcatalogue.sqlite", "../catalogue.sqlite", "%2e%2e"])
def test_no_url_reaches_outside_the_products(worlds, inside):
    _, there = worlds.clients()
    for address in ("/download/mer2/dtm/{}", "/stac/{}/collection.json", "/stac/mer2/{}.json"):
        assert there.get(address.format(inside)).status_code in (404, 422)


def test_versions_and_removal_in_an_object_store(url, tmp_path):
    store = ProductStore.open(tmp_path, ObjectStorage(url))
    made = [store.make(image(n), writing(b"label")) for n in range(3)]
    assert set(store.versions(ProductKind.IMAGE, IMAGE)) == set(made)
    for _ in range(2):
        store.remove(made[0])
    assert set(store.refs()) == set(made[1:])
    with pytest.raises(ProductNotFoundError, match="is not in the store; run the processing"):
        store.path(made[0])
    with pytest.raises(ProductNotFoundError, match="is not in the store; run the processing"):
        store.provenance(made[0])


def test_a_store_passed_to_another_process_works_there(url, tmp_path):
    store = ProductStore.open(tmp_path, ObjectStorage(url))
    ref = store.make(image(1), writing(b"label"))
    handed = pickle.loads(pickle.dumps(store))  # noqa: S301 - our own
    assert handed.path(ref).read_bytes() == b"label"


def test_the_location_of_products_is_remembered_and_not_mistaken(url, tmp_path):
    ref = ProductStore.open(tmp_path, ObjectStorage(url)).make(image(1), writing(b"label"))
    assert ProductStore.open(tmp_path).has(ref)
    with pytest.raises(ProductError, match=f"are at {url}, not at s3://other/maps"):
        ProductStore.open(tmp_path, ObjectStorage("s3://other/maps"))
    local = tmp_path / "local"
    ProductStore.open(local).make(image(1), writing(b"label"))
    with pytest.raises(ProductError, match="contains products"):
        ProductStore.open(local, ObjectStorage(url))


def test_two_concurrent_makers_of_one_product_keep_one(url, tmp_path):
    stores = [ProductStore.open(tmp_path / str(n), ObjectStorage(url)) for n in range(4)]
    together, made = threading.Barrier(len(stores)), []

    def write(path: Path) -> None:
        together.wait(timeout=30)  # nothing was sent yet
        path.write_bytes(b"label" * 1000)

    makers = [
        threading.Thread(target=lambda s=s: made.append(s.make(image(1), write))) for s in stores
    ]
    for maker in makers:
        maker.start()
    for maker in makers:
        maker.join()
    assert made == [image(1).ref] * len(stores)
    assert list(stores[0].refs()) == [image(1).ref]
    assert all(store.path(image(1).ref).read_bytes() == b"label" * 1000 for store in stores)


def is_whole(store: ProductStore, number: int) -> bool:
    ref = image(number).ref
    body = store.path(ref).read_bytes()
    return body == number.to_bytes(4, "little") * (len(body) // 4) and (
        len(body) == store.provenance(ref)["bytes"]
    )


def undisturbed_s(command: list[str]) -> float:
    """How long a maker works that nobody kills."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as maker:
        assert maker.stdout is not None
        maker.stdout.readline()
        begun = time.monotonic()
        assert maker.wait() == 0
    return time.monotonic() - begun


def kill_makers(url: str, root: Path, kills: int) -> tuple[int, int]:
    """Kill makers at random moments: products whole, and processes killed, in the end."""
    rng = np.random.default_rng(9)
    killed = 0
    command = [sys.executable, "-c", MAKER, str(root / "maker"), url]
    takes_s = undisturbed_s([*command, str(4 * kills), "4"])
    for turn in range(kills):
        with subprocess.Popen(
            [*command, str(4 * turn), "4"], stdout=subprocess.PIPE, text=True
        ) as maker:
            assert maker.stdout is not None
            maker.stdout.readline()
            time.sleep(rng.uniform(0.0, takes_s))
            maker.send_signal(signal.SIGKILL)
        killed += maker.returncode == -signal.SIGKILL
        seen = ProductStore.open(root / f"reader{turn}", ObjectStorage(url))
        assert all(
            is_whole(seen, n) for n in range(4 * turn, 4 * turn + 4) if seen.has(image(n).ref)
        )
    subprocess.run([*command, "0", str(4 * kills)], check=True, stdout=subprocess.DEVNULL)
    store = ProductStore.open(root / "judge", ObjectStorage(url))
    assert list(files_below(root / "maker" / "drafts")) == []
    return sum(is_whole(store, number) for number in range(4 * kills)), killed


def test_a_maker_killed_while_uploading_leaves_no_partial_product(url, tmp_path):
    whole, killed = kill_makers(url, tmp_path, 2)
    assert (whole, killed > 0) == (8, True)


@pytest.mark.slow
def test_makers_killed_often_leave_no_partial_product(url, tmp_path):
    whole, killed = kill_makers(url, tmp_path, 20)
    assert whole == 80
    assert killed > 10
    sys.stdout.write(f"{killed} makers killed, {whole} products whole\n")


def test_a_connection_cut_during_an_upload_leaves_no_visible_product(url, wire, tmp_path):
    store = ProductStore.open(tmp_path, ObjectStorage(url))
    wire.cut_after = LARGE // 2
    with pytest.raises(StoreAwayError, match=r"object store s3://.* does not respond"):
        store.make(image(1), writing(os.urandom(LARGE)))
    wire.repair()
    assert not store.has(image(1).ref)
    assert list(store.refs()) == []
    store.make(image(1), writing(b"x" * LARGE))
    forget_copies(tmp_path)
    assert store.path(image(1).ref).stat().st_size == LARGE


def test_a_slow_connection_is_waited_for(url, wire, tmp_path):
    store = ProductStore.open(tmp_path, ObjectStorage(url))
    wire.pause_s = 0.5
    ref = store.make(image(1), writing(b"label"))
    forget_copies(tmp_path)
    assert store.path(ref).read_bytes() == b"label"


def test_the_server_reports_an_unreachable_store_and_recovers(worlds, wire):
    object_storage = worlds.there.store.object_storage
    client = TestClient(create_app(worlds.there.store.root, object_storage=replace(object_storage)))
    forget_copies(worlds.there.store.root)
    layers = worlds.here.catalogue.layers("MER2")
    requested = [
        address for address in questions(layers) if address.startswith(("/tiles", "/down"))
    ]
    wire.cut()
    for address in (*requested[:2], next(x for x in requested if x.startswith("/tiles"))):
        answer = client.get(address)
        assert answer.status_code == 503, (address, answer.text)
        assert "does not respond" in answer.json()["detail"]
    wire.repair()
    assert {client.get(address).status_code for address in requested} == {200}


def test_an_unreachable_object_store_is_named(url, wire, tmp_path):
    wire.cut()
    with pytest.raises(StoreAwayError, match=r"127.0.0.1:\d+ does not respond.*AWS_ENDPOINT_URL"):
        ProductStore.open(tmp_path, ObjectStorage(url))


@pytest.mark.usefixtures("objects")
def test_a_missing_bucket_is_named(tmp_path):
    with pytest.raises(
        ProductError, match=r"there is no bucket nowhere at http.*; make it, or set"
    ):
        ProductStore.open(tmp_path, ObjectStorage("s3://nowhere/maps"))


def test_keys_refused_by_the_bucket_are_named(url, objects, tmp_path):
    objects.request("POST", "moto-api/reset-auth", b"0")
    try:
        with pytest.raises(ProductError, match=r"does not give access to s3://.*AWS_ACCESS_KEY_ID"):
            ProductStore.open(tmp_path, ObjectStorage(url))
    finally:
        objects.request("POST", "moto-api/reset-auth", b"inf")


@pytest.mark.parametrize("wrong", ["http://a/b", "s3:///prefix", "bucket/prefix", "gs://a/b"])
def test_an_invalid_object_store_url_is_refused(wrong, tmp_path):
    with pytest.raises(ProductError, match="set SOLMAP_STORE_URL=s3://bucket/prefix"):
        ProductStore.open(tmp_path, ObjectStorage(wrong))


def test_documents_are_replaced_whole(url, tmp_path):
    store = ProductStore.open(tmp_path, ObjectStorage(url))
    assert store.document("stac/catalog.json") is None
    for number in range(2):
        store.write_document("stac/catalog.json", json.dumps({"number": number}))
    assert json.loads(store.document("stac/catalog.json") or "") == {"number": 1}


def run(command: list[str], **variables: str) -> float:
    """Processor seconds of a command of solmap and of all it started."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    program = [str(Path(sys.executable).with_name("solmap")), *command]
    ended = subprocess.run(
        program, env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.slow
def test_a_whole_run_makes_the_same_products_by_configuration_alone(url, tmp_path):
    downlink, pipeline = tmp_path / "downlink", tmp_path / "coarse.toml"
    write_small_downlink(downlink, pairs=2)
    write_coarse_pipeline(pipeline)
    here, there = tmp_path / "here", tmp_path / "there"

    def take(store: Path, **variables: str) -> float:
        command = ["run", str(downlink), "--store", str(store), "--pipeline", str(pipeline)]
        return run(command, **variables)

    took = [take(here), take(there, SOLMAP_STORE_URL=url)]
    one, other = Workspace.open(here), Workspace.open(there, object_storage=ObjectStorage(url))
    refs = list(one.store.refs())
    assert len(refs) > 20
    assert list(other.store.refs()) == refs
    forget_copies(there)
    for ref in refs:
        assert other.store.path(ref).read_bytes() == one.store.path(ref).read_bytes(), ref
    layers = [layer.ref for layer in one.catalogue.layers()]
    assert [layer.ref for layer in other.catalogue.layers()] == layers
    assert files_below(there / "products") == []
    took.append(take(there, SOLMAP_STORE_URL=url))
    assert list(other.store.refs()) == refs
    here_s, there_s, again_s = (f"{seconds:.1f} s" for seconds in took)
    sys.stdout.write(f"{len(refs)} products: {here_s} here, {there_s} there, {again_s} again\n")
