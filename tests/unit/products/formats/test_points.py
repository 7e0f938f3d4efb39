"""Point clouds on disk: PLY and tiles of points, read back."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud
from solmap.photogrammetry.terrain.mesh.surface_mesh import TilePlace
from solmap.products.errors import ProductError
from solmap.products.formats.mesh.gltf import read_glb, write_points
from solmap.products.formats.mesh.ply import read_ply, write_ply
from solmap.products.formats.mesh.tiles3d import TilesetWriter, read_tileset
from tests.support.gltf_validator import validate_glb


@pytest.fixture
def cloud():
    rng = np.random.default_rng(3)
    points = rng.uniform((100.0, -250.0, 3.0), (112.0, -240.0, 5.0), (5000, 3))
    grey = rng.integers(0, 256, 5000, dtype=np.uint8)
    return PointCloud(points, grey, rng.uniform(0, 0.05, 5000).astype(np.float32), 0.02)


def test_a_ply_file_has_every_point_unchanged(tmp_path, cloud):
    path = tmp_path / "cloud.ply"
    write_ply(path, cloud, {"crs": 'ENGCRS["local\nmap"]', "inputs": ["a", "b"]})
    rows = read_ply(path)
    np.testing.assert_array_equal(np.column_stack([rows[k] for k in "xyz"]), cloud.points)
    for name in ("red", "green", "blue"):
        np.testing.assert_array_equal(rows[name], cloud.grey)
    np.testing.assert_array_equal(rows["sigma"], cloud.sigma_m)
    head = path.read_bytes()[:400]
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b'comment crs: ENGCRS["local map"]\ncomment inputs: a b\nelement vertex 5000\n' in head


def test_a_truncated_file_is_reported(tmp_path, cloud):
    path = tmp_path / "cloud.ply"
    write_ply(path, cloud, {})
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ProductError, match="does not contain its 5000 points"):
        read_ply(path)
    path.write_bytes(b"ply of another kind")
    with pytest.raises(ProductError, match="not a point cloud of solmap"):
        read_ply(path)


def test_points_of_a_tile_are_exact_to_a_sixteenth_of_a_millimetre(cloud):
    document, data = read_glb(write_points(cloud))
    view = document["bufferViews"][0]
    stored = np.frombuffer(data, "<u2", 5000 * 4, view["byteOffset"]).reshape(-1, 4)[:, :3]
    node = document["nodes"][0]
    x, y, z = (stored * node["scale"] + node["translation"]).T
    np.testing.assert_allclose(np.column_stack([x, -z, y]), cloud.points, atol=0.0001)
    assert document["meshes"][0]["primitives"][0]["mode"] == 0
    sigma = np.frombuffer(data, "<f4", 5000, document["bufferViews"][2]["byteOffset"])
    np.testing.assert_array_equal(sigma, cloud.sigma_m)


def test_tiles_of_points_add_up_to_the_cloud(tmp_path, cloud):
    path = tmp_path / "cloud.3tz"
    half = np.arange(len(cloud)) < 2500
    with TilesetWriter(path, {}, refine="ADD") as writer:
        for level, part in ((1, cloud.part(half)), (0, cloud.part(~half))):
            writer.add(TilePlace(level, 0, 0), write_points(part), part.points, 0.2)
    root = read_tileset(path)["root"]
    assert root["refine"] == "ADD"
    assert root["children"][0]["refine"] == "ADD"


VIEWER = Path(__file__).resolve().parents[4] / "gis_server" / "viewer"
LOADER = VIEWER / "node_modules" / "three" / "examples" / "jsm" / "loaders" / "PLYLoader.js"
READ = """
import { readFileSync } from "node:fs";
import { PLYLoader } from "three/examples/jsm/loaders/PLYLoader.js";
const loader = new PLYLoader();
loader.setCustomPropertyNameMapping({ sigma: ["sigma"] });
const bytes = readFileSync(process.argv[1]);
const { buffer, byteOffset, length } = bytes;
const geometry = loader.parse(buffer.slice(byteOffset, byteOffset + length));
const { position, color, sigma } = geometry.attributes;
const last = position.count - 1;
console.log(JSON.stringify({
  count: position.count,
  last: [position.getX(last), position.getY(last), position.getZ(last)],
  red: color.getX(last),
  sigma: sigma.getX(last),
}));
"""


@pytest.fixture
def white_cloud():
    rng = np.random.default_rng(3)
    points = rng.uniform((-5.0, -5.0, 0.0), (5.0, 5.0, 1.0), (300, 3))
    grey = np.full(300, 255, np.uint8)
    return PointCloud(points, grey, np.full(300, 0.03, np.float32), 0.02)


def test_three_js_reads_every_point_of_a_ply_file(tmp_path, white_cloud):
    node = shutil.which("node")
    if node is None or not LOADER.is_file():
        pytest.skip("Node or the viewer's packages are not here: run `make viewer`")
    path = tmp_path / "cloud.ply"
    write_ply(path, white_cloud, {"axes": "east, north, up"})
    command = [node, "--input-type=module", "-e", READ, str(path)]
    out = subprocess.run(command, cwd=VIEWER, check=True, capture_output=True, text=True).stdout
    read = json.loads(out)
    assert read["count"] == 300
    np.testing.assert_allclose(read["last"], white_cloud.points[-1], atol=1e-6)
    assert read["red"] == pytest.approx(1.0, abs=0.01)
    assert read["sigma"] == pytest.approx(0.03, abs=1e-6)


def test_the_validator_of_gltf_finds_no_fault_in_a_tile_of_points(tmp_path, white_cloud):
    path = tmp_path / "tile.glb"
    path.write_bytes(write_points(white_cloud))
    report = validate_glb(path)
    assert report["issues"]["numErrors"] == 0, report["issues"]
    assert report["info"]["totalVertexCount"] == 300
