"""Sols that are finished: what each was made from, so that a run need not walk over them again.

A mission of years has thousands of sols, of which a downlink changes the last. The key of a sol
names all that its processing reads; while it is the same, so is the outcome.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from solmap.products.catalogue.database import upsert, writing
from solmap.products.catalogue.tables import FINISHED


@dataclass(frozen=True, slots=True, eq=False)
class FinishedBook:
    """The finished sols in the catalogue's database."""

    engine: sa.Engine

    def known(self, scope: str, key: str) -> dict[str, Any] | None:
        """What was noted of a sol when it was processed from what `key` names."""
        query = sa.select(FINISHED.c.document).where(
            FINISHED.c.scope == scope, FINISHED.c.key == key
        )
        with self.engine.connect() as connection:
            return connection.execute(query).scalar_one_or_none()

    def note(self, scope: str, key: str, document: dict[str, Any]) -> None:
        """Note that a sol is finished, instead of what was noted before."""
        with writing(self.engine) as connection:
            upsert(connection, FINISHED, {"scope": scope}, {"key": key, "document": document})

    def forget(self, first: str, of: str) -> None:
        """Forget the sols from the scope `first` on, of those whose names begin with `of`."""
        later = (FINISHED.c.scope >= first) & FINISHED.c.scope.startswith(of, autoescape=True)
        with writing(self.engine) as connection:
            connection.execute(FINISHED.delete().where(later))
