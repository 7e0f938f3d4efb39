"""What must hold of a store at every moment, and what two stores differ in.

`faults` is asked after a process was killed: every product is whole, its provenance beside it with
the checksum of its bytes, every pointer of the catalogue leads to a file. `Contents` is what a
store holds without its dates, so that two runs can be compared byte for byte.
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

from solmap.products.model import ProductKind

PROVENANCE = ".provenance.json"
DATES = {"at", "made_at", "created", "updated", "datetime_made"}
"""Keys of documents that tell when something was made."""


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
    """What is wrong in the store at `root`, a line each."""
    found = list(_faulty_products(root / "products"))
    for file in sorted(root.rglob("*.sqlite")):
        if "prefect" not in file.parts:
            with closing(sqlite3.connect(file)) as database:
                answer = database.execute("PRAGMA integrity_check").fetchone()[0]
            found += [] if answer == "ok" else [f"{file.name}: {answer}"]
    found += [f"{what} is in the catalogue and not in the store" for what in _missing(root)]
    for file in (root / "stac").rglob("*.json"):
        try:
            json.loads(file.read_bytes())
        except ValueError as error:
            found.append(f"half of {file.relative_to(root)}: {error}")
    return found


def _faulty_products(folder: Path) -> Iterator[str]:
    for file in sorted(folder.rglob("*")):
        if not file.is_file():
            continue
        name = str(file.relative_to(folder))
        digest = file.name.split(".")[0]
        provenance = file.with_name(f"{digest}{PROVENANCE}")
        try:
            told = json.loads(provenance.read_bytes())
        except (OSError, ValueError) as error:
            yield f"half of {name}: no provenance, {error}"
            continue
        kind = ProductKind(name.split("/", maxsplit=1)[0])
        if file != provenance and file.name != digest + ProductKind(kind).suffix:
            yield f"{name} is no product"
        elif file != provenance and _sha256(file) != told["sha256"]:
            yield f"half of {name}: its checksum is not that of its provenance"


def _missing(root: Path) -> Iterator[str]:
    """Products that the catalogue names and the store lacks."""
    if not (root / "catalogue.sqlite").is_file():
        return
    with closing(sqlite3.connect(root / "catalogue.sqlite")) as database:
        tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master")}
        if not {"latest", "layers", "images"} <= tables:
            return
        named = list(database.execute("SELECT kind, scope, digest FROM latest"))
        named += database.execute("SELECT kind, scope, digest FROM layers")
        for (text,) in database.execute("SELECT document FROM images"):
            document = json.loads(text)
            refs = (document["ref"], document["browse"], document.get("radiometry"))
            named += [(r["kind"], r["scope"]["name"], r["digest"]) for r in refs if r]
    for kind, scope, digest in named:
        path = f"{kind}/{scope}/{digest}{ProductKind(kind).suffix}"
        if not (root / "products" / path).is_file():
            yield path


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
