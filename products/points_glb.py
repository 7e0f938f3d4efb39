"""Points as glTF 2.0: the content of tiles of a point cloud, as 3D Tiles 1.1 has it.

Axes and origin are those of our other models (see `gltf`): x east, y up, z south. A point has a
position in 16 bits of its tile (KHR_mesh_quantization), a colour, which glTF wants linear in light
and not as the eye sees it, and, as `_SIGMA`, its standard deviation in metres. Equal input gives
equal bytes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud
from solmap.products.glb import _FLOAT, _STEPS, _USHORT, _VERTICES, glb_bytes

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
