"""Parameters of paths and queries that several endpoints have, and the headers of caching."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, HTTPException, Path, Query, Request

from solmap.gis_server.analysis.ground import Ground
from solmap.gis_server.services import Services, ServicesOf, map_layers
from solmap.products.formats.raster.tiling import HALF_SIDE_M, MAX_ZOOM
from solmap.products.model import Layer, ProductKind

MissionName = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$", examples=["MER2"])]
ScopeName = Annotated[
    str, Path(pattern=r"^[a-z0-9][a-z0-9_.-]{0,127}$", examples=["mer2-site0010-drive0064"])
]
Digest = Annotated[str, Path(pattern=r"^[0-9a-f]{16}$", description="of the product's recipe")]
ImageName = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]
Metres = Annotated[
    float,
    Query(ge=-HALF_SIDE_M, le=HALF_SIDE_M, allow_inf_nan=False, description="metres, local map"),
]
LAST_SOL = 1_000_000
"""Largest number that is a sol; a catalogue counts in 64 bits."""
LARGEST_ID = 2**63 - 1
"""Largest number of a database row."""
Zoom = Annotated[int, Path(ge=0, le=MAX_ZOOM)]
TileNumber = Annotated[int, Path(ge=0, le=LARGEST_ID)]
"""Column or row of the landing site's tile matrix set."""
FOREVER = {"Cache-Control": "public, max-age=31536000, immutable"}
"""The digest in the address changes with the content."""
REVALIDATE = {"Cache-Control": "no-cache"}
"""Revalidate each time."""


def _layer(scope: ScopeName, kind: ProductKind, digest: Digest, services: ServicesOf) -> Layer:
    return services.layer(scope, kind, digest)


LayerPath = Annotated[Layer, Depends(_layer)]
"""The published layer of a scope, kind and digest."""


async def _bounds(
    bbox: Annotated[
        str | None,
        Query(pattern=r"^[^,]+(,[^,]+){3}$", description="west,south,east,north in local metres"),
    ] = None,
) -> tuple[float, float, float, float] | None:
    if bbox is None:
        return None
    try:
        west, south, east, north = (float(text) for text in bbox.split(","))
    except ValueError:
        raise HTTPException(422, f"bbox={bbox}: west,south,east,north are numbers") from None
    if not (west <= east and south <= north):  # also refuses NaN
        raise HTTPException(422, f"bbox={bbox}: west <= east and south <= north are expected")
    return west, south, east, north


BBox = Annotated[tuple[float, float, float, float] | None, Depends(_bounds)]
"""(west, south, east, north) in metres of the local map, or None."""


def base_of(request: Request, mission: str) -> str:
    """The landing page of a mission, as the client wrote its host."""
    return f"{str(request.base_url).rstrip('/')}/ogc/{mission}"


async def _base(request: Request, mission: MissionName) -> str:
    return base_of(request, mission)


BaseOf = Annotated[str, Depends(_base)]
"""The address of the mission's landing page, without a slash at its end."""


def ground_of(mission: str, requested: str, services: Services) -> Ground:
    """The requested terrain models of a mission."""
    services.catalogue.mission(mission)
    return Ground.of(map_layers(mission, services), requested, services.store, services.pool)
