"""One layer: its features, provenance, earlier versions, styles, legends and contours."""

from __future__ import annotations

from dataclasses import replace
from http import HTTPStatus
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.solutions import OVERALL
from solmap.gis_server.parameters import FOREVER, REVALIDATE, BBox, LayerPath, ScopeName
from solmap.gis_server.rendering.contours import contours_in, interval_of
from solmap.gis_server.rendering.painting import classes_in
from solmap.gis_server.rendering.styles import (
    ELEVATIONS,
    IMAGERY,
    Legend,
    StyleQuery,
    draw_legend,
    legend_of,
    resolve_style,
    styles_of,
)
from solmap.gis_server.services import Services, ServicesOf
from solmap.products.catalogue.layer_versions import (
    solutions_behind,
    solutions_of_mission,
    versions_of,
)
from solmap.products.catalogue.runs import Run
from solmap.products.errors import ProductNotFoundError
from solmap.products.features.texts import FeatureTexts, feature_texts
from solmap.products.formats.raster.styles import (
    RAMPS,
    STYLES,
    TileStyle,
    range_of,
)
from solmap.products.formats.raster.tiling import CELL_SIZES, whole_zoom_of, zoom_of
from solmap.products.formats.vector.geojson import FeatureCollection, local_geojson
from solmap.products.model import Layer, ProductKind

router = APIRouter(prefix="/api/layers", tags=["layers"])
_MOST_AT_ONCE = 20_000
"""Most features sent at once: about 30 MB."""
RequestedNames = Annotated[tuple[str, ...], Query(max_length=200)]
_ZOOMS_OUT = 3
"""Zooms offered below the one at which a layer fills one tile; at the lowest it has 32 pixels."""
_RUNS = 500
Drawn = Annotated[StyleQuery, Query()]
Interval = Annotated[
    float | None,
    Query(ge=0.001, le=1000, allow_inf_nan=False, description="metres; by the relief by default"),
]


@router.get("/{scope}/{kind}/{digest}/features.geojson", response_class=JSONResponse)
def features(
    layer: LayerPath, services: ServicesOf, bounds: BBox, ids: RequestedNames = ()
) -> Response:
    """The features of a layer as GeoJSON in metres of the local map: east, north and up if known.

    All of them, those that meet a box, or those of some identifiers. Of layers with more than
    20,000 a box or identifiers must be given; pages of all has `/ogc/{mission}/collections`. The
    download has them in degrees of Mars.
    """
    if layer.type != "vector":
        raise ProductNotFoundError(f"{layer.id} is a raster: it has tiles and no features")
    texts = feature_texts(services.store.path(layer.ref))
    if ids:
        numbers = texts.find(ids)
    elif bounds is not None:
        numbers = texts.within(bounds)
    else:
        numbers = range(_count_of(layer, texts))
    body = texts.collection(numbers)
    return Response(body, headers=FOREVER, media_type="application/geo+json")


def _count_of(layer: Layer, texts: FeatureTexts) -> int:
    """Check the number of features and return it.

    Raises:
        HTTPException: more than are sent at once.
    """
    count = len(texts.texts)
    if count > _MOST_AT_ONCE:
        raise HTTPException(
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            f"{layer.id} has {count} features, more than the {_MOST_AT_ONCE} that are sent at "
            f"once: give a bbox or ids, or use the pages of /ogc/{layer.mission}/collections",
        )
    return count


@router.get("/{scope}/{kind}/{digest}/provenance")
def provenance(layer: LayerPath, services: ServicesOf, response: Response) -> dict[str, Any]:
    """How the layer was made: recipe, inputs, parameters, time and checksum."""
    response.headers.update(FOREVER)
    return services.store.provenance(layer.ref)


