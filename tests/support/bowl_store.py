"""A store whose every value is known, for tests of the viewer.

The ground is a bowl: elevation z = d^2 / 100 at distance d metres from the landing point, so that
contours are circles and the elevation of every place is known in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import summarise, write_dtm, write_raster
from solmap.products.formats.vector.geojson import Feature, write_features
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
GALE = LandingPoint("Bradbury Landing", 137.4417, -4.5895, 3_391_000.0, "a test")
CRS = local_crs(LANDING)
GRID = MapGrid.covering((-40.0, -40.0, 40.0, 40.0), 0.08)
REGION = Scope(ScopeLevel.REGION, "mer2")
STOPS = (
    ("mer2-site0010-drive0064", 10, 64, (-18.0, -12.0), (-18.0, -12.0)),
    ("mer2-site0010-drive0102", 10, 102, (2.0, -3.0), (3.0, -4.2)),
    ("mer2-site0011-drive0000", 11, 0, (16.0, 14.0), (18.5, 12.0)),
)
"""Scope, site, drive, (east, north) by adjustment and by telemetry, metres."""
UNPAIRED = "its right image was never sent"
CONTOUR_RADIUS_M = 20.0


def elevation_at(east, north):
    return (east**2 + north**2) / 100.0


def surface() -> np.ndarray:
    east, north = GRID.centres()
    ground = elevation_at(east[None, :], north[:, None])
    ground[np.hypot(east[None, :], north[:, None]) > 38.0] = np.nan  # nothing was seen beyond
    return ground.astype(np.float32)


def slopes() -> np.ndarray:
    east, north = GRID.centres()
    steep = np.degrees(np.arctan(np.hypot(east[None, :], north[:, None]) / 50.0))
    return np.where(np.isfinite(surface()), steep, np.nan).astype(np.float32)


def dtm() -> Dtm:
    ground = surface()
    seen = np.isfinite(ground)
    sigma = np.where(seen, 0.02, np.nan).astype(np.float32)
    return Dtm(GRID, ground, sigma, np.where(seen, 3, 0).astype(np.float32), seen.astype(np.uint8))


def chequers() -> np.ndarray:
    """Squares of 4 m, dark and bright."""
    east, north = GRID.centres()
    odd = (np.floor(east / 4.0)[None, :] + np.floor(north / 4.0)[:, None]) % 2
    grey = np.where(odd, 170.0, 90.0)
    return np.where(np.isfinite(surface()), grey, np.nan).astype(np.float32)


def relief() -> np.ndarray:
    """Cosine of the sun's incidence, sun in the north-west 45 degrees high."""
    east, north = GRID.centres()
    east_slope, north_slope = east[None, :] / 50.0, north[:, None] / 50.0
    sun = np.array([-0.5, 0.5, math.sqrt(0.5)])
    shade = (-east_slope * sun[0] - north_slope * sun[1] + sun[2]) / np.sqrt(
        1.0 + east_slope**2 + north_slope**2
    )
    lit = np.clip(shade, 0.0, 1.0)
    return np.where(np.isfinite(surface()), lit, np.nan).astype(np.float32)


@dataclass(frozen=True)
class Shop:
    """Publishes into one store."""

    workspace: Workspace

    def raster(self, kind: ProductKind, write) -> None:
        self.show(self.workspace.store.make(Recipe(kind, REGION), write))

    def show(self, ref: ProductRef) -> None:
        """Publish a raster."""
        grid, bands = summarise(self.workspace.store.path(ref))
        facts = (grid.bounds, grid.cell_m, bands[0].unit or None, bands[0].range)
        self._publish(ref, "raster", *facts)

    def vectors(self, kind: ProductKind, features: list[Feature]) -> None:
        recipe = Recipe(kind, REGION)
        ref = self.workspace.store.make(
            recipe, lambda path: write_features(path, features, LANDING)
        )
        boxes = np.array([feature.bounds for feature in features])
        bounds = (*boxes[:, :2].min(axis=0).tolist(), *boxes[:, 2:].max(axis=0).tolist())
        self._publish(ref, "vector", bounds, None, None, None)

    def _publish(self, ref, type_, bounds, cell_m, unit, values) -> None:
        made_at = self.workspace.store.made_at(ref)
        layer = Layer(
            ref, "MER2", str(ref.kind), type_, bounds, cell_m, unit, values, (155, 156), made_at
        )
        self.workspace.catalogue.publish(layers=[layer])

    def image(self, stop: int, eye: str, look: int) -> ImageEntry:
        scope_name, site, drive, *_ = STOPS[stop]
        store = self.workspace.store
        name = f"2n{1400 + stop}0000{look}effa000p1600{eye[0]}0m1"
        scope = Scope(ScopeLevel.IMAGE, name)
        grey = np.tile(np.linspace(40 + 30 * look, 220, 256, dtype=np.uint8), (256, 1))
        body = cv2.imencode(".png", grey)[1].tobytes()
        original = store.make(Recipe(ProductKind.IMAGE, scope), lambda path: _keep(path, b"label"))
        browse = store.make(Recipe(ProductKind.BROWSE, scope), lambda path: _keep(path, body))
        paired = look != 2
        other = f"2n{1400 + stop}0000{look}effa000p1600{'r' if eye == 'left' else 'l'}0m1"
        return ImageEntry(
            id=name.upper(),
            mission="MER2",
            stop=scope_name,
            site=site,
            drive=drive,
            sol=155 + stop // 2,
            instrument="NAVCAM",
            eye=eye,
            product_type="EDR",
            start_time="2004-06-11T10:00:00Z",
            local_solar_time="12:10:05",
            partner=other.upper() if paired else None,
            unpaired_because=None if paired else UNPAIRED,
            ref=original,
            browse=browse,
        )


