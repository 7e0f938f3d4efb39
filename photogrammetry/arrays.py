"""Array types with shape, unit and frame conventions in their names.

Every run of the unit tests checks the axis names at each call (`tests/unit/conftest.py`), so
a transposed array fails at the function that received it. NaN means "not measured".
"""

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, UInt8, UInt16

Vector3: TypeAlias = Float64[np.ndarray, " 3"]
"""One vector, in metres or without unit, in the frame in its name."""

Rotation: TypeAlias = Float64[np.ndarray, "3 3"]
"""A proper rotation matrix, acting on column vectors from the left."""

Quaternion: TypeAlias = Float64[np.ndarray, " 4"]
"""A unit quaternion, scalar first."""

ImagePoints: TypeAlias = Float64[np.ndarray, "n 2"]
"""(sample, line) in pixels; (0, 0) is the centre of the first pixel."""

ObjectPoints: TypeAlias = Float64[np.ndarray, "n 3"]
"""(x, y, z) in metres, in the frame that the parameter's name gives."""

Directions: TypeAlias = Float64[np.ndarray, "n 3"]
"""Unit vectors, in the frame that the parameter's name gives."""

Covariance3: TypeAlias = Float64[np.ndarray, "3 3"]
"""Covariance of one point (square metres), direction or rotation (square radians)."""

Covariances3: TypeAlias = Float64[np.ndarray, "n 3 3"]
"""Covariance matrices of object points, square metres."""

PerPoint: TypeAlias = Float64[np.ndarray, " n"]
"""One number per point, in the unit in its name."""

Flags: TypeAlias = Bool[np.ndarray, " n"]
"""One truth value per point."""

GreyImage: TypeAlias = Float32[np.ndarray, "lines samples"]
"""Grey values (DN or radiance); rows run down the image. Check the mask before using a value."""

Mask: TypeAlias = Bool[np.ndarray, "lines samples"]
"""True where the pixel was measured and may be used."""

ParallaxMap: TypeAlias = Float32[np.ndarray, "lines samples"]
"""Left sample minus right sample on the epipolar line, in pixels; NaN where not matched."""

EightBits: TypeAlias = UInt8[np.ndarray, "lines samples *bands"]
"""An eight-bit image for display."""

Raster: TypeAlias = Float32[np.ndarray, "rows cols"]
"""Cell values of a map; row 0 is the northernmost. NaN where nothing was measured."""

Classes: TypeAlias = UInt8[np.ndarray, "rows cols"]
"""Class codes of map cells."""

__all__ = [
    "Bool",
    "Classes",
    "Covariance3",
    "Covariances3",
    "Directions",
    "EightBits",
    "Flags",
    "Float",
    "Float32",
    "Float64",
    "GreyImage",
    "ImagePoints",
    "Int32",
    "Mask",
    "ObjectPoints",
    "ParallaxMap",
    "PerPoint",
    "Quaternion",
    "Raster",
    "Rotation",
    "UInt8",
    "UInt16",
    "Vector3",
]
