"""Localise: differences of telemetry to the adjusted traverse, and the traverse for other tools.

After every adjustment: a table of accumulated differences with the vertical profile (JSON), the
same as a figure (SVG, PNG), lines, stops and error ellipses (GeoPackage), a PLACES table, and site
and rover vector files with the adjusted solution. Sites keep the offsets of telemetry; rovers have
their adjusted positions in them, so both files together give the adjusted stop in the LSL.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedStop
from solmap.photogrammetry.archive.tables.places import PlacedStop, places_text
from solmap.photogrammetry.archive.tables.vector_files import Solution, VectorFile, vector_text
from solmap.photogrammetry.frames import LSL, FrameKind, Pose, site_frame
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.traverse.differences import Difference, differences
from solmap.products.catalogue.catalogue import Catalogue
from solmap.products.crs import LandingPoint, lon_lat
from solmap.products.formats.documents.archives import finite, pose_document
from solmap.products.formats.documents.network import (
    NetworkProduct,
    cached_whole_network,
    traverses,
)
from solmap.products.formats.vector.geojson import Feature, FeatureCollection
from solmap.products.formats.vector.geopackage import write_geopackage
from solmap.products.model import (
    ProductKind,
    ProductRef,
    Recipe,
    Scope,
    ScopeLevel,
    mission_of,
)
from solmap.products.reports.network_figures import SIGMAS, png, svg, traverse_figure
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.telemetry import Telemetry
from solmap.tasks.mission.vectors import stop_features, traverse_features
from solmap.tasks.scopes import region_scope
from solmap.tasks.stage import stage

KINDS = (
    ProductKind.PLACES,
    ProductKind.SITE_VECTORS,
    ProductKind.ROVER_VECTORS,
    ProductKind.TRAVERSE_TABLE,
    ProductKind.TRAVERSE_FIGURE,
    ProductKind.TRAVERSE_FIGURE_PNG,
    ProductKind.TRAVERSE_PACKAGE,
)
FEWEST = 2
"""Fewest stops of a traverse to compare: a leg has two ends."""
FORMAT = 2
"""Version of the table: increased when its fields change."""
ELLIPSE_POINTS = 64
"""Corners of an error ellipse."""
PLAN = np.array([4, 3])
"""East and north in a stop's covariance, which begins with rotations (north, east, down)."""


def traverse_products(name: str, catalogue: Catalogue) -> list[ProductRef]:
    """The latest products of `localise` for a map, kind by kind."""
    region = region_scope(name).name
    return [
        ref
        for kind in KINDS
        for ref in catalogue.pointers(kind)
        if ref.scope.name.partition("-site")[0] == region
    ]


@stage(task_run_name="localise-{network.scope}")
def localise(
    network: ProductRef,
    telemetry: Telemetry,
    landing: LandingPoint,
    store: ProductStore,
) -> list[ProductRef]:
    """Write the adjusted traverse of a mission and the differences to telemetry."""
    product = cached_whole_network(network, store)
    frames = SiteFrames.of(telemetry, {stop.stop.site for stop in product.adjusted.stops})
    clocks = telemetry.first_clocks
    params = (
        FORMAT,
        landing,
        frames.document(),
        sorted((str(stop), at) for stop, at in clocks.items()),
    )
    made = [
        store.make(Recipe(kind, scope, (network,), params), partial(_write, content))
        for kind, scope, content in _contents(product, frames, clocks, landing)
    ]
    recipe = Recipe(
        ProductKind.TRAVERSE_PACKAGE, region_scope(product.mission), (network,), landing
    )
    return [*made, store.make(recipe, partial(write_package, product, landing))]


