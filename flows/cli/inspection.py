"""Data of an image: time, pose, pointing, camera, and its partner.

For a derived raster of the archive (XYZ, range, slope ...): content of its bands, unit, frame,
number of pixels, range of values, and difference from a store's measurement of the same image.

Directions are computed from quaternions and camera models, not from INSTRUMENT_AZIMUTH and
INSTRUMENT_ELEVATION, whose sign is wrong in whole product families. Two directions are given, which
differ by degrees: the mast's x axis, along the camera bar (what labels call the pointing), and the
ray through the middle of the image. With d a direction in the rover frame (x forward, y right, z
down) or, turned by the rover's attitude, in the site frame (north, east, down),

    azimuth = atan2(d_y, d_x), clockwise from forward or north      elevation = asin(-d_z)
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from solmap.config.radiometry import load_radiometry
from solmap.config.records import ConfigError
from solmap.config.settings import Settings
from solmap.photogrammetry.archive.file_names import FileName, parse_file_name
from solmap.photogrammetry.archive.images.derived_rasters import (
    DerivedRaster,
    RasterKind,
    raster_kind,
    read_raster,
)
from solmap.photogrammetry.archive.images.pixels import radiance_scale
from solmap.photogrammetry.archive.images.radiometry import Radiometry
from solmap.photogrammetry.archive.images.reading import (
    DescribedImage,
    ReadImage,
    describe_image,
    has_attached_label,
    read_image,
    read_label,
)
from solmap.photogrammetry.archive.labels.detached import decode_label
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.archive.missions import mission_of_host
from solmap.photogrammetry.archive.partners import MAX_CLOCK_DIFFERENCE, find_stereo_pairs
from solmap.photogrammetry.arrays import GreyImage, Mask, Vector3
from solmap.photogrammetry.cameras.cahv import Cahv, interior_orientation
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.cameras.cahvore import Cahvore
from solmap.photogrammetry.cameras.linearisation import Field, linearise_image, linearise_pair
from solmap.photogrammetry.cameras.photogrammetric import photogrammetric
from solmap.photogrammetry.errors import LabelError, PhotogrammetryError
from solmap.photogrammetry.frames import roll_pitch_yaw_of_rotation, rotation_of_quaternion
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.stretching import stretch
from solmap.products.errors import cause_of
from solmap.products.store.user_files import read_user_file, reason_of
from solmap.tasks.images.files import image_bytes
from solmap.tasks.images.folders import IMAGE_FILE_SUFFIXES, IMAGE_SUFFIXES

LABEL_SUFFIXES = frozenset({".lbl", ".xml", ".json"})
NEIGHBOURS = IMAGE_SUFFIXES | IMAGE_FILE_SUFFIXES | {".lbl"}
"""Files that may hold the partner of an image."""
FIELDS = {"PANCAM": Field.LARGEST}
"""Field of view of JPL's linearised products of an instrument, if not the smallest."""


class InspectionError(Exception):
    """A file cannot be inspected or its image not written; the message names file and fault."""


def inspect_files(
    files: Iterable[Path], store: Path | None = None
) -> tuple[list[dict[str, Any]], list[str]]:
    """Description of each file as plain values, and one line for each unreadable file."""
    findings: list[dict[str, Any]] = []
    faults: list[str] = []
    for file in files:
        try:
            findings.append(inspect_file(file, store))
        except InspectionError as error:
            faults.append(str(error))
    return findings, faults


def inspect_file(file: Path, store: Path | None = None) -> dict[str, Any]:
    """Description of a file; angles in degrees, lengths in metres, None for unknown values.

    Args:
        file: an image, a label or a derived raster.
        store: Compared with a derived raster, if given.

    Raises:
        InspectionError: it cannot be read.
    """
    data = _bytes(file)
    try:
        raster = _derived_raster(file, data)
        if raster is not None:
            beside = (
                {} if store is None else {"beside_store": _beside_store(file, data, raster, store)}
            )
            return {"file": str(file), **_raster(file, raster), **beside}
        described = _describe(file, data)
        image, label = described.image, described.label
        read = None if _is_label(file) else _read(file, data, image.stop.mission)
        mask = None if read is None else read.mask
        return {
            "file": str(file),
            **_identity(image),
            "size": {
                "samples": image.samples,
                "lines": image.lines,
                "masked_share": None if mask is None else 1.0 - float(mask.mean()),
            },
            "notes": [] if read is None else list(read.notes),
            "radiance": _radiance(label),
            "pointing": _pointing(image, label),
            "camera": _camera(image),
            "rover": _rover(image),
            "sun": _sun(image),
            "partner": _partner(file, image),
        }
    except InspectionError:
        raise
    except Exception as error:
        raise InspectionError(_error_line(file, error)) from error


