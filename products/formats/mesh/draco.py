"""Draco compression of a mesh by KHR_draco_mesh_compression: to a tenth of the size.

Positions keep 16 bits over the longest side, as quantised files do, texture coordinates 14 and
normals 8. Draco reorders triangles and splits vertices, so the compressed mesh is decoded for its
counts, its bounds and the numbers of its attributes.
"""

from __future__ import annotations

from dataclasses import dataclass

import DracoPy  # type: ignore[import-not-found]  # a module without types
import numpy as np

POSITION_BITS, NORMAL_BITS, PLACE_BITS = 16, 8, 14
LEVEL = 4
"""Compression, 0 to 10: 7 takes twice as long, here and in browsers, and saves a fourteenth."""
_NAMES = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}
"""Draco's types of attributes, by their names in glTF."""


@dataclass(frozen=True, slots=True, eq=False)
class Compressed:
    """A compressed mesh, with the data for its glTF."""

    data: bytes
    attributes: dict[str, int]
    """Draco's number of every attribute, by its name in glTF."""
    vertices: int
    triangles: int
    low: list[float]
    """Least and largest position."""
    high: list[float]


def compress(
    positions: np.ndarray, normals: np.ndarray, places: np.ndarray, triangles: np.ndarray
) -> Compressed:
    """A mesh compressed by Draco."""
    data: bytes = DracoPy.encode(
        positions.astype(np.float64),
        triangles.astype(np.uint32),
        quantization_bits=POSITION_BITS,
        compression_level=LEVEL,
        normals=normals.astype(np.float64),
        normal_quantization_bits=NORMAL_BITS,
        tex_coord=places.astype(np.float64),
        tex_coord_quantization_bits=PLACE_BITS,
    )
    made = DracoPy.decode(data)
    numbers = {_NAMES[one["attribute_type"]]: int(one["unique_id"]) for one in made.attributes}
    points = np.asarray(made.points, dtype=np.float32)
    return Compressed(
        data=data,
        attributes=numbers,
        vertices=len(points),
        triangles=len(made.faces),
        low=points.min(axis=0).tolist(),
        high=points.max(axis=0).tolist(),
    )
