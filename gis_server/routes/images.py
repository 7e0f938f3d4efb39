"""The rover's images: a picture to look at and the original file."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import FileResponse

from gis_server.routes.parameters import AGAIN, ImageName
from gis_server.services import ServicesOf

router = APIRouter(prefix="/images", tags=["images"])


@router.get("/{image}/browse.png", response_class=FileResponse)
def browse(image: ImageName, services: ServicesOf) -> FileResponse:
    """The image stretched to eight bits."""
    path = services.store.path(services.catalogue.image(image).browse)
    return FileResponse(path, media_type="image/png", headers=AGAIN)


@router.head("/{image}/original", include_in_schema=False)
@router.get("/{image}/original", response_class=FileResponse)
def original(image: ImageName, services: ServicesOf) -> FileResponse:
    """The file as the rover sent it, label and all."""
    entry = services.catalogue.image(image)
    path = services.store.path(entry.ref)
    return FileResponse(
        path,
        media_type="application/octet-stream",
        filename=f"{entry.id}{path.suffix}",
        headers=AGAIN,
    )
