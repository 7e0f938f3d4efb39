"""Relief of a whole terrain model, put together from its parts."""

import numpy as np

from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.parts import Terrain
from solmap.photogrammetry.terrain.relief.slope import Relief, SlopeParams, relief_parts


def whole_relief(terrain: Terrain, params: SlopeParams) -> tuple[Relief, MapGrid]:
    """Relief and its grid; NaN outside of all parts."""
    parts, grid = relief_parts(terrain, params)
    layers = np.full((5, *grid.shape), np.nan, np.float32)
    for own, part in parts:
        layers[:, *own] = part.layers
    return Relief(layers[:3], layers[3], layers[4]), grid
