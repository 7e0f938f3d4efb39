"""A small store in which most questions to the server find something, and the names of it.

python -m tests.support.fuzz_store FOLDER

Layers of the bowl, whose rasters and features are known; with `images` also the traverse of true
images with its network, which takes some twenty seconds to render.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

from solmap.products.catalogue.tokens import Role, Tokens
from solmap.products.catalogue.workspace import Workspace
from tests.support import bowl_store, stereo_viewer

OPERATOR = "fuzz"


def fill(root: Path, *, images: bool) -> str:
    """Fill the store at `root`; the token of an operator."""
    if images:
        stereo_viewer.fill(root)
    workspace = Workspace.open(root)
    # The bowl's images are labels without pixels: none of them, so that every image can be shown.
    catalogue = type(workspace.catalogue)
    published = catalogue.publish

    def without_images(self: Any, **parts: Any) -> Any:
        return published(self, **{name: part for name, part in parts.items() if name != "images"})

    with patch.object(catalogue, "publish", without_images):
        bowl_store.fill(workspace)
    _, text = Tokens.of(root).add(OPERATOR, Role.OPERATOR)
    return text


def names(root: Path) -> list[dict[str, Any]]:
    """Parameters of paths that belong together."""
    catalogue = Workspace.open(root).catalogue
    tiling = {"tms": "Columbia-Memorial-Station", "style": "default"}
    tile = {"z": 17, "x": 65536, "y": 65535, "zoom": 17, "row": 65535, "column": 65536}
    rows = [
        {
            "mission": "MER2",
            "scope": layer.ref.scope.name,
            "kind": str(layer.ref.kind),
            "digest": layer.ref.digest,
            "suffix": "tif" if layer.type == "raster" else "geojson",
            "collection": f"{layer.ref.scope.name}.{layer.ref.kind}",
            **tiling,
            **tile,
        }
        for layer in catalogue.layers("MER2")
    ]
    rows += [
        {"mission": "MER2", "image": entry.id, "style": style, "z": 1, "x": 0, "y": 0}
        for entry in catalogue.images("MER2")[::5]
        for style in ("raw", "stretched", "linearised", "anaglyph")
    ]
    kinds = ("stops", "images", "footprints", "tie-points", "contours", "annotations")
    rows += [{"mission": "MER2", "collection": kind, "feature": "1"} for kind in kinds]
    rows += [{"mission": "MSL"}, {"mission": "MER2", "number": 1, "name": "map"}]
    return rows


if __name__ == "__main__":
    print(fill(Path(sys.argv[1]), images=True))  # noqa: T201
