"""A catalogue in PostgreSQL: many processes write at once, and readers see all of it or nothing."""

import gc
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest
import sqlalchemy as sa

from solmap.products.catalogue import events
from solmap.products.catalogue.catalogue import Catalogue, Part
from solmap.products.catalogue.database import close_pools, write_transaction
from solmap.products.errors import ProductError, StoreAwayError
from solmap.products.model import ProductKind, ProductRef, Scope, ScopeLevel
from tests.unit.products.catalogue.test_catalogue import MISSION, a_layer, an_image

pytestmark = pytest.mark.timeout(120)
WRITER = """
import sys
from pathlib import Path
from solmap.products.catalogue.catalogue import Catalogue
from tests.unit.products.catalogue.test_catalogue import a_layer, an_image
root, url, name = Path(sys.argv[1]), sys.argv[2] or None, sys.argv[3]
catalogue = Catalogue.open(root, url)
print("open", flush=True)
sys.stdin.readline()
for number in range(25):
    digest = f"{name}{number:02d}".ljust(16, "0")
    catalogue.publish(images=[an_image(f"{name}{number}"), an_image("shared")],
                      layers=[a_layer(digest)])
"""


def test_two_processes_publish_at_once_without_loss(tmp_path, catalogue_url):
    command = (sys.executable, "-c", WRITER, str(tmp_path), catalogue_url or "")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    writers = [subprocess.Popen((*command, name), **pipes) for name in "ab"]
    for writer in writers:
        assert writer.stdout.readline() == "open\n"  # they found the tables at the same time
    for writer in writers:
        writer.communicate("go\n")
        assert writer.returncode == 0
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    assert len(catalogue.images()) == 51
    reported = catalogue.events_since(0)
    moved = [event for event in reported if event.kind == events.LAYERS_PUBLISHED]
    assert len(moved) == 50
    assert [event.id for event in reported] == list(range(1, len(reported) + 1))


