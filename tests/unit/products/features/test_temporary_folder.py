"""Where the index of a store lies that may only be read."""

import tempfile
from pathlib import Path

import pytest

from solmap.products.features.mission_features import temporary_folder


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_the_temporary_folder_is_stable_and_closed_to_others(temporary):
    folder = temporary_folder(Path("/srv/store"))
    assert folder == temporary_folder(Path("/srv/store"))
    assert folder != temporary_folder(Path("/srv/other"))
    assert folder.parent == temporary
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_writable_by_others_or_a_link_is_not_used():
    folder = temporary_folder(Path("/srv/store"))
    folder.chmod(0o777)
    other = temporary_folder(Path("/srv/store"))
    assert other != folder
    assert other.stat().st_mode & 0o777 == 0o700
    folder.rmdir()
    folder.symlink_to(other)
    assert temporary_folder(Path("/srv/store")) not in {folder, other}
