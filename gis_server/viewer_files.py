"""The viewer's files: compressed by its build; kept forever where the name tells the content."""

from __future__ import annotations

import os
from pathlib import PurePosixPath

from fastapi.staticfiles import StaticFiles
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

_ENCODINGS = {"br": ".br", "gzip": ".gz"}
"""Best first, and what the build adds to the name of a file."""
_FOREVER = "public, max-age=31536000, immutable"
_PINNED = "assets"
"""Folder of files whose names carry a digest of their content."""


class ViewerFiles(StaticFiles):
    """Static files beside which the build laid compressed ones."""

    def file_response(
        self,
        full_path: str | os.PathLike[str],
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        """The file, compressed as the browser accepts it."""
        accepted = _accepted(Headers(scope=scope).get("accept-encoding", ""))
        plain, used = os.fspath(full_path), None
        for encoding, suffix in _ENCODINGS.items():
            if encoding in accepted and os.path.isfile(plain + suffix):  # noqa: PTH113 - cheapest
                full_path, used = plain + suffix, encoding
                stat_result = os.stat(full_path)  # noqa: PTH116 - what the parent hands on
                break
        # Its type is told by its name: that of a file `name.js.br` is that of `name.js`.
        answer = super().file_response(full_path, stat_result, scope, status_code)
        if used:
            answer.headers["content-encoding"] = used
        answer.headers["vary"] = "Accept-Encoding"
        is_pinned = _PINNED in PurePosixPath(scope["path"]).parts
        answer.headers["cache-control"] = _FOREVER if is_pinned else "no-cache"
        return answer


def _accepted(header: str) -> set[str]:
    """Names of encodings in an Accept-Encoding header, without those of weight 0."""
    parts = (part.replace(" ", "").lower().partition(";") for part in header.split(","))
    return {name for name, _, weight in parts if weight not in {"q=0", "q=0.0"}}
