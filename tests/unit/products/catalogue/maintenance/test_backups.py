"""Backups are whole, grow by what is new, and give back every byte."""

import errno
import hashlib
import json
import subprocess
import sys
import time
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest

from solmap.products.catalogue import schema
from solmap.products.catalogue.edits import EditLog, RequestKind, RunRequests
from solmap.products.catalogue.events import RUN_CHANGED
from solmap.products.catalogue.maintenance import backups
from solmap.products.catalogue.maintenance.backups import back_up, newest_backup, restore
from solmap.products.catalogue.maintenance.pruning import PruningParams, prune
from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreBusyError, StoreFullError
from solmap.products.model import ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.locks import shared_run_lock, try_lock
from tests.support.old_store import EDITS, LAYERS, unpack_old_store
from tests.support.store_checks import Contents, faults

STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0000")


def made(workspace: Workspace, number: int) -> ProductRef:
    recipe = Recipe(ProductKind.SLOPE, STOP, (), (number,))
    return workspace.store.make(recipe, lambda path: path.write_text(f"slope {number}"))


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    workspace = Workspace.open(tmp_path / "store")
    workspace.catalogue.publish(pointers=[made(workspace, number) for number in range(3)])
    return workspace


def test_a_restored_store_has_every_byte_row_edit_and_token(tmp_path):
    root = unpack_old_store(tmp_path)
    report = back_up(Workspace.open(root), tmp_path / "backups")
    assert report.broken == ()
    restore(tmp_path / "backups", tmp_path / "new")
    assert Contents.of(root).differences(Contents.of(tmp_path / "new")) == []
    workspace = Workspace.open(tmp_path / "new")
    assert len(workspace.catalogue.layers()) == LAYERS
    assert len(EditLog.of(tmp_path / "new").edits()) == EDITS
    assert Tokens.of(tmp_path / "new").verify((root / "token.txt").read_text())
    assert (tmp_path / "new" / "access.sqlite").stat().st_mode & 0o777 == 0o600
    stac = "stac/catalog.json"
    assert workspace.store.document(stac) == Workspace.open(root).store.document(stac)
    assert (tmp_path / "new" / "inbox.json").read_bytes() == (root / "inbox.json").read_bytes()
    assert faults(tmp_path / "new") == []


def test_a_second_backup_copies_new_files_and_old_ones_are_removed(workspace, tmp_path):
    assert back_up(workspace, tmp_path / "backups").copied == 3
    workspace.catalogue.publish(pointers=[made(workspace, 9)])
    prune(workspace, PruningParams(versions=1, youngest=timedelta(0)))
    second = back_up(workspace, tmp_path / "backups")
    assert second.copied == 1
    assert newest_backup(tmp_path / "backups") == second.folder
    products = tmp_path / "backups" / "products"
    assert len(list(products.rglob("*.tif"))) == 4
    back_up(workspace, tmp_path / "backups", keep=1)
    assert len(list((tmp_path / "backups" / "backups").iterdir())) == 1
    assert len(list(products.rglob("*.tif"))) == 1


def test_a_backup_permits_runs_and_refuses_pruning(workspace, tmp_path, monkeypatch):
    taken = backups._take
    seen = []

    def meanwhile(*arguments):
        if not seen:
            with shared_run_lock(workspace.store.root):
                workspace.catalogue.publish(pointers=[made(workspace, 20)])
            with pytest.raises(StoreBusyError, match="a backup"):
                prune(workspace, PruningParams())
        seen.append(1)
        return taken(*arguments)

    monkeypatch.setattr(backups, "_take", meanwhile)
    back_up(workspace, tmp_path / "backups")
    restore(tmp_path / "backups", tmp_path / "new")
    assert faults(tmp_path / "new") == []


def test_a_broken_product_is_named_and_left_out(workspace, tmp_path):
    path = workspace.store.path(made(workspace, 1))
    path.write_text("something else")
    report = back_up(workspace, tmp_path / "backups")
    assert [name.rpartition("/")[2] for name in report.broken] == [path.name]
    assert report.files == 4


def test_a_backup_with_lost_bytes_restores_the_rest_and_reports_it(workspace, tmp_path):
    back_up(workspace, tmp_path / "backups")
    victim = next((tmp_path / "backups" / "products").rglob("*.tif"))
    victim.write_text("slopes!")
    report = restore(tmp_path / "backups", tmp_path / "new")
    assert [Path(name).name for name in report.broken] == [victim.name]
    assert len(list((tmp_path / "new" / "products").rglob("*.tif"))) == 2


