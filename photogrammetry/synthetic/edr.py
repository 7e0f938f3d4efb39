"""Experiment data records: pixels with a flight-like PDS3 label, and the archive's file names.

The label is that of a flight image (Spirit, sol 1869) with the values of this image put in: it has
every group of the archive, numbers have six significant digits as in ground products, records
contain one image line, and the pixels are 16-bit big-endian integers of 12 bits. There is no VICAR
label.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from importlib import resources

import numpy as np

from solmap.photogrammetry.archive.file_names import encode_counter
from solmap.photogrammetry.arrays import Int32
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.errors import PixelError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.synthetic.lighting import Sun
from solmap.photogrammetry.synthetic.rig import (
    CAMERAS,
    FULL_FRAME,
    T_PMA_M,
    CameraUnit,
    Instrument,
    Pointing,
)

CLOCK_ZERO = datetime(2000, 1, 1, 11, 58, 55, 816000)  # noqa: DTZ001 - UTC, written without zone
"""UTC of clock count 0 (the real clock drifts some minutes a year; this one does not)."""
EXPOSURE_S = 0.32
INSTRUMENT_NAMES = {
    Instrument.NAVCAM: "NAVIGATION CAMERA",
    Instrument.PANCAM: "PANORAMIC CAMERA",
}


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """Data for the label of one image."""

    stop: StopId
    sol: int
    local_solar_hour: float
    solar_longitude: float
    sun: Sun
    site_from_rover: Pose
    instrument: Instrument
    eye: Eye
    pointing: Pointing
    camera: Cahvor
    """Camera in the rover frame, by mast angles and calibration."""
    clock: int
    pma: int
    sequence: str
    averaging: int = 1
    celsius: float = 0.0
    """Temperature of the detectors."""
    bits_per_pixel: float = 0.0
    """Bits per pixel of lossy coding; 0: none."""

    @property
    def unit(self) -> CameraUnit:
        """The camera of the image."""
        return CAMERAS[self.instrument, self.eye]

    @property
    def product_id(self) -> str:
        """The 26 characters after the spacecraft's: 2N292280938EFFB100P0703L0M1."""
        kind = "EFF" if self.averaging == 1 else "EDN"
        filter_digit = 0 if self.instrument is Instrument.NAVCAM else self.unit.filter_number
        place = f"{encode_counter(self.stop.site)}{encode_counter(self.stop.drive)}"
        eye = "L" if self.eye is Eye.LEFT else "R"
        letter = self.instrument[0]
        return f"2{letter}{self.clock:09d}{kind}{place}{self.sequence}{eye}{filter_digit}M1"

    @property
    def file_name(self) -> str:
        """File name as in the archive: lower case."""
        return f"{self.product_id.lower().replace('#', '_')}.img"


def edr_bytes(exposure: Exposure, pixels: Int32[np.ndarray, "lines samples"]) -> bytes:
    """The file of one image.

    Raises:
        PixelError: the pixels do not fit 12 bits or the detector.
    """
    side = FULL_FRAME // exposure.averaging
    if pixels.shape != (side, side) or pixels.min() < 0 or pixels.max() > 4095:  # noqa: PLR2004
        raise PixelError(
            f"{exposure.product_id} needs {side} x {side} pixels from 0 to 4095, not "
            f"{pixels.shape} from {pixels.min()} to {pixels.max()}"
        )
    record_bytes = 2 * side
    values = _values(exposure) | _statistics(pixels) | {"lines": side, "record_bytes": record_bytes}
    return _label(values, record_bytes, side) + pixels.astype(">i2").tobytes()


def label_bytes(exposure: Exposure) -> bytes:
    """The file of one image without its pixels: only the label."""
    record_bytes = 2 * FULL_FRAME // exposure.averaging
    side = FULL_FRAME // exposure.averaging
    nothing = np.zeros((1, 1), dtype=np.int32)
    sizes = {"lines": side, "record_bytes": record_bytes}
    return _label(_values(exposure) | _statistics(nothing) | sizes, record_bytes, side)


