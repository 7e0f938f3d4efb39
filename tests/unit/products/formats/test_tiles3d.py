"""Tilesets: a tree whose boxes and errors nest, in an archive that any ZIP program reads."""

import hashlib
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.terrain.mesh.surface_mesh import TilePlace
from solmap.products.errors import ProductError, ProductNotFoundError
from solmap.products.formats.mesh.tiles3d import (
    TilesetWriter,
    box_of,
    external_tileset,
    read_member,
    read_tileset,
    tileset_document,
)

PLACES = [TilePlace(0, 0, 0), TilePlace(0, 1, 1), TilePlace(0, 2, 3), TilePlace(1, 0, 0)]
PLACES += [TilePlace(1, 1, 1), TilePlace(2, 0, 0)]


@pytest.fixture
def archive(tmp_path) -> Path:
    return written(tmp_path / "stop.3tz")


def written(path: Path) -> Path:
    with TilesetWriter(path, {"crs": "somewhere on Mars"}) as writer:
        for place in PLACES:
            side = 10.0 * 2**place.level
            corner = np.array([place.col * side, -place.row * side, 0.1 * place.row])
            points = corner + np.array([[0, 0, 0], [side, -side, 0.5 / (1 + place.level)]])
            writer.add(place, f"tile {place}".encode(), points, 0.08 * 2**place.level)
    return path


def nodes(node: dict) -> list[dict]:
    return [node, *(below for child in node.get("children", []) for below in nodes(child))]


def test_every_tile_is_in_the_tree_once_and_readable(archive):
    tree = read_tileset(archive)
    uris = [node["content"]["uri"] for node in nodes(tree["root"])]
    assert sorted(uris) == sorted(f"{p.level}/{p.row}-{p.col}.glb" for p in PLACES)
    assert read_member(archive, "0/2-3.glb") == f"tile {TilePlace(0, 2, 3)}".encode()


def test_boxes_contain_their_children_and_errors_grow_towards_the_root(archive):
    tree = read_tileset(archive)
    assert tree["asset"]["version"] == "1.1"
    assert tree["asset"]["extras"]["crs"] == "somewhere on Mars"
    assert tree["geometricError"] >= tree["root"]["geometricError"]
    for node in nodes(tree["root"]):
        low, high = box_of(node["boundingVolume"]["box"])
        for child in node.get("children", []):
            child_low, child_high = box_of(child["boundingVolume"]["box"])
            assert (np.array(low) <= np.array(child_low) + 1e-9).all()
            assert (np.array(high) >= np.array(child_high) - 1e-9).all()
            assert child["geometricError"] < node["geometricError"]
        assert ("children" in node) == (node["geometricError"] > 0)


def test_the_index_at_the_end_gives_the_offset_of_every_member(archive):
    with zipfile.ZipFile(archive) as zipped:
        members = zipped.infolist()
        assert members[-1].filename == "@3dtilesIndex1@"
        index = zipped.read(members[-1])
    entries = [struct.unpack("<16sQ", index[i : i + 24]) for i in range(0, len(index), 24)]
    assert len(entries) == len(members) - 1
    assert entries == sorted(entries, key=lambda entry: struct.unpack("<2Q", entry[0]))
    data = archive.read_bytes()
    for member in members[:-1]:
        offset = dict(entries)[hashlib.md5(member.filename.encode()).digest()]  # noqa: S324
        name_length = struct.unpack_from("<H", data, offset + 26)[0]
        assert data[offset : offset + 4] == b"PK\x03\x04"
        assert data[offset + 30 : offset + 30 + name_length].decode() == member.filename


def test_equal_input_gives_equal_bytes(archive, tmp_path):
    assert archive.read_bytes() == written(tmp_path / "again.3tz").read_bytes()


def test_a_tile_whose_parent_is_empty_is_attached_to_the_next_coarser(tmp_path):
    with TilesetWriter(tmp_path / "strip.3tz", {}) as writer:
        for place in (TilePlace(0, 3, 3), TilePlace(2, 0, 0)):
            writer.add(place, b"", np.zeros((1, 3)), 1.0)
    root = read_tileset(tmp_path / "strip.3tz")["root"]
    assert [child["content"]["uri"] for child in root["children"]] == ["0/3-3.glb"]


def test_tilesets_are_joined_into_one_of_a_region(archive):
    one = read_tileset(archive)
    parts = [external_tileset(f"{name}/tileset.json", one) for name in ("a", "b")]
    region = json.loads(json.dumps(tileset_document(parts, {})))
    assert [tile["content"]["uri"] for tile in region["root"]["children"]] == [
        "a/tileset.json",
        "b/tileset.json",
    ]
    assert region["root"]["boundingVolume"] == one["root"]["boundingVolume"]


def test_a_missing_member_and_a_file_that_is_not_an_archive_are_named(archive, tmp_path):
    with pytest.raises(ProductNotFoundError, match=r"stop.3tz has no member 'x.glb'"):
        read_member(archive, "x.glb")
    broken = tmp_path / "broken.3tz"
    broken.write_bytes(archive.read_bytes()[:200])
    with pytest.raises(ProductError, match=r"broken.3tz is not a tileset"):
        read_member(broken, "tileset.json")
    with (
        pytest.raises(ProductError, match="without tiles"),
        TilesetWriter(tmp_path / "empty.3tz", {}),
    ):
        pass
