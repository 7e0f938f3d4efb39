"""The password of a store's engine."""

import errno
from pathlib import Path

import pytest

from solmap.flows.runtime.engine import password_file


def test_a_password_is_made_once_and_readable_by_its_owner_only(tmp_path):
    file = password_file(tmp_path)
    secret = file.read_text()
    assert secret.startswith("solmap:")
    assert len(secret) > 40
    file.chmod(0o644)
    assert password_file(tmp_path).read_text() == secret
    assert file.stat().st_mode & 0o777 == 0o600
    assert list(file.parent.iterdir()) == [file]


def test_an_empty_password_is_replaced(tmp_path):
    file = password_file(tmp_path)
    file.write_text("")
    assert len(password_file(tmp_path).read_text()) > 40


@pytest.mark.parametrize("number", [errno.EPERM, errno.EOPNOTSUPP])
def test_a_password_is_made_on_a_file_system_without_hard_links(tmp_path, monkeypatch, number):
    def refuse(*_: object) -> None:
        raise OSError(number, "no hard links here")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    file = password_file(tmp_path)
    secret = file.read_text()
    assert len(secret) > 40
    assert file.stat().st_mode & 0o777 == 0o600
    assert password_file(tmp_path).read_text() == secret
    assert list(file.parent.iterdir()) == [file]


def test_a_password_made_first_by_another_process_is_used(tmp_path, monkeypatch):
    def be_late(path: Path, _draft: str) -> None:
        path.write_text("solmap:first")
        raise OSError(errno.EPERM, "no hard links here")

    monkeypatch.setattr(Path, "hardlink_to", be_late)
    assert password_file(tmp_path).read_text() == "solmap:first"
