"""The password and the database of a store's engine."""

import errno
import sqlite3
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

import pytest

from solmap.flows.runtime import engine
from solmap.flows.runtime.engine import SCHEMA, make_database, password_file
from tests.support.engine_schema import made_by_prefect


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


def _tables(database: Path) -> int:
    with closing(sqlite3.connect(database)) as connection:
        return connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]


@pytest.fixture
def _own_database(monkeypatch):
    monkeypatch.delenv("PREFECT_API_DATABASE_CONNECTION_URL", raising=False)


@pytest.mark.usefixtures("_own_database")
def test_the_tables_of_the_installed_version_are_made_at_once(tmp_path):
    make_database(tmp_path / "prefect.db")
    assert [path.name for path in tmp_path.iterdir()] == ["prefect.db"]
    assert _tables(tmp_path / "prefect.db") > 100


@pytest.mark.usefixtures("_own_database")
def test_a_database_that_exists_is_left_as_it_is(tmp_path):
    (tmp_path / "prefect.db").write_text("runs")
    make_database(tmp_path / "prefect.db")
    assert (tmp_path / "prefect.db").read_text() == "runs"


@pytest.mark.usefixtures("_own_database")
def test_tables_of_another_version_are_left_to_its_server(tmp_path, monkeypatch):
    other = tmp_path / "other.sql"
    other.write_text(SCHEMA.read_text().replace(version("prefect"), "3.0.0", 1))
    monkeypatch.setattr(engine, "SCHEMA", other)
    make_database(tmp_path / "prefect.db")
    assert not (tmp_path / "prefect.db").exists()


def test_no_tables_are_made_where_another_database_is_set(tmp_path, monkeypatch):
    monkeypatch.setenv("PREFECT_API_DATABASE_CONNECTION_URL", "postgresql+asyncpg://elsewhere/runs")
    make_database(tmp_path / "prefect.db")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_tables_are_those_that_the_server_makes(tmp_path):
    assert _lines(SCHEMA.read_text()) == _lines(made_by_prefect(tmp_path))


def _lines(schema: str) -> list[str]:
    """Its lines; migrations make indices and constraints in any order."""
    return sorted(line.strip(" \t,") for line in schema.splitlines())
