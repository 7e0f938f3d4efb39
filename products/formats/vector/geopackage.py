"""Features as a GeoPackage in metres of the local map, for QGIS and other OGC software.

Features are stored as GeoJSON (`products.formats.vector.geojson`); a GeoPackage is made from it on
request, by geopandas. It includes the local CRS, and elevations as the third coordinate. Properties
that are lists are written as JSON. It contains no creation date: equal features give equal bytes,
as for every product.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from pyproj import CRS

from solmap.products.crs import local_crs
from solmap.products.errors import ProductError
from solmap.products.formats.vector.geojson import FeatureCollection

if TYPE_CHECKING:
    import geopandas

_DATE = {"OGR_CURRENT_DATE": "2004-01-04T04:35:00.000Z"}
"""Date in the column `last_change`, which the format requires: the landing of Spirit."""


def write_geopackage(path: Path, collection: FeatureCollection, layer: str) -> None:
    """Write features as one layer of a GeoPackage, beside those that the file has already.

    Raises:
        ProductError: there is no feature, or their geometries differ in kind.
    """
    features = collection.features
    kinds = {feature.geometry for feature in features}
    if len(kinds) != 1:
        raise ProductError(
            "a layer of a GeoPackage must have features of one geometry, not "
            f"{sorted(kinds) or 'none'}; use the GeoJSON"
        )
    frame = feature_frame(
        [feature.properties for feature in features],
        [feature.shape for feature in features],
        local_crs(collection.landing),
    )
    import pyogrio  # noqa: PLC0415 - with geopandas

    pyogrio.set_gdal_config_options(_DATE)  # at every write: long runs may lose it
    frame.to_file(path, driver="GPKG", layer=layer, index=False)


def feature_frame(
    rows: Sequence[Any], shapes: Iterable[shapely.Geometry | None], crs: CRS
) -> geopandas.GeoDataFrame:
    """Properties, row by row, and shapes as a table for geopandas.

    A column has numbers if every row has one, else text or null.
    """
    import geopandas  # noqa: PLC0415 - 30 MB, for the one process that writes such files

    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    return geopandas.GeoDataFrame(columns, geometry=np.array([*shapes], dtype=object), crs=crs)


def _column(values: list[Any]) -> np.ndarray:
    if all(isinstance(value, bool) for value in values):
        return np.array(values, dtype=bool)
    if all(isinstance(value, int) and not isinstance(value, bool) for value in values):
        return np.array(values, dtype=np.int64)
    if all(isinstance(value, int | float) or value is None for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=float)
    return np.array([_text(value) for value in values], dtype=object)


def _text(value: Any) -> str | None:  # noqa: ANN401 - a property
    return value if isinstance(value, str) or value is None else json.dumps(value)