def test_a_backup_with_a_broken_database_is_refused(workspace, tmp_path):
    folder = back_up(workspace, tmp_path / "backups").folder
    (folder / schema.CATALOGUE).write_bytes(b"x")
    with pytest.raises(ProductError, match=r"catalogue.sqlite has changed since the backup"):
        restore(tmp_path / "backups", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_store_with_content_is_replaced_only_on_request(workspace, tmp_path):
    back_up(workspace, tmp_path / "backups")
    workspace.catalogue.append_event(RUN_CHANGED, {})
    with pytest.raises(ProductError, match="is not empty; name an empty folder, or use --replace"):
        restore(tmp_path / "backups", workspace.store.root)
    with shared_run_lock(workspace.store.root), pytest.raises(StoreBusyError, match="restore when"):
        restore(tmp_path / "backups", workspace.store.root, replace=True)
    (workspace.store.root / schema.CATALOGUE).write_bytes(b"damaged" * 1000)
    restore(tmp_path / "backups", workspace.store.root, replace=True)
    assert faults(workspace.store.root) == []


def test_a_replaced_store_is_kept_even_if_damaged(workspace, tmp_path):
    root = workspace.store.root
    back_up(workspace, tmp_path / "backups")
    RunRequests.of(root).add(RequestKind.OVERALL, "MER2", "ada")
    _, token = Tokens.of(root).add("later", Role.ANALYST)
    workspace.catalogue.engine.dispose()  # or its log would have the sound pages
    (root / schema.CATALOGUE).write_bytes(b"damaged" * 1000)
    restore(tmp_path / "backups", root, replace=True)
    restore(tmp_path / "backups", root, replace=True)
    first, second = sorted(root.glob("before-restore-*"))
    assert (first / schema.CATALOGUE).read_bytes() == b"damaged" * 1000
    assert len(RunRequests.of(first).requests()) == 1
    assert Tokens.of(first).verify(token)
    assert (first / "access.sqlite").stat().st_mode & 0o777 == 0o600
    assert {one.name for one in second.iterdir()} == {schema.CATALOGUE}
    restore(tmp_path / "backups", tmp_path / "new")
    assert not list((tmp_path / "new").glob("before-*"))


def test_an_incompletely_restored_store_cannot_be_opened(workspace, tmp_path, monkeypatch):
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    back_up(workspace, tmp_path / "backups")
    with monkeypatch.context() as patch:
        patch.setattr(backups, "_restore_databases", stop)
        with pytest.raises(KeyboardInterrupt):
            restore(tmp_path / "backups", tmp_path / "new")
    with pytest.raises(ProductError, match=r"was not restored completely: run `solmap restore "):
        Workspace.open(tmp_path / "new")
    restore(tmp_path / "backups", tmp_path / "new")
    assert faults(tmp_path / "new") == []


def test_backups_inside_the_store_are_refused(workspace, tmp_path):
    for wrong in (workspace.store.root / "backups", tmp_path):
        with pytest.raises(ProductError, match="contain each other"):
            back_up(workspace, wrong)
    with try_lock(tmp_path / "b" / "backup.lock"), pytest.raises(ProductError, match="another"):
        back_up(workspace, tmp_path / "b")
    with pytest.raises(ProductError, match="has no backup; `solmap backup"):
        restore(tmp_path / "b", tmp_path / "new")


def test_a_full_disk_ends_a_backup_and_keeps_the_earlier_ones(workspace, tmp_path, monkeypatch):
    first = back_up(workspace, tmp_path / "backups")
    made(workspace, 9)

    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(backups, "write_chunks", full)
        with pytest.raises(StoreFullError, match=r"the disk of .*backups is full; free some space"):
            back_up(workspace, tmp_path / "backups")
    assert newest_backup(tmp_path / "backups") == first.folder
    assert not (tmp_path / "backups" / "drafts").exists()


_BACK_UP = """
import sys
from pathlib import Path
from solmap.products.catalogue.maintenance.backups import back_up
from solmap.products.catalogue.workspace import Workspace
def progress(done, total):
    print(done, flush=True)
    sys.stdin.readline()
back_up(Workspace.open(Path(sys.argv[1])), Path(sys.argv[2]), None, progress)
"""


def test_an_interrupted_backup_is_never_listed(workspace, tmp_path):
    command = [sys.executable, "-c", _BACK_UP, str(workspace.store.root), str(tmp_path / "backups")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stdin=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "1\n"
        process.kill()
    with pytest.raises(ProductError, match="has no backup"):
        newest_backup(tmp_path / "backups")
    assert back_up(workspace, tmp_path / "backups").copied == 2  # the first was there
    restore(tmp_path / "backups", tmp_path / "new")
    assert faults(tmp_path / "new") == []


@pytest.mark.parametrize("target", ["SQLite", "PostgreSQL"])
def test_a_catalogue_in_postgresql_is_backed_up_and_moved(postgres, tmp_path, target):
    url = postgres.database()
    workspace = Workspace.open(tmp_path / "store", url)
    workspace.catalogue.publish(pointers=[made(workspace, number) for number in range(3)])
    for number in range(5):
        workspace.catalogue.append_event(RUN_CHANGED, {"number": number, "é": [0.1, None]})
    folder = back_up(workspace, tmp_path / "backups").folder
    with closing(schema.database_reader(folder / schema.CATALOGUE)) as copy:
        assert copy.execute("SELECT count(*) FROM events").fetchone() == (5,)
    to = postgres.database() if target == "PostgreSQL" else None
    restore(tmp_path / "backups", tmp_path / "new", to)
    restored = Workspace.open(tmp_path / "new", to)
    assert restored.catalogue.events_since(0) == workspace.catalogue.events_since(0)
    slope = ProductKind.SLOPE
    assert restored.catalogue.latest(STOP.name, slope) == workspace.catalogue.latest(
        STOP.name, slope
    )
    restored.catalogue.append_event(RUN_CHANGED, {})
    assert restored.catalogue.version() == 6
    with pytest.raises(ProductError, match="or its catalogue is not empty"):
        restore(tmp_path / "backups", tmp_path / "third", url)


def test_a_newer_backup_is_refused(workspace, tmp_path):
    folder = back_up(workspace, tmp_path / "backups").folder
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"schema": 9}))
    with pytest.raises(ProductError, match="has schema 9, this solmap reads up to 2: update"):
        restore(folder, tmp_path / "new")


