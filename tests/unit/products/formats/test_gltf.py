"""glTF binaries: valid by Khronos' validator, and the same surface when read back."""

import cv2
import DracoPy
import numpy as np
import pytest
from scipy.spatial import cKDTree

from solmap.photogrammetry.terrain.mesh.surface_mesh import (
    SurfaceMesh,
    TexturedMesh,
    mean_normals,
)
from solmap.products.errors import ProductError
from solmap.products.formats.mesh.gltf import Encoding, box_of_glb, read_glb, write_glb
from tests.support.gltf_validator import validate_glb

ORIGIN = (7000.0, -3000.0, -20.0)
TYPES = {5120: "i1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}


def hill(side: int = 12) -> TexturedMesh:
    """A rise between level ground, some kilometres from the lander."""
    row, col = (grid.ravel() for grid in np.mgrid[:side, :side])
    up = -20 + np.exp(-((row - 6) ** 2 + (col - 5) ** 2) / 9.0)
    points = np.column_stack([7000.0 + 0.1 * col, -3000.0 - 0.1 * row, up])
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    nw, ne, sw, se = corner, corner + 1, corner + side, corner + side + 1
    triangles = np.concatenate([np.column_stack([nw, sw, se]), np.column_stack([nw, se, ne])])
    places = np.column_stack([col, row]).astype(np.float32) / np.float32(side - 1)
    texture = np.arange(256, dtype=np.uint8).repeat(256).reshape(256, 256)
    triangles = triangles.astype(np.int32)
    normals = mean_normals(points, triangles)
    return TexturedMesh("hill", SurfaceMesh(points, normals, triangles, places), texture)


def values(document: dict, binary: bytes, number: int) -> np.ndarray:
    """The numbers of an accessor, as a reader of the standard would find them."""
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
    kind = np.dtype(TYPES[accessor["componentType"]])
    stride = view.get("byteStride", width * kind.itemsize)
    strides = (stride, kind.itemsize)
    found = np.ndarray((accessor["count"], width), kind, binary, view["byteOffset"], strides)
    return found / np.iinfo(kind).max if accessor.get("normalized") else found


def surface_of(data: bytes) -> SurfaceMesh:
    """The first mesh of a file, in metres of the local map."""
    document, binary = read_glb(data)
    root, node = document["nodes"][:2]
    part = document["meshes"][node["mesh"]]["primitives"][0]
    rows = values(document, binary, part["attributes"]["POSITION"])
    x, y, z = (rows * node.get("scale", [1, 1, 1]) + node.get("translation", [0, 0, 0])).T
    east, up, south = root["translation"]
    points = np.column_stack([x + east, -(z + south), y + up])
    triangles = values(document, binary, part["indices"]).reshape(-1, 3).astype(np.int32)
    places = values(document, binary, part["attributes"]["TEXCOORD_0"]).astype(np.float32)
    x, y, z = values(document, binary, part["attributes"]["NORMAL"]).astype(float).T
    return SurfaceMesh(points, np.column_stack([x, -z, y]), triangles, places)


STORED = (Encoding.PLAIN, Encoding.QUANTISED)


@pytest.mark.parametrize("encoding", STORED)
def test_khronos_validator_finds_no_fault(encoding, tmp_path):
    path = tmp_path / "hill.glb"
    path.write_bytes(write_glb([hill(), hill(8)], ORIGIN, encoding=encoding, notes={"sols": [3]}))
    report = validate_glb(path)
    assert report["issues"]["messages"] == []
    assert report["info"]["totalTriangleCount"] == 2 * (11 * 11 + 7 * 7)


@pytest.mark.parametrize(
    ("encoding", "tolerance_m"),
    [(Encoding.PLAIN, 1e-6), (Encoding.QUANTISED, 1.1 / 65535 / 2)],  # half a step of the extent
)
def test_a_reader_finds_the_same_surface_on_the_map(encoding, tolerance_m):
    written = hill().mesh
    read = surface_of(write_glb([hill()], ORIGIN, encoding=encoding))
    np.testing.assert_array_equal(read.triangles, written.triangles)
    np.testing.assert_allclose(read.points, written.points, rtol=0, atol=tolerance_m + 1e-9)
    np.testing.assert_allclose(read.texture_at, written.texture_at, atol=1e-5)
    np.testing.assert_allclose(read.normals, written.normals, atol=0.5 / 127 + 1e-6)


def test_frame_and_notes_are_in_the_file():
    document, _ = read_glb(write_glb([hill()], ORIGIN, notes={"crs": "somewhere on Mars"}))
    extras = document["nodes"][0]["extras"]
    assert extras == {"axes": "x east, y up, z south", "unit": "metre", "crs": "somewhere on Mars"}


def test_the_texture_is_the_image():
    document, binary = read_glb(write_glb([hill()], ORIGIN))
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    first = view["byteOffset"]
    jpeg = np.frombuffer(binary[first : first + view["byteLength"]], np.uint8)
    seen = cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED)
    assert np.abs(seen.astype(int) - hill().texture).max() < 8  # of 256: JPEG at quality 90


