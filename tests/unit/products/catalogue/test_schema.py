"""Stores have a version: older ones are migrated, once and whole, and newer ones are refused."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa

from solmap.products.catalogue import schema
from solmap.products.catalogue.edits import EditLog, RunRequests
from solmap.products.catalogue.runs import RunRecords
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreBusyError, StoreFullError
from solmap.products.store.locks import shared_run_lock
from tests.support.old_store import EDITS, EVENTS, IMAGES, LAYERS, unpack_old_store
from tests.support.store_checks import Contents, faults


@pytest.fixture
def old_store(tmp_path: Path) -> Path:
    return unpack_old_store(tmp_path)


def test_an_old_store_opens_after_migration_with_all_its_content(old_store):
    before = Contents.of(old_store)
    workspace = Workspace.open(old_store)
    assert before.differences(Contents.of(old_store)) == []
    assert len(workspace.catalogue.layers()) == LAYERS
    assert len(workspace.catalogue.images()) == IMAGES
    assert len(EditLog.of(old_store).edits()) == EDITS
    assert workspace.catalogue.version() == EVENTS
    assert len(RunRequests.of(old_store).waiting()) == 1
    assert len(RunRecords(workspace.catalogue.engine).runs()) == 2
    token = Tokens.of(old_store).verify((old_store / "token.txt").read_text())
    assert token is not None
    assert token.role is Role.ANALYST
    assert schema.version_of(old_store, workspace.catalogue.engine) == schema.latest_version()
    assert {one.name for one in (old_store / "before-schema-2").iterdir()} == set(schema.DATABASES)
    assert faults(old_store) == []


def test_a_store_is_migrated_once(old_store, monkeypatch):
    calls = []
    monkeypatch.setattr(schema, "MIGRATIONS", [lambda *_: calls.append(1)])
    Workspace.open(old_store)
    Workspace.open(old_store)
    assert calls == [1]


def test_a_new_store_has_the_latest_version_and_no_copies(tmp_path):
    workspace = Workspace.open(tmp_path / "store")
    assert (
        schema.version_of(tmp_path / "store", workspace.catalogue.engine) == schema.latest_version()
    )
    assert (tmp_path / "store" / "schema").read_text() == f"{schema.latest_version()}\n"
    assert not list((tmp_path / "store").glob("before-schema-*"))


def test_a_folder_of_another_machine_has_the_version_of_its_catalogue(tmp_path):
    engine = Workspace.open(tmp_path / "store").catalogue.engine
    other = tmp_path / "other"
    other.mkdir()
    schema.prepare(other, engine)
    Tokens.of(other).add("Ada", Role.ANALYST)  # as in a store of an earlier version
    with shared_run_lock(other):
        schema.prepare(other, engine)
    assert schema.version_of(other, engine) == schema.latest_version()


@pytest.mark.parametrize("where", ["folder", "catalogue"])
def test_a_newer_store_is_refused(tmp_path, where):
    root = tmp_path / "store"
    workspace = Workspace.open(root)
    if where == "folder":
        schema.write_version(root, 7)
    else:
        with workspace.catalogue.engine.begin() as connection:
            connection.execute(schema.STEPS.insert().values(version=7, at="2030"))
    with pytest.raises(ProductError, match="has schema 7, this solmap reads up to 2: update"):
        Workspace.open(root)


def test_an_old_store_is_not_migrated_during_a_run(old_store, monkeypatch):
    monkeypatch.setattr(schema, "_WAIT_S", 0.3)
    with shared_run_lock(old_store), pytest.raises(StoreBusyError, match="when it has ended"):
        Workspace.open(old_store)
    assert not (old_store / schema.FILE).exists()
    Workspace.open(old_store)


def test_migrations_continue_after_a_failed_one(old_store, monkeypatch):
    done = []

    def first(_root: Path, connection: sa.Connection) -> None:
        connection.exec_driver_sql("CREATE TABLE first(x)")
        done.append("first")

    def broken(_root: Path, connection: sa.Connection) -> None:
        connection.exec_driver_sql("CREATE TABLE second(x)")
        raise KeyboardInterrupt

    monkeypatch.setattr(schema, "MIGRATIONS", [first, broken])
    with pytest.raises(KeyboardInterrupt):
        Workspace.open(old_store)
    with closing(sqlite3.connect(old_store / schema.CATALOGUE)) as database:
        tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master")}
    assert "first" in tables
    assert "second" not in tables
    monkeypatch.setattr(schema, "MIGRATIONS", [first, lambda *_: done.append("second")])
    Workspace.open(old_store)
    assert done == ["first", "second"]


_OPEN = """
import sys, time
from pathlib import Path
from solmap.products.catalogue import schema
from solmap.products.catalogue.workspace import Workspace
add = schema.MIGRATIONS[0]
def slowly(root, connection):
    add(root, connection)
    (root / "migrating").touch()
    time.sleep(60)
