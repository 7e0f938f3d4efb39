"""The mast and its cameras: pose of every camera for a pointing of the mast.

The mast head rotates by azimuth and elevation (a positive rotation about +y lifts x) at a fixed
position,

    rover_from_mast = (Rz(az) Ry(el), T_pma),      az = az_motor + d_az,   el = el_motor + d_el,

which gives the camera centres of 15 flight labels to 4 micrometres. The Navcam rig is Spirit's own,
from the labels of both eyes of sol 767. Of the Pancams only Opportunity's left one (L2) was
available: it is used here on Spirit's mast, and the right one is SYNTHETIC, its mirror image about
the plane y = 0.0125 m: with S = diag(1, -1, 1), A, O, V go to S A, S O, S V, C to S C + (0, 0.025,
0), and H to 1023 S A - S H, so that samples still run to the right.

Labels describe the rig as calibrated. The true one may differ: the rig bends with temperature, so
that the right cameras are rotated about their centres, and the mast has zero errors and a tilted
axis,

    R_true = R_axis Rz(az + zero_az) Ry(el + zero_el) R_noise,

with the noise a small rotation of the mast head, drawn for every pair and common to both cameras.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation as ScipyRotation

from solmap.photogrammetry.arrays import Rotation, Vector3
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.frames import (
    LSL,
    Frame,
    FrameKind,
    Pose,
    roll_pitch_yaw_of_rotation,
    rotation_of_roll_pitch_yaw,
)
from solmap.photogrammetry.imagery import Eye, StopId

FULL_FRAME = 1024
"""Samples and lines of the detector."""
T_PMA_M = (0.45781, 0.02779, -1.09668)
"""Position of the mast head in Spirit's rover frame."""
D_AZ, D_EL = np.deg2rad(0.2133), np.deg2rad(3.080)
"""Mast axis minus motor angle, Spirit."""
CALIBRATED_AT_C = 5.0
"""Temperature at which labels describe the stereo rig correctly, except for `RigErrors.bend`."""
GROUND_M = 0.294
"""Level ground below the rover origin."""
_NAVCAM_FILTER = "PANCAM_L8_440NM_SOL_ND5"


class Instrument(StrEnum):
    """Stereo cameras on the mast."""

    NAVCAM = "NAVCAM"
    PANCAM = "PANCAM"


@dataclass(frozen=True, slots=True)
class CameraUnit:
    """One camera, as named in labels, and its model in the mast frame."""

    serial_number: int
    calibration: str
    in_mast: Cahvor
    filter_name: str
    filter_number: int
    detector_rotation: float
    pixel_rad: float
    """Nominal angle of a pixel, for AZIMUTH_FOV."""


def _model(*rows: tuple[float, float, float]) -> Cahvor:
    c, a, h, v, o, r = (np.array(row) for row in rows)
    return Cahvor(c=c, a=a / np.linalg.norm(a), h=h, v=v, o=o / np.linalg.norm(o), r=r)


def _mirror(left: Cahvor) -> Cahvor:
    mirror = np.array([1.0, -1.0, 1.0])
    return Cahvor(
        c=mirror * left.c + np.array([0.0, 0.025, 0.0]),
        a=mirror * left.a,
        h=(FULL_FRAME - 1) * mirror * left.a - mirror * left.h,
        v=mirror * left.v,
        o=mirror * left.o,
        r=left.r,
    )


_NAVCAM_LEFT = _model(
    (0.00564067, -0.08762517, -0.15419121),
    (0.99976234, -0.02182367, 0.0008631),
    (495.74617644, 1177.7075846, 5.80372678),
    (515.65185336, -15.93388638, 1188.77956764),
    (0.98854227, -0.14833401, -0.02794826),
    (0.019876, -0.014281, 0.020876),
)
_NAVCAM_RIGHT = _model(
    (0.00499414, 0.1127188, -0.15462585),
    (0.99984955, 0.01635669, 0.00586385),
    (499.28786562, 1217.46753802, 9.8239257),
    (517.73089348, 2.17528891, 1212.75538585),
    (0.99997543, 0.00661894, 0.00235476),
    (0.0003, -0.004874, 0.018766),
)
_PANCAM_LEFT = _model(
    (0.028060, -0.135900, -0.155257),
    (0.999761, 0.021850, -0.001134),
    (440.565, 3634.997, -11.061),
    (509.771, 22.037, 3624.964),
    (0.999497, 0.031403, 0.004335),
    (0.000998, 0.003762, -0.057232),
)
CAMERAS = {
    (Instrument.NAVCAM, Eye.LEFT): CameraUnit(
        112, "174", _NAVCAM_LEFT, _NAVCAM_FILTER, 8, 180.0, 0.77e-3
    ),
    (Instrument.NAVCAM, Eye.RIGHT): CameraUnit(
        113, "175", _NAVCAM_RIGHT, _NAVCAM_FILTER, 8, 180.0, 0.77e-3
    ),
    (Instrument.PANCAM, Eye.LEFT): CameraUnit(
        115, "199", _PANCAM_LEFT, "PANCAM_L2_753NM", 2, 0.0, 0.27e-3
    ),
    (Instrument.PANCAM, Eye.RIGHT): CameraUnit(
        114, "SYNTHETIC", _mirror(_PANCAM_LEFT), "PANCAM_R2_754NM", 2, 180.0, 0.27e-3
    ),
}


