"""Folders are brought up to date and archives replaced; what an export did not write stays."""

import hashlib
import os
import subprocess
import zipfile

import pytest

from solmap.products.errors import ProductError
from solmap.products.export.writing import (
    SUMS,
    ExportFile,
    Written,
    check_target,
    write_archive,
    write_folder,
)
from solmap.products.model import ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

SCOPE = Scope(ScopeLevel.REGION, "mer2")


@pytest.fixture
def store(tmp_path):
    return ProductStore.open(tmp_path / "store")


def product(store, text):
    recipe = Recipe(ProductKind.PLACES, SCOPE, params=(text,))
    return store.make(recipe, lambda path: path.write_text(text))


def files_of(texts, store):
    """Files of an export by name, each a product."""
    return [ExportFile.of(name, product(store, text), store) for name, text in texts.items()]


def found_in(folder):
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != SUMS
    }


def test_a_second_export_writes_only_what_changed(store, tmp_path):
    target = tmp_path / "out"
    first = {"README.md": "a", "maps/one.csv": "b", "old/two.csv": "c"}
    assert write_folder(target, files_of(first, store), store) == Written(3, 0, 0)
    (target / "mine.txt").write_text("a note")
    stamps = {name: (target / name).stat().st_mtime_ns for name in first}
    second = {"README.md": "a", "maps/one.csv": "B", "new.csv": "d"}
    assert write_folder(target, files_of(second, store), store) == Written(2, 1, 1)
    assert found_in(target) == second | {"mine.txt": "a note"}
    assert (target / "README.md").stat().st_mtime_ns == stamps["README.md"]
    assert not (target / "old").exists()
    assert write_folder(target, files_of(second, store), store) == Written(0, 3, 0)


def test_the_list_of_checksums_is_read_by_sha256sum(store, tmp_path):
    write_folder(tmp_path / "out", files_of({"a b.csv": "a", "maps/b.csv": "b"}, store), store)
    done = subprocess.run(
        ["/usr/bin/sha256sum", "--check", SUMS], cwd=tmp_path / "out", check=False
    )
    assert done.returncode == 0


def test_a_changed_file_is_written_again(store, tmp_path):
    files = files_of({"a.csv": "a", "b.csv": "b"}, store)
    write_folder(tmp_path / "out", files, store)
    changed = tmp_path / "out" / "a.csv"
    changed.write_text("x")
    later = (tmp_path / "out" / SUMS).stat().st_mtime + 10
    os.utime(changed, (later, later))
    assert write_folder(tmp_path / "out", files, store) == Written(1, 1, 0)
    assert changed.read_text() == "a"


def test_an_interrupted_export_is_completed_by_the_next(store, tmp_path):
    target = tmp_path / "out"
    first = {"a.csv": "a", "b.csv": "b"}
    write_folder(target, files_of(first, store), store)
    second = files_of({"a.csv": "A", "b.csv": "B"}, store)
    broken = ExportFile(second[1].name, second[1].source, hashlib.sha256(b"other").hexdigest())
    with pytest.raises(ProductError, match=r"b\.csv: the product in the store is broken"):
        write_folder(target, [second[0], broken], store)
    assert found_in(target) == {"a.csv": "A", "b.csv": "b"}
    assert write_folder(target, files_of(first, store), store) == Written(2, 0, 0)
    assert found_in(target) == first


def test_names_of_a_forged_list_reach_no_other_file(store, tmp_path):
    target, outside = tmp_path / "out", tmp_path / "keep.txt"
    outside.write_text("mine")
    target.mkdir()
    (target / SUMS).write_text(f"{'0' * 64}  ../keep.txt\n")
    write_folder(target, files_of({"a.csv": "a"}, store), store)
    assert outside.read_text() == "mine"


def test_an_archive_is_replaced_only_by_a_complete_and_different_one(store, tmp_path):
    target, files = tmp_path / "out.zip", files_of({"a.csv": "a", "maps/b.tif": "b"}, store)
    assert write_archive(target, files, store) == Written(2, 0, 0)
    with zipfile.ZipFile(target) as archive:
        assert archive.testzip() is None
        assert set(archive.namelist()) == {"out/a.csv", "out/maps/b.tif", f"out/{SUMS}"}
        assert archive.read("out/maps/b.tif") == b"b"
    before = target.read_bytes()
    assert write_archive(target, files, store) == Written(0, 2, 0)
    broken = ExportFile("a.csv", files[0].source, "0" * 64)
    with pytest.raises(ProductError, match="broken"):
        write_archive(target, [broken], store)
    assert target.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.zip", "store"]


def test_equal_files_give_equal_archives(store, tmp_path):
    files = files_of({"a.csv": "a", "b.csv": "b"}, store)
    write_archive(tmp_path / "one" / "out.zip", files, store)
    write_archive(tmp_path / "two" / "out.zip", files[::-1], store)
    assert (tmp_path / "one/out.zip").read_bytes() == (tmp_path / "two/out.zip").read_bytes()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("store/out", "is in the store"),
        ("full", "contains files and no earlier export"),
        ("file.txt", "is a file"),
        ("folder.zip", "is a folder"),
    ],
)
def test_other_files_are_never_overwritten(store, tmp_path, name, content):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("x")
    (tmp_path / "file.txt").write_text("x")
    (tmp_path / "folder.zip").mkdir()
    with pytest.raises(ProductError, match=content):
        check_target(tmp_path / name, store)