def test_a_reader_of_events_misses_none_during_writes(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    seen, done = [], threading.Event()

    def write(number: int) -> None:
        for step in range(15):
            with write_transaction(catalogue.engine) as connection:
                events.append(connection, "test", {"writer": number, "step": step})
                time.sleep(0.002 * (number % 3))  # others end before those who began earlier

    def follow() -> None:
        while True:
            ended = done.is_set()
            since = seen[-1] if seen else 0
            seen.extend(event.id for event in catalogue.events_since(since))
            if ended:
                return

    follower = threading.Thread(target=follow)
    writers = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in (follower, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    done.set()
    follower.join()
    assert len(seen) == 60
    assert seen == [event.id for event in catalogue.events_since(0)]


def test_events_are_committed_in_their_order(postgres, tmp_path):
    catalogue = Catalogue.open(tmp_path, postgres.database())
    late = threading.Thread(target=catalogue.append_event, args=("second", {}))
    with write_transaction(catalogue.engine) as connection:
        events.append(connection, "first", {})
        late.start()
        time.sleep(0.3)  # without turns the second would be there now, under a higher number
        assert catalogue.events_since(0) == []
    late.join()
    assert [event.kind for event in catalogue.events_since(0)] == ["first", "second"]


def test_readers_wait_for_no_writer_and_see_no_partial_state(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    catalogue.publish(missions=[MISSION], layers=[a_layer()])
    with write_transaction(catalogue.engine) as connection:
        connection.execute(sa.text("DELETE FROM latest"))
        assert catalogue.layers() == [a_layer()]
    assert catalogue.layers() == []


def test_changed_images_change_the_version_of_a_mission(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    versions = [catalogue.images_version("MER2")]
    for images in ([an_image("1")], [an_image("1", sol=157)], [an_image("2")]):
        catalogue.publish(images=images)
        versions.append(catalogue.images_version("MER2"))
    assert len(set(versions)) == 4
    catalogue.publish(images=[an_image("2")])  # changes nothing
    assert catalogue.images_version("MER2") == versions[-1]


def test_names_sort_by_bytes_in_both_databases(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    names = ["a_1", "B1", "a-2", "A3", "ä"]
    catalogue.publish(images=[an_image(name) for name in names])
    assert [image.id for image in catalogue.images()] == ["A3", "B1", "a-2", "a_1", "ä"]


def test_pages_types_and_extent_of_layers_agree_in_both_databases(tmp_path, catalogue_url):
    catalogue = Catalogue.open(tmp_path, catalogue_url)
    assert catalogue.extent("MER2") is None
    named = {
        name: replace(
            a_layer(), ref=ProductRef(ProductKind.DTM, Scope(ScopeLevel.STOP, name), "a" * 16)
        )
        for name in (
            "mer2-site0001-drive0002",
            "mer2-site0001-drive0001",
            "mer2-site0002-drive0000",
        )
    }
    model, west, empty = named.values()
    layers = [
        replace(model, type="model"),
        replace(west, bounds=(-5.5, 1.0, 2.0, 3.0)),
        replace(empty, bounds=(0.0, 0.0, 0.0, 0.0)),
    ]
    catalogue.publish(layers=layers)
    assert catalogue.layers("MER2", types=("raster",)) == layers[1:]
    assert catalogue.layers("MER2", part=Part(2, 1)) == [layers[0], layers[2]]
    assert catalogue.layer_count("MER2", ("raster", "vector")) == 2
    assert catalogue.extent("MER2") == (-5.5, 0.0, 10.24, 10.24)


def test_a_connection_dropped_by_the_server_is_reopened(postgres, tmp_path):
    catalogue = Catalogue.open(tmp_path, postgres.database())
    catalogue.publish(missions=[MISSION])
    postgres.stop()
    with pytest.raises(sa.exc.OperationalError):
        catalogue.missions()
    postgres.start()
    assert catalogue.missions() == [MISSION]


def test_no_connection_is_left_to_the_garbage_collector(postgres, tmp_path):
    url = postgres.database()  # ours are distinguished by their names
    for number in range(20):
        Catalogue.open(tmp_path, f"{url}&application_name=ours{number}")
    gc.collect()  # an engine that was dropped would make this test fail by its ResourceWarning
    query = sa.text("SELECT count(*) FROM pg_stat_activity WHERE application_name LIKE 'ours%'")
    catalogue = Catalogue.open(tmp_path, url)

    def open_connections() -> int:
        with catalogue.engine.connect() as connection:
            return connection.scalar(query)

    assert open_connections() == 20
    close_pools()
    give_up = time.monotonic() + 30.0
    while open_connections() and time.monotonic() < give_up:
        time.sleep(0.05)  # a backend of the server takes a moment to end
    assert open_connections() == 0
    catalogue.engine.dispose()  # it was requested once more


def test_an_unreachable_database_is_named_without_its_password(tmp_path):
    url = "postgresql+psycopg://maps:secret@127.0.0.1:1/solmap"
    with pytest.raises(StoreAwayError, match="does not respond") as caught:
        Catalogue.open(tmp_path, url)
    assert "127.0.0.1:1/solmap" in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("somewhere", "cannot be used"),
        ("oracle://host/db", "cannot lie in oracle"),
        ("nosuch://host/db", "cannot be used"),
    ],
)
def test_an_invalid_database_url_is_refused_with_an_example(tmp_path, url, message):
    with pytest.raises(ProductError, match=message) as caught:
        Catalogue.open(tmp_path, url)
    assert "SOLMAP_CATALOGUE_URL=postgresql+psycopg://" in str(caught.value)


def test_a_command_on_an_unreachable_database_ends_with_one_line(tmp_path):
    (tmp_path / "store" / "products").mkdir(parents=True)
    requested = subprocess.run(
        (sys.executable, "-m", "solmap.flows.cli", "status", "--store", str(tmp_path / "store")),
        env={"PATH": "", "SOLMAP_CATALOGUE_URL": "postgresql+psycopg://x:y@127.0.0.1:1/z"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert requested.returncode == 1
    assert "does not respond" in requested.stderr
    assert "Traceback" not in requested.stderr
