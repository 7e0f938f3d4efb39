"""Solids over the server."""

from __future__ import annotations

import numpy as np
import pytest

from products.stl import read_stl

pytestmark = pytest.mark.slow  # a world is rendered first


def test_the_terrain_of_a_stop_is_handed_out_as_a_solid(stereo, stereo_client):
    layer = next(
        one for one in stereo.workspace.catalogue.layers("MER2") if str(one.ref.kind) == "dtm"
    )
    path = f"/models/{layer.ref.scope.name}/dtm/{layer.ref.digest}/terrain.stl"
    answer = stereo_client.get(path, params={"base_m": 1.0, "tolerance_m": 0.1})
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "model/stl"
    corners = read_stl(answer.content).astype(np.float64)
    a, b, c = np.moveaxis(corners, 1, 0)
    inside = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert 200 < inside < 1000  # 16 m x 16 m, a metre and more high
    assert np.ptp(corners[..., 0]) == pytest.approx(16.0, abs=10.24)
    assert stereo_client.get(path, params={"base_m": -1}).status_code == 422