def _keep(path: Path, body: bytes) -> None:
    path.write_bytes(body)


def azimuth_of(look: int) -> float:
    return math.radians(30.0 + 120.0 * look)


def viewing(entry: ImageEntry, look: int, at: tuple[float, float]) -> tuple[Feature, Feature]:
    """Footprint and pointing line: a wedge of 40 degrees from 2 to 12 m."""
    east, north = at
    turn = np.radians([-20.0, 0.0, 20.0]) + azimuth_of(look)
    near = np.column_stack([east + 2 * np.sin(turn), north + 2 * np.cos(turn)])
    far = np.column_stack([east + 12 * np.sin(turn), north + 12 * np.cos(turn)])[::-1]
    facts = {
        "image": entry.id,
        "instrument": entry.instrument,
        "eye": entry.eye,
        "sol": entry.sol,
        "stop": entry.stop,
        "partner": entry.partner,
        "unpaired_because": entry.unpaired_because,
    }
    line = np.array([[east, north], far[1]])
    ring = np.vstack([near, far])
    return Feature("Polygon", ring, facts, entry.id), Feature("LineString", line, facts, entry.id)


def stop_features() -> Iterator[Feature]:
    for index, (name, site, drive, adjusted, telemetry) in enumerate(STOPS):
        moved = math.dist(adjusted, telemetry)
        known = {"stop": name, "site": site, "drive": drive, "sols": [155], "moved_m": moved}
        sure = {
            "held": index == 0,
            "sigma_north_m": 0.03 * index,
            "sigma_east_m": 0.05 * index,
            "ellipse_semi_major_m": 0.06 * index,
            "ellipse_semi_minor_m": 0.02 * index,
            "ellipse_azimuth_deg": 60.0,
        }
        yield Feature("Point", on_ground(telemetry), {**known, "solution": "telemetry"})
        yield Feature("Point", on_ground(adjusted), {**known, **sure, "solution": "adjusted"})


def on_ground(place: tuple[float, float]) -> np.ndarray:
    """One point: east, north and up."""
    return np.array([[*place, elevation_at(*place)]])


def contours() -> Iterator[Feature]:
    turn = np.linspace(0.0, 2 * math.pi, 181)
    for step in range(1, 13):
        radius = math.sqrt(100.0 * step)
        ring = np.column_stack([radius * np.sin(turn), radius * np.cos(turn)])
        yield Feature("LineString", ring, {"elevation_m": float(step), "is_index": step % 4 == 0})


def fill(workspace: Workspace) -> None:
    shop = Shop(workspace)
    entries, outlines, lines = [], [], []
    for stop, (_, _, _, adjusted, _) in enumerate(STOPS):
        for look in range(3):
            for eye in ("left", "right")[: 1 if look == 2 else 2]:
                entry = shop.image(stop, eye, look)
                outline, line = viewing(entry, look, adjusted)
                entries.append(entry)
                outlines.append(outline)
                lines.append(line)
    mission = MissionEntry("MER2", "Spirit, Gusev crater", LANDING, "LSL starts at the lander.")
    other = MissionEntry("MSL", "Curiosity, Gale crater", GALE, None)
    workspace.catalogue.publish(missions=[mission, other], images=entries)
    shop.raster(ProductKind.DTM, lambda path: write_dtm(path, dtm(), CRS))
    shop.raster(
        ProductKind.ORTHOPHOTO,
        lambda path: write_orthophoto(path, GRID, chequers(), CRS, stretch=(0.0, 254.0)),
    )
    for kind, band, unit in (
        (ProductKind.SLOPE, slopes(), "degree"),
        (ProductKind.HILLSHADE, relief(), ""),
    ):
        shop.raster(
            kind,
            lambda path, kind=kind, band=band, unit=unit: write_raster(
                path, GRID, {str(kind): band}, CRS, unit=unit
            ),
        )
    shop.vectors(ProductKind.CONTOURS, list(contours()))
    shop.vectors(ProductKind.STOPS, list(stop_features()))
    shop.vectors(ProductKind.FOOTPRINTS, outlines)
    shop.vectors(ProductKind.POINTING, lines)
    ways = {"adjusted": [s[3] for s in STOPS], "telemetry": [s[4] for s in STOPS]}
    shop.vectors(
        ProductKind.TRAVERSE,
        [Feature("LineString", np.array(way), {"solution": name}) for name, way in ways.items()],
    )
