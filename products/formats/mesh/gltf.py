"""glTF 2.0 binary (.glb): textured meshes, and points as the content of 3D Tiles 1.1.

A file holds meshes of the local map. glTF's axes are right-handed with y up, so a point is written

    x = east - east_0,     y = up - up_0,     z = -(north - north_0)

in single precision relative to a nearby origin, and the scene's root node is translated by the
origin: its children are in metres of the local map. Data without a field in glTF (frame, CRS,
units, source products) are in the `extras` of that node.

`PLAIN` files use only the core of glTF. `QUANTISED` ones store positions in 16 bits (65535 steps
over the longest side of a mesh, 0.2 mm over 10 m), normals in 8 and texture coordinates in 16, as
KHR_mesh_quantization allows: half the size, supported by all current viewers of tiles. `DRACO` ones
are equally exact and a tenth of the size, but have to be decompressed. Textures are JPEG, grey or
RGB. Equal input gives equal bytes.

Points have quantised positions, a colour, which in glTF is linear in light, and, as `_SIGMA`, their
standard deviation in metres.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from solmap.photogrammetry.arrays import EightBits
from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud
from solmap.photogrammetry.terrain.mesh.surface_mesh import SurfaceMesh, TexturedMesh
from solmap.products.errors import BrokenProductError, ProductError
from solmap.products.formats.mesh.draco import compress

_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
_FLOAT, _BYTE, _USHORT, _UINT = 5126, 5120, 5123, 5125
_VERTICES, _INDICES = 34962, 34963
_LARGEST_SHORT = 65534
"""Index 65535 of 16-bit indices is reserved as restart marker."""
_STEPS = 65535
_LINEAR_MIPMAP_LINEAR, _LINEAR, _CLAMP = 9987, 9729, 33071


class Encoding(StrEnum):
    """Encoding of numbers."""

    PLAIN = "plain"
    QUANTISED = "quantised"
    DRACO = "draco"


_EXTENSION = {
    Encoding.QUANTISED: "KHR_mesh_quantization",
    Encoding.DRACO: "KHR_draco_mesh_compression",
}


@dataclass(slots=True)
class GlbWriter:
    """A file in preparation: its document's lists and its binary part."""

    encoding: Encoding
    binary: bytearray = field(default_factory=bytearray)
    views: list[dict[str, Any]] = field(default_factory=list)
    accessors: list[dict[str, Any]] = field(default_factory=list)
    images: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    nodes: list[dict[str, Any]] = field(default_factory=list)

    def add(self, textured: TexturedMesh, origin: tuple[float, float, float], quality: int) -> None:
        """Append a mesh, its texture and its node."""
        number = len(self.meshes)
        draw = (
            self._draco_primitive
            if self.encoding is Encoding.DRACO
            else self._uncompressed_primitive
        )
        part, node = draw(textured.mesh, origin)
        self.meshes.append({"name": textured.name, "primitives": [{**part, "material": number}]})
        self.nodes.append({"name": textured.name, "mesh": number, **node})
        view = self._view(_jpeg(textured.texture, quality))
        self.images.append({"bufferView": view, "mimeType": "image/jpeg"})

    def _uncompressed_primitive(
        self, mesh: SurfaceMesh, origin: tuple[float, float, float]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """An uncompressed mesh: its primitive, and its node's transform."""
        positions, node = self._positions(_y_up(mesh.points - np.asarray(origin)))
        attributes = {
            "POSITION": positions,
            "NORMAL": self._normals(_y_up(mesh.normals)),
            "TEXCOORD_0": self._texture_places(mesh),
        }
        return {"attributes": attributes, "indices": self._indices(mesh)}, node

    def _draco_primitive(
        self, mesh: SurfaceMesh, origin: tuple[float, float, float]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """A mesh compressed by Draco."""
        positions = _y_up(mesh.points - np.asarray(origin))
        made = compress(positions, _y_up(mesh.normals), mesh.texture_at, mesh.triangles)
        facts = {"POSITION": {"min": made.low, "max": made.high}}
        shapes = {"POSITION": "VEC3", "NORMAL": "VEC3", "TEXCOORD_0": "VEC2"}
        attributes = {
            name: self._accessor(None, _FLOAT, made.vertices, shape, facts.get(name, {}))
            for name, shape in shapes.items()
        }
        indices = self._accessor(None, _UINT, 3 * made.triangles, "SCALAR", {})
        packed = {"bufferView": self._view(made.data), "attributes": made.attributes}
        extension = {_EXTENSION[Encoding.DRACO]: packed}
        return {"attributes": attributes, "indices": indices, "extensions": extension}, {}

    def _positions(self, points: np.ndarray) -> tuple[int, dict[str, Any]]:
        """Accessor of positions, and their node's transform."""
        if self.encoding is Encoding.PLAIN:
            return self._vertices(points.astype("<f4"), _FLOAT, bounded=True), {}
        low = points.min(axis=0)
        step = max(float((points - low).max()), 1e-6) / _STEPS
        steps = np.rint((points - low) / step).astype("<u2")
        node = {"translation": low.tolist(), "scale": [step] * 3}
        return self._vertices(steps, _USHORT, bounded=True), node

    def _normals(self, normals: np.ndarray) -> int:
        if self.encoding is Encoding.PLAIN:
            return self._vertices(normals.astype("<f4"), _FLOAT)
        return self._vertices(np.rint(normals * 127).astype("i1"), _BYTE, normalized=True)

    def _texture_places(self, mesh: SurfaceMesh) -> int:
        if self.encoding is Encoding.PLAIN:
            return self._vertices(mesh.texture_at.astype("<f4"), _FLOAT)
        steps = np.rint(np.clip(mesh.texture_at, 0, 1) * np.float32(_STEPS)).astype("<u2")
        return self._vertices(steps, _USHORT, normalized=True)

    def _indices(self, mesh: SurfaceMesh) -> int:
        short = len(mesh.points) <= _LARGEST_SHORT
        values = mesh.triangles.astype("<u2" if short else "<u4").ravel()
        view = self._view(values.tobytes(), target=_INDICES)
        kind = _USHORT if short else _UINT
        return self._accessor(view, kind, len(values), "SCALAR", {})

    def _vertices(
        self, rows: np.ndarray, kind: int, *, bounded: bool = False, normalized: bool = False
    ) -> int:
        """Accessor of one row per vertex, every row padded to whole words of four bytes."""
        width = rows.shape[1] * rows.itemsize
        stride = -(-width // 4) * 4
        padded = np.zeros((len(rows), stride), np.uint8)
        padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), width)
        view = self._view(padded.tobytes(), byteStride=stride, target=_VERTICES)
        facts: dict[str, Any] = {"normalized": True} if normalized else {}
        if bounded:
            facts |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self._accessor(view, kind, len(rows), f"VEC{rows.shape[1]}", facts)

    def _accessor(
        self, view: int | None, kind: int, count: int, shape: str, facts: dict[str, Any]
    ) -> int:
        where = {} if view is None else {"bufferView": view}
        self.accessors.append(
            {**where, "componentType": kind, "count": count, "type": shape, **facts}
        )
        return len(self.accessors) - 1

    def _view(self, data: bytes, **facts: int) -> int:
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **facts}
        )
        self.binary += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def bytes(self, origin: tuple[float, float, float], notes: dict[str, Any]) -> bytes:
        """The whole file."""
        return glb_bytes(self._document(origin, notes), bytes(self.binary))

    def _document(
        self, origin: tuple[float, float, float], notes: dict[str, Any]
    ) -> dict[str, Any]:
        east, north, up = origin
        count = len(self.meshes)
        root = {
            "name": "local map",
            "translation": [east, up, -north],
            "children": list(range(1, count + 1)),
            "extras": {"axes": "x east, y up, z south", "unit": "metre", **notes},
        }
        needed = [_EXTENSION[self.encoding]] if self.encoding in _EXTENSION else []
        return {
            "asset": {"version": "2.0", "generator": "solmap"},
            "extensionsUsed": [*needed, "KHR_materials_unlit"],
            **({"extensionsRequired": needed} if needed else {}),
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [root, *self.nodes],
            "meshes": self.meshes,
            "materials": [_material(number) for number in range(count)],
            "textures": [{"source": number, "sampler": 0} for number in range(count)],
            "images": self.images,
            "samplers": [_SAMPLER],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.binary)}],
        }


