"""Check a store: files against their provenance, the catalogue against the files, databases.

It finds

- products whose bytes are not those of their provenance, or that have none;
- files that are not products, provenance without a product, drafts without a process;
- rows of the catalogue that name a product which is not there, or by a name no path can hold;
- databases that SQLite finds damaged, documents that are not JSON.

Repairing removes broken products and withdraws missing ones, so that the next run makes them again.
Images cannot be made again: their files have to be delivered again. Delivered files are moved to
`broken` when only their provenance is lost.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import sqlalchemy as sa

from solmap.products.catalogue import edits, schema, tokens
from solmap.products.catalogue.database import (
    FINISHED,
    IMAGES,
    LATEST,
    LAYERS,
    explain_full_disk,
    write_transaction,
)
from solmap.products.catalogue.events import LAYERS_PUBLISHED, append
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import ProductKind
from solmap.products.store.faults import is_read_only
from solmap.products.store.product_store import provenance_name, write_chunks

_PROVENANCE = ".provenance.json"
_YOUNG_S = 3600.0
"""Age in seconds below which provenance and drafts may belong to an unfinished product."""
_AGAIN = "removed, the next run makes it again; delivered files have to be delivered again"
_BROKEN = "broken"
"""Folder of a store for delivered files without known provenance."""
_DELIVERED = {
    ProductKind.IMAGE,
    ProductKind.VECTORS,
    ProductKind.MANUAL_TIES,
    ProductKind.CONTROL_FILE,
    ProductKind.ORBITAL_IMAGE,
}
"""Kinds that solmap cannot make again."""
_PARTS = "standing", "layers", "pointers"
"""Lists of products in the document of a finished sol."""
_REFERENCES = "ref", "browse", "radiometry"
"""Products in the document of an image."""
_LEVELS = 4
"""Parts of a product's name: `products/KIND/SCOPE/FILE`."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of a part of a store."""

    text: str
    remedy: str
    """What was done about it, or has to be done."""
    is_repaired: bool = False

    def __str__(self) -> str:
        return f"{self.text}; {self.remedy}"


@dataclass(frozen=True, slots=True)
class _Fault:
    text: str
    remedy: str
    """Repairs made; without them, actions for the operator."""
    action: Callable[[], object] | None = None


