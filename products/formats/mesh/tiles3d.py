"""3D Tiles 1.1: a quadtree of glTF tiles with levels of detail, in one archive (.3tz).

A tileset has many small files. A product is one file with one checksum, so the tileset is stored in
the usual archive format: 3TZ, a ZIP whose members a server reads one by one, with an index of their
offsets at the end (MD5 of the name, offset; in the order of the hashes). Unpacked by any ZIP
program it is a folder for a plain web server. Members except the JSON are stored, not deflated,
because images are compressed already.

Tiles contain glTF with y up, which viewers of 3D Tiles rotate to z up: coordinates of the tileset
are (east, north, up) in metres of the mission's local map. There is no globe in it and no
transform; `asset.extras` names the CRS. A tile's geometric error is in metres, and is chosen so
that the texture is sharp as well: a viewer that allows 16 pixels of error shows a texel on two
pixels.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np

from solmap.photogrammetry.arrays import ObjectPoints
from solmap.photogrammetry.terrain.mesh.surface_mesh import TilePlace
from solmap.products.errors import BrokenProductError, ProductError, ProductNotFoundError

TILESET = "tileset.json"
_INDEX = "@3dtilesIndex1@"
_DAY_ONE = (1980, 1, 1, 0, 0, 0)
"""The date of all members: equal input gives equal bytes."""
TEXELS = 8.0
"""Least geometric error of a tile, in texels."""

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Least and largest (east, north, up), metres."""


@dataclass(frozen=True, slots=True)
class _Tile:
    box: Box
    error_m: float
    uri: str


@dataclass(slots=True)
class TilesetWriter:
    """Writes the tiles of one tileset in any order, and then the tree of them."""

    path: Path
    notes: Mapping[str, Any]
    refine: Literal["REPLACE", "ADD"] = "REPLACE"
    """Whether finer tiles replace a coarser one, or add to it, as points do."""
    _archive: zipfile.ZipFile = field(init=False)
    _tiles: dict[TilePlace, _Tile] = field(init=False, default_factory=dict)

    def __enter__(self) -> Self:
        """Open the archive."""
        self._archive = zipfile.ZipFile(self.path, "w", allowZip64=True)
        return self

    def add(self, place: TilePlace, glb: bytes, points: ObjectPoints, error_m: float) -> None:
        """Add a tile: its file, its content, and the error of showing it instead of finer ones."""
        uri = f"{place.level}/{place.row}-{place.col}.glb"
        self._put(uri, glb)
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        self._tiles[place] = _Tile((tuple(low), tuple(high)), error_m, uri)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """Write the tree and the index, unless there was an error."""
        with self._archive:
            if kind is None:
                document = _document(self._tiles, self.notes, self.refine)
                self._put(TILESET, _json(document), zipfile.ZIP_DEFLATED)
                self._put(_INDEX, _index_of(self._archive.infolist()))

    def _put(self, name: str, data: bytes, method: int = zipfile.ZIP_STORED) -> None:
        info = zipfile.ZipInfo(name, _DAY_ONE)
        info.compress_type = method
        self._archive.writestr(info, data)


def _json(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode()


def _index_of(members: Iterable[zipfile.ZipInfo]) -> bytes:
    """Hash of the name and offset of every member, in the order of the hashes' two numbers."""
    hashed = [
        (hashlib.md5(m.filename.encode(), usedforsecurity=False).digest(), m.header_offset)
        for m in members
    ]
    hashed.sort(key=lambda entry: struct.unpack("<2Q", entry[0]))
    return b"".join(digest + struct.pack("<Q", offset) for digest, offset in hashed)


def _document(
    tiles: Mapping[TilePlace, _Tile], notes: Mapping[str, Any], refine: str
) -> dict[str, Any]:
    if not tiles:
        raise ProductError("a tileset without tiles is empty; leave it out")
    nodes = {place: _node(tile, place.level, refine) for place, tile in tiles.items()}
    root = max(nodes)
    for place, node in sorted(nodes.items()):
        if place != root:
            nodes[_shown_by(place, nodes)].setdefault("children", []).append(node)
    for place in sorted(nodes):  # finest first: a tile's box contains those of its children
        _widen(nodes[place])
    return tileset_document([nodes[root]], notes)


def _shown_by(place: TilePlace, nodes: Mapping[TilePlace, Any]) -> TilePlace:
    """The next coarser existing tile; narrow strips of ground may be missing at coarser levels."""
    above = place.parent
    while above not in nodes and above.level < max(nodes).level:
        above = above.parent
    return above if above in nodes else max(nodes)


def _node(tile: _Tile, level: int, refine: str) -> dict[str, Any]:
    return {
        "boundingVolume": {"box": _volume(tile.box)},
        "geometricError": tile.error_m if level else 0.0,
        "refine": refine,
        "content": {"uri": tile.uri},
    }


def _widen(node: dict[str, Any]) -> None:
    boxes = [box_of(node["boundingVolume"]["box"])]
    boxes += [box_of(child["boundingVolume"]["box"]) for child in node.get("children", [])]
    node["boundingVolume"]["box"] = _volume(_union(boxes))


def tileset_document(roots: list[dict[str, Any]], notes: Mapping[str, Any]) -> dict[str, Any]:
    """A `tileset.json` of one tile, or of several under a root without its own content."""
    box = _union([box_of(root["boundingVolume"]["box"]) for root in roots])
    extent = max(high - low for low, high in zip(*box, strict=True))
    root = roots[0]
    if len(roots) > 1:
        root = {
            "boundingVolume": {"box": _volume(box)},
            "geometricError": extent,
            "refine": "ADD",
            "children": roots,
        }
    extras = {"axes": "east, north, up of the local map", "unit": "metre", **notes}
    return {
        "asset": {"version": "1.1", "extras": extras},
        "geometricError": extent,
        "root": root,
    }


def external_tileset(uri: str, document: Mapping[str, Any]) -> dict[str, Any]:
    """The tile that refers to another tileset in a larger one."""
    return {
        "boundingVolume": document["root"]["boundingVolume"],
        "geometricError": document["geometricError"],
        "refine": "ADD",
        "content": {"uri": uri},
    }


def _union(boxes: list[Box]) -> Box:
    low = np.min([box[0] for box in boxes], axis=0).tolist()
    high = np.max([box[1] for box in boxes], axis=0).tolist()
    return tuple(low), tuple(high)


def _volume(box: Box) -> list[float]:
    """A box in the format of 3D Tiles: its middle and its three half axes."""
    low, high = (np.array(corner) for corner in box)
    half = np.diag((high - low) / 2)
    return [*((low + high) / 2).tolist(), *half.ravel().tolist()]


def box_of(volume: list[float]) -> Box:
    """Least and largest coordinates of a bounding volume along the axes of the map."""
    middle, half = np.array(volume[:3]), np.abs(np.array(volume[3:])).reshape(3, 3).sum(axis=0)
    return tuple((middle - half).tolist()), tuple((middle + half).tolist())


def read_member(path: Path, name: str) -> bytes:
    """One file of a tileset.

    Raises:
        ProductNotFoundError: the tileset has no such file.
        ProductError: the archive is broken.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.read(name)
    except KeyError as error:
        raise ProductNotFoundError(f"{path.name} has no member {name!r}") from error
    except (OSError, zipfile.BadZipFile) as error:
        raise BrokenProductError(f"{path.name} is not a tileset: {error}") from error


def read_tileset(path: Path) -> dict[str, Any]:
    """The tree of a tileset's tiles."""
    document: dict[str, Any] = json.loads(read_member(path, TILESET))
    return document
