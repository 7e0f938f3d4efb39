"""A camera network as a COLMAP model in text: `cameras.txt`, `images.txt`, `points3D.txt`.

COLMAP's cameras point along +z with x right and y down; its poses lead from the world to the
camera, as a quaternion (scalar first) and a translation. The first pixel's centre is (0.5, 0.5).
Numbers of cameras, images and points begin with 1. The world is the map: east, north, up in metres.

Source: https://colmap.github.io/format.html
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solmap.photogrammetry.frames import quaternion_of_rotation
from solmap.products.export.camera_network import CameraNetwork, CameraView

_HALF_PIXEL = 0.5
_GREY = "128 128 128"
"""Points have a colour there, but not here."""


def colmap_texts(network: CameraNetwork) -> dict[str, str]:
    """The files of the model by their names."""
    return {
        "cameras.txt": "".join(_cameras(network)),
        "images.txt": "".join(_images(network)),
        "points3D.txt": "".join(_points(network)),
    }


def _cameras(network: CameraNetwork) -> Iterator[str]:
    yield "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[] (fx, fy, cx, cy)\n"
    for number, view in {view.camera: view for view in network.views}.items():
        geometry = view.geometry
        x, y = (value + _HALF_PIXEL for value in geometry.centre_px)
        size, focal = f"{geometry.samples} {geometry.lines}", repr(geometry.focal_px)
        yield f"{number + 1} PINHOLE {size} {focal} {focal} {x!r} {y!r}\n"


def _images(network: CameraNetwork) -> Iterator[str]:
    yield "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
    yield "# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    for number, view in enumerate(network.views):
        yield f"{number + 1} {_pose(view)} {view.camera + 1} {view.name}.png\n"
        rows = np.flatnonzero(network.view == number)
        at = network.at[rows] + _HALF_PIXEL
        yield " ".join(
            f"{x:.4f} {y:.4f} {point + 1}"
            for (x, y), point in zip(at.tolist(), network.point[rows].tolist(), strict=True)
        )
        yield "\n"


def _pose(view: CameraView) -> str:
    camera_from_map = view.map_from_camera.T
    values = (*quaternion_of_rotation(camera_from_map), *(-camera_from_map @ view.centre_m))
    return " ".join(repr(float(value)) for value in values)


def _points(network: CameraNetwork) -> Iterator[str]:
    yield "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    place = np.zeros(len(network.view), dtype=np.int64)
    for number in range(len(network.views)):
        rows = np.flatnonzero(network.view == number)
        place[rows] = np.arange(len(rows))
    error = np.linalg.norm(network.residuals_px(), axis=1)
    ends = np.searchsorted(network.point, np.arange(len(network.points) + 1))
    for number, xyz in enumerate(network.points.tolist()):
        of_point = slice(int(ends[number]), int(ends[number + 1]))
        seen = zip(network.view[of_point].tolist(), place[of_point].tolist(), strict=True)
        track = " ".join(f"{view + 1} {index}" for view, index in seen)
        x, y, z = xyz
        yield f"{number + 1} {x:.5f} {y:.5f} {z:.5f} {_GREY} {error[of_point].mean():.4f} {track}\n"
