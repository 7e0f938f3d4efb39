"""Back up a store in use, and restore stores from backups.

A backup folder contains the files of products once for all backups, and for each backup a dated
folder with a manifest, copies of the databases and the documents:

    DEST/products/KIND/SCOPE/FILE      as in the store; copied when DEST lacks them
    DEST/backups/20261123T012000Z/     manifest.json, catalogue.sqlite, edits.sqlite ...

The databases are copied first, each as a snapshot, and the products after them: all products in the
catalogue exist by then, and nothing is pruned meanwhile. The dated folder gets its name when it is
complete. The catalogue of a backup is SQLite even if that of the store is in PostgreSQL, so it can
be restored to either.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import SQLAlchemyError

from solmap.products.catalogue import edits, schema, tokens
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.catalogue.database import TABLES, engine_of, tables_of, write_transaction
from solmap.products.catalogue.events import EVENTS
from solmap.products.catalogue.turns import maintenance_turn
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreFullError
from solmap.products.store.backends import FolderBackend, ObjectStorage
from solmap.products.store.faults import is_disk_full, is_read_only, require_writable
from solmap.products.store.locks import try_lock
from solmap.products.store.product_store import ProductStore, provenance_name, write_chunks

BACKUPS, MANIFEST = "backups", "manifest.json"
_DRAFTS, _LOCK = "drafts", "backup.lock"
_PRODUCTS, _STAC = "products", "stac"
_FOLDERS = (_PRODUCTS, BACKUPS, _DRAFTS)
"""Subfolders of a backup."""
_OWN = (edits.FILE, tokens.FILE)
_INBOX = "inbox.json"
_PROVENANCE = ".provenance.json"
_BATCH = 1000
OnProgress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class BackupReport:
    """Result of a backup or restore."""

    folder: Path
    files: int
    copied: int
    """Number of files that were not in the target before."""
    broken: tuple[str, ...]
    """Files left out because their bytes do not match their checksum."""


def back_up(
    workspace: Workspace,
    destination: Path,
    keep: int | None = None,
    on_progress: OnProgress = lambda _done, _total: None,
) -> BackupReport:
    """Back up a store into a folder; keeps the newest `keep` backups, or all.

    Raises:
        ProductError: the folder cannot be used, or another backup is being made there.
        StoreFullError: its disk is full; earlier backups are unchanged.
    """
    root, target = workspace.store.root, destination.resolve()
    if target.is_relative_to(root) or root.is_relative_to(target):
        raise ProductError(f"{destination} and {root} contain each other; name another folder")
    if (target / schema.CATALOGUE).exists():
        raise ProductError(f"{destination} is a store; name another folder")
    is_ours = (target / _LOCK).exists() or any((target / BACKUPS).glob(f"*/{MANIFEST}"))
    if not is_ours and (taken := [one for one in _FOLDERS if (target / one).exists()]):
        raise ProductError(
            f"{target / taken[0]} does not belong to a backup, and backups would change it; name "
            "another folder"
        )
    with _explaining(target), _alone_in(target):
        with contextlib.nullcontext() if is_read_only(root) else workspace.run_turn():
            report = _back_up(workspace, target, on_progress)
        if keep is not None:
            _remove_older(target, keep)
    return report


def _back_up(workspace: Workspace, target: Path, on_progress: OnProgress) -> BackupReport:
    root, began = workspace.store.root, datetime.now(UTC)
    draft = target / _DRAFTS / "backup"
    draft.mkdir(parents=True)
    if (root / _INBOX).is_file():  # before the catalogue, which lists it as processed
        shutil.copyfile(root / _INBOX, draft / _INBOX)
    _copy_catalogue(workspace, draft / schema.CATALOGUE)
    for name in _OWN:
        if (root / name).is_file():
            if not os.access(root / name, os.R_OK):
                raise ProductError(f"{root / name} cannot be read: back up as its owner")
            schema.copy_database(root / name, draft / name)
    for name in workspace.store.backend.names(_STAC):
        (draft / name).parent.mkdir(parents=True, exist_ok=True)
        (draft / name).write_bytes(workspace.store.backend.read(name) or b"")
    files: dict[str, str] = {}
    broken: list[str] = []
    copied = 0
    names = [n for n in workspace.store.backend.names(_PRODUCTS) if not n.endswith(_PROVENANCE)]
    for done, name in enumerate(sorted(names), 1):
        taken = _take(name, workspace.store, target)
        if taken is None:
            broken.append(name)
        else:
            files |= taken.checksums
            copied += taken.is_new
        on_progress(done, len(names))
    others = sorted(one for one in draft.rglob("*") if one.is_file())
    manifest = {
        "schema": schema.version_of(root, workspace.catalogue.engine),
        "store": str(root),
        "at": began.isoformat(timespec="seconds"),
        "software": f"solmap {version('solmap')}",
        "own": {str(one.relative_to(draft)): _sha256(one) for one in others},
        "files": files,
    }
    with (draft / MANIFEST).open("w") as file:
        json.dump(manifest, file, indent=0)
        file.flush()
        os.fsync(file.fileno())
    folder = _dated(target / BACKUPS, began)
    folder.parent.mkdir(exist_ok=True)
    draft.replace(folder)
    return BackupReport(folder, len(files), copied, tuple(broken))


@dataclass(frozen=True, slots=True)
class _Taken:
    checksums: dict[str, str]
    is_new: bool


def _take(name: str, store: ProductStore, target: Path) -> _Taken | None:
    """Copy a product and its provenance to the backup folder; None where the product is broken."""
    notes = store.backend.read(provenance_name(name))
    size = store.backend.size(name)
    try:
        sha256 = str(json.loads(notes or b"")["sha256"])
    except (ValueError, LookupError, TypeError):
        return None
    draft, pool = target / _DRAFTS / "file", FolderBackend(target)
    has_it = size is not None and pool.size(name) == size
    if not has_it:
        if write_chunks(draft, store.backend.chunks(name, 0, size or 0)) != sha256:
            return None
        pool.put(draft, name, once=False)
    of_notes = write_chunks(draft, [notes or b""])
    if pool.read(provenance_name(name)) != notes:
        pool.put(draft, provenance_name(name), once=False)
    return _Taken({name: sha256, provenance_name(name): of_notes}, not has_it)


def _copy_catalogue(workspace: Workspace, target: Path) -> None:
    engine = workspace.catalogue.engine
    if engine.dialect.name == "sqlite":
        schema.copy_database(workspace.store.root / schema.CATALOGUE, target)
        return
    copy = engine_of(target)
    with (
        engine.connect().execution_options(isolation_level="REPEATABLE READ") as source,
        write_transaction(copy) as connection,
    ):
        TABLES.create_all(connection)
        _copy_rows(source, connection)
    copy.dispose()


def _copy_rows(source: sa.Connection, target: sa.Connection) -> None:
    known = sa.inspect(source).get_table_names()
    for table in TABLES.sorted_tables:
        target.execute(table.delete())
        if table.name not in known:
            continue
        rows = source.execution_options(yield_per=_BATCH).execute(sa.select(table))
        for some in rows.mappings().partitions(_BATCH):
            target.execute(table.insert(), [dict(row) for row in some])


def newest_backup(folder: Path) -> Path:
    """The folder of a backup: the one named, or the newest of a backup folder.

    Raises:
        ProductError: there is no complete one.
    """
    if (folder / MANIFEST).is_file():
        return folder
    whole = sorted(one.parent for one in (folder / BACKUPS).glob(f"*/{MANIFEST}"))
    if not whole:
        raise ProductError(f"{folder} has no backup; `solmap backup {folder}` makes one")
    return whole[-1]


def restore(
    backup: Path,
    root: Path,
    catalogue_url: str | None = None,
    object_storage: ObjectStorage | None = None,
    *,
    replace: bool = False,
    on_progress: OnProgress = lambda _done, _total: None,
) -> BackupReport:
    """Restore a backup into an empty store, or with `replace` over the content of a store.

    Every file is compared with its checksum. If the process is killed, the store cannot be opened
    until it is restored again. Products outside the backup remain, unreferenced. The previous
    SQLite databases are kept in `before-restore-TIME`, with edits and tokens newer than the backup.

    Raises:
        ProductError: there is no such backup, it is newer than this solmap or its databases are
            broken; or the store is not empty.
        StoreFullError: the disk is full; call it again.
    """
    folder, root = newest_backup(backup).resolve(), root.resolve()
    manifest = _read_manifest(folder)
    if not (replace or (root / schema.RESTORING).exists()) and _is_used(root, catalogue_url):
        raise ProductError(
            f"{root} or its catalogue is not empty; name an empty folder, or use --replace to "
            "replace its content by the backup"
        )
    root.mkdir(parents=True, exist_ok=True)
    require_writable(root)
    engine = engine_of(root / schema.CATALOGUE, catalogue_url)
    with _explaining(root), maintenance_turn(root, engine, "restore"):
        if not (root / schema.RESTORING).exists():
            prefix = f"{schema.SAFETY_COPIES}restore-"
            schema.keep_safety_copies(root, _dated(root, datetime.now(UTC), prefix).name)
        (root / schema.RESTORING).write_text(f"{folder}\n")
        store = ProductStore.open(root, object_storage)
        report = _restore_products(manifest["files"], folder, store, on_progress)
        for name in manifest["own"]:
            if name.startswith(f"{_STAC}/"):
                store.write_document(name, (folder / name).read_text(encoding="utf-8"))
        _restore_databases(folder, root, engine)
        schema.write_version(root, manifest["schema"])
        (root / schema.RESTORING).unlink()
    return report


def _read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a backup whose databases and documents are unchanged."""
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_bytes())
        is_newer = manifest["schema"] > schema.latest_version()
        own = (_STAC, *schema.DATABASES, _INBOX)
        unknown = [
            *(name for name in manifest["files"] if not _is_below(name, (_PRODUCTS,))),
            *(name for name in manifest["own"] if not _is_below(name, own)),
        ]
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ProductError(f"{folder / MANIFEST} is damaged; restore another backup") from error
    if is_newer:
        raise ProductError(
            f"{folder} has schema {manifest['schema']}, this solmap reads up to "
            f"{schema.latest_version()}: update solmap"
        )
    if unknown:  # a forged manifest could overwrite other files
        raise ProductError(
            f"{folder / MANIFEST} names {unknown[0][:60]!a}, which is not part of a backup; "
            "restore another"
        )
    for name, sha256 in manifest["own"].items():
        if not (folder / name).is_file() or _sha256(folder / name) != sha256:
            raise ProductError(
                f"{folder / name} has changed since the backup; restore another backup"
            )
    return manifest