def test_two_backups_within_a_second_have_separate_names(workspace, tmp_path):
    began = time.monotonic()
    names = {back_up(workspace, tmp_path / "backups").folder for _ in range(2)}
    assert len(names) == 2 or time.monotonic() - began > 1.0


@pytest.mark.parametrize("folder", ["drafts", "products", "backups"])
def test_a_folder_with_other_files_does_not_become_a_backup_folder(workspace, tmp_path, folder):
    mine = tmp_path / "papers" / folder / "thesis.txt"
    mine.parent.mkdir(parents=True)
    mine.write_text("years of work")
    with pytest.raises(ProductError, match=f"{folder} does not belong to a backup"):
        back_up(workspace, tmp_path / "papers", keep=1)
    assert mine.read_text() == "years of work"


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ("files", "products/../../outside"),
        ("files", "../outside"),
        ("files", "/outside"),
        ("files", "access.sqlite"),
        ("files", "prefect/password"),
        ("own", "stac/../../outside"),
        ("own", "schema"),
    ],
)
def test_a_backup_cannot_overwrite_other_files(workspace, tmp_path, part, name):
    report = back_up(workspace, tmp_path / "deep" / "backups")
    manifest = json.loads((report.folder / "manifest.json").read_text())
    given = (report.folder if part == "own" else tmp_path / "deep" / "backups") / name.lstrip("/")
    given.parent.mkdir(parents=True, exist_ok=True)
    given.write_text("given")
    manifest[part][name] = hashlib.sha256(b"given").hexdigest()
    (report.folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ProductError, match="which is not part of a backup"):
        restore(report.folder, tmp_path / "new")
    assert not (tmp_path / "outside").exists()
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"schema": "1", "own": {}, "files": {}}', "\xff"]
)
def test_a_backup_with_a_damaged_manifest_is_refused(workspace, tmp_path, text):
    report = back_up(workspace, tmp_path / "backups")
    (report.folder / "manifest.json").write_text(text, encoding="latin-1")
    with pytest.raises(ProductError, match=r"manifest\.json is damaged"):
        restore(tmp_path / "backups", tmp_path / "new")


def test_restoring_removes_the_write_ahead_log(workspace, tmp_path):
    back_up(workspace, tmp_path / "backups")
    Tokens.of(workspace.store.root).add("later", Role.ANALYST)
    log = workspace.store.root / "access.sqlite-wal"
    log.write_bytes(b"left by a process that was killed")
    restore(tmp_path / "backups", workspace.store.root, replace=True)
    assert not log.exists()
    assert not log.with_name("access.sqlite").exists()