class MapLayer(BaseModel):
    """A layer of the map and the addresses of its parts."""

    id: str
    scope: str
    level: str
    kind: str
    digest: str
    title: str
    type: Literal["raster", "vector"]
    bounds: tuple[float, float, float, float]
    cell_m: float | None
    minzoom: int
    maxzoom: int
    unit: str | None
    range: tuple[float, float] | None
    sols: tuple[int, ...]
    made_at: str
    tiles: ServerPath | None
    """URL of WebP tiles; those that end in `.png` show the same without loss."""
    values: ServerPath | None
    """Tiles of values, for shading in the browser."""
    styles: ServerPath | None
    """Values of `style` for tiles of a layer, with legends."""
    features: ServerPath | None
    legend: Legend | None
    download: ServerPath
    provenance: ServerPath


def layer_body(layer: Layer) -> MapLayer:
    """A layer and its addresses."""
    ref = layer.ref
    place = f"{ref.scope.name}/{ref.kind}/{ref.digest}"
    style = STYLES.get(ref.kind) if layer.type == "raster" else None
    is_vector = layer.type == "vector"
    return MapLayer(
        id=layer.id,
        scope=ref.scope.name,
        level=str(ref.scope.level),
        kind=str(ref.kind),
        digest=ref.digest,
        title=layer.title,
        type="vector" if is_vector else "raster",
        bounds=layer.bounds,
        cell_m=layer.cell_m,
        minzoom=max(0, whole_zoom_of(layer.bounds) - _ZOOMS_OUT),
        maxzoom=len(CELL_SIZES) - 1 if layer.cell_m is None else zoom_of(layer.cell_m),
        unit=layer.unit,
        range=range_of(style, layer) if style and layer.range else layer.range,
        sols=layer.sols,
        made_at=layer.made_at,
        tiles=f"/tiles/{place}/{{z}}/{{x}}/{{y}}.webp" if style else None,
        values=_values_of(layer, place) if style else None,
        styles=f"/api/layers/{place}/styles" if style else None,
        features=f"/api/layers/{place}/features.geojson" if is_vector else None,
        legend=legend_of(layer),
        download=f"/download/{place}",
        provenance=f"/api/layers/{place}/provenance",
    )


def _values_of(layer: Layer, place: str) -> str | None:
    is_imagery = layer.ref.kind in IMAGERY
    return None if is_imagery else f"/tiles/{place}/{{z}}/{{x}}/{{y}}.values"


class SolutionBehind(BaseModel):
    """An adjustment for which a version is valid."""

    id: str
    """Identifier as in `/solutions`."""
    scope: str
    is_overall: bool


class RunBehind(BaseModel):
    """The run that a version was made in."""

    id: str
    kind: str
    subject: str


class LayerVersion(BaseModel):
    """A layer as it was published once."""

    layer: MapLayer
    """Its `id` ends in `@` and the digest."""
    is_latest: bool
    solutions: list[SolutionBehind]
    """The adjustments for which the version is valid, its own one first; empty if unknown."""
    run: RunBehind | None
    """The run that made it; null if no record covers that time."""


class LayerVersions(BaseModel):
    """A page of the versions of a layer, newest first."""

    total: int
    versions: list[LayerVersion]


@router.get("/{scope}/{kind}/versions")
def versions(
    scope: ScopeName,
    kind: ProductKind,
    services: ServicesOf,
    response: Response,
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    offset: Annotated[int, Query(ge=0)] = 0,
) -> LayerVersions:
    """All published versions of a layer, with their solutions."""
    response.headers.update(REVALIDATE)
    found = versions_of(scope, kind, services.catalogue)
    if not found or found[0].type == "model":
        raise ProductNotFoundError(f"no {kind} of {scope} is a layer of the map")
    page = found[offset : offset + limit]
    return LayerVersions(total=len(found), versions=_bodies(page, services))


@router.get("/{scope}/{kind}/{digest}")
def version(layer: LayerPath, services: ServicesOf, response: Response) -> LayerVersion:
    """One version of a layer."""
    response.headers.update(REVALIDATE)
    if layer.type == "model":
        raise ProductNotFoundError(f"{layer.id} is a model, which is not a layer of the map")
    return _bodies([layer], services)[0]


