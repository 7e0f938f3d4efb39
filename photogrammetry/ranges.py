"""Ranges of parameters: the permitted values in pipeline files.

A parameter record names the range of a field as its type, `cell_m: CellSize = 0.04`. The reader of
files (`config.records`) rejects values outside, and the documentation shows the range. Upper limits
are far above sensible values: they prevent a typing error from filling the memory.
"""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Interval, Predicate


def is_odd(value: int) -> bool:
    """Whether a number is odd, as for sides of windows with a middle."""
    return value % 2 == 1


Freedoms = Annotated[float, Interval(gt=0.0, le=1e9)]
"""Degrees of freedom."""
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
ShareAboveZero = Annotated[float, Interval(gt=0.0, le=1.0)]
Factor = Annotated[float, Interval(gt=0.0, le=1000.0)]
FactorOrZero = Annotated[float, Interval(ge=0.0, le=1000.0)]
FactorFromOne = Annotated[float, Interval(ge=1.0, le=1000.0)]

MOST_SIDE = 20_000
"""Cells per side of a map that is held in memory; each layer of this size takes 1.6 GB."""

CellSize = Annotated[float, Interval(ge=0.005, le=100.0)]
"""Side of a cell on the map, metres."""
Metres = Annotated[float, Interval(gt=0.0, le=10_000.0)]
MetresOrZero = Annotated[float, Interval(ge=0.0, le=10_000.0)]
ShortMetres = Annotated[float, Interval(gt=0.0, le=100.0)]
"""Side of a window of cells."""
ShortMetresOrZero = Annotated[float, Interval(ge=0.0, le=100.0)]
SquareMetres = Annotated[float, Interval(gt=0.0, le=1e6)]
NearestMetres = Annotated[float, Interval(ge=0.1, le=1000.0)]
"""Distance from a camera to the nearest ground; limits the search range."""
ContourInterval = Annotated[float, Interval(ge=0.001, le=1000.0)]

Pixels = Annotated[float, Interval(gt=0.0, le=1000.0)]
PixelsOrZero = Annotated[float, Interval(ge=0.0, le=1000.0)]
Parallax = Annotated[float, Interval(ge=-1000.0, le=1000.0)]
WholeParallax = Annotated[int, Interval(ge=-1000, le=1000)]
WholePixels = Annotated[int, Interval(ge=1, le=8192)]
OddPixels = Annotated[int, Interval(ge=3, le=101), Predicate(is_odd)]
HalfWindow = Annotated[int, Interval(ge=3, le=100)]

Radians = Annotated[float, Interval(gt=0.0, le=math.pi)]
AzimuthStep = Annotated[float, Interval(ge=1e-4, le=math.pi)]
Degrees = Annotated[float, Interval(gt=0.0, le=180.0)]
Slope = Annotated[float, Interval(gt=0.0, le=90.0)]
Elevation = Annotated[float, Interval(ge=0.0, le=90.0)]
Tilt = Annotated[float, Interval(ge=-90.0, le=90.0)]
Azimuth = Annotated[float, Interval(ge=-360.0, le=360.0)]
SolarLongitude = Annotated[float, Interval(ge=0.0, le=360.0)]
OpticalDepth = Annotated[float, Interval(ge=0.0, le=20.0)]
PanoramaPixel = Annotated[float, Interval(ge=0.0, le=10.0)]

Count = Annotated[int, Interval(ge=1, le=1_000_000)]
CountOrZero = Annotated[int, Interval(ge=0, le=1_000_000)]
Few = Annotated[int, Interval(ge=1, le=1000)]
FewOrZero = Annotated[int, Interval(ge=0, le=1000)]
MapCells = Annotated[int, Interval(ge=10_000, le=100_000_000)]
Percent = Annotated[int, Interval(ge=0, le=100)]
JpegQuality = Annotated[int, Interval(ge=1, le=100)]
Tolerance = Annotated[float, Interval(gt=0.0, le=1.0)]