@dataclass(frozen=True, slots=True, eq=False)
class SiteFrames:
    """The frames of sites, chained to the LSL by telemetry."""

    origin: int
    """The site whose frame the LSL is: 0, the lander, if the chain includes it."""
    lsl_from_site: Mapping[int, Pose]

    @classmethod
    def of(cls, telemetry: Telemetry, sites: Iterable[int]) -> SiteFrames:
        """The frames of some sites, in ascending order."""
        tree = telemetry.tree
        origin = next(f.index[0] for f, pose in tree.parent_from.items() if pose.target == LSL)
        return cls(origin, {site: tree.pose(LSL, site_frame(site)) for site in sorted(set(sites))})

    def document(self) -> dict[str, Any]:
        """The localisations as plain JSON, for the recipe."""
        poses = {str(site): pose_document(pose) for site, pose in self.lsl_from_site.items()}
        return {"origin": self.origin, "sites": poses}


def _write(content: Callable[[], str | bytes], path: Path) -> None:
    made = content()
    path.write_bytes(made.encode() if isinstance(made, str) else made)


def _contents(
    product: NetworkProduct,
    frames: SiteFrames,
    clocks: Mapping[StopId, float],
    landing: LandingPoint,
) -> Iterator[tuple[ProductKind, Scope, Callable[[], str | bytes]]]:
    """Every file about the traverse, and the function that makes it."""
    region = region_scope(product.mission)
    if not landing.origin:  # a table with offsets from the lander
        yield (
            ProductKind.PLACES,
            region,
            lambda: places_text(placed_stops(product, clocks, landing)),
        )
    if set(frames.lsl_from_site) != {frames.origin}:
        yield ProductKind.SITE_VECTORS, region, partial(site_vectors, product.mission, frames)
    for site, pose in frames.lsl_from_site.items():
        scope = Scope(ScopeLevel.REGION, f"{region}-site{site:04d}")
        yield ProductKind.ROVER_VECTORS, scope, partial(rover_vectors, product, site, pose)
    if len(product.adjusted.stops) >= FEWEST:
        table = partial(traverse_table, product, landing)
        yield ProductKind.TRAVERSE_TABLE, region, lambda: json.dumps(table())
        yield ProductKind.TRAVERSE_FIGURE, region, partial(_figure, product, landing, svg)
        yield ProductKind.TRAVERSE_FIGURE_PNG, region, partial(_figure, product, landing, png)


def traverse_table(product: NetworkProduct, landing: LandingPoint) -> dict[str, Any]:
    """Accumulated differences stop by stop and sol by sol, and both profiles, as plain JSON."""
    telemetry, adjusted = traverses(product)
    found = differences(telemetry, adjusted)
    summary = found.summary()
    return {
        "mission": product.mission,
        "origin": landing.name,
        "sol": product.sol,
        "end": _row(summary.end),
        "worst": _row(summary.worst),
        "farthest": _row(summary.farthest),
        "by_sol": [_row(row) for row in found.by_sol()],
        "stops": [
            {
                "stop": name,
                "sol": int(sol),
                "distance_m": round(float(found.distance_m[k]), 3),
                "horizontal_m": round(float(found.horizontal_m[k]), 3),
                "elevation_m": round(float(found.offset_m[k, 2]), 3),
                "telemetry_enu_m": np.round(telemetry.places_m[k], 4).tolist(),
                "adjusted_enu_m": np.round(adjusted.places_m[k], 4).tolist(),
                "percent": finite(round(float(found.percent[k]), 3)),
                **_certainty(product.adjusted.stops[k]),
            }
            for k, (name, sol) in enumerate(zip(found.stops, found.sols, strict=True))
        ],
    }


def _certainty(stop: AdjustedStop) -> dict[str, Any]:
    """Accuracy of a stop, and what determines its pose."""
    north, east, down = np.round(stop.sigma_ned_m, 4).tolist()
    azimuth_deg = float(np.degrees(np.sqrt(max(stop.covariance[2, 2], 0.0))))
    return {
        "sigma_east_m": east,
        "sigma_north_m": north,
        "sigma_up_m": down,
        "sigma_azimuth_deg": round(azimuth_deg, 4),
        "held_by": stop.held_by,
    }


def _row(difference: Difference) -> dict[str, Any]:
    fields = dataclasses.asdict(difference)
    return {k: finite(round(v, 3) if isinstance(v, float) else v) for k, v in fields.items()}