def _is_below(name: str, first: Collection[str]) -> bool:
    """Whether a name is that of a file of a store, in one of some folders."""
    parts = name.split("/")
    return parts[0] in first and not {"", ".", ".."}.intersection(parts)


def _is_used(root: Path, catalogue_url: str | None) -> bool:
    """Whether a store, or its catalogue at a URL, holds anything already."""
    if any(one.is_file() and one.parent.name != "locks" for one in root.rglob("*")):
        return True
    return bool(catalogue_url) and bool(tables_of(engine_of(root, catalogue_url)))


def _restore_products(
    files: Mapping[str, str], folder: Path, store: ProductStore, on_progress: OnProgress
) -> BackupReport:
    broken: list[str] = []
    copied, pool = 0, FolderBackend(folder.parent.parent)
    # provenance before its product, as products are made
    order = sorted(files, key=lambda name: (provenance_name(name), not name.endswith(_PROVENANCE)))
    for done, name in enumerate(order, 1):
        size = pool.size(name)
        if size is None:
            broken.append(name)
        elif store.backend.size(name) != size or _sha256_in(store, name) != files[name]:
            is_whole = store.admit(name, pool.chunks(name, 0, size), files[name])
            copied += is_whole
            broken += [] if is_whole else [name]
        on_progress(done, len(files))
    return BackupReport(folder, len(files) - len(broken), copied, tuple(broken))


