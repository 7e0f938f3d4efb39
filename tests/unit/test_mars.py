import math

import numpy as np
import pytest

from solmap.photogrammetry.mars import map_from_lsl, planetographic


def test_the_map_is_the_tangent_plane_seen_from_above(test_vectors):
    for row in test_vectors["map_coordinates"]["points"]:
        east, north = row["east_north_m"]
        in_lsl = np.array([[north, east, 5.0]])
        np.testing.assert_array_equal(map_from_lsl(in_lsl), [[east, north, -5.0]])


def test_planetographic_latitude_equals_that_of_the_facts(test_vectors):
    row = test_vectors["map_coordinates"]["latitudes"]
    centric, graphic = (math.radians(row[f"planeto{kind}_deg"]) for kind in ("centric", "graphic"))
    assert planetographic(centric) == pytest.approx(graphic, abs=1e-10)
