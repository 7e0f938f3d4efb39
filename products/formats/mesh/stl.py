"""Solids as binary STL, the common format of 3D printing.

Metres of the local map (east, north, up), relative to a nearby origin because of single precision:
the 80 bytes of the header name it. STL has no units; printing programs take millimetres, so that 1
m is printed as 1 mm, a model at 1 : 1000.
"""

from __future__ import annotations

import struct

import numpy as np

from solmap.photogrammetry.terrain.mesh.solid import Solid

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
_HEADER = 80


def stl_bytes(solid: Solid) -> bytes:
    """The bytes of a binary STL file."""
    east, north, up = np.round(solid.points.mean(axis=0)).tolist()
    facets = np.zeros(len(solid.triangles), _FACET)
    corners = (solid.points - [east, north, up]).astype("<f4")[solid.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    facets["normal"] = normal / np.where(length > 0, length, 1)
    facets["corners"] = corners
    text = f"solmap: metres east, north, up from {east:.0f} {north:.0f} {up:.0f}"
    return text.encode().ljust(_HEADER, b" ") + struct.pack("<I", len(facets)) + facets.tobytes()
