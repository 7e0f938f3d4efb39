"""What must hold of a store at every moment, and what two stores differ in.

`faults` is called after a process was killed. `Contents` is what a store holds without its dates,
so that two runs can be compared byte for byte.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from solmap.products.catalogue.maintenance.checking import check
from solmap.products.catalogue.workspace import Workspace

PROVENANCE = ".provenance.json"
DATES = {"at", "made_at", "created", "updated", "datetime_made"}
"""Keys of documents that give the time when something was made."""


@dataclass(frozen=True)
class Contents:
    """What a store holds."""

    products: dict[str, str]
    """Checksum of every product, by its path below the folder of products."""
    rows: dict[str, dict[str, Any]]
    """Documents of the catalogue without dates, by table and key."""

    @classmethod
    def of(cls, root: Path) -> Contents:
        """Those of the store at `root`."""
        folder = root / "products"
        products = {
            str(file.relative_to(folder)): _sha256(file)
            for file in sorted(folder.rglob("*"))
            if file.is_file() and not file.name.endswith(PROVENANCE)
        }
        return cls(products, dict(_rows(root)))

    def differences(self, other: Contents) -> list[str]:
        """What is lost, changed or more than once in another store, a line each."""
        lost = [f"lost {name}" for name in sorted(self.products.keys() - other.products.keys())]
        more = [f"doubled {name}" for name in sorted(other.products.keys() - self.products.keys())]
        both = self.products.keys() & other.products.keys()
        changed = [f"changed {n}" for n in sorted(both) if self.products[n] != other.products[n]]
        tables = [
            f"{table} differs in {key}"
            for table in sorted(self.rows.keys() | other.rows.keys())
            for key in sorted(self.rows[table].keys() | other.rows[table].keys())
            if self.rows[table].get(key) != other.rows[table].get(key)
        ]
        return [*lost, *more, *changed, *tables]


def faults(root: Path) -> list[str]:
    """What is wrong in the store at `root`, a line each, as `solmap check` finds it."""
    workspace = Workspace.open(root)
    try:
        return [str(finding) for finding in check(workspace)]
    finally:
        workspace.catalogue.engine.dispose()


def _rows(root: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    queries = {
        "missions": "SELECT mission, document FROM missions",
        "images": "SELECT id, document FROM images",
        "layers": "SELECT scope || '/' || kind || '/' || digest, document FROM layers",
        "latest": "SELECT scope || '/' || kind, digest FROM latest",
        "outcomes": "SELECT subject, document FROM outcomes",
    }
    with closing(sqlite3.connect(root / "catalogue.sqlite")) as database:
        for table, query in queries.items():
            rows = database.execute(query).fetchall()
            dated = table != "latest"
            yield table, {key: undated(json.loads(v)) if dated else v for key, v in rows}


def undated(value: Any) -> Any:
    """A document without its dates."""
    if isinstance(value, dict):
        return {key: undated(item) for key, item in value.items() if key not in DATES}
    return [undated(item) for item in value] if isinstance(value, list) else value


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