def _label(values: Mapping[str, object], record_bytes: int, image_records: int) -> bytes:
    """The label filled in and padded to whole records, whose number it includes."""
    template = (
        resources.files("solmap.photogrammetry.synthetic").joinpath("edr.lbl").read_text("ascii")
    )
    records = 1
    while True:
        counts = {
            "label_records": records,
            "image_record": records + 1,
            "file_records": records + image_records,
        }
        text = template.format_map({**values, **counts}).replace("\n", "\r\n").encode("ascii")
        needed = -(-len(text) // record_bytes)
        if needed <= records:
            return text.ljust(records * record_bytes)
        records = needed


def _values(exposure: Exposure) -> dict[str, object]:
    camera, unit = exposure.camera, exposure.unit
    counter = (exposure.stop.site, exposure.stop.drive, 0, exposure.pma, 0)
    mast = exposure.pointing.rover_from_mast(exposure.stop)
    motor_azimuth, motor_elevation = exposure.pointing.motors
    model = (camera.c, camera.a, camera.h, camera.v, camera.o, camera.r)
    return {
        **{f"model_{k}": format_vector(row) for k, row in enumerate(model, 1)},
        **_times(exposure),
        **_directions(exposure),
        "instrument": exposure.instrument.value,
        "instrument_name": INSTRUMENT_NAMES[exposure.instrument],
        "eye": exposure.eye.upper(),
        "image_id": str(exposure.pma),
        "serial_number": unit.serial_number,
        "calibration": unit.calibration,
        "observation_id": str(exposure.clock % 10**9),
        "sol": exposure.sol,
        "product_id": exposure.product_id,
        "motion_counter": "(" + ",".join(map(str, counter)) + ")",
        "sequence": exposure.sequence.lower(),
        "site": exposure.stop.site,
        "rover_offset": format_vector(exposure.site_from_rover.translation_m),
        "rover_quaternion": format_vector(exposure.site_from_rover.quaternion),
        "gravity": format_vector(exposure.site_from_rover.rotation[2]),
        "mast_offset": format_vector(T_PMA_M),
        "mast_quaternion": format_vector(mast.quaternion),
        "motor_azimuth": format_number(motor_azimuth),
        "motor_elevation": format_number(motor_elevation),
        "downsampling": "NONE" if exposure.averaging == 1 else "SOFTWARE",
        "averaging": exposure.averaging,
        "field_of_view": format_number(np.rad2deg(FULL_FRAME * unit.pixel_rad)),
        "detector_rotation": format_number(unit.detector_rotation),
        "filter_name": unit.filter_name,
        "filter_number": unit.filter_number,
        "temperature": format_number(exposure.celsius),
        "compression": _compression(exposure.bits_per_pixel),
    }


def _compression(bits_per_pixel: float) -> str:
    """Keywords of the image coding, as in flight labels."""
    rows = {"DESC": '"No compression"', "MODE": "0", "NAME": '"NONE"', "RATIO": "1.0"}
    if bits_per_pixel:
        rows = {
            "DESC": '"Lossy compression algorithm developed at JPL"',
            "MODE": "2",
            "NAME": '"ICER ADAPTIVE VARIABLE-LENGTH CODING (ICER)"',
            "RATE": format_number(bits_per_pixel),
            "RATIO": format_number(12 / bits_per_pixel),
        }
    return "\n".join(f"  {'INST_CMPRS_' + key:<32}= {value}" for key, value in rows.items())


def _times(exposure: Exposure) -> dict[str, str]:
    start = CLOCK_ZERO + timedelta(seconds=exposure.clock)
    received = start + timedelta(hours=6)
    seconds = round(exposure.local_solar_hour * 3600) % 86400
    minutes, second = divmod(seconds, 60)
    return {
        "solar_longitude": format_number(np.rad2deg(exposure.solar_longitude)),
        "local_true_solar_time": f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}",
        "clock_start": f"{exposure.clock}.000",
        "clock_stop": f"{exposure.clock + EXPOSURE_S:.3f}",
        "start_time": _utc(start),
        "stop_time": _utc(start + timedelta(seconds=EXPOSURE_S)),
        "creation_time": _utc(start + timedelta(days=1)),
        "received_start": _utc(received),
        "received_stop": _utc(received + timedelta(minutes=4)),
    }


def _utc(time: datetime) -> str:
    return time.isoformat(timespec="milliseconds")


def _directions(exposure: Exposure) -> dict[str, str]:
    in_rover = exposure.pointing.rotation[:, 0]
    in_site = exposure.site_from_rover.rotation @ in_rover
    degrees = {}
    for name, direction in (("rover", in_rover), ("site", in_site)):
        azimuth = np.rad2deg(np.arctan2(direction[1], direction[0]))
        degrees[f"{name}_azimuth"] = format_number(azimuth)
        degrees[f"{name}_elevation"] = format_number(np.rad2deg(np.arcsin(-direction[2])))
    degrees["solar_azimuth"] = format_number(np.rad2deg(exposure.sun.azimuth))
    degrees["solar_elevation"] = format_number(np.rad2deg(exposure.sun.elevation))
    return degrees


def _statistics(pixels: np.ndarray) -> dict[str, str]:
    return {
        "checksum": format_number(float(pixels.sum(dtype=np.int64))),
        "maximum": format_number(float(pixels.max())),
        "minimum": format_number(float(pixels.min())),
        "mean": format_number(float(pixels.mean())),
        "median": format_number(float(np.median(pixels))),
        "deviation": format_number(float(pixels.std())),
    }


def format_number(value: float) -> str:
    """Six significant digits, always recognisable as a real number."""
    text = f"{value:.6g}"
    return text if any(sign in text for sign in ".e") else f"{text}.0"


def format_vector(values: Iterable[float]) -> str:
    """(x,y,z) as in labels."""
    return "(" + ",".join(format_number(float(value)) for value in values) + ")"
