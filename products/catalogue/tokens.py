"""Tokens and their roles, which permit writing.

A token is 256 random bits, shown once when it is made. Only its SHA-256 is stored, which is
sufficient for random secrets (passwords would need a slow hash), in a separate database,
`access.sqlite`, that only its owner may read.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from pathlib import Path

from solmap.products.catalogue.database import explain_full_disk, read_only_connection
from solmap.products.errors import ProductNotFoundError, StoreReadOnlyError
from solmap.products.store.faults import is_read_only, require_writable

FILE = "access.sqlite"
_PREFIX = "solmap"
_SCHEMA = """CREATE TABLE IF NOT EXISTS tokens(
    id TEXT PRIMARY KEY, name TEXT NOT NULL, role TEXT NOT NULL, hash TEXT NOT NULL,
    made_at TEXT NOT NULL, ends_at TEXT, revoked_at TEXT)"""


class Role(IntEnum):
    """What the owner of a token may do; each role includes those before it."""

    VIEWER = 1
    """View."""
    ANALYST = 2
    """Edit ties and annotations."""
    OPERATOR = 3
    """Start runs."""

    def __str__(self) -> str:
        return self.name.lower()

    @classmethod
    def of_name(cls, name: str) -> Role:
        """The role of a name in lower case."""
        return cls[name.upper()]


@dataclass(frozen=True, slots=True)
class Token:
    """A token without its secret."""

    id: str
    name: str
    """Its owner."""
    role: Role
    made_at: str
    """UTC, ISO 8601, as for all times."""
    ends_at: str | None = None
    revoked_at: str | None = None

    @property
    def is_valid(self) -> bool:
        """Whether it is accepted now."""
        return self.revoked_at is None and (self.ends_at is None or _now() < self.ends_at)


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of a store."""

    path: Path

    @classmethod
    def of(cls, root: Path) -> Tokens:
        """The tokens of the store at `root`; nothing is written before the first token."""
        return cls(root / FILE)

    def add(self, name: str, role: Role, days: int | None = None) -> tuple[Token, str]:
        """Make a token; returns it and its text with the secret, which is not stored."""
        number, secret = secrets.token_hex(4), secrets.token_urlsafe(32)
        ends = _now(timedelta(days=days)) if days is not None else None
        token = Token(number, name, role, _now(), ends)
        with self._connection() as connection:
            connection.execute(
                "INSERT INTO tokens VALUES(?,?,?,?,?,?,NULL)",
                (number, name, str(role), _hash(secret), token.made_at, ends),
            )
        return token, f"{_PREFIX}_{number}_{secret}"

    def tokens(self) -> list[Token]:
        """All, revoked ones too, in the order in which they were made."""
        if not self.path.is_file():
            return []
        with self._reading() as connection:
            rows = connection.execute(
                "SELECT id, name, role, made_at, ends_at, revoked_at FROM tokens ORDER BY rowid"
            )
            return [Token(a, b, Role.of_name(c), *times) for a, b, c, *times in rows]

    def revoke(self, number: str) -> Token:
        """Revoke a token.

        Raises:
            ProductNotFoundError: there is none with that number.
        """
        with self._connection() as connection:
            connection.execute(
                "UPDATE tokens SET revoked_at = ? WHERE id = ? AND revoked_at IS NULL",
                (_now(), number),
            )
        for token in self.tokens():
            if token.id == number:
                return token
        raise ProductNotFoundError(f"no token {number!r}; `solmap token list` shows all")

    def verify(self, text: str) -> Token | None:
        """The token of a text, if it is valid."""
        parts = text.split("_", 2)
        if len(parts) != 3 or parts[0] != _PREFIX or not os.access(self.path, os.R_OK):  # noqa: PLR2004
            return None
        with self._reading() as connection:
            row = connection.execute("SELECT hash FROM tokens WHERE id = ?", (parts[1],)).fetchone()
        if row is None or not hmac.compare_digest(row[0], _hash(parts[2])):
            return None
        same = (token for token in self.tokens() if token.id == parts[1] and token.is_valid)
        return next(same, None)

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """A connection for readers, also without write permission."""
        if not os.access(self.path, os.R_OK):
            raise StoreReadOnlyError(f"{self.path} cannot be read: it belongs to another user")
        if not is_read_only(self.path):
            with self._connection() as connection:
                yield connection
            return
        with closing(read_only_connection(self.path)) as connection:
            yield connection

    @contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        require_writable(self.path)
        if not self.path.exists():
            self.path.touch(mode=0o600)
        connection = sqlite3.connect(self.path, timeout=30.0)
        try:
            with explain_full_disk(self.path), connection:
                connection.execute(_SCHEMA)
                yield connection
        finally:
            connection.close()


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _now(later: timedelta = timedelta()) -> str:
    return (datetime.now(UTC) + later).isoformat(timespec="seconds")
