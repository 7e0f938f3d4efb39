"""A store as large as a mission: stops, images and tie points without one image file."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from solmap.products.catalogue.catalogue import Catalogue, ImageEntry, MissionEntry
from solmap.products.crs import LandingPoint
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.products.store.product_store import ProductStore

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
REGION = Scope(ScopeLevel.REGION, "mer2")
FIRST = datetime(2004, 1, 4, tzinfo=UTC)
SOL = timedelta(seconds=88775.244)


def write_mission(
    root: Path, stops: int = 500, images: int = 10_000, tie_points: int = 150_000
) -> None:
    """Fill a store: a traverse of 14 m a stop with all its vector layers, published."""
    root.mkdir(parents=True, exist_ok=True)
    store, catalogue = ProductStore.open(root), Catalogue.open(root)
    rng = np.random.default_rng(7)
    steps = rng.normal((9.0, 9.0, 0.2), 3.0, (stops, 3))
    places = np.cumsum(steps, axis=0) - steps[0]
    names = [f"mer2-site{k // 100:04d}-drive{k % 100:04d}" for k in range(stops)]
    entries = [_image(k, names, images // stops) for k in range(images)]
    catalogue.publish(
        missions=[MissionEntry("MER2", "A long traverse", LANDING, None)], images=entries
    )
    layers = []
    of_image = [places[k // (images // stops)] for k in range(images)]
    for kind, features in (
        (ProductKind.TRAVERSE, _traverse(places)),
        (ProductKind.STOPS, _stops(places, names)),
        (ProductKind.POINTING, _lines(entries, of_image, rng)),
        (ProductKind.FOOTPRINTS, _outlines(entries, of_image, rng)),
        (ProductKind.TIE_POINTS, _ties(entries, of_image, tie_points, rng)),
    ):
        layers.append(_publish(kind, REGION, list(features), tuple(range(stops)), store))
    for k, name in enumerate(names):
        rings = list(_contours(places[k], rng))
        scope = Scope(ScopeLevel.STOP, name)
        layers.append(_publish(ProductKind.CONTOURS, scope, rings, (k,), store))
    catalogue.publish(layers=layers)


def _image(number: int, names: list[str], of_stop: int) -> ImageEntry:
    sol = number // of_stop
    name = f"2N{number:09d}EFF0000P0000L0M1"
    ref = ProductRef(ProductKind.IMAGE, Scope(ScopeLevel.IMAGE, name.lower()), "0" * 16)
    time = FIRST + sol * SOL + timedelta(minutes=number % of_stop)
    return ImageEntry(
        id=name,
        mission="MER2",
        stop=names[sol],
        site=sol // 100,
        drive=sol % 100,
        sol=sol,
        instrument="NAVCAM",
        eye="left",
        product_type="EDR",
        start_time=time.isoformat(),
        local_solar_time=None,
        partner=None,
        unpaired_because=None,
        ref=ref,
        browse=ref,
    )


def _publish(
    kind: ProductKind,
    scope: Scope,
    features: list[Feature],
    sols: tuple[int, ...],
    store: ProductStore,
) -> Layer:
    write: Callable[[Path], None] = lambda path: write_features(path, features, LANDING)  # noqa: E731
    ref = store.make(Recipe(kind, scope), write)
    boxes = np.array([feature.bounds for feature in features])
    bounds = (*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
    return Layer(ref, "MER2", str(kind), "vector", bounds, None, None, None, sols, "2026-01-01")


def _traverse(places: np.ndarray) -> Iterable[Feature]:
    for solution, shift in (("telemetry", 0.01), ("adjusted", 0.0)):
        line = places * (1.0 + shift)
        yield Feature("LineString", line, {"solution": solution, "stops": len(line)}, solution)


def _stops(places: np.ndarray, names: list[str]) -> Iterable[Feature]:
    for sol, (name, place) in enumerate(zip(names, places, strict=True)):
        known = {"stop": name, "site": sol // 100, "drive": sol % 100, "sols": [sol]}
        for solution, shift in (("telemetry", 0.01), ("adjusted", 0.0)):
            there = (place * (1.0 + shift))[None]
            yield Feature("Point", there, {**known, "solution": solution}, f"{name}-{solution}")


def _known(entry: ImageEntry) -> dict[str, object]:
    return {"image": entry.id, "sol": entry.sol, "stop": entry.stop, "instrument": "NAVCAM"}


def _lines(
    entries: list[ImageEntry], places: list[np.ndarray], rng: np.random.Generator
) -> Iterable[Feature]:
    for entry, place in zip(entries, places, strict=True):
        ends = np.vstack([place, place + rng.normal(0, 15, 3)])
        yield Feature("LineString", ends, _known(entry), entry.id)


def _outlines(
    entries: list[ImageEntry], places: list[np.ndarray], rng: np.random.Generator
) -> Iterable[Feature]:
    fan = np.linspace(0.0, 0.8, 24)
    for entry, place in zip(entries, places, strict=True):
        angle = fan + rng.uniform(0, 6.28)
        ring = place[:2] + 30.0 * np.column_stack([np.cos(angle), np.sin(angle)])
        yield Feature("Polygon", np.vstack([place[:2], ring]), _known(entry), entry.id)


def _ties(
    entries: list[ImageEntry], places: list[np.ndarray], count: int, rng: np.random.Generator
) -> Iterable[Feature]:
    for number in range(count):
        k = number * (len(entries) - 1) // count
        known = {
            "kind": "inter-stereo",
            "pairs": [entries[k].id, entries[k + 1].id],
            "residual_px": round(float(rng.rayleigh(0.3)), 3),
            "sigma_m": 0.05,
        }
        yield Feature("Point", places[k][None] + rng.normal(0, 12, (1, 3)), known, str(number))


def _contours(place: np.ndarray, rng: np.random.Generator) -> Iterable[Feature]:
    turn = np.linspace(0.0, 6.2, 60)
    for number in range(60):
        radius = rng.uniform(2.0, 40.0)
        line = place[:2] + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        yield Feature("LineString", line, {"elevation_m": number * 0.5, "is_index": False})
