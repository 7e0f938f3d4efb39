"""Rasters of a stereo pair as in JPL's pipeline: XYZ, range, normals and slope, in VICAR.

    XYL   x north, y east, z down in the frame of the site, metres
    RNL   distance from the projection centre of the left camera, metres
    UVL   unit normal of the ground in the frame of the site, away from the ground
    SLL   slope, degrees from the level

in the left epipolar image of the pair ("linearised", hence the L), whose camera model the label
gives. XYZ are triangulated from the dense parallax, with the adjusted pointing of the mast and the
pose of the rover from the image's label, so that they can be compared with archived products of the
same image. Normals are of planes z = a x + b y + c fitted to all points in a window of `WINDOW_PX`
pixels around a pixel; a window that is less than half filled has none.

A pixel with a parallax below `FEWEST_SIGMAS` of its standard deviations counts as not measured,
because its range is unknown.

Files are VICAR with an attached label; values are little-endian 32-bit floats, band after band, and
0 in all bands means not measured. `solmap inspect`, GDAL and VICAR read them; each has a PDS4 label
(`.xml`) beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Float32, Mask, ObjectPoints
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.matching.records import DenseMatches
from solmap.products.export.pds4 import pds4_label
from solmap.products.store.provenance import SOFTWARE

WINDOW_PX = 15
"""0.7 degrees of a Navcam: a decimetre at 8 m, the size of a wheel."""
FEWEST_SIGMAS = 3.0
"""Least parallax in standard deviations: the range is accurate to a third."""
_FILLED = 0.5
"""Least measured fraction of a window."""
_FLATTEST = 1e-6
"""Least determinant of a fit, relative to its diagonal: below it points are on a line."""
Bands = Float32[np.ndarray, "bands lines samples"]


@dataclass(frozen=True, slots=True)
class RasterType:
    """A raster of the archive: its letters, and its name in labels."""

    letters: str
    """Product type in the name of an image."""
    derived: str
    """DERIVED_IMAGE_TYPE."""
    title: str
    unit: str
    pds4_unit: str | None


XYZ = RasterType("XYL", "XYZ_MAP", "XYZ in the frame of the site", "METER", "m")
RANGE = RasterType("RNL", "RANGE_MAP", "Range from the camera", "METER", "m")
NORMAL = RasterType("UVL", "UVW_MAP", "Surface normals in the frame of the site", "N/A", None)
SLOPE = RasterType("SLL", "SLOPE_MAP", "Slope", "DEGREE", "deg")


def pair_rasters(
    image: RoverImage, geometry: EpipolarPair, dense: DenseMatches, rover_from_pair: Pose
) -> Iterator[tuple[str, bytes]]:
    """File name and content of each raster of a pair.

    Args:
        image: Label of the left image.
        geometry: The epipolar images that the parallax was measured in.
        dense: Parallax of every pixel of the left one.
        rover_from_pair: The adjusted pose of the pair on the rover.
    """
    camera = _camera_group(image, geometry, rover_from_pair)
    found = pair_values(image, geometry, dense, rover_from_pair)
    for raster, bands in found.items():
        values = np.nan_to_num(bands)
        name = _name(image, raster)
        groups = {**_groups(image, raster, name), "GEOMETRIC_CAMERA_MODEL": camera}
        content = vicar_bytes(values, groups)
        yield f"{name}.img", content
        label = pds4_label(
            image,
            name=f"{name}.img",
            title=f"{raster.title} of {image.id}, by solmap",
            offset=len(content) - values.nbytes,
            shape=values.shape,
            unit=raster.pds4_unit,
        )
        yield f"{name}.xml", label.encode()


def pair_values(
    image: RoverImage, geometry: EpipolarPair, dense: DenseMatches, rover_from_pair: Pose
) -> dict[RasterType, Bands]:
    """The values of each raster of a pair, NaN in all bands where nothing was measured.

    Arguments are those of `pair_rasters`.
    """
    site_from_pair = image.site_from_rover @ rover_from_pair
    shape = (geometry.lines, geometry.samples)
    rows, cols = np.indices(shape, dtype=np.float64)
    pixels = np.column_stack([cols.ravel(), rows.ravel()])
    known_px = dense.parallax_px > FEWEST_SIGMAS * dense.sigma_px
    parallax = np.where(known_px, dense.parallax_px, np.nan).astype(np.float64)
    in_pair = geometry.triangulate(pixels, parallax.ravel())
    measured = np.isfinite(in_pair).all(axis=1).reshape(shape)
    in_site = site_from_pair.apply(in_pair)
    normals = surface_normals(in_site, measured)
    known = np.isfinite(normals).all(axis=0)
    slope = np.degrees(np.arccos(np.clip(-normals[2:], 0.0, 1.0)))
    distance = np.linalg.norm(in_pair, axis=1).reshape(1, *shape)
    return {
        raster: np.where(mask, bands, np.nan).astype(np.float32)
        for raster, bands, mask in (
            (XYZ, in_site.T.reshape(3, *shape), measured),
            (RANGE, distance, measured),
            (NORMAL, normals, known),
            (SLOPE, slope, known),
        )
    }


def surface_normals(points: ObjectPoints, measured: Mask) -> np.ndarray:
    """Unit normals (3, lines, samples), upward in a frame whose z is down; NaN where unknown."""
    lines, samples = measured.shape
    middle = points[measured.ravel()].mean(axis=0) if measured.any() else np.zeros(3)
    x, y, z = np.where(measured.ravel()[:, None], points - middle, 0.0).T.reshape(3, lines, samples)
    one = measured.astype(np.float64)
    size = (WINDOW_PX, WINDOW_PX)

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(values, cv2.CV_64F, size, borderType=cv2.BORDER_CONSTANT)

    filled = mean(one)
    with np.errstate(invalid="ignore", divide="ignore"):
        mx, my, mz = (mean(values) / filled for values in (x, y, z))
        xx, yy, xy = (
            mean(x * x) / filled - mx**2,
            mean(y * y) / filled - my**2,
            mean(x * y) / filled,
        )
        xz, yz = mean(x * z) / filled - mx * mz, mean(y * z) / filled - my * mz
        xy = xy - mx * my
        determinant = xx * yy - xy**2
        a = (xz * yy - yz * xy) / determinant
        b = (yz * xx - xz * xy) / determinant
        good = measured & (filled >= _FILLED) & (determinant > _FLATTEST * xx * yy)
        normals = np.stack([a, b, -np.ones_like(a)]) / np.sqrt(1.0 + a * a + b * b)
    return np.where(good, normals, np.nan)


def _name(image: RoverImage, raster: RasterType) -> str:
    """The name of an image with another product type."""
    head, found, tail = image.id.rpartition(image.product_type or "\0")
    return f"{head}{raster.letters}{tail}" if found else f"{image.id}_{raster.letters}"


Value = str | int | float | Iterable[int | float]


def _groups(image: RoverImage, raster: RasterType, name: str) -> dict[str, dict[str, Value]]:
    """The label's groups except the camera's."""
    stop, pose = image.stop, image.site_from_rover
    return {
        "IDENTIFICATION": {
            "PRODUCT_ID": name,
            "SOURCE_PRODUCT_ID": image.id,
            "INSTRUMENT_HOST_ID": stop.mission,
            "PLANET_DAY_NUMBER": image.sol,
            "ROVER_MOTION_COUNTER": image.motion_counter,
            "SPACECRAFT_CLOCK_START_COUNT": f"{image.clock:.3f}",
        },
        "DERIVED_IMAGE_PARMS": {
            "DERIVED_IMAGE_TYPE": raster.derived,
            "REFERENCE_COORD_SYSTEM_NAME": "SITE_FRAME",
            "REFERENCE_COORD_SYSTEM_INDEX": stop.site,
            "UNIT": raster.unit,
        },
        "ROVER_COORDINATE_SYSTEM": {
            "COORDINATE_SYSTEM_NAME": "ROVER_FRAME",
            "COORDINATE_SYSTEM_INDEX": (stop.site, stop.drive),
            "ORIGIN_OFFSET_VECTOR": pose.translation_m.tolist(),
            "ORIGIN_ROTATION_QUATERNION": pose.quaternion.tolist(),
            "REFERENCE_COORD_SYSTEM_NAME": "SITE_FRAME",
            "REFERENCE_COORD_SYSTEM_INDEX": stop.site,
        },
        "IMAGE_DATA": {"MISSING_CONSTANT": 0.0},
    }


def _camera_group(
    image: RoverImage, geometry: EpipolarPair, rover_from_pair: Pose
) -> dict[str, Value]:
    """The camera of the left epipolar image, as CAHV in the rover frame."""
    right, down, forward = rover_from_pair.rotation.T
    focal, (x, y) = geometry.focal_px, geometry.centre_px
    vectors = (
        rover_from_pair.translation_m,
        forward,
        focal * right + x * forward,
        focal * down + y * forward,
    )
    return {
        "MODEL_TYPE": "CAHV",
        "REFERENCE_COORD_SYSTEM_NAME": "ROVER_FRAME",
        "REFERENCE_COORD_SYSTEM_INDEX": (image.stop.site, image.stop.drive),
        **{f"MODEL_COMPONENT_{k}": v.tolist() for k, v in enumerate(vectors, start=1)},
    }


def vicar_bytes(bands: Bands, groups: Mapping[str, Mapping[str, Value]]) -> bytes:
    """A VICAR file: its label, and bands of little-endian floats one after the other."""
    count, lines, samples = bands.shape
    record = 4 * samples
    items: list[tuple[str, Value]] = [
        ("FORMAT", "REAL"),
        ("TYPE", "IMAGE"),
        ("BUFSIZ", record),
        ("DIM", 3),
        ("EOL", 0),
        ("RECSIZE", record),
        ("ORG", "BSQ"),
        ("NL", lines),
        ("NS", samples),
        ("NB", count),
        ("N1", samples),
        ("N2", lines),
        ("N3", count),
        ("N4", 0),
        ("NBB", 0),
        ("NLB", 0),
        ("HOST", "X86-LINUX"),
        ("INTFMT", "LOW"),
        ("REALFMT", "RIEEE"),
        ("BHOST", "X86-LINUX"),
        ("BINTFMT", "LOW"),
        ("BREALFMT", "RIEEE"),
        ("BLTYPE", ""),
    ]
    text = " ".join(f"{key}={_item(value)}" for key, value in items)
    for group, values in groups.items():
        text += f"  PROPERTY={_item(group)}"
        text += "".join(f" {key}={_item(value)}" for key, value in values.items())
    text += f"  TASK='SOLMAP' USER='SOLMAP' PROGRAM={_item(SOFTWARE)}"
    size_item = len("LBLSIZE=00000000 ")
    size = -(-(size_item + len(text) + 1) // record) * record  # whole records
    label = f"LBLSIZE={size:<8d} {text}".encode("ascii").ljust(size, b"\0")
    return label + bands.astype("<f4").tobytes()


def _item(value: Value) -> str:
    """A value in VICAR's notation."""
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, int | float):
        return repr(value)
    return "(" + ",".join(repr(one) for one in value) + ")"
