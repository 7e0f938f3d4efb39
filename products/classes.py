"""What the values of class layers mean, and the colours they are drawn in.

Colours keep apart without colour vision (Paul Tol's bright and muted sets): good ground is blue or
green, bad ground yellow to red, and lightness falls from one to the other.
"""

from __future__ import annotations

from solmap.photogrammetry.terrain.traversability.hazard import Hazard
from solmap.photogrammetry.terrain.visibility.viewshed import Sight
from solmap.products.formats.raster.cog import RasterClass

HAZARDS = (
    RasterClass(Hazard.TRAVERSABLE, "traversable", "#44bb99"),
    RasterClass(Hazard.ROUGH, "too rough", "#eedd88"),
    RasterClass(Hazard.STEP, "step too high", "#ee8866"),
    RasterClass(Hazard.STEEP, "too steep", "#aa3377"),
)
SIGHTS = (
    RasterClass(Sight.VISIBLE, "visible", "#77aadd"),
    RasterClass(Sight.HIDDEN, "hidden", "#664422"),
)
