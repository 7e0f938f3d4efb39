"""glTF 2.0 binary (.glb): textured meshes that every viewer of three-dimensional models opens.

A file holds meshes of the local map. glTF's axes are right-handed with y up, so a point is written

    x = east - east_0,     y = up - up_0,     z = -(north - north_0)

in single precision relative to an origin near by, and the scene's one node is translated by the
origin: its children are in metres of the local map. What cannot be said in glTF (frame, CRS, units,
which products it was made from) stands in the `extras` of that node.

`PLAIN` files use nothing beyond the core of glTF. `QUANTISED` ones store positions in 16 bits
(65535 steps over the longest side of a mesh, 0.2 mm over 10 m), normals in 8 and places in textures
in 16, as KHR_mesh_quantization allows: half the size, read by all current viewers of tiles. `DRACO`
ones are as exact and a tenth of the size, but have to be decompressed (`products.draco`).
Textures are JPEG, grey or RGB. Equal input gives equal bytes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from solmap.photogrammetry.terrain.mesh.surface_mesh import TexturedMesh
from solmap.products.errors import ProductError
from solmap.products.glb import _MAGIC, _VERSION, Encoding, Glb


def write_glb(
    meshes: Sequence[TexturedMesh],
    origin: tuple[float, float, float],
    *,
    encoding: Encoding = Encoding.PLAIN,
    jpeg_quality: int = 90,
    notes: Mapping[str, Any] | None = None,
) -> bytes:
    """The bytes of a glTF binary with these meshes.

    Args:
        meshes: What to write; a mesh without triangles is left out.
        origin: East, north and up of a place near by, metres of the local map.
        encoding: How numbers are stored.
        jpeg_quality: Of the textures, percent.
        notes: Plain JSON values to keep with the file.

    Raises:
        ProductError: there is no triangle to write.
    """
    drawn = [mesh for mesh in meshes if len(mesh.mesh)]
    if not drawn:
        raise ProductError("a model without a triangle is nothing to look at; leave it out")
    file = Glb(encoding)
    for mesh in drawn:
        file.add(mesh, origin, jpeg_quality)
    return file.bytes(origin, dict(notes or {}))


def read_glb(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary part of a glTF binary.

    Raises:
        ProductError: it is none.
    """
    if data[:8] != struct.pack("<2I", _MAGIC, _VERSION):
        raise ProductError(f"a glTF 2.0 binary begins with b'glTF' and 2, not with {data[:8]!r}")
    try:
        (length,) = struct.unpack_from("<I", data, 12)
        document = json.loads(data[20 : 20 + length])
        (size,) = struct.unpack_from("<I", data, 20 + length)
    except (struct.error, ValueError) as error:
        raise ProductError(f"this glTF binary is broken: {error}; make it again") from error
    return document, data[28 + length : 28 + length + size]


def box_of_glb(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest (east, north, up) of all meshes of a file of ours, metres."""
    document, _ = read_glb(data)
    root, *nodes = document["nodes"]
    corners = []
    for node in nodes:
        part = document["meshes"][node["mesh"]]["primitives"][0]
        accessor = document["accessors"][part["attributes"]["POSITION"]]
        ends = np.array([accessor["min"], accessor["max"]], dtype=np.float64)
        corners.append(ends * node.get("scale", [1] * 3) + node.get("translation", [0] * 3))
    x, y, z = (np.concatenate(corners) + root["translation"]).T
    places = np.column_stack([x, -z, y])
    return places.min(axis=0), places.max(axis=0)
