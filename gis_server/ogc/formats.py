"""Features as GeoJSON, CSV, GeoPackage and FlatGeobuf.

GeoJSON is put together from text: properties lie in the index as JSON and shapes are written by
GEOS, so that a page of a thousand features costs some milliseconds.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import shapely

from solmap.gis_server.ogc.crs import Crs, transform_shapes
from solmap.products.crs import MARS, MARS_URN, LandingPoint, local_crs, mars_crs
from solmap.products.features.index import IndexedFeature
from solmap.products.formats.documents.csv_table import csv_table
from solmap.products.formats.vector.geopackage import feature_frame


class Format(StrEnum):
    """Values of the parameter `f`."""

    JSON = "json"
    GEOJSON = "geojson"
    HTML = "html"
    CSV = "csv"
    GPKG = "gpkg"
    FGB = "fgb"


MEDIA_TYPES = {
    Format.JSON: "application/geo+json",
    Format.GEOJSON: "application/geo+json",
    Format.HTML: "text/html",
    Format.CSV: "text/csv; charset=utf-8",
    Format.GPKG: "application/geopackage+sqlite3",
    Format.FGB: "application/flatgeobuf",
}
FILES = (Format.CSV, Format.GPKG, Format.FGB)
"""Formats that are downloaded as a whole, not in pages."""
_DRIVERS = {Format.GPKG: "GPKG", Format.FGB: "FlatGeobuf"}


@dataclass(frozen=True, slots=True, eq=False)
class FeaturePage:
    """Features of a page in the requested coordinate system."""

    features: Sequence[IndexedFeature]
    crs: Crs
    landing: LandingPoint
    image_root: str | None = None
    """Address of the server, for features that represent images: their files are linked."""

    def shapes(self, crs: Crs | None = None) -> np.ndarray:
        """The geometries, the first axis of the CRS first; None where a place is not known."""
        found = np.array(shapely.from_wkb([one.shape for one in self.features]), dtype=object)
        return transform_shapes(found, crs or self.crs, self.landing)

    def properties(self, feature: IndexedFeature) -> str:
        """A JSON object."""
        if self.image_root is None:
            return feature.properties
        place = f"{self.image_root}/images/{feature.name}"
        files = json.dumps({"browse": f"{place}/browse.png", "original": f"{place}/original"})
        return f"{feature.properties[:-1]},{files[1:]}"

    def rows(self) -> list[dict[str, Any]]:
        """The properties of all, read."""
        return [json.loads(self.properties(one)) for one in self.features]


def feature_text(page: FeaturePage) -> list[str]:
    """Each feature as GeoJSON."""
    shapes = shapely.to_geojson(page.shapes())
    return [
        f'{{"type":"Feature","id":{json.dumps(one.name)},"geometry":{shape or "null"},'
        f'"properties":{page.properties(one)}}}'
        for one, shape in zip(page.features, shapes, strict=True)
    ]


def geojson(page: FeaturePage, members: dict[str, Any]) -> str:
    """A feature collection with further members, such as its links.

    Where the order is that of GeoJSON, a foreign member states that these are degrees of Mars, or
    metres of a map that is not tied to the lander, as in the files of the store.
    """
    name = local_crs(page.landing).to_wkt() if page.landing.origin else MARS_URN
    is_named = page.crs is Crs.LON_LAT or bool(page.landing.origin)
    named = {"crs": {"type": "name", "properties": {"name": name}}} if is_named else {}
    head = {"type": "FeatureCollection", **named, **members}
    features = ",\n".join(feature_text(page))
    return f'{json.dumps(head)[:-1]},"features":[\n{features}]}}'


def as_csv(page: FeaturePage) -> str:
    """A table: identifier, properties, for points a column for each axis, and the shape as WKT."""
    rows, shapes = page.rows(), page.shapes()
    names = list(dict.fromkeys(name for row in rows for name in row))
    axes = {
        Crs.LON_LAT: ["longitude", "latitude"],
        Crs.MARS: ["latitude", "longitude"],
        Crs.LOCAL: ["east_m", "north_m"],
    }[page.crs] + ["elevation_m"]
    is_points = all(shape is None or shape.geom_type == "Point" for shape in shapes)
    lines = (
        [
            one.name,
            *(_cell(row.get(name)) for name in names),
            *(_coordinates(shape) if is_points else []),
            None if shape is None else shapely.to_wkt(shape, rounding_precision=9),
        ]
        for one, row, shape in zip(page.features, rows, shapes, strict=True)
    )
    return csv_table(["id", *names, *(axes if is_points else []), "wkt"], lines)


def _coordinates(point: shapely.Point | None) -> list[float | str]:
    known = [] if point is None else list(point.coords[0])
    return [*known, "", "", ""][:3]


def _cell(value: Any) -> Any:  # noqa: ANN401 - a property
    return json.dumps(value) if isinstance(value, list | dict) else value


def as_file(page: FeaturePage, form: Format, layer: str) -> bytes:
    """A GeoPackage or FlatGeobuf. These carry their CRS, and have longitude or east first."""
    shapes = page.shapes(Crs.LOCAL if page.crs is Crs.LOCAL else Crs.LON_LAT)
    crs = local_crs(page.landing) if page.crs is Crs.LOCAL else mars_crs(MARS)
    rows = [
        {"feature_id": one.name, **row} for one, row in zip(page.features, page.rows(), strict=True)
    ]
    can_index = form is Format.GPKG or all(shape is not None for shape in shapes)
    options = {} if can_index else {"SPATIAL_INDEX": "NO"}
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{layer}.{form}"
        feature_frame(rows, shapes, crs).to_file(
            path, driver=_DRIVERS[form], layer=layer, index=False, layer_options=options
        )
        return path.read_bytes()