def write_png(file: Path, png: Path) -> None:
    """Write an eight-bit copy of an image, stretched like browse images.

    Raises:
        InspectionError: the image cannot be read or the image not written.
    """
    data = _bytes(file)
    try:
        read = _read(file, data, _describe(file, data).image.stop.mission)
    except PhotogrammetryError as error:
        raise InspectionError(_error_line(file, error)) from error
    _write_stretched(read.pixels, read.mask, file, png)


def write_linearised(file: Path, png: Path) -> None:
    """Write an image linearised by JPL's rule for its pair, as archived FFL and RSL products are.

    Raises:
        InspectionError: there is no partner beside it, the pair is not of CAHVOR cameras and one
            size, the image cannot be read or the image not written.
    """
    data = _bytes(file)
    try:
        image = _describe(file, data).image
        partner = _partner_record(file, image)
        own, other = image.camera, partner.camera
        if not isinstance(own, Cahvor) or not isinstance(other, Cahvor):
            raise InspectionError(
                f"{file.name}: JPL's linearisation is for CAHVOR cameras, not for "
                f"{type(own).__name__.upper()}{' (linearised already)' * image.is_linearised}"
            )
        if (partner.samples, partner.lines) != (image.samples, image.lines):
            raise InspectionError(
                f"{file.name}: {image.samples} x {image.lines} pixels, its partner {partner.id} "
                f"{partner.samples} x {partner.lines}: JPL's linearisation is for one size"
            )
        linear, _ = linearise_pair(
            own, other, image.samples, image.lines, FIELDS.get(image.instrument, Field.SMALLEST)
        )
        read = _read(file, data, image.stop.mission)
        pixels, mask = linearise_image(read.pixels, read.mask, own, linear)
    except PhotogrammetryError as error:
        raise InspectionError(_error_line(file, error)) from error
    _write_stretched(pixels, mask, file, png)


def _write_stretched(pixels: GreyImage, mask: Mask, file: Path, png: Path) -> None:
    import cv2  # noqa: PLC0415 - only images need it

    draft = png.with_name(png.name + ".part")
    try:
        encoded, content = cv2.imencode(".png", stretch(pixels, mask))
        if not encoded:
            raise InspectionError(f"{file.name} could not be encoded as PNG")
        draft.write_bytes(content.tobytes())
        draft.replace(png)
    except OSError as error:
        raise InspectionError(f"{png} cannot be written: {error.strerror}") from error


def _bytes(file: Path) -> bytes:
    """A label unchanged; an image joined to its detached label."""
    try:
        return read_user_file(file) if _is_label(file) else image_bytes(file)
    except LabelError as error:
        raise InspectionError(_error_line(file, error)) from error
    except OSError as error:
        raise InspectionError(f"{file} cannot be read: {reason_of(error)}") from error


def _is_label(file: Path) -> bool:
    return file.suffix.lower() in LABEL_SUFFIXES


def _describe(file: Path, data: bytes) -> DescribedImage:
    """Record and label of a file; a label alone may be PDS4 or JSON metadata, too."""
    if _is_label(file) and not has_attached_label(data):
        return describe_image(b"", file.name, detached_label=decode_label(data))
    return describe_image(data, file.name)


def _read(file: Path, data: bytes, mission: str) -> ReadImage:
    """Pixels, read with the tables that the settings name."""
    try:
        known = load_radiometry(Settings().instruments)
    except ConfigError as error:
        raise InspectionError(str(error)) from error
    return read_image(data, file.name, radiometry=known.get(mission, Radiometry()))


def _derived_raster(file: Path, data: bytes) -> DerivedRaster | None:
    """The raster in a file; None for an image, or a file without an attached label."""
    try:
        kind = None if _is_label(file) else raster_kind(read_label(data, file.name), file.name)
    except LabelError:
        return None  # reading it as an image reports the fault
    return None if kind is None else read_raster(data, file.name)


def _raster(file: Path, raster: DerivedRaster) -> dict[str, Any]:
    lines, samples = raster.mask.shape
    return {
        "product": file.stem.upper(),
        "raster": str(raster.kind),
        "frame": None if raster.frame is None else str(raster.frame),
        "partner_image": raster.partner,
        "size": {
            "samples": samples,
            "lines": lines,
            "masked_share": 1.0 - float(raster.mask.mean()),
        },
        "bands": [
            {"name": name, "unit": raster.unit, "range": _range(values[raster.mask])}
            for name, values in zip(raster.band_names, raster.bands, strict=True)
        ],
    }


