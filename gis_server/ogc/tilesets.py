"""Documents of OGC API Tiles for layers and the tile matrix set, without HTTP.

Of every raster layer there is one tileset for each of its styles, in the only tile matrix set of
the mission (`products.formats.raster.tiling`). It is reached by the layer's name without a digest,
so that an address that somebody keeps shows the latest version. A tileset's limits begin at zoom 0,
because OpenLayers takes no others, and end at the zoom of the raster's own cells.
"""

from __future__ import annotations

import json
import math
from typing import Any

from solmap.gis_server.ogc.crs import Crs, spatial_extent, uri_of
from solmap.gis_server.ogc.documents import JSON, Link, link
from solmap.gis_server.rendering.styles import (
    DEFAULT,
    styles_of,
)
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import LandingPoint, local_proj4
from solmap.products.formats.raster.styles import (
    TileStyle,
)
from solmap.products.formats.raster.tiling import CELL_SIZES, tile_matrix_set, zoom_of
from solmap.products.model import Layer

_REL = "http://www.opengis.net/def/rel/ogc/1.0"
TILING_SCHEME, TILESETS_MAP = f"{_REL}/tiling-scheme", f"{_REL}/tilesets-map"
TILING_SCHEMES, STYLES = f"{_REL}/tiling-schemes", f"{_REL}/styles"
PNG = "image/png"
_CONTENT = "image/tiff; application=geotiff; profile=cloud-optimized"
Limits = dict[str, Any]


def tms_id(landing: LandingPoint) -> str:
    """Identifier of the tile matrix set of a landing site."""
    return str(tile_matrix_set(landing).id)


def tms_document(landing: LandingPoint, base: str) -> dict[str, Any]:
    """The tile matrix set, with the CRS as PROJJSON and, for proj4js, as a PROJ string."""
    known = tile_matrix_set(landing)
    document: dict[str, Any] = json.loads(known.model_dump_json(exclude_none=True, by_alias=True))
    return {
        **document,
        "uri": f"{base}/tileMatrixSets/{known.id}",
        "orderedAxes": ["E", "N"],
        "solmap:proj4": local_proj4(landing),
    }


def collection_id(layer: Layer) -> str:
    """The name of a layer as a collection."""
    return f"{layer.ref.scope.name}.{layer.ref.kind}"


def collection_document(layer: Layer, mission: MissionEntry, base: str) -> dict[str, Any]:
    """Description, extent and links of a raster layer."""
    here = f"{base}/collections/{collection_id(layer)}"
    place = f"{layer.ref.scope.name}/{layer.ref.kind}/{layer.ref.digest}"
    root = base.rsplit("/ogc/", 1)[0]
    return {
        "id": collection_id(layer),
        "title": layer.full_title,
        "extent": {"spatial": spatial_extent(layer.bounds, mission.landing, base)},
        "crs": [uri_of(Crs.LOCAL, base)],
        "storageCrs": uri_of(Crs.LOCAL, base),
        "dataType": "map",
        "links": [
            link("self", here, JSON, "This collection"),
            link(TILESETS_MAP, f"{here}/map/tiles", JSON, f"Tiles of {layer.full_title}"),
            link(STYLES, f"{here}/styles", JSON, "Styles of its tiles"),
            link("enclosure", f"{root}/download/{place}", _CONTENT, "The GeoTIFF"),
        ],
    }


def styles_document(layer: Layer, base: str) -> dict[str, Any]:
    """The styles of a layer's tiles."""
    here = f"{base}/collections/{collection_id(layer)}/styles"
    return {
        "default": DEFAULT,
        "styles": [
            {
                "id": name,
                "title": style.title or layer.title,
                "links": [
                    link(TILESETS_MAP, f"{here}/{name}/map/tiles", JSON, "Tiles in this style"),
                    link("preview", legend_address(layer, name, base), PNG, "Legend"),
                ],
            }
            for name, style in styles_of(layer.ref.kind).items()
        ],
    }


