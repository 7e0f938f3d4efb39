"""Cameras for the Ames Stereo Pipeline: pinhole models without distortion (`.tsai`, version 4).

Lengths are pixels (`pitch = 1`), the first pixel's centre is (0, 0). C is the projection centre and
R the rotation from the camera (right, down, forward) to the world, row by row. The world is the
map: east, north, up in metres, as for rover images that ASP ships as examples, and not the body-
fixed frame that its tools for orbiters expect.

Source: `PinholeModel` of the NASA Vision Workbench.
"""

from __future__ import annotations

from solmap.products.export.camera_network import CameraView


def tsai_text(view: CameraView) -> str:
    """The camera of an epipolar image."""
    geometry = view.geometry
    centre = " ".join(repr(value) for value in view.centre_m.tolist())
    rotation = " ".join(repr(value) for value in view.map_from_camera.ravel().tolist())
    return (
        "VERSION_4\nPINHOLE\n"
        f"fu = {geometry.focal_px!r}\nfv = {geometry.focal_px!r}\n"
        f"cu = {geometry.centre_px[0]!r}\ncv = {geometry.centre_px[1]!r}\n"
        "u_direction = 1 0 0\nv_direction = 0 1 0\nw_direction = 0 0 1\n"
        f"C = {centre}\nR = {rotation}\npitch = 1\nNULL\n"
    )