def _figure(
    product: NetworkProduct, landing: LandingPoint, form: Callable[[Figure], bytes]
) -> bytes:
    telemetry, adjusted = traverses(product)
    plan = np.array([stop.covariance[np.ix_(PLAN, PLAN)] for stop in product.adjusted.stops])
    found, title = differences(telemetry, adjusted), landing.name if landing.origin else ""
    return traverse_figure(telemetry, adjusted, found, plan, form, title)


def placed_stops(
    product: NetworkProduct, clocks: Mapping[StopId, float], landing: LandingPoint
) -> list[PlacedStop]:
    """The adjusted stops in the LSL and in degrees of Mars."""
    adjusted = traverses(product)[1]
    lon, lat = lon_lat(landing, adjusted.places_m[:, 0], adjusted.places_m[:, 1])
    return [
        PlacedStop(
            stop=stop.stop,
            lsl_from_rover=stop.lsl_from_rover,
            longitude_deg=float(lon[k]),
            latitude_deg=float(lat[k]),
            clock=clocks.get(stop.stop),
            sol=int(adjusted.sols[k]),
        )
        for k, stop in enumerate(product.adjusted.stops)
    ]


def site_vectors(mission: str, frames: SiteFrames) -> str:
    """The SVF: the sites of the stops, in the one whose frame the LSL is."""
    solutions = [
        _solution("telemetry", FrameKind.SITE, (site,), frames.origin, pose)
        for site, pose in frames.lsl_from_site.items()
        if site != frames.origin
    ]
    name = mission_of(mission)
    return vector_text(VectorFile("", name, "svf", ("telemetry",), tuple(solutions)))


def rover_vectors(product: NetworkProduct, site: int, lsl_from_site: Pose) -> str:
    """The RVF of a site: its stops at their adjusted positions."""
    solutions = [
        _solution(
            "adjusted",
            FrameKind.ROVER,
            (site, stop.stop.drive),
            site,
            lsl_from_site.inverse @ stop.lsl_from_rover,
        )
        for stop in product.adjusted.stops
        if stop.stop.site == site
    ]
    priority = ("adjusted", "telemetry")
    mission = mission_of(product.mission)
    return vector_text(VectorFile("", mission, "rvf", priority, tuple(solutions)))


def _solution(
    solution_id: str, kind: FrameKind, counter: tuple[int, ...], reference: int, pose: Pose
) -> Solution:
    place, turn = pose.translation_m, pose.quaternion
    return Solution(solution_id, kind, counter, reference, place, turn, added="")


def write_package(product: NetworkProduct, landing: LandingPoint, path: Path) -> None:
    """Lines, stops and error ellipses as the layers of one GeoPackage."""
    layers = {
        "traverse": traverse_features(product),
        "stops": list(stop_features(product)),
        "error_ellipses": list(ellipse_features(product)),
    }
    for name, features in layers.items():
        if features:
            write_geopackage(path, FeatureCollection(landing, tuple(features)), name)


def ellipse_features(product: NetworkProduct) -> Iterator[Feature]:
    """The error ellipses of the adjusted stops on the map, 3 sigma large; none where held."""
    turn = np.linspace(0.0, 2 * np.pi, ELLIPSE_POINTS, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    for stop in product.adjusted.stops:
        variances, axes = np.linalg.eigh(stop.covariance[np.ix_(PLAN, PLAN)])
        sigma_m = np.sqrt(np.clip(variances, 0.0, None))
        if sigma_m.max() <= 0:
            continue
        north, east, _ = stop.lsl_from_rover.translation_m.tolist()
        outline = SIGMAS * circle * sigma_m @ axes.T + [east, north]
        properties = {
            "stop": str(stop.stop),
            "sigmas": SIGMAS,
            "semi_major_m": round(float(sigma_m[1]), 4),
            "semi_minor_m": round(float(sigma_m[0]), 4),
            "held_by": stop.held_by,
        }
        yield Feature("Polygon", outline, properties, id=f"{stop.stop}-ellipse")