def _bodies(layers: list[Layer], services: Services) -> list[LayerVersion]:
    store, catalogue = services.store, services.catalogue
    runs = services.runs.runs(_RUNS)
    bodies = []
    for layer in layers:
        solutions = solutions_of_mission(layer.mission, catalogue, store)
        behind = solutions_behind(layer.ref, solutions, store)
        body = layer_body(layer)
        latest = catalogue.latest(layer.ref.scope.name, layer.ref.kind)
        body.id = f"{layer.id}@{layer.ref.digest}"
        bodies.append(
            LayerVersion(
                layer=body,
                is_latest=layer.ref.digest == latest,
                solutions=[
                    SolutionBehind(
                        id=f"{ref.scope.name}/{ref.digest}",
                        scope=ref.scope.name,
                        is_overall=ref.scope.name.endswith(OVERALL),
                    )
                    for ref in behind
                ],
                run=_run_at(layer.made_at, runs),
            )
        )
    return bodies


def _run_at(made_at: str, runs: list[Run]) -> RunBehind | None:
    """The newest run in progress at that time; times of products are whole seconds."""
    second = made_at[:19]
    for run in runs:
        ended = run.ended_at or run.changed_at
        if run.started_at[:19] <= second <= ended[:19]:
            return RunBehind(id=run.id, kind=run.kind, subject=run.subject)
    return None


class NamedStyle(BaseModel):
    """A style of a layer."""

    style: str
    title: str
    legend: Legend | None


class Styles(BaseModel):
    """The styles of a layer, the default first, and the names of the colours they can have."""

    styles: list[NamedStyle]
    colours: list[str]


@router.get("/{scope}/{kind}/{digest}/styles")
def styles(layer: LayerPath, response: Response) -> Styles:
    """How the tiles of a layer may be drawn: `?style=` of a tile."""
    response.headers.update(FOREVER)
    named = [_named_style(layer, name, style) for name, style in styles_of(layer.ref.kind).items()]
    return Styles(styles=named, colours=list(RAMPS))


@router.get("/{scope}/{kind}/{digest}/legend")
def legend(layer: LayerPath, query: Drawn, services: ServicesOf, response: Response) -> Legend:
    """Values and colours of the layer's tiles with the same query."""
    response.headers.update(FOREVER)
    found = legend_of(layer, _style_with_classes(layer, query, services))
    if found is None:
        raise ProductNotFoundError(f"{layer.id} needs no legend in the style {query.style}")
    return found


@router.get("/{scope}/{kind}/{digest}/legend.png", response_class=Response)
def legend_image(layer: LayerPath, query: Drawn, services: ServicesOf) -> Response:
    """The legend as an image."""
    body = draw_legend(layer, _style_with_classes(layer, query, services))
    return Response(body, media_type="image/png", headers=FOREVER)


def _style_with_classes(layer: Layer, query: StyleQuery, services: Services) -> TileStyle:
    """The style of a layer, with the classes that its file names."""
    style = resolve_style(layer, query)
    if not style.is_classes or style.classes:
        return style
    with services.pool.reading(services.store.address(layer.ref)) as dataset:
        return replace(style, classes=classes_in(dataset, style), has_legend=True)


@router.get("/{scope}/{kind}/{digest}/contours.geojson", response_class=JSONResponse)
def contours(
    layer: LayerPath, bounds: BBox, services: ServicesOf, interval: Interval = None
) -> Response:
    """Contours of a terrain model at any interval, in metres of the local map."""
    if layer.ref.kind not in ELEVATIONS:
        raise ProductNotFoundError(f"{layer.id} is not a terrain model: it has no contours")
    interval_m = interval_of(layer, interval)
    found = contours_in(layer, interval_m, bounds, services.store, services.pool)
    landing = services.catalogue.mission(layer.mission).landing
    body = local_geojson(FeatureCollection(landing, tuple(found), {}))
    body["solmap:interval_m"] = interval_m
    return JSONResponse(body, headers=FOREVER, media_type="application/geo+json")


def _named_style(layer: Layer, name: str, style: TileStyle) -> NamedStyle:
    return NamedStyle(style=name, title=style.title or layer.title, legend=legend_of(layer, style))
