"""What `solmap check` finds in a store, and what it repairs."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.database import FINISHED, LATEST
from solmap.products.catalogue.maintenance.checking import Finding, check
from solmap.products.catalogue.maintenance.pruning import (
    PruningParams,
    prune,
    unreferenced_products,
)
from solmap.products.catalogue.runs import FinishedSolRecords
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import StoreBusyError
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.locks import shared_run_lock

STOP = Scope(ScopeLevel.STOP, "mer2-site0010-drive0000")
NOW = PruningParams(versions=1, youngest=timedelta(0))


def made(workspace: Workspace, kind: ProductKind, scope: Scope = STOP, number: int = 0):
    recipe = Recipe(kind, scope, (), (number,))
    return workspace.store.make(recipe, lambda path: path.write_text(f"{kind} {number}"))


def image(workspace: Workspace, name: str) -> ImageEntry:
    scope = Scope(ScopeLevel.IMAGE, name.lower())
    refs = made(workspace, ProductKind.IMAGE, scope), made(workspace, ProductKind.BROWSE, scope)
    where = ("MER2", STOP.name, 10, 0, 155, "navcam", "left", "EFF", None, None, None, None)
    return ImageEntry(name, *where, *refs)


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    workspace = Workspace.open(tmp_path / "store")
    dtm, network = made(workspace, ProductKind.DTM), made(workspace, ProductKind.MATCHES)
    layer = Layer(dtm, "MER2", "A map", "raster", (0, 0, 1, 1), 1.0, None, None, (155,), "2026")
    workspace.catalogue.publish(
        layers=[layer], pointers=[network], images=[image(workspace, "2N1")]
    )
    document = {"standing": [network.text], "layers": [dtm.text], "pointers": []}
    FinishedSolRecords(workspace.catalogue.engine).note("mer2-sol0155", "key", document)
    return workspace


def path_of(workspace: Workspace, kind: ProductKind) -> Path:
    return next((workspace.store.root / "products" / kind).rglob(f"*{kind.suffix}"))


def notes_of(path: Path) -> Path:
    return path.with_name(f"{path.name.split('.')[0]}.provenance.json")


def texts(findings: list[Finding]) -> str:
    return "\n".join(map(str, findings))


def repaired(workspace: Workspace) -> str:
    """Findings of a repair; after it nothing repairable remains."""
    assert not any(one.is_repaired for one in check(workspace))
    found = list(check(workspace, repair=True))
    assert not any(one.is_repaired for one in check(workspace, repair=True))
    return texts(found)


def test_an_intact_store_has_no_faults(workspace):
    steps = []
    assert list(check(workspace, on_progress=lambda *step: steps.append(step))) == []
    assert steps[-1] == (8, 8)
    assert list(check(workspace, repair=True)) == []


def test_a_broken_product_is_removed_from_store_and_catalogue(workspace):
    seen = workspace.catalogue.version()
    path_of(workspace, ProductKind.DTM).write_text("bits that rotted")
    assert "is broken: its checksum differs from its provenance; `solmap check" in texts(
        list(check(workspace))
    )
    message = repaired(workspace)
    assert "removed, the next run makes it again" in message
    assert "withdrawn, the next run makes it again" in message
    assert "products of the finished sol mer2-sol0155 are not in the store; forgotten" in message
    assert workspace.catalogue.layers() == []
    assert workspace.catalogue.events_since(seen)[0].document["layers"] == [f"{STOP}/dtm"]
    with workspace.catalogue.engine.connect() as connection:
        assert connection.execute(sa.select(FINISHED)).all() == []
    assert made(workspace, ProductKind.DTM)
    assert list(check(workspace)) == []


def test_a_lost_product_is_withdrawn(workspace):
    path_of(workspace, ProductKind.MATCHES).unlink()
    assert "matches/mer2-site0010-drive0000/" in repaired(workspace)
    assert workspace.catalogue.pointers(ProductKind.MATCHES) == []
    assert len(workspace.catalogue.layers()) == 1


def test_a_store_whose_disk_is_not_mounted_loses_no_row(workspace):
    products = workspace.store.root / "products"
    products.rename(away := products.with_name("away"))
    found = texts(list(check(workspace, repair=True)))
    assert "the catalogue lists 2 products and the store has no file; mount its disk" in found
    away.rename(products)
    assert list(check(workspace)) == []


def test_a_lost_image_must_be_delivered_again(workspace):
    path_of(workspace, ProductKind.IMAGE).unlink()
    assert "image 2N1 is not in the store; `solmap run` a folder" in repaired(workspace)
    assert len(workspace.catalogue.images()) == 1
    image(workspace, "2N1")
    assert list(check(workspace)) == []


@pytest.mark.parametrize("notes", [None, b"{", b"[]", b'{"made_at": 7}', b"\xff\xfe"])
def test_a_product_of_unknown_origin_stops_neither_pruning_nor_checking(workspace, notes):
    path = path_of(workspace, ProductKind.DTM)
    if notes is None:
        notes_of(path).unlink()
    else:
        notes_of(path).write_bytes(notes)
    assert unreferenced_products(workspace, NOW) == []
    assert "has no readable provenance" in repaired(workspace)
    assert not path.exists()


@pytest.mark.parametrize("notes", [None, "{"])
@pytest.mark.parametrize("kind", [ProductKind.IMAGE, ProductKind.VECTORS])
def test_a_delivered_file_of_unknown_origin_is_moved_and_not_removed(workspace, kind, notes):
    if kind is ProductKind.VECTORS:
        made(workspace, kind)
    path = path_of(workspace, kind)
    notes_of(path).unlink() if notes is None else notes_of(path).write_text(notes)
    message, name = repaired(workspace), path.relative_to(workspace.store.root / "products")
    assert f"its product was moved to broken/{name}; deliver its file again" in message
    assert (workspace.store.root / "broken" / name).read_text() == f"{kind} 0"
    assert not path.exists()
    assert not notes_of(path).exists()


def test_provenance_without_a_product_is_removed_when_no_run_can_be_making_it(workspace):
    path = path_of(workspace, ProductKind.DTM)
    twin = notes_of(path).with_name("0123456789abcdef.provenance.json")
    twin.write_bytes(notes_of(path).read_bytes())
    assert list(check(workspace)) == []
    document = json.loads(twin.read_bytes())
    yesterday = (datetime.now(UTC) - timedelta(days=1)).isoformat(timespec="seconds")
    twin.write_text(json.dumps(document | {"made_at": yesterday}))
    assert "exists without its product" in repaired(workspace)
    assert not twin.exists()


def test_drafts_are_removed_when_no_process_can_be_writing_them(workspace):
    draft = workspace.store.root / "drafts" / "another-machine-7-abc"
    draft.mkdir()
    assert list(check(workspace)) == []
    assert "was left by a process; removed" in repaired(workspace)
    assert not draft.exists()


def test_unknown_files_are_named_and_kept(workspace):
    for name in ("dtm/note.txt", "dtm/stop/.dtm.tif.swp", "cellar/stop/1.tif", "loose"):
        file = workspace.store.root / "products" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("mine")
    message = repaired(workspace)
    assert message.count("is not a product; it is left unchanged") == 4
    assert (workspace.store.root / "products" / "loose").exists()
    prune(workspace, NOW)


@pytest.mark.parametrize("name", ["/.", "/..", "a/b", "..", "/", "\x1b[31m"])
def test_unusual_names_in_a_store_stop_neither_pruning_nor_checking(workspace, name):
    workspace.catalogue.publish(images=[image(workspace, name)])
    odd = Scope(ScopeLevel.STOP, name.lower())
    workspace.catalogue.publish(pointers=[made(workspace, ProductKind.TIES, odd)])
    finished = FinishedSolRecords(workspace.catalogue.engine)
    finished.note("mer2-sol0156", "key", {"standing": [f"ties/stop/{name}/0"], "layers": ["x"]})
    prune(workspace, NOW)
    assert "is not a valid path" in repaired(workspace)
    assert [one.id for one in workspace.catalogue.images()] == ["2N1"]
    assert list(check(workspace)) == []
    prune(workspace, NOW)
    assert len(workspace.catalogue.layers()) == 1


def test_rows_of_unknown_kinds_are_withdrawn(workspace):
    with workspace.catalogue.engine.begin() as connection:
        row = {"scope": "s", "kind": "crystal-ball", "digest": "0" * 16}
        connection.execute(LATEST.insert().values(**row))
    prune(workspace, NOW)
    assert "crystal-ball/s/0000000000000000 is in the catalogue" in repaired(workspace)


def test_damaged_databases_are_named(workspace):
    (workspace.store.root / "edits.sqlite").write_bytes(b"no database" * 1000)
    assert "edits.sqlite is damaged: file is not a database; `solmap restore`" in repaired(
        workspace
    )


def test_incomplete_documents_are_removed(workspace):
    workspace.store.write_document("stac/catalog.json", '{"half": ')
    assert "half of stac/catalog.json" in repaired(workspace)
    assert workspace.store.document("stac/catalog.json") is None


def test_a_store_is_checked_during_runs_and_repaired_exclusively(workspace):
    with shared_run_lock(workspace.store.root):
        assert list(check(workspace)) == []
        with pytest.raises(StoreBusyError, match="repair it when it has ended"):
            list(check(workspace, repair=True))