def _restore_databases(folder: Path, root: Path, engine: sa.Engine) -> None:
    for name in _OWN:
        if (folder / name).is_file():
            _overwrite_database(folder / name, root / name)
        else:
            _remove_database(root / name)
    if (folder / _INBOX).is_file():
        shutil.copyfile(folder / _INBOX, root / _INBOX)
    if engine.dialect.name == "sqlite":
        _overwrite_database(folder / schema.CATALOGUE, root / schema.CATALOGUE)
        return
    with tempfile.TemporaryDirectory() as migrated:
        schema.copy_database(folder / schema.CATALOGUE, Path(migrated) / schema.CATALOGUE)
        source = Catalogue.open(Path(migrated)).engine
        with source.connect() as rows, write_transaction(engine) as connection:
            TABLES.create_all(connection)
            _copy_rows(rows, connection)
            last = sa.func.coalesce(sa.func.max(EVENTS.c.id), 1)
            number = sa.func.pg_get_serial_sequence(EVENTS.name, EVENTS.c.id.name)
            connection.execute(sa.select(sa.func.setval(number, last)))
        source.dispose()


def _overwrite_database(source: Path, target: Path) -> None:
    """Replace a database by another, in one transaction of the processes that have it open."""
    try:
        schema.copy_database(source, target)
    except sqlite3.OperationalError:
        raise
    except sqlite3.DatabaseError:  # the existing one is damaged
        _remove_database(target)
        schema.copy_database(source, target)


