"""How a layer may be drawn: its styles, their legends, and contours at any interval."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from solmap.gis_server.rendering.colours import RAMPS
from solmap.gis_server.rendering.contour_features import contours_in
from solmap.gis_server.rendering.contour_lines import interval_of
from solmap.gis_server.rendering.legends import draw_legend
from solmap.gis_server.rendering.looks import Look, style_for
from solmap.gis_server.rendering.styles import ELEVATIONS, Style, legend_of, styles_of
from solmap.gis_server.routes.bodies import Legend
from solmap.gis_server.routes.looks import AskedLook
from solmap.gis_server.routes.parameters import FOREVER, Bounds, LayerPath
from solmap.gis_server.services import ServicesOf
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.vector.geojson import FeatureCollection, local_geojson
from solmap.products.model import Layer

router = APIRouter(prefix="/api/layers/{scope}/{kind}/{digest}", tags=["layers"])
Asked = Annotated[AskedLook, Query()]
Interval = Annotated[
    float | None,
    Query(ge=0.001, le=1000, allow_inf_nan=False, description="metres; by the relief by default"),
]


class NamedStyle(BaseModel):
    """A style of a layer."""

    style: str
    title: str
    legend: Legend | None


class Styles(BaseModel):
    """The styles of a layer, the default first, and the names of the colours they can have."""

    styles: list[NamedStyle]
    colours: list[str]


@router.get("/styles")
def styles(layer: LayerPath, response: Response) -> Styles:
    """How the tiles of a layer may be drawn: `?style=` of a tile."""
    response.headers.update(FOREVER)
    named = [_named(layer, name, style) for name, style in styles_of(layer.ref.kind).items()]
    return Styles(styles=named, colours=list(RAMPS))


@router.get("/legend")
def legend(layer: LayerPath, asked: Asked, response: Response) -> Legend:
    """Values and colours of the layer's tiles when they are asked for with the same query."""
    response.headers.update(FOREVER)
    found = legend_of(layer, style_for(layer, asked.look))
    if found is None:
        raise ProductNotFoundError(f"{layer.id} needs no legend in the style {asked.style}")
    return Legend.model_validate(found)


@router.get("/legend.png", response_class=Response)
def legend_picture(layer: LayerPath, asked: Asked) -> Response:
    """The legend as a picture."""
    body = draw_legend(layer, style_for(layer, asked.look))
    return Response(body, media_type="image/png", headers=FOREVER)


@router.get("/contours.geojson", response_class=JSONResponse)
def contours(
    layer: LayerPath, bounds: Bounds, services: ServicesOf, interval: Interval = None
) -> Response:
    """Contours of a terrain model at any interval, in metres of the local map."""
    if layer.ref.kind not in ELEVATIONS:
        raise ProductNotFoundError(f"{layer.id} is no terrain model: it has no contours")
    interval_m = interval_of(layer, Look(interval_m=interval))
    found = contours_in(layer, interval_m, bounds, services.store, services.pool)
    landing = services.catalogue.mission(layer.mission).landing
    body = local_geojson(FeatureCollection(landing, tuple(found), {}))
    body["solmap:interval_m"] = interval_m
    return JSONResponse(body, headers=FOREVER, media_type="application/geo+json")


def _named(layer: Layer, name: str, style: Style) -> NamedStyle:
    legend = legend_of(layer, style)
    body = None if legend is None else Legend.model_validate(legend)
    return NamedStyle(style=name, title=style.title or layer.title, legend=body)
