"""A store for tests of what can be seen: a dome over which the horizon is known in closed form.

The ground is z = -d^2 / 100 at distance d metres from the landing point. An eye at height h above
its top sees targets of height t as far as 10 (sqrt(h) + sqrt(t)) metres. A strip in the east was
not mapped. Tie points lie in a row, each with its own residual. A wall that no rover climbs runs
from west to east in the south.
"""

from __future__ import annotations

import math

import numpy as np

from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.raster.orthophoto import write_orthophoto
from solmap.products.formats.raster.raster import HAZARD_CLASSES, write_classes, write_dtm
from solmap.products.formats.vector.geojson import Feature
from solmap.products.model import ProductKind
from tests.support.bowl_store import CRS, GRID, LANDING, Shop, surface, viewing

STRIP = (20.0, 28.0)
"""East, metres: nothing is known between."""
RESIDUALS_PX = (0.01, 0.05, 0.2, 0.5, 2.0, 26.0, None)
TIE_SPACING_M = 5.0
TIE_NORTH_M = 8.0
WALL_NORTH_M = -10.0
WALL_HALF_M = (8.0, 0.5)
"""Half the wall's length, and half its width among the hazards."""
LOOKED_FROM = 3
"""The tie point at which a pointing line begins."""


def tie_place(number: int) -> tuple[float, float]:
    """East and north of a tie point."""
    return (number - 3) * TIE_SPACING_M, TIE_NORTH_M


def horizon_m(eye_m: float, target_m: float) -> float:
    """How far an eye above the top sees targets."""
    return 10.0 * (math.sqrt(eye_m) + math.sqrt(target_m))


def dome() -> Dtm:
    ground = -surface()
    east, _ = GRID.centres()
    ground[:, (east > STRIP[0]) & (east < STRIP[1])] = np.nan
    seen = np.isfinite(ground)
    sigma = np.where(seen, 0.02, np.nan).astype(np.float32)
    return Dtm(GRID, ground, sigma, np.where(seen, 3, 0).astype(np.float32), seen.astype(np.uint8))


def hazards() -> np.ndarray:
    """All is safe that is known, but for the wall."""
    east, north = GRID.centres()
    along, across = np.abs(east)[None, :], np.abs(north - WALL_NORTH_M)[:, None]
    wall = (along < WALL_HALF_M[0]) & (across < WALL_HALF_M[1])
    known = np.isfinite(dome().elevation)
    codes = np.where(wall, Hazard.STEP, np.where(known, Hazard.TRAVERSABLE, Hazard.UNKNOWN))
    return codes.astype(np.uint8)


def ties() -> list[Feature]:
    known = {"kind": "cross-site", "pairs": ["2N1400L0M1", "2N1401L0M1"], "sigma_m": 0.0312}
    return [
        Feature(
            "Point",
            np.array([[*tie_place(number), 0.0]]),
            {**known, "residual_px": residual},
            id=str(number),
        )
        for number, residual in enumerate(RESIDUALS_PX)
    ]


def fill(workspace: Workspace) -> None:
    shop, model = Shop(workspace), dome()
    mission = MissionEntry("MER2", "Spirit, Gusev crater", LANDING, "LSL starts at the lander.")
    entry = shop.image(0, "left", 0)
    workspace.catalogue.publish(missions=[mission], images=[entry])
    _, line = viewing(entry, 0, tie_place(LOOKED_FROM))
    shop.vectors(ProductKind.POINTING, [line])
    shop.raster(ProductKind.DTM, lambda path: write_dtm(path, model, CRS))
    shop.raster(
        ProductKind.HAZARD,
        lambda path: write_classes(
            path, GRID, hazards(), CRS, name="hazard", classes=HAZARD_CLASSES
        ),
    )
    grey = np.where(np.isfinite(model.elevation), 128.0, np.nan).astype(np.float32)
    shop.raster(
        ProductKind.ORTHOPHOTO,
        lambda path: write_orthophoto(path, GRID, grey, CRS, stretch=(0.0, 254.0)),
    )
    shop.vectors(ProductKind.TIE_POINTS, ties())