def _remove_database(database: Path) -> None:
    """Remove a database with its log, which SQLite would add to another of that name."""
    for end in ("", "-wal", "-shm"):
        Path(f"{database}{end}").unlink(missing_ok=True)


def _remove_older(target: Path, keep: int) -> None:
    """Remove all but the newest backups, then the products that none of these contains."""
    whole = sorted(one.parent for one in (target / BACKUPS).glob(f"*/{MANIFEST}"))
    for folder in whole[:-keep]:
        gone = target / _DRAFTS / folder.name  # from now on not a backup, even if interrupted
        folder.replace(gone)
        shutil.rmtree(gone)
    named = {
        name
        for folder in whole[-keep:]
        for name in json.loads((folder / MANIFEST).read_bytes())["files"]
    }
    pool = FolderBackend(target)
    for name in list(pool.names(_PRODUCTS)):
        if name not in named:
            pool.remove(name)


@contextmanager
def _alone_in(target: Path) -> Iterator[None]:
    """Lock a folder for one backup, and remove what killed processes left there."""
    with try_lock(target / _LOCK) as is_alone:
        if not is_alone:
            raise ProductError(f"another backup is being made in {target}; wait for it to end")
        drafts = target / _DRAFTS
        shutil.rmtree(drafts, ignore_errors=True)
        drafts.mkdir()
        try:
            yield
        finally:
            shutil.rmtree(drafts, ignore_errors=True)


@contextmanager
def _explaining(target: Path) -> Iterator[None]:
    """Report in one line that a folder is full, or cannot be written."""
    try:
        yield
    except (OSError, sqlite3.Error, SQLAlchemyError) as error:
        there = next(one for one in (target, *target.parents) if one.exists())
        if is_disk_full(there, error):
            raise StoreFullError(
                f"the disk of {target} is full; free some space and repeat the command: finished "
                "files are kept"
            ) from error
        if isinstance(error, OSError):
            raise ProductError(f"{error.filename or target}: {error.strerror}") from error
        raise


def _dated(folder: Path, at: datetime, prefix: str = "") -> Path:
    """A name by time for a new folder, numbered within the same second."""
    name = f"{prefix}{at:%Y%m%dT%H%M%SZ}"
    names = (name, *(f"{name}-{number}" for number in range(2, 1000)))
    return next(folder / one for one in names if not (folder / one).exists())


def _sha256(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _sha256_in(store: ProductStore, name: str) -> str:
    digest = hashlib.sha256()
    for chunk in store.backend.chunks(name, 0, store.backend.size(name) or 0):
        digest.update(chunk)
    return digest.hexdigest()