def _beside_store(file: Path, data: bytes, raster: DerivedRaster, store: Path) -> dict[str, Any]:
    """Difference of a raster from a store's measurement of the same image."""
    from solmap.products.catalogue.workspace import Workspace  # noqa: PLC0415 - needs databases
    from solmap.products.export.comparison import compare_raster  # noqa: PLC0415

    return asdict(compare_raster(raster, read_label(data, file.name), Workspace.open(store)))


def write_points(file: Path, ply: Path) -> None:
    """Write the points of an XYZ raster: east, north, up of the frame that it is in.

    Raises:
        InspectionError: it is not a raster, cannot be read, or the points not written.
    """
    from solmap.photogrammetry.terrain.mesh.point_cloud import PointCloud  # noqa: PLC0415
    from solmap.products.formats.mesh.ply import write_ply  # noqa: PLC0415

    try:
        raster = _derived_raster(file, _bytes(file))
    except PhotogrammetryError as error:
        raise InspectionError(_error_line(file, error)) from error
    if raster is None or raster.kind is not RasterKind.XYZ:
        raise InspectionError(f"{file.name} is not an XYZ raster: there are no points to write")
    north, east, down = raster.bands[:, raster.mask].astype(np.float64)
    count = len(down)
    cloud = PointCloud(
        np.column_stack([east, north, -down]),
        np.full(count, 255, dtype=np.uint8),
        np.full(count, np.nan, dtype=np.float32),
        0.0,
    )
    draft = ply.with_name(ply.name + ".part")
    try:
        write_ply(draft, cloud, {"frame": str(raster.frame), "source": file.name})
        draft.replace(ply)
    except OSError as error:
        raise InspectionError(f"{ply} cannot be written: {error.strerror}") from error


def _range(values: np.ndarray) -> list[float] | None:
    return [float(values.min()), float(values.max())] if len(values) else None


def _radiance(label: Label | None) -> dict[str, float] | None:
    """Conversion of numbers to radiance, W m^-2 sr^-1 nm^-1, where the label gives it."""
    scale = None if label is None else radiance_scale(label)
    return None if scale is None else {"factor": scale.factor, "offset": scale.offset}


def _error_line(file: Path, error: Exception) -> str:
    """The fault in one line that names the file."""
    line = cause_of(error)
    return line if file.name in line else f"{file.name}: {line}"


def _identity(image: RoverImage) -> dict[str, Any]:
    return {
        "product": image.id,
        "product_type": image.product_type,
        "is_linearised": image.is_linearised,
        "mission": image.stop.mission,
        "sol": image.sol,
        "local_solar_time": image.local_solar_time,
        "start_time": image.start_time,
        "clock": image.clock,
        "site": image.stop.site,
        "drive": image.stop.drive,
        "motion_counter": list(image.motion_counter),
        "sequence": image.sequence,
        "instrument": image.instrument,
        "eye": str(image.eye),
        "filter": image.filter_number,
    }


def _pointing(image: RoverImage, label: Label | None) -> dict[str, Any]:
    """Viewing directions of mast and camera, in both frames."""
    middle = np.array([[(image.samples - 1) / 2, (image.lines - 1) / 2]])
    directions = {"image_centre": image.camera.rays(middle)[0]}
    mast = _mast_direction(image, label)
    if mast is not None:
        directions["mast"] = mast
    return {
        name: {
            "in_rover_deg": _azimuth_elevation(direction),
            "in_site_deg": _azimuth_elevation(image.site_from_rover.turn(direction[None])[0]),
        }
        for name, direction in directions.items()
    }


def _mast_direction(image: RoverImage, label: Label | None) -> Vector3 | None:
    """The mast's x axis in the rover frame; None for cameras that it does not carry."""
    mission = mission_of_host(image.stop.mission)
    if mission is None or label is None or image.mast_in_rover is None:
        return None
    if label.get(mission.mast_group, "ORIGIN_ROTATION_QUATERNION") is None:
        return None
    quaternion = label.require_numbers(mission.mast_group, "ORIGIN_ROTATION_QUATERNION", 4)
    return rotation_of_quaternion(quaternion)[:, 0]


