"""Where a single stop lies in an orbital image: control for the adjustment.

The stop's own map is registered to the image as if it were the only one. A correction (see
`records.Correction`) carries what the image claims, p, to where the rover's map has it,

    x = c + R (p - c) + t

so the rover itself, at x with azimuth A, lies in the image at

    p = c + R' (x - c - t)          azimuth A + rotation

with the covariance of (t, rotation) carried over, and in an orbital terrain model its height too.
The place depends on how the map lies about the rover, and no longer on where the adjustment had put
both.
"""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.control import StopControl
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.orbital.records import Correction


def stop_in_image(
    stop: StopId, lsl_from_rover: Pose, correction: Correction, frame: str
) -> StopControl:
    """Where an image shows a stop whose map it was registered to.

    Args:
        stop: its name.
        lsl_from_rover: the pose that its map was made with.
        correction: of the image, onto that map alone.
        frame: the name of the image.
    """
    north, east, _ = lsl_from_rover.translation_m.tolist()
    theta = np.radians(correction.rotation_deg)
    c, s = np.cos(theta), np.sin(theta)
    back = np.array([[c, s], [-s, c]])
    arm = np.array([east - correction.east_m, north - correction.north_m])
    arm = arm - np.asarray(correction.centre_m)
    place = np.asarray(correction.centre_m) + back @ arm
    rotation = lsl_from_rover.rotation
    azimuth = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0])) + correction.rotation_deg
    J = np.zeros((3, 3))
    J[:2, :2] = -back
    J[:2, 2] = np.array([[-s, c], [-c, -s]]) @ arm
    J[2, 2] = 1.0
    C = J @ correction.covariance @ J.T
    up_m = None
    if correction.up_m is not None and correction.sigma_up_m is not None:
        up_m = float(-lsl_from_rover.translation_m[2] - correction.up_m)
        C = np.insert(np.insert(C, 2, 0.0, axis=0), 2, 0.0, axis=1)
        C[2, 2] = correction.sigma_up_m**2
    return StopControl(
        stop,
        frame,
        float(place[0]),
        float(place[1]),
        (C + C.T) / 2,
        up_m,
        float((azimuth + 180.0) % 360.0 - 180.0),
    )