def legend_address(layer: Layer, style: str, base: str) -> str:
    """Address of the legend of a style, as an image."""
    root = base.rsplit("/ogc/", 1)[0]
    place = f"{layer.ref.scope.name}/{layer.ref.kind}/{layer.ref.digest}"
    return f"{root}/api/layers/{place}/legend.png?style={style}"


def tilesets_document(layer: Layer, landing: LandingPoint, style: str, base: str) -> dict[str, Any]:
    """The only tileset of a layer in a style, in a list."""
    here = _tiles_url(layer, style, base)
    tileset = {
        "title": _title(layer, style),
        "dataType": "map",
        "crs": uri_of(Crs.LOCAL, base),
        "tileMatrixSetURI": f"{base}/tileMatrixSets/{tms_id(landing)}",
        "links": [
            link("self", f"{here}/{tms_id(landing)}", JSON, "This tileset"),
            _scheme(landing, base),
        ],
    }
    return {"links": [link("self", here, JSON, "Tilesets")], "tilesets": [tileset]}


def tileset_document(layer: Layer, landing: LandingPoint, style: str, base: str) -> dict[str, Any]:
    """A tileset: where its tiles are, and the address of each."""
    here = f"{_tiles_url(layer, style, base)}/{tms_id(landing)}"
    west, south, east, north = layer.bounds
    return {
        "title": _title(layer, style),
        "dataType": "map",
        "crs": uri_of(Crs.LOCAL, base),
        "tileMatrixSetURI": f"{base}/tileMatrixSets/{tms_id(landing)}",
        "tileMatrixSetLimits": [
            limits_at(zoom, layer.bounds) for zoom in range(finest_zoom(layer) + 1)
        ],
        "boundingBox": {
            "lowerLeft": [west, south],
            "upperRight": [east, north],
            "crs": uri_of(Crs.LOCAL, base),
            "orderedAxes": ["E", "N"],
        },
        "links": [
            link("self", here, JSON, "This tileset"),
            {
                **link("item", f"{here}/{{tileMatrix}}/{{tileRow}}/{{tileCol}}", PNG, "A tile"),
                "templated": True,
            },
            _scheme(landing, base),
        ],
    }


def finest_zoom(layer: Layer) -> int:
    """The zoom of the layer's own cells."""
    return len(CELL_SIZES) - 1 if layer.cell_m is None else zoom_of(layer.cell_m)


def limits_at(zoom: int, bounds: Bounds) -> Limits:
    """The first and last column and row of the tiles of a zoom inside some bounds."""
    west, south, east, north = bounds
    side_m, middle = BLOCK * CELL_SIZES[zoom], 2**zoom / 2
    last = 2**zoom - 1
    first_col, first_row = math.floor(west / side_m + middle), math.floor(middle - north / side_m)
    last_col = math.ceil(east / side_m + middle) - 1
    last_row = math.ceil(middle - south / side_m) - 1
    return {
        "tileMatrix": str(zoom),
        "minTileRow": min(max(first_row, 0), last),
        "maxTileRow": min(max(last_row, first_row, 0), last),
        "minTileCol": min(max(first_col, 0), last),
        "maxTileCol": min(max(last_col, first_col, 0), last),
    }


def _tiles_url(layer: Layer, style: str, base: str) -> str:
    here = f"{base}/collections/{collection_id(layer)}"
    return f"{here}/map/tiles" if style == DEFAULT else f"{here}/styles/{style}/map/tiles"


def _title(layer: Layer, style: str) -> str:
    chosen: TileStyle = styles_of(layer.ref.kind)[style]
    return f"{layer.title}: {chosen.title}" if chosen.title else layer.title


def _scheme(landing: LandingPoint, base: str) -> Link:
    return link(TILING_SCHEME, f"{base}/tileMatrixSets/{tms_id(landing)}", JSON, "Tile matrix set")
