"""Images, stereo pairs and tie points, with their identifiers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.arrays import Flags, ImagePoints, Int32, PerPoint, Vector3
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import FrameError, LabelError
from solmap.photogrammetry.frames import Frame, Pose, rover_frame

MAX_SOL = 100_000
"""150 Mars years; no rover has counted more than 6,000."""
MAX_COUNTER = 1_000_000
"""Sites, drives and the other motion counters have at most five digits in the archive."""
MAX_CLOCK = 1 << 32
"""Spacecraft clocks count seconds in 32 bits."""
MAX_PIXELS = 1 << 25
"""Nearly twice the 5120 x 3840 pixels of the largest rover camera."""
MAX_FROM_SITE_M = 100_000.0
"""Largest distance of stops and other sites from a site: twice as far as any rover has driven."""
MAX_IN_ROVER_M = 10.0
"""Every camera or mast of a rover is nearer to its origin between the wheels."""
_IDENTIFIER = re.compile(r"[A-Z0-9][A-Z0-9_.()+ -]{0,99}", re.ASCII)
_MAX_TEXT = 100


class Eye(StrEnum):
    """Which camera of a stereo pair."""

    LEFT = "left"
    RIGHT = "right"
    MONO = "mono"


@dataclass(frozen=True, slots=True, order=True)
class StopId:
    """A position of the rover: all images with the same site and drive counter share one pose."""

    mission: str
    site: int
    drive: int

    def __str__(self) -> str:
        return f"{self.mission.lower()}-site{self.site:04d}-drive{self.drive:04d}"

    @property
    def frame(self) -> Frame:
        """The rover frame of the stop."""
        return rover_frame(self.site, self.drive)


@dataclass(frozen=True, slots=True, eq=False)
class RoverImage:
    """One exposure of one camera, from its label; the pixels are kept separately.

    `camera` is in the rover frame of `stop` and already belongs to the image as stored (sub-framed,
    averaged). `site_from_rover` is the telemetry solution of the label.
    """

    id: str
    """Product identifier, upper case: 2N292280938EFFB100P0703L0M1."""
    stop: StopId
    sol: int
    instrument: str
    """NAVCAM, PANCAM, FRONT_HAZCAM, REAR_HAZCAM, MASTCAM ..., without the eye."""
    eye: Eye
    filter_number: int | None
    clock: float
    """Spacecraft clock at the start of the exposure, seconds."""
    motion_counter: tuple[int, ...]
    sequence: str
    product_type: str
    """EFF, ESF, EDN, ILF, RAD, RSL ...: the three letters of the file name."""
    is_linearised: bool
    lines: int
    samples: int
    camera: CameraModel
    site_from_rover: Pose
    attitude_measured_by: str
    """QUATERNION_MEASUREMENT_METHOD: FINE, COARSE ..., or UNKNOWN."""
    local_solar_time: str | None
    start_time: str | None
    sun_azimuth: float | None
    """Radians, clockwise from north in the site frame."""
    sun_elevation: float | None
    """Radians above the horizon, with corrected sign."""
    mast_in_rover: tuple[float, float, float] | None = None
    """The mast head, about which its pointing errors rotate the cameras; None for cameras on the
    body."""
    parent_from_site: Pose | None = None
    """Position of the site in the site where it was declared, if the label gives it (after MER)."""
    created: str | None = None
    """PRODUCT_CREATION_TIME: when the file was made on Earth; products may be made again."""
    camera_celsius: float | None = None
    """Mean temperature of detectors on the mast; None for cameras on the body or without value."""

    @property
    def sun(self) -> Vector3 | None:
        """Unit vector towards the Sun in the site frame (north, east, down); None: not known."""
        if self.sun_azimuth is None or self.sun_elevation is None:
            return None
        level = math.cos(self.sun_elevation)
        return np.array(
            [
                level * math.cos(self.sun_azimuth),
                level * math.sin(self.sun_azimuth),
                -math.sin(self.sun_elevation),
            ]
        )

    def __post_init__(self) -> None:
        if self.site_from_rover.source != self.stop.frame:
            raise FrameError(
                f"{self.id} was taken at {self.stop.frame}, but its label gives the pose of "
                f"{self.site_from_rover.source}"
            )
        _check_image(self)


def _check_image(image: RoverImage) -> None:
    """Reject impossible values of a rover's image, because its file comes from elsewhere."""
    if not _IDENTIFIER.fullmatch(image.id):
        raise LabelError(
            f"the product identifier {image.id[:40]!a} should be up to 100 letters, digits and "
            "_ . - + ( ), of which a letter or digit is the first"
        )
    if image.lines < 1 or image.samples < 1:
        raise LabelError(
            f"{image.id}: {image.samples} x {image.lines} pixels is not a valid image size"
        )
    _check_range(image.id, "lines and samples", (image.lines, image.samples), MAX_PIXELS)
    _check_range(image.id, "pixels", (image.lines * image.samples,), MAX_PIXELS)
    _check_range(image.id, "the sol", (image.sol,), MAX_SOL)
    _check_range(image.id, "the motion counter", (image.stop.site, image.stop.drive), MAX_COUNTER)
    _check_range(image.id, "the motion counter", image.motion_counter, MAX_COUNTER)
    _check_range(image.id, "the spacecraft clock", (image.clock,), MAX_CLOCK)
    for pose in (image.site_from_rover, image.parent_from_site):
        distance_m = 0.0 if pose is None else float(np.linalg.norm(pose.translation_m))
        if not distance_m <= MAX_FROM_SITE_M:
            raise LabelError(
                f"{image.id}: rover and sites should be within {MAX_FROM_SITE_M:,.0f} m of their "
                f"reference site, but {distance_m:.6g} m are given"
            )
    in_rover = [image.camera.centre.tolist(), image.mast_in_rover or ()]
    if not all(abs(metres) <= MAX_IN_ROVER_M for place in in_rover for metres in place):
        raise LabelError(
            f"{image.id}: camera and mast should be within {MAX_IN_ROVER_M:.0f} m of the rover's "
            f"origin, but are at {in_rover}"
        )
    angles = (image.sun_azimuth, image.sun_elevation)
    if not all(angle is None or abs(angle) <= math.tau for angle in angles):
        raise LabelError(
            f"{image.id}: the Sun's angles should be within one turn, but are {angles}"
        )
    texts = (image.sequence, image.product_type, image.attitude_measured_by)
    for text in texts:
        if len(text) > _MAX_TEXT or not text.isprintable():
            raise LabelError(f"{image.id}: {text[:40]!a} is not a plain text of one line")