def glb_bytes(document: dict[str, Any], binary: bytes) -> bytes:
    """A glTF binary: its header, the document and the binary part."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<3I", _MAGIC, _VERSION, 12 + 8 + len(text) + 8 + len(binary))
    chunks = struct.pack("<2I", len(text), _JSON), struct.pack("<2I", len(binary), _BIN)
    return b"".join([head, chunks[0], text, chunks[1], binary])


_SAMPLER = {
    "magFilter": _LINEAR,
    "minFilter": _LINEAR_MIPMAP_LINEAR,
    "wrapS": _CLAMP,
    "wrapT": _CLAMP,
}


def _material(number: int) -> dict[str, Any]:
    """Matt, visible from both sides, and unlit: the texture includes the illumination."""
    return {
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": number},
            "metallicFactor": 0,
            "roughnessFactor": 1,
        },
        "doubleSided": True,
        "extensions": {"KHR_materials_unlit": {}},
    }


def _y_up(rows: np.ndarray) -> np.ndarray:
    """(east, north, up) as glTF's (x, y, z)."""
    return np.column_stack([rows[:, 0], rows[:, 2], -rows[:, 1]])


def _jpeg(texture: EightBits, quality: int) -> bytes:
    bgr = texture[..., ::-1] if texture.ndim == 3 else texture  # noqa: PLR2004 - with bands
    encoded, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not encoded:
        raise ProductError(f"a texture of {texture.shape} could not be encoded as JPEG")
    return data.tobytes()


