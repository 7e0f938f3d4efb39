"""How long tiles and downloads take out of an object store, beside those of local files.

python -m tests.support.object_latency STORE [--tiles 200]: the store's latest terrain models,
orthophotos and hillshades are put into an S3 server on this machine; two servers of maps answer the
same questions, first with nothing open, then again.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import sqlite3
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.formats.raster.tiling import zoom_of
from solmap.products.model import Layer, ProductKind, Recipe, Scope, ScopeLevel
from solmap.products.store.backends import ObjectStorage
from solmap.products.store.product_store import ProductStore
from tests.support.live_server import Server, running
from tests.support.object_store import (
    ObjectStore,
    environment,
    environment_of,
    forget_copies,
    running_object_store,
)
from tests.support.tile_at import tile_at
from tests.support.tile_load import cpu_seconds, load

KINDS = (ProductKind.DTM, ProductKind.ORTHOPHOTO, ProductKind.HILLSHADE)
_SERVE = (
    "import sys, pathlib, uvicorn; from solmap.gis_server.app import create_app; "
    "uvicorn.run(create_app(pathlib.Path(sys.argv[1])), port=int(sys.argv[2]), log_level='error')"
)


def tile_paths(layers: Sequence[Layer], count: int, rng: np.random.Generator) -> list[str]:
    """Tiles anywhere on some rasters, at their own zoom and the three coarser ones."""
    paths = []
    for number in range(count):
        layer = layers[number % len(layers)]
        west, south, east, north = layer.bounds
        assert layer.cell_m is not None
        zoom = zoom_of(layer.cell_m) - int(rng.integers(4))
        at = tile_at(rng.uniform(west, east), rng.uniform(south, north), zoom)
        place = f"{layer.ref.scope.name}/{layer.ref.kind}/{layer.ref.digest}"
        paths.append(f"/tiles/{place}/{zoom}/{at.column}/{at.row}.png")
    return paths


def copied(root: Path, folder: Path, layers: Sequence[Layer], url: str) -> Path:
    """The store with its catalogue here and some of its rasters in the object store."""
    there = folder / "there"
    store = ProductStore.open(there, ObjectStorage(url))
    with (
        contextlib.closing(sqlite3.connect(root / "catalogue.sqlite")) as source,
        contextlib.closing(sqlite3.connect(there / "catalogue.sqlite")) as target,
    ):
        source.backup(target)
    for layer in layers:
        draft = store.root / "drafts" / "copy"
        name = f"products/{layer.ref.file_name}"
        shutil.copyfile(root / name, draft)
        store.backend.put(draft, name, once=True)
    forget_copies(there)
    return there


def measure(root: Path, paths: Sequence[str], objects: ObjectStore) -> Iterator[dict[str, object]]:
    """Figures of a server with nothing open, and then of the same questions again."""
    with running([sys.executable, "-c", _SERVE, str(root)]) as server:
        for turn in ("first", "again"):
            requested, spent = len(objects.requests), cpu_seconds(objects.pid)
            figures = load(server.port, server.pid, paths).figures
            yield {
                "turn": turn,
                **figures,
                "requests/tile": round((len(objects.requests) - requested) / len(paths), 2),
                "cpu ms/tile of the S3 server": round(
                    1e3 * (cpu_seconds(objects.pid) - spent) / len(paths), 2
                ),
            }
        yield {"turn": "download", **_download(server, paths[0])}


def making(store: ProductStore, count: int = 200) -> dict[str, object]:
    """What it costs to keep a product of 100 kB, and to find that one is there."""
    scope, body = Scope(ScopeLevel.IMAGE, "trial"), b"x" * 100_000
    recipes = [Recipe(ProductKind.BROWSE, scope, params=(n,)) for n in range(count)]
    figures: dict[str, object] = {"turn": "make"}
    for name in ("make", "find"):
        spent, started = time.process_time(), time.perf_counter()
        for recipe in recipes:
            store.make(recipe, lambda path: _keep(path, body))
        figures[f"ms to {name}"] = round(1e3 * (time.perf_counter() - started) / count, 2)
        figures[f"cpu ms to {name}"] = round(1e3 * (time.process_time() - spent) / count, 2)
    return figures


def _keep(path: Path, body: bytes) -> None:
    path.write_bytes(body)


def _download(server: Server, tile: str) -> dict[str, object]:
    """A whole raster."""
    _, _, scope, kind, digest, *_ = tile.split("/")
    before, started = cpu_seconds(server.pid), time.perf_counter()
    found = load(server.port, server.pid, [f"/download/{scope}/{kind}/{digest}"] * 3)
    seconds = time.perf_counter() - started
    return {
        "MB": round(found.size / 3e6, 1),
        "MB/s": round(found.size / 1e6 / seconds),
        "cpu ms/MB": round(1e9 * (cpu_seconds(server.pid) - before) / found.size, 2),
    }


def main() -> None:
    """Print a line for every server and turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("--tiles", type=int, default=200)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        here = folder / "here"
        here.mkdir()
        for part in given.store.glob("catalogue.sqlite*"):
            shutil.copyfile(part, here / part.name)
        (here / "products").symlink_to(given.store.resolve() / "products")
        layers = [layer for layer in Catalogue.open(here).layers() if layer.ref.kind in KINDS]
        paths = tile_paths(layers, given.tiles, np.random.default_rng(9))
        with (
            running_object_store(folder) as objects,
            environment(**environment_of(objects.address)),
        ):
            there = copied(here, folder, layers, objects.bucket("maps"))
            trials = (
                ProductStore.open(folder / "trial"),
                ProductStore.open(folder / "trial there", ObjectStorage(objects.bucket("trial"))),
            )
            for place, root, trial in zip(
                ("folder", "object store"), (here, there), trials, strict=True
            ):
                rows = [*measure(root, paths, objects), making(trial)]
                for row in rows:
                    print(json.dumps({"from": place, **row}))  # noqa: T201


if __name__ == "__main__":
    main()
