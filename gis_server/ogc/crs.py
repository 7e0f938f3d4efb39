"""Coordinate systems of requests and answers, and the order of their axes.

    no `crs`                                         longitude, latitude, as GeoJSON has them
    http://www.opengis.net/def/crs/IAU/2015/49900    latitude, longitude: the order of that CRS
    {landing page}/crs/local                         metres east and north on the mission's map

A map that is not tied to the lander has no longitude and latitude: all of it is in metres, `local`.
All degrees are planetocentric on Mars. CRS84, which OGC API Features means by "no crs", is on the
Earth and never claimed: the default has an address of its own, `{landing page}/crs/lon-lat`.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Any

import numpy as np
import shapely
from fastapi import HTTPException

from solmap.photogrammetry.terrain.dtm.grid import Bounds
from solmap.products.crs import MARS_URN, LandingPoint, east_north, lon_lat
from solmap.products.features.index import Area
from solmap.products.reports.stac import degrees

MARS_URI = "http://www.opengis.net/def/crs/IAU/2015/49900"
_DEGREES_DECIMALS, _METRES_DECIMALS = 9, 4
_EDGE_POINTS = 17
"""Points along an edge in degrees, which is a curve on the map."""
_TURN = 360.0


class Crs(StrEnum):
    """The supported coordinate systems."""

    LON_LAT = "lon-lat"
    MARS = "mars"
    LOCAL = "local"


def uri_of(crs: Crs, base: str) -> str:
    """Identifier of a coordinate reference system."""
    return MARS_URI if crs is Crs.MARS else f"{base}/crs/{crs}"


def crs_named(text: str | None, parameter: str, base: str) -> Crs:
    """The coordinate system that a parameter names; longitude and latitude where it is absent.

    Raises:
        HTTPException: 400, the CRS is not supported.
    """
    if not text:
        return Crs.LON_LAT
    known = {uri_of(crs, base): crs for crs in Crs} | {MARS_URN: Crs.MARS}
    if text not in known:
        raise HTTPException(400, f"{parameter}={text} is none of {', '.join(known)}")
    return known[text]


def spatial_extent(bounds: Bounds, landing: LandingPoint, base: str) -> dict[str, Any]:
    """Extent of a collection in degrees, or in metres of a map not tied to the lander."""
    if landing.origin:
        return {"bbox": [list(bounds)], "crs": uri_of(Crs.LOCAL, base)}
    return {"bbox": [list(degrees(bounds, landing))], "crs": uri_of(Crs.LON_LAT, base)}


def crs_on(landing: LandingPoint, requested: Crs) -> Crs:
    """The coordinate system to answer in, where the default is longitude and latitude.

    Raises:
        HTTPException: 400, degrees of a map that is not tied to the lander.
    """
    if landing.origin and requested is Crs.MARS:
        raise HTTPException(400, f"this map has no degrees; {landing.name}: use crs/local")
    return Crs.LOCAL if landing.origin else requested


def transform_shapes(shapes: np.ndarray, crs: Crs, landing: LandingPoint) -> np.ndarray:
    """Shapes of the local map in another coordinate system, its first axis first."""

    def to_crs(points: np.ndarray) -> np.ndarray:
        heights = np.round(points[:, 2:], _METRES_DECIMALS)
        if crs is Crs.LOCAL:
            return np.hstack([np.round(points[:, :2], _METRES_DECIMALS), heights]) + 0.0
        axes = lon_lat(landing, points[:, 0], points[:, 1])
        plane = np.column_stack(axes if crs is Crs.LON_LAT else axes[::-1])
        return np.hstack([np.round(plane, _DEGREES_DECIMALS), heights]) + 0.0  # no -0.0

    return shapely.transform(shapes, to_crs, include_z=None)


def bbox_of(text: str | None, crs: Crs) -> Bounds | None:
    """(west, south, east, north) of `bbox`, whose axes are those of its CRS; heights do not count.

    Raises:
        HTTPException: 400, these are not four or six numbers in order.
    """
    if not text:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 6) or not all(map(math.isfinite, numbers)):
        raise HTTPException(400, f"bbox={text}: four or six numbers are expected")
    half = len(numbers) // 2
    low, high = numbers[:2], numbers[half : half + 2]
    if crs is Crs.MARS:
        low, high = low[::-1], high[::-1]
    crosses_the_antimeridian = crs is not Crs.LOCAL and low[0] > high[0]
    if low[1] > high[1] or (low[0] > high[0] and not crosses_the_antimeridian):
        raise HTTPException(400, f"bbox={text}: the first corner has the smaller coordinates")
    east = high[0] + _TURN if crosses_the_antimeridian else high[0]
    return low[0], low[1], east, high[1]


def area_of(box: Bounds, crs: Crs, landing: LandingPoint, extent: Bounds) -> Area | None:
    """A box as an area of the local map; None where it cannot hold anything of `extent`, metres.

    A box in degrees may be the whole globe, of which the map shows half: it is cut to the extent.
    """
    if crs is Crs.LOCAL:
        return Area.of_box(box)
    west, south, east, north = extent
    margin = 1.0 + 0.01 * max(east - west, north - south)
    around = degrees((west - margin, south - margin, east + margin, north + margin), landing)
    for turn in (-_TURN, 0.0, _TURN):
        cut = (
            max(box[0] + turn, around[0]),
            max(box[1], around[1]),
            min(box[2] + turn, around[2]),
            min(box[3], around[3]),
        )
        if cut[0] <= cut[2] and cut[1] <= cut[3]:
            return _area_from_degrees(cut, landing)
    return None


def _area_from_degrees(box: Bounds, landing: LandingPoint) -> Area:
    """A box in degrees on the map, where its edges are curves."""
    west, south, east, north = box
    along, up = np.linspace(west, east, _EDGE_POINTS), np.linspace(south, north, _EDGE_POINTS)
    bottom, right, top, left = (
        np.column_stack(east_north(landing, *np.broadcast_arrays(lon, lat)))
        for lon, lat in ((along, south), (east, up), (along[::-1], north), (west, up[::-1]))
    )
    ring = shapely.Polygon(np.vstack([bottom[:-1], right[:-1], top[:-1], left[:-1]]))
    inner = (left[:, 0].max(), bottom[:, 1].max(), right[:, 0].min(), top[:, 1].min())
    return Area(ring, (float(inner[0]), float(inner[1]), float(inner[2]), float(inner[3])))