def write_glb(
    meshes: Sequence[TexturedMesh],
    origin: tuple[float, float, float],
    *,
    encoding: Encoding = Encoding.PLAIN,
    jpeg_quality: int = 90,
    notes: Mapping[str, Any] | None = None,
) -> bytes:
    """The bytes of a glTF binary with these meshes.

    Args:
        meshes: What to write; a mesh without triangles is left out.
        origin: East, north and up of a nearby point, metres of the local map.
        encoding: Encoding of numbers.
        jpeg_quality: Of the textures, percent.
        notes: Plain JSON values to keep with the file.

    Raises:
        ProductError: there is no triangle to write.
    """
    drawn = [mesh for mesh in meshes if len(mesh.mesh)]
    if not drawn:
        raise ProductError("a model without triangles is empty; leave it out")
    file = GlbWriter(encoding)
    for mesh in drawn:
        file.add(mesh, origin, jpeg_quality)
    return file.bytes(origin, dict(notes or {}))


def read_glb(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary part of a glTF binary.

    Raises:
        ProductError: it is not a glTF binary.
    """
    if data[:8] != struct.pack("<2I", _MAGIC, _VERSION):
        raise ProductError(f"a glTF 2.0 binary begins with b'glTF' and 2, not with {data[:8]!r}")
    try:
        (length,) = struct.unpack_from("<I", data, 12)
        document = json.loads(data[20 : 20 + length])
        (size,) = struct.unpack_from("<I", data, 20 + length)
    except (struct.error, ValueError) as error:
        raise BrokenProductError(f"this glTF binary is broken: {error}") from error
    return document, data[28 + length : 28 + length + size]


def box_of_glb(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest (east, north, up) of all meshes of a solmap file, metres."""
    document, _ = read_glb(data)
    root, *nodes = document["nodes"]
    corners = []
    for node in nodes:
        part = document["meshes"][node["mesh"]]["primitives"][0]
        accessor = document["accessors"][part["attributes"]["POSITION"]]
        ends = np.array([accessor["min"], accessor["max"]], dtype=np.float64)
        corners.append(ends * node.get("scale", [1] * 3) + node.get("translation", [0] * 3))
    x, y, z = (np.concatenate(corners) + root["translation"]).T
    places = np.column_stack([x, -z, y])
    return places.min(axis=0), places.max(axis=0)


_POINTS = 0


def write_points(cloud: PointCloud) -> bytes:
    """The bytes of a glTF binary with these points."""
    east, north, up = cloud.points.T
    places = np.column_stack([east, up, -north])
    low = places.min(axis=0)
    step = max(float((places - low).max()), 1e-6) / _STEPS
    steps = np.rint((places - low) / step).astype("<u2")
    positions = np.zeros((len(steps), 4), "<u2")
    positions[:, :3] = steps
    colours = np.full((len(steps), 4), _STEPS, "<u2")
    colours[:, :3] = _linear()[cloud.grey][:, None]
    parts = [positions.tobytes(), colours.tobytes(), cloud.sigma_m.astype("<f4").tobytes()]
    count = len(steps)
    accessors: list[dict[str, Any]] = [
        {
            "componentType": _USHORT,
            "type": "VEC3",
            "min": steps.min(axis=0).tolist(),
            "max": steps.max(axis=0).tolist(),
        },
        {"componentType": _USHORT, "type": "VEC4", "normalized": True},
        {"componentType": _FLOAT, "type": "SCALAR"},
    ]
    strides, offset, views = (8, 8, 4), 0, []
    for stride, part in zip(strides, parts, strict=True):
        views.append(
            {
                "buffer": 0,
                "byteOffset": offset,
                "byteLength": len(part),
                "byteStride": stride,
                "target": _VERTICES,
            }
        )
        offset += len(part)
    attributes = {"POSITION": 0, "COLOR_0": 1, "_SIGMA": 2}
    document = {
        "asset": {"version": "2.0", "generator": "solmap"},
        "extensionsUsed": ["KHR_mesh_quantization", "KHR_materials_unlit"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": low.tolist(), "scale": [step] * 3}],
        "meshes": [{"primitives": [{"attributes": attributes, "mode": _POINTS, "material": 0}]}],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
        "accessors": [
            {"bufferView": number, "count": count, **facts}
            for number, facts in enumerate(accessors)
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    return glb_bytes(document, b"".join(parts))


def _linear() -> np.ndarray:
    """Light, in 16 bits, of the 256 grey values of sRGB."""
    grey = np.arange(256) / 255
    light = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)  # noqa: PLR2004 - sRGB
    return np.rint(light * _STEPS).astype("<u2")
