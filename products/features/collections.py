"""What a mission knows as collections of features, whichever layers they come from.

A collection joins the latest layers of its kinds: contours lie in one layer for each stop, tie
points in one for the mission. Some are drawn from others: differences join the two places of a
stop. Every collection is kept in an index (`products.feature_index`) under the digests of what it
comes from, so that it is read anew only when that has changed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solmap.products.feature_drawing import (
    Draw,
    as_they_are,
    cameras,
    differences,
    of_solution,
    profile,
    with_times,
)
from solmap.products.formats.vector.geojson import Geometry
from solmap.products.model import ProductKind


@dataclass(frozen=True, slots=True)
class CollectionOf:
    """A collection: what it is called, what layers it comes from, and how."""

    id: str
    title: str
    description: str
    geometry: Geometry | Literal["Unknown"]
    kinds: tuple[ProductKind, ...]
    draw: Draw = as_they_are
    shows_images: bool = False
    """Whether a feature stands for an image, whose identifier it bears."""
    all_images: bool = False
    """Whether images without a feature are in it too, without a place."""
    is_written: bool = False
    """Whether people write it on the map; it comes from the log of edits and no layer."""


COLLECTIONS = (
    CollectionOf(
        "traverse-adjusted",
        "Traverse, adjusted",
        "Where the rover went by the bundle adjustment",
        "LineString",
        (ProductKind.TRAVERSE,),
        of_solution("adjusted"),
    ),
    CollectionOf(
        "traverse-telemetry",
        "Traverse, telemetry",
        "Where the rover itself believed to be",
        "LineString",
        (ProductKind.TRAVERSE,),
        of_solution("telemetry"),
    ),
    CollectionOf(
        "traverse-differences",
        "Differences of the traverses",
        "From each stop by telemetry to the same stop as adjusted, metres east, north and up",
        "LineString",
        (ProductKind.STOPS,),
        differences,
    ),
    CollectionOf(
        "traverse-profile",
        "Profile of the traverse",
        "Stops with the distance driven to them and their elevation by telemetry and as adjusted",
        "Point",
        (ProductKind.STOPS,),
        profile,
    ),
    CollectionOf(
        "stops",
        "Stops, adjusted",
        "Stops with standard deviations, 1-sigma error ellipse and what holds them",
        "Point",
        (ProductKind.STOPS,),
        of_solution("adjusted"),
    ),
    CollectionOf(
        "stops-telemetry",
        "Stops, telemetry",
        "Stops where telemetry has them",
        "Point",
        (ProductKind.STOPS,),
        of_solution("telemetry"),
    ),
    CollectionOf(
        "mission-traverse",
        "Published traverses",
        "Traverses of the whole mission from published tables",
        "LineString",
        (ProductKind.MISSION_TRAVERSE,),
    ),
    CollectionOf(
        "mission-stops",
        "Published stops",
        "Stops of the whole mission from published tables",
        "Point",
        (ProductKind.MISSION_STOPS,),
    ),
    CollectionOf(
        "images",
        "Images",
        "Every image, where its camera stood; no place where its stop has none yet",
        "Point",
        (ProductKind.POINTING,),
        cameras,
        shows_images=True,
        all_images=True,
    ),
    CollectionOf(
        "footprints",
        "Image footprints",
        "The ground that an image shows, taken for level",
        "Polygon",
        (ProductKind.FOOTPRINTS,),
        with_times,
        shows_images=True,
    ),
    CollectionOf(
        "pointing-lines",
        "Pointing lines",
        "From the camera to the ground in the middle of its image",
        "LineString",
        (ProductKind.POINTING,),
        with_times,
        shows_images=True,
    ),
    CollectionOf(
        "tie-points",
        "Tie points",
        "Tie points of the last adjustment with their residuals in the images",
        "Point",
        (ProductKind.TIE_POINTS,),
    ),
    CollectionOf(
        "contours",
        "Contours",
        "Contours of the terrain models of stops",
        "LineString",
        (ProductKind.CONTOURS,),
    ),
    CollectionOf(
        "far-contours",
        "Far contours",
        "Contours of far ground, matched from two stops",
        "LineString",
        (ProductKind.FAR_CONTOURS,),
    ),
    CollectionOf(
        "region-contours",
        "Contours of regions",
        "Contours of the fused terrain models",
        "LineString",
        (ProductKind.REGION_CONTOURS,),
    ),
    CollectionOf(
        "havens",
        "Winter havens",
        "Ground at the stops that is tilted to the sun in winter and safe to stand on",
        "Polygon",
        (ProductKind.HAVENS, ProductKind.REGION_HAVENS),
    ),
    CollectionOf(
        "dips",
        "Strike and dip",
        "Planar facets with strike, dip and their standard deviations",
        "Point",
        (ProductKind.DIPS,),
    ),
    CollectionOf(
        "annotations",
        "Annotations",
        "What people wrote on the map",
        "Unknown",
        (),
        is_written=True,
    ),
)
BY_ID = {collection.id: collection for collection in COLLECTIONS}