@dataclass(frozen=True, slots=True)
class Pointing:
    """The mast's own axis, radians: azimuth clockwise from the rover's x, elevation upwards."""

    azimuth: float
    elevation: float

    @property
    def motors(self) -> tuple[float, float]:
        """Motor angles of the mast."""
        return (self.azimuth - D_AZ) % (2 * np.pi), self.elevation - D_EL

    @property
    def rotation(self) -> Rotation:
        """Rotates directions of the mast frame to the rover frame."""
        return rotation_of_roll_pitch_yaw(0.0, self.elevation, self.azimuth)

    def rover_from_mast(self, stop: StopId, *, turned_by: Vector3 | None = None) -> Pose:
        """The mast in the rover frame.

        `turned_by` are small roll, pitch and yaw of the mast head that the motors do not report.
        """
        rotation = self.rotation
        if turned_by is not None:
            rotation = rotation @ rotation_of_roll_pitch_yaw(*map(float, turned_by))
        return Pose(stop.frame, mast_frame(stop), rotation, np.array(T_PMA_M))


@dataclass(frozen=True, slots=True)
class RigErrors:
    """True errors of mast and stereo rig against the labels, radians."""

    pointing: float = float(np.deg2rad(0.12))
    """Standard deviation of a pair's azimuth and elevation; its roll has half."""
    mast_zero: tuple[float, float] = (0.0, 0.0)
    """Errors of the zeros of azimuth and elevation, the same for all pairs."""
    mast_axis: tuple[float, float] = (0.0, 0.0)
    """Roll and pitch of the mast's azimuth axis in the rover frame."""
    bend: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector of the right cameras about the mast axes at `CALIBRATED_AT_C`."""
    bend_per_kelvin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def draw_miss(self, pointing: Pointing, rng: np.random.Generator) -> tuple[float, float, float]:
        """Roll, pitch, yaw of the mast head that the motors do not report, for one pair."""
        roll, pitch, yaw = map(float, rng.normal(0.0, self.pointing, 3) * (0.5, 1.0, 1.0))
        if not any(self.mast_zero + self.mast_axis):
            return roll, pitch, yaw
        azimuth, elevation = np.add((pointing.azimuth, pointing.elevation), self.mast_zero)
        true = (
            rotation_of_roll_pitch_yaw(*self.mast_axis, 0.0)
            @ Pointing(float(azimuth), float(elevation)).rotation
            @ rotation_of_roll_pitch_yaw(roll, pitch, yaw)
        )
        return roll_pitch_yaw_of_rotation(pointing.rotation.T @ true)

    def camera_in_mast(self, instrument: Instrument, eye: Eye, celsius: float) -> Cahvor:
        """The true camera at a temperature: right ones are rotated about their centres."""
        camera = CAMERAS[instrument, eye].in_mast
        kelvin = celsius - CALIBRATED_AT_C
        bend = np.add(self.bend, np.multiply(self.bend_per_kelvin, kelvin))
        if eye is Eye.LEFT or not bend.any():
            return camera
        turn = ScipyRotation.from_rotvec(bend).as_matrix()
        return camera.transform(Pose(LSL, LSL, turn, camera.c - turn @ camera.c))


def rig_temperature(local_solar_hour: float) -> float:
    """Temperature of cameras and rig, degrees Celsius: lowest at two in the night."""
    return -35.0 + 35.0 * float(np.cos((local_solar_hour - 14) * np.pi / 12))


def mast_frame(stop: StopId) -> Frame:
    """The frame of the mast head at a stop."""
    return Frame(FrameKind.MAST, (stop.site, stop.drive))