def _check_range(image_id: str, what: str, values: Iterable[int | float], most: int) -> None:
    for value in values:
        if not 0 <= value <= most:
            raise LabelError(
                f"{image_id}: {what} should be from 0 to {most:,.0f}, but is {value:.6g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Left and right image of one exposure, their camera models in one rover frame."""

    left: RoverImage
    right: RoverImage

    def __post_init__(self) -> None:
        if self.left.stop != self.right.stop:
            raise FrameError(
                f"both images of a stereo pair must be at the same stop, but {self.left.id} is at "
                f"{self.left.stop} and {self.right.id} at {self.right.stop}"
            )

    @property
    def id(self) -> str:
        """The pair is identified by its left image."""
        return self.left.id

    @property
    def stop(self) -> StopId:
        """The stop where both were taken."""
        return self.left.stop


class TieKind(StrEnum):
    """Kind of images that a tie point joins."""

    INTRA_STEREO = "intra-stereo"
    INTER_STEREO = "inter-stereo"
    CROSS_SITE = "cross-site"


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Intra-stereo matches of one pair, in its epipolar images.

    A match is a left image point and its parallax; rows correspond exactly by construction.
    """

    pair_id: str
    left: ImagePoints
    parallax_px: PerPoint
    sigma_px: PerPoint
    """Standard deviation of an image coordinate, from least-squares matching."""

    def __len__(self) -> int:
        return len(self.left)

    @classmethod
    def none(cls, pair_id: str) -> StereoMatches:
        """No matches, as for an image without partner."""
        return cls(pair_id, np.zeros((0, 2)), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class TiePoints:
    """Tie points of a network, one row per observation of a point in a stereo pair.

    Observation k sees tie point `point[k]` in pair `pair_ids[pair[k]]` at the left epipolar image
    point `left[k]` with parallax `parallax_px[k]`. A point seen in one pair only is an intra-stereo
    tie; in several pairs of a stop, an inter-stereo tie; from several stops, a cross-site tie.
    `parallax_px` is NaN where the point was measured in the left image only. Standard deviations
    are of the sample (`sigma_px`), the parallax and the line.
    """

    pair_ids: tuple[str, ...]
    point: Int32[np.ndarray, " n"]
    pair: Int32[np.ndarray, " n"]
    left: ImagePoints
    parallax_px: PerPoint
    sigma_px: PerPoint
    sigma_parallax_px: PerPoint
    sigma_line_px: PerPoint
    surface_matched: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether surface-matched rather than image-matched; if not given, none is."""

    def __post_init__(self) -> None:
        if not len(self.surface_matched):
            object.__setattr__(self, "surface_matched", np.zeros(len(self.point), dtype=bool))

    def __len__(self) -> int:
        return len(self.point)
