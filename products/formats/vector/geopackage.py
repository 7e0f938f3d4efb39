"""Features as a GeoPackage in metres of the local map, for QGIS and whatever reads OGC's format.

GeoJSON (`products.formats.vector.geojson`) is how features are kept; a GeoPackage is made from it when it is asked
for. It carries the local CRS itself, so that nothing need be said of degrees on Mars, and
elevations as the third coordinate. Properties that are lists are written as JSON. It holds no date
of its own making: equal features give equal bytes, as of every product.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyogrio.raw
import shapely

from solmap.products.crs import local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.vector.geojson import Feature, FeatureCollection

_DATE = {"OGR_CURRENT_DATE": "2004-01-04T04:35:00.000Z"}
"""For the column `last_change`, which the format asks for: when Spirit landed."""


def write_geopackage(path: Path, collection: FeatureCollection, layer: str) -> None:
    """Write features as one layer of a GeoPackage; beside those that the file has already.

    Raises:
        ProductError: there is no feature, or their geometries are not all of one kind.
    """
    features = collection.features
    kinds = {feature.geometry for feature in features}
    if len(kinds) != 1:
        raise ProductError(
            f"a layer of a GeoPackage has features of one geometry, not {sorted(kinds) or 'none'}; "
            "take the GeoJSON"
        )
    solid = any(feature.points.shape[1] == 3 for feature in features)  # noqa: PLR2004 - with up
    names = list(dict.fromkeys(name for feature in features for name in feature.properties))
    pyogrio.set_gdal_config_options(_DATE)  # at every write: a long run is known to lose it
    pyogrio.raw.write(
        path,
        geometry=np.array([shapely.to_wkb(_shape(f)) for f in features], dtype=object),
        field_data=[column_of([f.properties.get(name) for f in features]) for name in names],
        fields=np.array(names, dtype=object),
        geometry_type=f"{kinds.pop()}{' Z' if solid else ''}",
        crs=local_crs(collection.landing).to_wkt(),
        driver="GPKG",
        layer=layer,
    )


def _shape(feature: Feature) -> shapely.Geometry:
    outline, *holes = feature.rings
    if feature.geometry == "Polygon":
        return shapely.Polygon(outline, holes)
    return shapely.Point(outline[0]) if feature.geometry == "Point" else shapely.LineString(outline)


def column_of(values: list[Any]) -> np.ndarray:
    """A property of all features: numbers where it is one in each, else text or nothing."""
    if all(isinstance(value, bool) for value in values):
        return np.array(values, dtype=bool)
    if all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        return np.array(values, dtype=np.int64)
    if all(isinstance(value, int | float) or value is None for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return np.array([_text(value) for value in values], dtype=object)


def _text(value: Any) -> str | None:  # noqa: ANN401 - a property
    return value if isinstance(value, str) or value is None else json.dumps(value)