def test_equal_input_gives_equal_bytes():
    assert write_glb([hill()], ORIGIN) == write_glb([hill()], ORIGIN)


def test_many_vertices_are_indexed_with_32_bits():
    mesh = surface_of(write_glb([hill(257)], ORIGIN))
    assert mesh.triangles.max() == 257 * 257 - 1


def test_a_model_without_triangles_is_refused():
    none = np.empty((0, 3))
    empty = SurfaceMesh(none, none, none.astype(np.int32), np.empty((0, 2), np.float32))
    with pytest.raises(ProductError, match="without triangles"):
        write_glb([TexturedMesh("nothing", empty, np.zeros((4, 4), np.uint8))], ORIGIN)


def test_other_files_are_not_gltf():
    with pytest.raises(ProductError, match="begins with b'glTF' and 2, not with b'PK"):
        read_glb(b"PK\x03\x04 and more")


def test_draco_keeps_the_surface_in_a_fraction_of_the_size(tmp_path):
    path = tmp_path / "hill.glb"
    path.write_bytes(write_glb([hill(100)], ORIGIN, encoding=Encoding.DRACO))
    assert validate_glb(path)["issues"]["numErrors"] == 0
    document, binary = read_glb(path.read_bytes())
    part = document["meshes"][0]["primitives"][0]
    packed = part["extensions"]["KHR_draco_mesh_compression"]
    view = document["bufferViews"][packed["bufferView"]]
    mesh = DracoPy.decode(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    written = hill(100).mesh
    corners = written.points[written.triangles]
    x, y, z = np.asarray(mesh.points, np.float64)[mesh.faces].transpose(2, 0, 1)
    east, up, south = document["nodes"][0]["translation"]
    read = np.stack([x + east, -(z + south), y + up], axis=-1)
    off, twin = cKDTree(corners.mean(axis=1)).query(read.mean(axis=1))
    assert off.max() < np.sqrt(3) * 9.9 / 65535  # a step of the longest side along every axis
    assert sorted(twin) == list(range(len(corners)))
    for name, shape in (("POSITION", "VEC3"), ("NORMAL", "VEC3"), ("TEXCOORD_0", "VEC2")):
        accessor = document["accessors"][part["attributes"][name]]
        assert (accessor["count"], accessor["type"]) == (len(mesh.points), shape)
    plain = write_glb([hill(100)], ORIGIN, encoding=Encoding.PLAIN)
    assert len(path.read_bytes()) < len(plain) / 5


def test_trimesh_reads_the_surface_at_its_coordinates(tmp_path):
    peer = pytest.importorskip("trimesh")
    path = tmp_path / "hill.glb"
    path.write_bytes(write_glb([hill()], ORIGIN))
    scene = peer.load_scene(path)
    ((_, mesh),) = scene.geometry.items()
    assert len(mesh.faces) == len(hill().mesh)
    x, y, z = np.array(scene.bounds).T
    places = np.column_stack([x, -z[::-1], y])
    low, high = box_of_glb(path.read_bytes())
    np.testing.assert_allclose(places, [low, high], atol=1e-4)
