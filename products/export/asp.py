"""Cameras for the Ames Stereo Pipeline: pinhole models (`.tsai`) and CSM states (`.json`).

`.tsai`, version 4: lengths are pixels (`pitch = 1`), the first pixel's centre is (0, 0). C is the
projection centre and R the rotation from the camera (right, down, forward) to the world, row by
row. The world is the map: east, north, up in metres, as for rover images that ASP ships as
examples.

CSM state: the frame camera of USGSCSM, body-fixed, as ASP's tools for orbiters and terrain on Mars
expect. Lengths on the focal plane are pixels and the first pixel's centre is (0.5, 0.5), so that
with the rotation M from the camera to the body-fixed frame and d from the projection centre to a
point

    (x, y, z) = M' d,      sample = f x / z + ccd_sample,      line = f y / z + ccd_line

Neither has distortion: they are cameras of epipolar images.

Source: `PinholeModel` of the NASA Vision Workbench; `UsgsAstroFrameSensorModel::replaceModelState`
and `groundToImage` of USGSCSM.
"""

from __future__ import annotations

import json

import numpy as np

from solmap.photogrammetry.frames import quaternion_of_rotation
from solmap.products.crs import IAU_RADIUS_M, LandingPoint
from solmap.products.export.camera_network import CameraView, body_fixed

_MODEL = "USGS_ASTRO_FRAME_SENSOR_MODEL"
_HALF_PIXEL = 0.5
_RADIAL = 0
"""Kind of distortion; with coefficients of zero there is none."""
_LOWEST_M, _HIGHEST_M = -10_000.0, 22_000.0
"""Heights of ground on Mars above its sphere."""


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


def csm_state(view: CameraView, landing: LandingPoint) -> str:
    """The state of the frame camera of an epipolar image: name of the model, then JSON.

    Args:
        view: The camera, in the map.
        landing: Origin of the map, on Mars.
    """
    geometry, entry = view.geometry, view.entry
    turn, origin = body_fixed(landing)
    w, x, y, z = quaternion_of_rotation(turn @ view.map_from_camera).tolist()
    sample, line = (value + _HALF_PIXEL for value in geometry.centre_px)
    state = {
        "m_modelName": _MODEL,
        "m_imageIdentifier": view.name,
        "m_sensorName": entry.instrument,
        "m_platformName": entry.mission,
        "m_collectionIdentifier": "",
        "m_targetName": "MARS",
        "m_majorAxis": IAU_RADIUS_M,
        "m_minorAxis": IAU_RADIUS_M,
        "m_minElevation": _LOWEST_M,
        "m_maxElevation": _HIGHEST_M,
        "m_nSamples": geometry.samples,
        "m_nLines": geometry.lines,
        "m_startingDetectorSample": 0.0,
        "m_startingDetectorLine": 0.0,
        "m_detectorSampleSumming": 1.0,
        "m_detectorLineSumming": 1.0,
        "m_ccdCenter": [line, sample],
        "m_focalLength": geometry.focal_px,
        "m_focalLengthEpsilon": 0.0,
        "m_pixelPitch": 1.0,
        "m_ifov": 1.0 / geometry.focal_px,
        "m_iTransS": [0.0, 1.0, 0.0],
        "m_iTransL": [0.0, 0.0, 1.0],
        "m_transX": [0.0, 0.0, 1.0],
        "m_transY": [0.0, 1.0, 0.0],
        "m_boresight": [0.0, 0.0, 1.0],
        "m_distortionType": _RADIAL,
        "m_opticalDistCoeffs": [0.0, 0.0, 0.0],
        "m_currentParameterValue": [*(turn @ view.centre_m + origin).tolist(), x, y, z, w],
        "m_currentParameterCovariance": np.eye(7).ravel().tolist(),
        "m_spacecraftVelocity": [0.0, 0.0, 0.0],
        "m_sunPosition": [0.0, 0.0, 0.0],
        "m_ephemerisTime": 0.0,
        "m_referencePointXyz": [0.0, 0.0, 0.0],
        "m_logFile": "",
    }
    return f"{_MODEL}\n{json.dumps(state, indent=2)}\n"
