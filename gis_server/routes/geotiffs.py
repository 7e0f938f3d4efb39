"""Answers that are GeoTIFFs made for the question."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from fastapi import Response

from solmap.gis_server.routes.parameters import AGAIN


def geotiff(name: str, write: Callable[[Path], None]) -> Response:
    """A GeoTIFF to be kept as `name`, as `write` writes it to a path."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        body = path.read_bytes()
    disposition = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(body, media_type="image/tiff", headers={**AGAIN, **disposition})