def check(
    workspace: Workspace,
    *,
    repair: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Iterator[Finding]:
    """Check a store, and with `repair` repair what is possible; yields every finding.

    Checking may run beside other runs; repairing may not.

    Raises:
        StoreBusyError: others work on a store that is to be repaired.
        StoreReadOnlyError: nothing can be repaired there.
    """
    if repair:
        turn = workspace.maintenance_turn("repair it")
    elif is_read_only(workspace.store.root):
        turn = contextlib.nullcontext()
    else:
        turn = workspace.run_turn()
    with turn:
        for fault in _faults(workspace, repair, on_progress):
            if repair and fault.action is not None:
                fault.action()
                yield Finding(fault.text, fault.remedy, is_repaired=True)
            elif fault.action is not None:
                yield Finding(fault.text, "`solmap check --repair` repairs it")
            else:
                yield Finding(fault.text, fault.remedy)


def _faults(
    workspace: Workspace,
    is_alone: bool,  # noqa: FBT001 - a fact
    on_progress: Callable[[int, int], None],
) -> Iterator[_Fault]:
    yield from _faulty_databases(workspace)
    oldest = time.time() - (0.0 if is_alone else _YOUNG_S)
    yield from _faulty_files(workspace, oldest, on_progress)
    yield from _faulty_documents(workspace)
    yield from _left_drafts(workspace, oldest)
    yield from _faulty_rows(workspace)


def _faulty_databases(workspace: Workspace) -> Iterator[_Fault]:
    root, engine = workspace.store.root, workspace.catalogue.engine
    names = [schema.CATALOGUE] if engine.dialect.name == "sqlite" else []
    for name in (*names, edits.FILE, tokens.FILE):
        if os.access(root / name, os.R_OK):  # tokens belong to their owner
            answer = _integrity(root / name)
            if answer != "ok":
                yield _Fault(f"{name} is damaged: {answer}", "`solmap restore` a backup of it")


def _integrity(database: Path) -> str:
    try:
        with (
            explain_full_disk(database),
            closing(schema.database_reader(database)) as connection,
        ):
            return str(connection.execute("PRAGMA integrity_check(1)").fetchone()[0])
    except (sqlite3.Error, OSError) as error:
        return str(error)


def _faulty_files(
    workspace: Workspace, oldest: float, on_progress: Callable[[int, int], None]
) -> Iterator[_Fault]:
    names = set(workspace.store.backend.names("products"))
    for done, name in enumerate(sorted(names), 1):
        fault = _file_fault(name, workspace, names, oldest)
        if fault is not None:
            yield fault
        on_progress(done, len(names))


def _file_fault(name: str, workspace: Workspace, names: set[str], oldest: float) -> _Fault | None:
    backend, short = workspace.store.backend, name.partition("/")[2]
    remove = partial(_remove, name, workspace)
    product = _product_name(name)
    if product is None and provenance_name(name) in names:
        return _Fault(f"{short} is not in the place of a product", "removed", remove)
    if product is None:
        return _Fault(
            f"{short} is not a product", "it is left unchanged: remove it or move it elsewhere"
        )
    try:
        notes = json.loads(backend.read(provenance_name(name)) or b"")
        made_at, sha256 = datetime.fromisoformat(notes["made_at"]), str(notes["sha256"])
    except (ValueError, LookupError, TypeError):
        # pruned, or removed with its product, since it was listed
        is_gone = not backend.has(name)
        return None if is_gone else _fault_without_provenance(name, product, workspace)
    if name != product:
        is_lone = product not in names and made_at.timestamp() < oldest and not backend.has(product)
        return _Fault(f"{short} exists without its product", "removed", remove) if is_lone else None
    if _sha256(name, workspace) in (None, sha256):
        return None
    return _Fault(f"{short} is broken: its checksum differs from its provenance", _AGAIN, remove)


def _fault_without_provenance(name: str, product: str, workspace: Workspace) -> _Fault:
    what = f"{name.partition('/')[2]} has no readable provenance"
    if product.split("/")[1] not in _DELIVERED or not workspace.store.backend.has(product):
        return _Fault(what, _AGAIN, partial(_remove, name, workspace))
    kept = f"{_BROKEN}/{product.partition('/')[2]}"
    remedy = f"its product was moved to {kept}; deliver its file again"
    return _Fault(what, remedy, partial(_set_aside, product, kept, workspace))


def _remove(name: str, workspace: Workspace) -> None:
    """Remove a product with its provenance."""
    workspace.store.backend.remove(name)
    workspace.store.backend.remove(provenance_name(name))


def _set_aside(product: str, kept: str, workspace: Workspace) -> None:
    """Move a product out of the products, and remove the rest of its provenance."""
    backend, target = workspace.store.backend, workspace.store.root / kept
    target.parent.mkdir(parents=True, exist_ok=True)
    write_chunks(target, backend.chunks(product, 0, backend.size(product) or 0))
    _remove(product, workspace)


def _product_name(name: str) -> str | None:
    """The name of the product of a file or of its provenance, if any."""
    levels, kind = name.split("/"), name.split("/")[1]
    if len(levels) != _LEVELS or kind not in set(ProductKind):
        return None
    digest, _, rest = levels[-1].partition(".")
    suffix = ProductKind(kind).suffix
    is_ours = f".{rest}" in (suffix, _PROVENANCE)
    return "/".join([*levels[:-1], f"{digest}{suffix}"]) if is_ours else None


def _sha256(name: str, workspace: Workspace) -> str | None:
    """The checksum of a file; None where it has been removed meanwhile."""
    backend, digest = workspace.store.backend, hashlib.sha256()
    try:
        for chunk in backend.chunks(name, 0, backend.size(name) or 0):
            digest.update(chunk)
    except FileNotFoundError:
        return None
    return digest.hexdigest()


def _faulty_documents(workspace: Workspace) -> Iterator[_Fault]:
    backend = workspace.store.backend
    for name in backend.names("stac"):
        try:
            json.loads(backend.read(name) or b"{}")
        except ValueError as error:
            remedy = "removed, the next publication writes it again"
            yield _Fault(f"half of {name}: {error}", remedy, partial(backend.remove, name))


def _left_drafts(workspace: Workspace, oldest: float) -> Iterator[_Fault]:
    for folder in (workspace.store.root / "drafts").glob("*"):
        with contextlib.suppress(FileNotFoundError):  # completed meanwhile
            if folder.stat().st_mtime < oldest:
                action = partial(shutil.rmtree, folder, ignore_errors=True)
                yield _Fault(f"drafts/{folder.name} was left by a process", "removed", action)


@dataclass(slots=True)
class _Presence:
    """Which products exist in the store; each is checked once."""

    workspace: Workspace
    _known: dict[_Key, bool] = field(default_factory=dict)

    def has(self, key: _Key) -> bool:
        """Whether it exists, under a valid name."""
        if key not in self._known:
            has = self.workspace.store.backend.has
            self._known[key] = _is_sound(key) and has(_name_of(key))
        return self._known[key]


def _faulty_rows(workspace: Workspace) -> Iterator[_Fault]:
    """Rows that refer to missing products, or have an invalid name."""
    presence = _Presence(workspace)
    with workspace.catalogue.engine.connect() as connection:
        pointers = [_Key(*row) for row in connection.execute(sa.select(*_columns(LATEST)))]
        versions = [_Key(*row) for row in connection.execute(sa.select(*_columns(LAYERS)))]
        sols = connection.execute(sa.select(FINISHED.c.scope, FINISHED.c.document)).all()
        images = connection.execute(sa.select(IMAGES.c.id, IMAGES.c.document)).all()
    named = sorted({*pointers, *versions})
    if named and not any(True for _ in workspace.store.backend.names("products")):
        what = f"the catalogue lists {len(named)} products and the store has no file"
        yield _Fault(what, "mount its disk, or `solmap restore` a backup; no row was changed")
        return
    for key in named:
        if not presence.has(key):
            remedy = "withdrawn, the next run makes it again"
            what = f"{'/'.join(key)} is in the catalogue, but not in the store"
            yield _Fault(what, remedy, partial(_withdraw, key, workspace))
    for scope, document in sols:
        keys = [_key_of_text(text) for part in _PARTS for text in document.get(part, ())]
        if not all(key is not None and presence.has(key) for key in keys):
            remedy = "forgotten, the next run processes it again"
            action = partial(_delete, FINISHED, FINISHED.c.scope == scope, workspace)
            yield _Fault(
                f"products of the finished sol {scope} are not in the store", remedy, action
            )
    for name, document in images:
        yield from _faults_of_image(name, document, presence)


def _faults_of_image(name: str, document: dict[str, Any], presence: _Presence) -> Iterator[_Fault]:
    keys = [_key_of_reference(document[one]) for one in _REFERENCES if document.get(one)]
    if not all(map(_is_sound, keys)):
        action = partial(_delete, IMAGES, IMAGES.c.id == name, presence.workspace)
        yield _Fault(f"the name of image {name!r} is not a valid path", "forgotten", action)
        return
    for key in keys:
        if not presence.has(key):
            what = f"{'/'.join(key)} of image {name} is not in the store"
            yield _Fault(what, "`solmap run` a folder with its file again")


class _Key(NamedTuple):
    """Identifies a product in the catalogue."""

    kind: str
    scope: str
    digest: str


def _columns(table: sa.Table) -> list[sa.Column[str]]:
    return [table.c.kind, table.c.scope, table.c.digest]


def _key_of_text(text: str) -> _Key | None:
    parts = text.split("/")
    return _Key(parts[0], *parts[2:]) if len(parts) == _LEVELS else None


def _key_of_reference(reference: dict[str, Any]) -> _Key:
    return _Key(reference["kind"], reference["scope"]["name"], reference["digest"])


def _is_sound(key: _Key) -> bool:
    return (
        key.kind in set(ProductKind)
        and _product_name(_name_of(key)) is not None
        and (key.scope not in {"", ".", ".."} and key.scope.isprintable())
    )


def _name_of(key: _Key) -> str:
    suffix = ProductKind(key.kind).suffix if key.kind in set(ProductKind) else ""
    return f"products/{key.kind}/{key.scope}/{key.digest}{suffix}"


def _withdraw(key: _Key, workspace: Workspace) -> None:
    """Remove a product from the catalogue, in one transaction; browsers are notified."""
    of_layer, of_pointer = (
        sa.and_(*(one == value for one, value in zip(_columns(table), key, strict=True)))
        for table in (LAYERS, LATEST)
    )
    with write_transaction(workspace.catalogue.engine) as connection:
        mission = connection.execute(sa.select(LAYERS.c.mission).where(of_layer)).scalar()
        connection.execute(LAYERS.delete().where(of_layer))
        was_latest = connection.execute(LATEST.delete().where(of_pointer)).rowcount
        if mission is not None and was_latest:
            ids = [f"{key.scope}/{key.kind}"]
            append(connection, LAYERS_PUBLISHED, {"mission": mission, "layers": ids})


def _delete(table: sa.Table, rows: sa.ColumnElement[bool], workspace: Workspace) -> None:
    with write_transaction(workspace.catalogue.engine) as connection:
        connection.execute(table.delete().where(rows))
