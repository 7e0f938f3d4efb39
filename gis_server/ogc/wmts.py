"""WMTS 1.0.0 (OGC 07-057r7): the tiles of OGC API - Tiles, also for clients that support only WMTS.

    /ogc/{mission}/wmts/1.0.0/WMTSCapabilities.xml
    /ogc/{mission}/wmts?service=WMTS&request=GetCapabilities
    /ogc/{mission}/wmts?service=WMTS&request=GetTile&layer=...&tilematrix=...

Names of parameters may be written in any case. Errors in requests with query parameters return an
OWS exception report.

The CRS is given as a PROJ string: GDAL accepts PROJ strings, WKT and authority URNs but not URLs,
and no authority has registered a landing site's CRS. Scale denominators assume pixels of 0.28 mm,
as in the standard.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from http import HTTPStatus
from typing import Annotated
from xml.etree import ElementTree as ET

from fastapi import APIRouter, Query, Request, Response

from solmap.gis_server.ogc.documents import Link, link
from solmap.gis_server.ogc.tiles import (
    ClientEtag,
    Matrix,
    Raster,
    StyleName,
    check_tms,
    in_style,
    latest_tile,
    raster_named,
    rasters,
)
from solmap.gis_server.ogc.tilesets import (
    collection_id,
    finest_zoom,
    legend_address,
    limits_at,
    tms_id,
)
from solmap.gis_server.parameters import REVALIDATE, BaseOf, MissionName
from solmap.gis_server.rendering.styles import DEFAULT, StyleQuery, UnknownStyleError, styles_of
from solmap.gis_server.services import Services, ServicesOf
from solmap.photogrammetry.terrain.dtm.grid import BLOCK, Bounds
from solmap.products.catalogue.catalogue import MissionEntry
from solmap.products.crs import crs_text
from solmap.products.errors import OutsideCoverageError, ProductNotFoundError
from solmap.products.formats.raster.tiling import (
    CELL_SIZES,
    EXTENT,
    HALF_SIDE_M,
    TileAddress,
    whole_zoom_of,
)
from solmap.products.model import Layer
from solmap.products.reports.stac import degrees

_WMTS, _OWS = "http://www.opengis.net/wmts/1.0", "http://www.opengis.net/ows/1.1"
_XLINK = "http://www.w3.org/1999/xlink"
_PIXEL_M = 0.00028
_ZOOMS_OUT = 3
"""Number of coarser zooms offered beyond the finest one at which the layer fits into one tile."""
router = APIRouter(prefix="/ogc/{mission}/wmts", tags=["ogc tiles"])
CONFORMANCE: tuple[str, ...] = ()
_XML = "application/xml"
for _prefix, _name in (("", _WMTS), ("ows", _OWS), ("xlink", _XLINK)):
    ET.register_namespace(_prefix, _name)


def capabilities(mission: MissionEntry, layers: Iterable[Layer], base: str) -> bytes:
    """All layers, their styles and the tile matrix set."""
    root = ET.Element(f"{{{_WMTS}}}Capabilities", version="1.0.0")
    service = ET.SubElement(root, f"{{{_OWS}}}ServiceIdentification")
    _ows(service, "Title", f"Maps of {mission.title}")
    start = "Mars; coordinates" if mission.landing.is_on_mars else "Coordinates"
    _ows(service, "Abstract", f"{start} in metres east and north of {mission.landing.name}")
    _ows(service, "ServiceType", "OGC WMTS")
    _ows(service, "ServiceTypeVersion", "1.0.0")
    _operations(root, f"{base}/wmts")
    contents = ET.SubElement(root, f"{{{_WMTS}}}Contents")
    for layer in layers:
        _layer(contents, layer, mission, base)
    _tile_matrix_set(contents, mission)
    address = {f"{{{_XLINK}}}href": f"{base}/wmts/1.0.0/WMTSCapabilities.xml"}
    ET.SubElement(root, f"{{{_WMTS}}}ServiceMetadataURL", address)
    return _bytes(root)


def exception_report(code: str, text: str, locator: str = "") -> bytes:
    """OWS exception report, as XML."""
    root = ET.Element(f"{{{_OWS}}}ExceptionReport", version="1.1.0")
    attributes = {"exceptionCode": code, **({"locator": locator} if locator else {})}
    exception = ET.SubElement(root, f"{{{_OWS}}}Exception", attributes)
    _ows(exception, "ExceptionText", text)
    return _bytes(root)


def _operations(root: ET.Element, address: str) -> None:
    metadata = ET.SubElement(root, f"{{{_OWS}}}OperationsMetadata")
    for name in ("GetCapabilities", "GetTile"):
        operation = ET.SubElement(metadata, f"{{{_OWS}}}Operation", name=name)
        http = ET.SubElement(ET.SubElement(operation, f"{{{_OWS}}}DCP"), f"{{{_OWS}}}HTTP")
        get = ET.SubElement(http, f"{{{_OWS}}}Get", {f"{{{_XLINK}}}href": f"{address}?"})
        constraint = ET.SubElement(get, f"{{{_OWS}}}Constraint", name="GetEncoding")
        _ows(ET.SubElement(constraint, f"{{{_OWS}}}AllowedValues"), "Value", "KVP")


def _layer(contents: ET.Element, layer: Layer, mission: MissionEntry, base: str) -> None:
    element = ET.SubElement(contents, f"{{{_WMTS}}}Layer")
    _ows(element, "Title", layer.full_title)
    _box(element, "BoundingBox", layer.bounds, crs_text(mission.landing))
    if not mission.landing.origin:
        # the standard has no Mars variant; these are degrees on Mars
        _box(element, "WGS84BoundingBox", degrees(layer.bounds, mission.landing))
    _ows(element, "Identifier", collection_id(layer))
    for name, style in styles_of(layer.ref.kind).items():
        style_element = ET.SubElement(
            element, f"{{{_WMTS}}}Style", isDefault="true" if name == DEFAULT else "false"
        )
        _ows(style_element, "Title", style.title or layer.title)
        _ows(style_element, "Identifier", name)
        address = {f"{{{_XLINK}}}href": legend_address(layer, name, base)}
        ET.SubElement(style_element, f"{{{_WMTS}}}LegendURL", address, format="image/png")
    _wmts(element, "Format", "image/png")
    link = ET.SubElement(element, f"{{{_WMTS}}}TileMatrixSetLink")
    _wmts(link, "TileMatrixSet", tms_id(mission.landing))
    limits = ET.SubElement(link, f"{{{_WMTS}}}TileMatrixSetLimits")
    for zoom in range(max(0, whole_zoom_of(layer.bounds) - _ZOOMS_OUT), finest_zoom(layer) + 1):
        limit = ET.SubElement(limits, f"{{{_WMTS}}}TileMatrixLimits")
        for name, value in limits_at(zoom, layer.bounds).items():
            _wmts(limit, name[0].upper() + name[1:], str(value))
    template = (
        f"{base}/wmts/1.0.0/{collection_id(layer)}/{{Style}}/{{TileMatrixSet}}/{{TileMatrix}}/"
        "{TileRow}/{TileCol}.png"
    )
    ET.SubElement(
        element,
        f"{{{_WMTS}}}ResourceURL",
        format="image/png",
        resourceType="tile",
        template=template,
    )


def _tile_matrix_set(contents: ET.Element, mission: MissionEntry) -> None:
    element = ET.SubElement(contents, f"{{{_WMTS}}}TileMatrixSet")
    _ows(element, "Identifier", tms_id(mission.landing))
    crs = crs_text(mission.landing)
    _box(element, "BoundingBox", EXTENT, crs)
    _ows(element, "SupportedCRS", crs)
    for zoom, cell_m in enumerate(CELL_SIZES):
        matrix = ET.SubElement(element, f"{{{_WMTS}}}TileMatrix")
        _ows(matrix, "Identifier", str(zoom))
        _wmts(matrix, "ScaleDenominator", repr(cell_m / _PIXEL_M))
        _wmts(matrix, "TopLeftCorner", f"{-HALF_SIDE_M!r} {HALF_SIDE_M!r}")
        for name in ("TileWidth", "TileHeight"):
            _wmts(matrix, name, str(BLOCK))
        for name in ("MatrixWidth", "MatrixHeight"):
            _wmts(matrix, name, str(2**zoom))


def _box(parent: ET.Element, name: str, bounds: Bounds, crs: str = "") -> None:
    west, south, east, north = bounds
    named = {"crs": crs} if crs else {}
    box = ET.SubElement(parent, f"{{{_OWS}}}{name}", named)
    _ows(box, "LowerCorner", f"{west!r} {south!r}")
    _ows(box, "UpperCorner", f"{east!r} {north!r}")


def _ows(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, f"{{{_OWS}}}{name}").text = text


def _wmts(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, f"{{{_WMTS}}}{name}").text = text


def _bytes(root: ET.Element) -> bytes:
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


class _RequestError(Exception):
    def __init__(self, code: str, text: str, locator: str) -> None:
        super().__init__(text)
        self.code, self.text, self.locator = code, text, locator


def landing_links(base: str) -> list[Link]:
    """Links to WMTS on the landing page."""
    address = f"{base}/wmts/1.0.0/WMTSCapabilities.xml"
    return [link("service", address, _XML, "Web Map Tile Service")]


@router.get("/1.0.0/WMTSCapabilities.xml", response_class=Response)
def document(mission: MissionName, services: ServicesOf, base: BaseOf) -> Response:
    """All layers, their styles and the tile matrix set."""
    body = _capabilities(mission, services, base, services.catalogue.published_version())
    return Response(body, media_type=_XML, headers=REVALIDATE)


@router.get("/1.0.0/{collection}/{style}/{tms}/{zoom}/{row}/{column}.png", response_class=Response)
def tile(
    layer: Raster,
    style: StyleName,
    address: Matrix,
    services: ServicesOf,
    query: Annotated[StyleQuery, Query()],
    known: ClientEtag = "",
) -> Response:
    """A tile of the latest version of a layer."""
    return latest_tile(layer, address, in_style(style, query), services, known)


@router.get("", response_class=Response)
def by_parameters(
    mission: MissionName,
    request: Request,
    services: ServicesOf,
    base: BaseOf,
    known: ClientEtag = "",
) -> Response:
    """GetCapabilities and GetTile, by parameters in the query."""
    parameters = {name.lower(): value for name, value in request.query_params.items()}
    if parameters.get("request", "").lower() == "getcapabilities":
        return document(mission, services, base)
    try:
        return _tile(mission, parameters, services, known)
    except _RequestError as error:
        body = exception_report(error.code, error.text, error.locator)
        return Response(body, HTTPStatus.BAD_REQUEST, {"Cache-Control": "no-store"}, _XML)


@lru_cache(maxsize=4)
def _capabilities(mission: str, services: Services, base: str, _version: int) -> bytes:
    """The document, cached until the next publication: it takes seconds for 5500 layers."""
    entry = services.catalogue.mission(mission)
    return capabilities(entry, rasters(mission, services), base)


def _tile(mission: str, parameters: Mapping[str, str], services: Services, known: str) -> Response:
    operation = parameters.get("request", "")
    if operation.lower() != "gettile":
        raise _RequestError(
            "OperationNotSupported",
            f"request={operation} is neither GetCapabilities nor GetTile",
            "request",
        )
    try:
        check_tms(
            _required_parameter(parameters, "tilematrixset"), services.catalogue.mission(mission)
        )
        layer = raster_named(_required_parameter(parameters, "layer"), mission, services)
        address = TileAddress(
            *(_number(parameters, n) for n in ("tilematrix", "tilecol", "tilerow"))
        )
        _check_format(parameters)
        query = StyleQuery.model_construct(style=parameters.get("style") or DEFAULT)
        return latest_tile(layer, address, query, services, known)
    except OutsideCoverageError as error:
        raise _RequestError("TileOutOfRange", str(error), "tilematrix") from error
    except UnknownStyleError as error:
        raise _RequestError("InvalidParameterValue", str(error), "style") from error
    except ProductNotFoundError as error:
        raise _RequestError("InvalidParameterValue", str(error), "layer") from error


def _check_format(parameters: Mapping[str, str]) -> None:
    value = parameters.get("format", "image/png")
    if value != "image/png":
        raise _RequestError(
            "InvalidParameterValue", f"format={value} is not supported; use image/png", "format"
        )


def _required_parameter(parameters: Mapping[str, str], name: str) -> str:
    if not parameters.get(name):
        raise _RequestError("MissingParameterValue", f"GetTile requires the parameter {name}", name)
    return parameters[name]


def _number(parameters: Mapping[str, str], name: str) -> int:
    text = _required_parameter(parameters, name)
    if not (text.isascii() and text.isdigit() and len(text) < 10):  # noqa: PLR2004 - digits
        raise _RequestError(
            "InvalidParameterValue",
            f"{name}={text} is not a whole number of at most 9 digits",
            name,
        )
    return int(text)
