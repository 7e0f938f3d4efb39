"""On a full disk migration, backup, restoring and repair end clearly, lose nothing, and go on."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from solmap.products.catalogue.maintenance.backups import back_up, newest_backup, restore
from solmap.products.catalogue.maintenance.checking import check
from solmap.products.catalogue.maintenance.history import trim_history
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductError, StoreFullError
from tests.support.old_store import LAYERS, unpack_old_store
from tests.support.store_checks import Contents, faults

pytestmark = pytest.mark.slow


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 20 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no disk may be mounted here: it takes the rights of the super-user")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)  # noqa: S607


def fill(disk: Path, left: int) -> Path:
    """Fill a disk with a file up to so many bytes; the file."""
    file = disk / "ballast"
    with file.open("wb") as opened:
        while (free := shutil.disk_usage(disk).free) > left:
            opened.write(bytes(min(free - left, 1 << 20)))
            opened.flush()
    return file


@pytest.mark.parametrize("left", [0, 100_000])
def test_a_store_on_a_full_disk_is_migrated_when_there_is_space(disk, left):
    root = unpack_old_store(disk)
    before = Contents.of(root)
    ballast = fill(disk, left)
    with pytest.raises(StoreFullError, match=r"is full.*free some"):
        Workspace.open(root)
    ballast.unlink()
    assert before.differences(Contents.of(root)) == []
    assert len(Workspace.open(root).catalogue.layers()) == LAYERS
    assert faults(root) == []


def test_a_backup_to_a_full_disk_keeps_the_earlier_one_and_resumes(disk, tmp_path):
    root = unpack_old_store(tmp_path)
    workspace = Workspace.open(root)
    ballast = fill(disk, 2_000_000)
    with pytest.raises(StoreFullError, match=r"the disk of .*backups is full; free some space"):
        back_up(workspace, disk / "backups")
    with pytest.raises(ProductError, match="has no backup"):
        newest_backup(disk / "backups")
    ballast.unlink()
    first = back_up(workspace, disk / "backups")
    assert 0 < first.copied < first.files / 2  # what was there was not copied again
    fill(disk, 0)
    with pytest.raises(StoreFullError):
        back_up(workspace, disk / "backups")
    assert newest_backup(disk / "backups") == first.folder
    restore(disk / "backups", tmp_path / "new")
    assert faults(tmp_path / "new") == []


def test_restoring_to_a_full_disk_resumes_after_space_is_freed(disk, tmp_path):
    root = unpack_old_store(tmp_path)
    back_up(Workspace.open(root), tmp_path / "backups")
    ballast = fill(disk, 2_000_000)
    with pytest.raises(StoreFullError, match="is full"):
        restore(tmp_path / "backups", disk / "new")
    with pytest.raises(ProductError, match="was not restored completely"):
        Workspace.open(disk / "new")
    ballast.unlink()
    restore(tmp_path / "backups", disk / "new")
    assert faults(disk / "new") == []
    assert Contents.of(root).differences(Contents.of(disk / "new")) == []


def test_a_full_disk_is_checked_and_repaired(disk):
    root = unpack_old_store(disk)
    workspace = Workspace.open(root)
    next((root / "products" / "dtm").rglob("*.tif")).write_bytes(b"broken")
    ballast = fill(disk, 0)
    with pytest.raises(StoreFullError, match="is full"):
        list(check(workspace))
    with pytest.raises(StoreFullError, match="is full"):
        list(check(workspace, repair=True))
    ballast.unlink()
    assert "is broken" in str(list(check(workspace, repair=True)))
    trim_history(workspace, 90)
    assert faults(root) == []
