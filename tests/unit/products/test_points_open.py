"""Point clouds in programs that are not ours."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud
from solmap.products.formats.mesh.gltf import write_points
from solmap.products.formats.mesh.ply import write_ply
from tests.support.gltf_validator import validate_glb

VIEWER = Path(__file__).resolve().parents[3] / "gis_server" / "viewer"
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
def cloud():
    rng = np.random.default_rng(3)
    points = rng.uniform((-5.0, -5.0, 0.0), (5.0, 5.0, 1.0), (300, 3))
    grey = np.full(300, 255, np.uint8)
    return PointCloud(points, grey, np.full(300, 0.03, np.float32), 0.02)


def test_three_js_reads_every_point_of_a_ply_file(tmp_path, cloud):
    node = shutil.which("node")
    if node is None or not LOADER.is_file():
        pytest.skip("Node or the viewer's packages are not here: run `make viewer`")
    path = tmp_path / "cloud.ply"
    write_ply(path, cloud, {"axes": "east, north, up"})
    command = [node, "--input-type=module", "-e", READ, str(path)]
    out = subprocess.run(command, cwd=VIEWER, check=True, capture_output=True, text=True).stdout
    read = json.loads(out)
    assert read["count"] == 300
    np.testing.assert_allclose(read["last"], cloud.points[-1], atol=1e-6)
    assert read["red"] == pytest.approx(1.0, abs=0.01)
    assert read["sigma"] == pytest.approx(0.03, abs=1e-6)


def test_the_validator_of_gltf_finds_no_fault_in_a_tile_of_points(tmp_path, cloud):
    path = tmp_path / "tile.glb"
    path.write_bytes(write_points(cloud))
    report = validate_glb(path)
    assert report["issues"]["numErrors"] == 0, report["issues"]
    assert report["info"]["totalVertexCount"] == 300
