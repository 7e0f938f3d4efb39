"""Tiles of values: what a browser shades from."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from solmap.gis_server.rendering.tiles import encode_values
from solmap.products.formats.raster.tiling import TileAddress, zoom_of
from solmap.products.model import ProductKind
from tests.support.tile_at import tile_at
from tests.support.value_tiles import decode_values
from tests.unit.gis_server.conftest import (
    CELL_M,
    GRID,
    UNSEEN_WEST_OF_M,
    elevation_at,
    ref_of,
)

OWN_ZOOM = zoom_of(CELL_M)


def requested(client, world, kind, address, **query):
    ref = ref_of(world, kind)
    place = f"{ref.scope.name}/{kind}/{ref.digest}"
    name = f"{address.zoom}/{address.column}/{address.row}.values"
    return client.get(f"/tiles/{place}/{name}", params=query)


heights = st.floats(-8e3, 2e4, width=32)


@given(
    values=arrays.arrays(
        np.float32, arrays.array_shapes(min_dims=2, max_dims=2), elements=heights | st.just(np.nan)
    ),
    finest=st.floats(1e-5, 1.0),
)
def test_values_are_decoded_to_half_a_step(values, finest):
    body = encode_values(values, finest)
    again = decode_values(body)
    np.testing.assert_array_equal(np.isnan(again), np.isnan(values))
    known = values[np.isfinite(values)]
    extent = float(known.max()) - float(known.min()) if known.size else 0.0
    coarsest = max(2 * extent / 65532, finest)  # the next power of two
    off = np.abs(again - values.astype(np.float64))[np.isfinite(values)]
    assert (off <= coarsest / 2 + 2e-3 * (np.abs(known) > 1e3) + np.spacing(np.abs(known))).all()


def test_shared_nodes_of_neighbouring_tiles_are_equal(client, world):
    """So that a browser's shading runs across the edge of tiles."""
    zoom = OWN_ZOOM
    west = tile_at(-0.1, -0.1, zoom)
    east = TileAddress(zoom, west.column + 1, west.row)
    south = TileAddress(zoom, west.column, west.row + 1)
    tiles = [
        decode_values(requested(client, world, ProductKind.DTM, at).content)
        for at in (west, east, south)
    ]
    assert all(tile.shape == (258, 258) for tile in tiles)
    np.testing.assert_array_equal(tiles[0][:, -2:], tiles[1][:, :2])
    np.testing.assert_array_equal(tiles[0][-2:], tiles[2][:2])


@pytest.mark.parametrize("zoom", [OWN_ZOOM - 2, OWN_ZOOM, OWN_ZOOM + 1])
def test_values_are_the_elevations_of_the_ground_at_every_zoom(client, world, zoom):
    address = tile_at(5.0, 5.0, zoom)
    values = decode_values(requested(client, world, ProductKind.DTM, address).content)
    west, north = address.west_north
    at = (np.arange(-1, 257) + 0.5) * address.cell_m
    east, north = (west + at)[None, :], (north - at)[:, None]
    there = (
        (east > UNSEEN_WEST_OF_M + 2 * address.cell_m)
        & (east < GRID.bounds[2] - address.cell_m)
        & (np.abs(north) < GRID.bounds[3] - address.cell_m)
    )
    assert there.sum() > 1000
    cell_m = max(address.cell_m, CELL_M)
    off = cell_m / 512 + (0.5 * CELL_M * 0.15 if address.cell_m < CELL_M else 1e-4)
    expected = np.broadcast_to(elevation_at(east, north), values.shape)
    np.testing.assert_allclose(values[there], expected[there], atol=off)


def test_another_band_is_requested_by_its_name(client, world):
    address = tile_at(5.0, 5.0, OWN_ZOOM)
    answer = requested(client, world, ProductKind.DTM, address, band="standard_deviation")
    np.testing.assert_allclose(decode_values(answer.content), 0.02, rtol=1e-6)
    unknown = requested(client, world, ProductKind.DTM, address, band="colour")
    assert unknown.status_code == 404
    assert "has no band colour; it has elevation, " in unknown.json()["detail"]


def test_unseen_ground_has_no_content(client, world):
    for east in (-39.0, 5_000.0):
        address = tile_at(east, 0.1, MAX if east < 0 else OWN_ZOOM)
        answer = requested(client, world, ProductKind.DTM, address)
        assert answer.status_code == 204
        assert answer.content == b""


MAX = 19
"""A zoom at which a tile lies wholly in the unseen west of the small world."""


def test_a_client_without_gzip_gets_the_plain_body(client, world):
    ref = ref_of(world, ProductKind.SLOPE)
    address = tile_at(5.0, 5.0, OWN_ZOOM)
    path = f"/tiles/{ref.scope.name}/slope/{ref.digest}/{OWN_ZOOM}/{address.column}/{address.row}"
    bodies = {}
    for encoding in ("gzip", "identity"):
        with client.stream(
            "GET", f"{path}.values", headers={"accept-encoding": encoding}
        ) as answer:
            bodies[encoding] = b"".join(answer.iter_raw())
            assert answer.headers.get("content-encoding") == (
                "gzip" if encoding == "gzip" else None
            )
            assert answer.headers["vary"] == "Accept-Encoding"
    assert gzip.decompress(bodies["gzip"]) == bodies["identity"]
    np.testing.assert_allclose(decode_values(bodies["identity"]), 20.0, atol=1e-3)


def test_an_image_has_no_values(client, world):
    address = tile_at(5.0, 5.0, OWN_ZOOM)
    answer = requested(client, world, ProductKind.ORTHOPHOTO, address)
    assert answer.status_code == 404
    assert "has images only" in answer.json()["detail"]
    layers = {layer["kind"]: layer for layer in client.get("/api/missions/MER2/layers").json()}
    assert layers["orthophoto"]["values"] is None
    assert layers["dtm"]["values"].endswith("/{z}/{x}/{y}.values")


@pytest.mark.parametrize("body", [b"", b"SMV1", b"PNG.....................", b"SMV1" + bytes(30)])
def test_invalid_value_tiles_are_refused(body):
    with pytest.raises(ValueError, match="tile of"):
        decode_values(body)


DOCUMENTED = Path(__file__).parents[3] / "docs" / "reference" / "http-api.md"


@pytest.mark.skipif(shutil.which("node") is None, reason="Node runs the documented decoder")
def test_the_documented_decoder_reads_the_tiles_of_the_server(tmp_path, rng):
    values = rng.normal(3.0, 1.0, (258, 258)).astype(np.float32)
    values[rng.random(values.shape) < 0.2] = np.nan
    (tmp_path / "tile.values").write_bytes(encode_values(values, 1e-3))
    decoder = re.search(r"```js\n(.*?)```", DOCUMENTED.read_text(), re.DOTALL)[1]
    script = tmp_path / "decode.mjs"
    script.write_text(
        'import { readFileSync, writeFileSync } from "node:fs";\n'
        'const body = readFileSync("tile.values");\n'
        "globalThis.fetch = async () => new Response(body);\n"
        f'{decoder}\nwriteFileSync("floats", await values("tile"));\n'
    )
    subprocess.run(["node", str(script)], check=True, cwd=tmp_path)  # noqa: S607 - the machine's
    shown = np.fromfile(tmp_path / "floats", np.float32).reshape(258, 258)
    np.testing.assert_array_equal(shown, decode_values(encode_values(values, 1e-3)))
