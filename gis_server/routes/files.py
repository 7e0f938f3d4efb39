"""A product's file over HTTP, whole or by ranges, from a folder or out of an object store.

Objects are streamed through: who may read the map needs no key of the object store, and need not
even reach it.
"""

from __future__ import annotations

import re
from pathlib import Path

from fastapi import HTTPException, Request, Response
from fastapi.responses import FileResponse, StreamingResponse

from solmap.gis_server.routes.parameters import FOREVER
from solmap.products.model import ProductRef
from solmap.products.store.product_store import ProductStore

_RANGE = re.compile(r"bytes=(\d*)-(\d*)$", re.ASCII)
_UNSATISFIABLE = 416


def product_response(
    ref: ProductRef,
    store: ProductStore,
    request: Request,
    media_type: str,
    filename: str | None = None,
) -> Response:
    """A product's file, or the one range of it that is asked for.

    Raises:
        ProductNotFoundError: it is not in the store.
        StoreAwayError: the object store does not answer.
    """
    if isinstance(store.address(ref), Path):
        path = store.path(ref)
        return FileResponse(path, media_type=media_type, filename=filename, headers=FOREVER)
    size = store.size(ref)
    headers = {**FOREVER, "accept-ranges": "bytes", "etag": f'"{ref.digest}"'}
    if filename is not None:
        headers["content-disposition"] = f'attachment; filename="{filename}"'
    asked = _asked(request, size, headers["etag"])
    start, end = asked or (0, size)
    status = 206 if asked else 200
    if asked:
        headers["content-range"] = f"bytes {start}-{end - 1}/{size}"
    headers["content-length"] = str(end - start)
    if request.method == "HEAD":
        return Response(status_code=status, headers=headers, media_type=media_type)
    body = store.chunks(ref, start, end)
    return StreamingResponse(body, status, headers=headers, media_type=media_type)


def _asked(request: Request, size: int, tag: str) -> tuple[int, int] | None:
    """First byte of a range, and the one after its last; None where one range is not asked for.

    Raises:
        HTTPException: the range lies beyond the file.
    """
    found = _RANGE.match(request.headers.get("range", "").replace(" ", ""))
    if found is None or request.headers.get("if-range", tag) != tag or found[0] == "bytes=-":
        return None
    first, last = found[1], found[2]
    start = int(first) if first else max(0, size - int(last))
    end = min(size, int(last) + 1) if first and last else size
    if start >= end:
        raise HTTPException(
            _UNSATISFIABLE,
            f"the file has {size} bytes",
            headers={"content-range": f"bytes */{size}"},
        )
    return start, end