if sys.argv[2] == "slowly":
    schema.MIGRATIONS[0] = slowly
Workspace.open(Path(sys.argv[1]))
"""


def test_a_migration_of_a_killed_process_is_completed_by_the_next(old_store):
    before = Contents.of(old_store)
    process = subprocess.Popen([sys.executable, "-c", _OPEN, str(old_store), "slowly"])
    while not (old_store / "migrating").exists():
        assert process.poll() is None
        time.sleep(0.02)
    waiting = subprocess.Popen([sys.executable, "-c", _OPEN, str(old_store), "at once"])
    time.sleep(0.3)
    assert waiting.poll() is None
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert waiting.wait(60) == 0
    assert (
        schema.version_of(old_store, Workspace.open(old_store).catalogue.engine)
        == schema.latest_version()
    )
    assert before.differences(Contents.of(old_store)) == []


def test_without_space_for_copies_nothing_is_changed(old_store, monkeypatch):
    def full(_source: Path, _target: Path) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(schema, "copy_database", full)
        with pytest.raises(StoreFullError, match=r"disk of .* is full.* nothing was changed"):
            Workspace.open(old_store)
    assert not (old_store / schema.FILE).exists()
    assert not list(old_store.glob("before-schema-*"))
    assert len(Workspace.open(old_store).catalogue.layers()) == LAYERS


def test_a_catalogue_in_postgresql_is_migrated_too(postgres, tmp_path):
    url, root = postgres.database(), tmp_path / "store"
    engine = Workspace.open(root, url).catalogue.engine
    with engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE schema_steps")
        connection.exec_driver_sql("DROP TABLE ingested")
    (root / schema.FILE).unlink()
    engine = Workspace.open(root, url).catalogue.engine
    assert schema.version_of(root, engine) == schema.latest_version()
    assert "ingested" in sa.inspect(engine).get_table_names()


def test_a_damaged_catalogue_is_named(tmp_path):
    root = tmp_path / "store"
    root.mkdir()
    (root / schema.CATALOGUE).write_bytes(b"no database at all" * 100)
    with pytest.raises(ProductError, match=r"catalogue.sqlite is damaged .*`solmap restore`"):
        Workspace.open(root)


def test_a_url_without_a_port_is_refused_without_printing_a_password(tmp_path):
    with pytest.raises(ProductError, match="port in the catalogue's URL is not a number") as caught:
        Workspace.open(tmp_path, "postgresql+psycopg://user@host:secret/database")
    assert "secret" not in str(caught.value)
    assert caught.value.__cause__ is None


def test_a_catalogue_whose_file_cannot_be_opened_is_named_in_one_line(tmp_path):
    file = tmp_path / "nowhere" / "catalogue.sqlite"
    with pytest.raises(ProductError, match=f"the catalogue {file} cannot be opened") as caught:
        Workspace.open(tmp_path / "store", f"sqlite:///{file}")
    assert "\n" not in str(caught.value)
