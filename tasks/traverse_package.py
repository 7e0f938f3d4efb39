"""The traverse as one GeoPackage: lines, stops and error ellipses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.network import NetworkProduct
from solmap.products.formats.vector.geojson import Feature, FeatureCollection
from solmap.products.formats.vector.geopackage import write_geopackage
from solmap.products.reports.traverse_figure import SIGMAS
from solmap.tasks.vectors import stop_features, traverse_features

ELLIPSE_POINTS = 64
"""Corners of an error ellipse."""
PLAN = np.array([4, 3])
"""East and north in a stop's covariance, which holds turns before (north, east, down)."""


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