def _azimuth_elevation(direction: Vector3) -> list[float]:
    x, y, z = (direction / np.linalg.norm(direction)).tolist()
    azimuth = math.degrees(math.atan2(y, x)) % 360.0
    return [azimuth, math.degrees(math.asin(max(-1.0, min(1.0, -z))))]


def _camera(image: RoverImage) -> dict[str, Any]:
    camera = image.camera
    if not isinstance(camera, Cahv | Cahvor | Cahvore):
        raise LabelError(
            f"{image.id}: its camera is a {type(camera).__name__}, not of the CAHV kind"
        )
    inner = interior_orientation(camera.a, camera.h, camera.v)
    perspective = camera.perspective if isinstance(camera, Cahvore) else camera
    angles = photogrammetric(perspective).omega_phi_kappa
    return {
        "model": type(camera).__name__.upper(),
        "focal_px": [inner.hs, inner.vs],
        "principal_point_px": [inner.hc, inner.vc],
        "field_of_view_deg": _field_of_view(image),
        "centre_in_rover_m": camera.centre.tolist(),
        "omega_phi_kappa_deg": [math.degrees(angle) for angle in angles],
    }


def _field_of_view(image: RoverImage) -> list[float]:
    """Angles between the middles of opposite outer edges: across and down."""
    x, y = (image.samples - 1) / 2, (image.lines - 1) / 2
    edges = [[-0.5, y], [image.samples - 0.5, y], [x, -0.5], [x, image.lines - 0.5]]
    left, right, upper, lower = image.camera.rays(np.array(edges))
    return [_angle_deg(left, right), _angle_deg(upper, lower)]


def _angle_deg(first: Vector3, second: Vector3) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(first, second))), first @ second))


def _rover(image: RoverImage) -> dict[str, Any]:
    pose = image.site_from_rover
    angles = roll_pitch_yaw_of_rotation(pose.rotation)
    return {
        "in_site_m": pose.translation_m.tolist(),
        "roll_pitch_yaw_deg": [math.degrees(angle) for angle in angles],
        "attitude_measured_by": image.attitude_measured_by,
        "mast_in_rover_m": None if image.mast_in_rover is None else list(image.mast_in_rover),
    }


def _sun(image: RoverImage) -> dict[str, Any] | None:
    if image.sun_azimuth is None or image.sun_elevation is None:
        return None
    return {"in_site_deg": [math.degrees(image.sun_azimuth), math.degrees(image.sun_elevation)]}


def _partner(file: Path, image: RoverImage) -> dict[str, Any]:
    """The stereo partner in the folder of a file, or the reason for none."""
    found, why_none = _find_partner(file, image)
    if found is None:
        return {"product": None, "file": None, "why_none": why_none}
    return {"product": found[1].id, "file": str(found[0]), "why_none": None}


def _partner_record(file: Path, image: RoverImage) -> RoverImage:
    found, why_none = _find_partner(file, image)
    if found is None:
        raise InspectionError(
            f"{file.name}: JPL's linearisation needs the stereo partner beside it: {why_none}"
        )
    return found[1]


def _find_partner(
    file: Path, image: RoverImage
) -> tuple[tuple[Path, RoverImage] | None, str | None]:
    """File and record of the stereo partner in the folder of a file, or the reason for none."""
    beside = _beside(file, image)
    pairing = find_stereo_pairs([image, *(record for _, record in beside)])
    for pair in pairing.pairs:
        if image.id in {pair.left.id, pair.right.id}:
            other = pair.right.id if image.id == pair.left.id else pair.left.id
            return next(one for one in beside if one[1].id == other), None
    return None, pairing.unpaired.get(image.id)


def _beside(file: Path, image: RoverImage) -> list[tuple[Path, RoverImage]]:
    """Images in the same folder that were taken at the same time, by their names."""
    found: list[tuple[Path, RoverImage]] = []
    for path in sorted(file.parent.iterdir()):
        name = _file_name(path)
        if name is None or name.product_id == image.id or name.instrument != image.instrument:
            continue
        if abs(name.clock - math.floor(image.clock)) <= math.ceil(MAX_CLOCK_DIFFERENCE):
            try:
                found.append((path, _describe(path, _bytes(path)).image))
            except Exception:  # noqa: BLE001, S112 - any fault of it
                continue  # a broken neighbour is not a partner; inspecting it reports the fault
    return found


def _file_name(path: Path) -> FileName | None:
    if path.suffix.lower() not in NEIGHBOURS:
        return None
    try:
        return parse_file_name(path.name)
    except LabelError:
        return None
