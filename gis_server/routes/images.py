"""The rover's images in several styles, whole or as tiles, and the file."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Depends, HTTPException, Path, Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel

from solmap.gis_server.addresses import ServerPath
from solmap.gis_server.analysis.bodies import UnanswerableError, json_numbers
from solmap.gis_server.parameters import REVALIDATE, ImageName
from solmap.gis_server.rendering.images import TILE, ImageView, Stretch, Style, png_of
from solmap.gis_server.services import ServicesOf
from solmap.photogrammetry.matching.manual.editing import epipolar_point
from solmap.photogrammetry.matching.resampling import GROUND_M
from solmap.products.catalogue.oriented_images import geometry_of, matched_record, matches_of
from solmap.products.catalogue.workspace import Workspace

router = APIRouter(prefix="/images", tags=["images"])
_MAX_ZOOM = 12
Percent = Annotated[float, Query(ge=0, le=100)]
Value = Annotated[float | None, Query(ge=-1e6, le=1e6, description="of the image, DN or radiance")]
Pixel = Annotated[float, Query(ge=-1e5, le=1e5, allow_inf_nan=False)]


class StyledImage(BaseModel):
    """A style in which an image can be shown, and its addresses."""

    samples: int
    lines: int
    max_zoom: int
    """Zoom at which a pixel of a tile is one of the image."""
    tile_px: int = TILE
    picture: ServerPath
    tiles: ServerPath


class ImageInfo(BaseModel):
    """The available styles of an image."""

    id: str
    stop: str
    sol: int
    instrument: str
    eye: str
    partner: str | None
    notes: tuple[str, ...]
    """Notes on its pixels."""
    styles: dict[str, StyledImage]
    original: ServerPath


class PointHere(BaseModel):
    """One point in the image as stored and in the linearised one, pixels."""

    stored_sample: float | None
    stored_line: float | None
    linearised_sample: float | None
    linearised_line: float | None


async def _stretch(
    low: Percent = 1.0,
    high: Percent = 99.0,
    black: Value = None,
    white: Value = None,
    gamma: Annotated[float, Query(ge=0.1, le=10)] = 1.0,
    shift_px: Annotated[float, Query(ge=-4000, le=4000)] = 0.0,
) -> Stretch:
    if low >= high:
        raise HTTPException(
            422, f"low={low}, high={high}: the low percentile is below the high one"
        )
    if black is not None and white is not None and black >= white:
        raise HTTPException(422, f"black={black}, white={white}: black is below white")
    return Stretch(low, high, black, white, gamma, shift_px)


StretchOf = Annotated[Stretch, Depends(_stretch)]
"""Percentiles or values shown as black and white, gamma, and the shift of an anaglyph."""


@router.get("/{image}/info")
def info(image: ImageName, services: ServicesOf, response: Response) -> ImageInfo:
    """The styles that an image can be shown in, their sizes and addresses."""
    response.headers.update(REVALIDATE)
    workspace = Workspace(services.store, services.catalogue)
    entry = services.catalogue.image(image)
    matches = matches_of(entry, workspace) if entry.partner else None
    flat = matched_record(entry, workspace)
    sizes = dict.fromkeys((Style.RAW, Style.STRETCHED), (flat.samples, flat.lines))
    if matches is not None:
        geometry = geometry_of(matches, workspace)
        linear = (geometry.samples, geometry.lines)
        sizes |= dict.fromkeys((Style.LINEARISED, Style.ANAGLYPH), linear)
    known = {name: getattr(entry, name) for name in ImageInfo.model_fields if hasattr(entry, name)}
    return ImageInfo(
        **known,
        styles={str(style): _styled_image(entry.id, style, size) for style, size in sizes.items()},
        original=f"/images/{entry.id}/original",
    )


def _styled_image(image: str, style: Style, size: tuple[int, int]) -> StyledImage:
    place = f"/images/{image}/{style}"
    return StyledImage(
        samples=size[0],
        lines=size[1],
        max_zoom=max(0, int(np.ceil(np.log2(max(size) / TILE)))),
        picture=f"{place}.png",
        tiles=f"{place}/{{z}}/{{x}}/{{y}}.png",
    )


@router.get("/{image}/point")
def point(
    image: ImageName,
    services: ServicesOf,
    sample: Pixel,
    line: Pixel,
    given: Annotated[Literal["stored", "linearised"], Query()] = "stored",
) -> PointHere:
    """A point of the image as stored, or of the linearised one, in both."""
    workspace = Workspace(services.store, services.catalogue)
    entry = services.catalogue.image(image)
    matches = matches_of(entry, workspace) if entry.partner else None
    if matches is None:
        raise UnanswerableError(
            f"{entry.id} has no matched partner, so there is no linearised image"
        )
    geometry, camera = geometry_of(matches, workspace), matched_record(entry, workspace).camera
    stored = linear = np.array([sample, line])
    if given == "stored":
        linear = epipolar_point(camera, geometry, (sample, line))
    else:
        ground = camera.centre + GROUND_M * geometry.directions(linear[None])
        stored = camera.project(ground)[0]
    both = json_numbers([*stored, *linear], 3)
    return PointHere(**dict(zip(PointHere.model_fields, both, strict=True)))


@router.get("/{image}/browse.png", response_class=FileResponse)
def browse(image: ImageName, services: ServicesOf) -> FileResponse:
    """The image stretched to eight bits."""
    path = services.store.path(services.catalogue.image(image).browse)
    return FileResponse(path, media_type="image/png", headers=REVALIDATE)


@router.get("/{image}/{style}.png", response_class=Response)
def image_png(
    image: ImageName, style: Style, stretch: StretchOf, services: ServicesOf, request: Request
) -> Response:
    """The whole image in a style."""
    shown = _view(image, style, services)
    tag = _tag(shown, request)
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304)
    return _png(png_of(shown.image(stretch)), tag)


@router.get("/{image}/{style}/{z}/{x}/{y}.png", response_class=Response)
def tile(  # noqa: PLR0913, PLR0917 - the address
    image: ImageName,
    style: Style,
    z: Annotated[int, Path(ge=0, le=_MAX_ZOOM)],
    x: Annotated[int, Path(ge=0, le=10_000)],
    y: Annotated[int, Path(ge=0, le=10_000)],
    stretch: StretchOf,
    services: ServicesOf,
    request: Request,
) -> Response:
    """One tile of the image in a style, for deep zoom; zoom 0 is the whole in one tile."""
    shown = _view(image, style, services)
    tag = _tag(shown, request)
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304)
    return _png(png_of(shown.tile(z, x, y, stretch)), tag)


@router.get("/{image}/original", response_class=FileResponse)
def original(image: ImageName, services: ServicesOf) -> FileResponse:
    """The file as the rover sent it, with its label."""
    entry = services.catalogue.image(image)
    path = services.store.path(entry.ref)
    return FileResponse(
        path,
        media_type="application/octet-stream",
        filename=f"{entry.id}{path.suffix}",
        headers=REVALIDATE,
    )


def _view(image: str, style: Style, services: ServicesOf) -> ImageView:
    workspace = Workspace(services.store, services.catalogue)
    return ImageView.of(services.catalogue.image(image), style, workspace)


def _tag(shown: ImageView, request: Request) -> str:
    """Changes with the source products and with the query."""
    made = "-".join(digest for _, digest in shown.planes)
    text = f"{made} {request.url.path}?{request.url.query}"
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:24]}"'


def _png(body: bytes, tag: str) -> Response:
    return Response(body, media_type="image/png", headers={**REVALIDATE, "ETag": tag})
