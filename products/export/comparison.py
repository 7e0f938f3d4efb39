"""Compare archived rasters with those of a store for the same image.

An archived raster of a left image (XYZ, range, surface normal, slope) is compared with the rasters
of its pair in the store, pixel by pixel: the ray of the archived pixel, by the camera model of its
own label, is projected to the epipolar image of the pair, where our values are interpolated. XYZ
and ranges are first converted to points, because the projection centres of both may differ by the
pointing of the mast. Both use the rover's pose by telemetry, so that differences are only those of
stereo and pointing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from solmap.photogrammetry.archive.images.derived_rasters import DerivedRaster, RasterKind
from solmap.photogrammetry.archive.images.rover_image import (
    CAMERA,
    ROVER_FRAMES,
    camera_model,
)
from solmap.photogrammetry.archive.labels.label import Label
from solmap.photogrammetry.archive.missions import mission_id
from solmap.photogrammetry.archive.partners import MAX_CLOCK_DIFFERENCE
from solmap.photogrammetry.arrays import ObjectPoints
from solmap.photogrammetry.errors import LabelError
from solmap.photogrammetry.frames import FrameKind
from solmap.photogrammetry.imagery import Eye, RoverImage, StopId
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.errors import ProductNotFoundError
from solmap.products.export.pair_rasters import NORMAL, RANGE, SLOPE, XYZ, RasterType, pair_values

MOST_PIXELS = 100_000
"""Most pixels compared, distributed evenly."""
FAR_M = 1e4
"""Distance at which rays are projected for kinds without ranges: the centres of both cameras
coincide."""
_NORMAL_SHARE = 1.4826
"""Ratio of the standard deviation of a normal distribution to its median absolute deviation."""
TYPES: dict[RasterKind, RasterType] = {
    RasterKind.XYZ: XYZ,
    RasterKind.RANGE: RANGE,
    RasterKind.NORMAL: NORMAL,
    RasterKind.SLOPE: SLOPE,
}


@dataclass(frozen=True, slots=True)
class Difference:
    """Archived minus ours."""

    name: str
    unit: str
    median: float
    spread: float
    """1.4826 times the median absolute deviation from the median."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of an archived raster with ours."""

    image_id: str
    pixels: int
    """Number of compared values."""
    share: float
    """Fraction of the examined archived values for which we have one."""
    differences: tuple[Difference, ...]


def compare_raster(raster: DerivedRaster, label: Label, workspace: Workspace) -> Comparison:
    """Compare an archived raster with the rasters of the same image in a store.

    Raises:
        LabelError: its label does not identify its image or its camera.
        ProductNotFoundError: the store has no matched pair of that image, or the kind has no
            counterpart.
    """
    kind = TYPES.get(raster.kind)
    if kind is None:
        raise ProductNotFoundError(
            f"{label.source}: solmap has no {raster.kind}; XYZ, ranges, normals and slopes are "
            "compared"
        )
    record, mission, entry = _image_of(label, workspace)
    partners, pair = mission.stereo_partners(entry), mission.pairs.get(entry.id)
    if partners is None or pair is None:
        raise ProductNotFoundError(f"{label.source}: {entry.id} has no matched pair in the store")
    geometry = partners.geometry
    rover_from_pair = mission.stops[pair.stop].lsl_from_rover.inverse @ pair.lsl_from_pair
    lines, samples = np.nonzero(raster.mask)
    some = slice(None, None, 1 + len(lines) // MOST_PIXELS)
    lines, samples = lines[some], samples[some]
    theirs = raster.bands[:, lines, samples].T.astype(np.float64)
    points = _points_in_rover(raster, theirs, np.column_stack([samples, lines]), record, label)
    at, _ = geometry.project(rover_from_pair.inverse.apply(points))
    ours = _sampled(pair_values(record, geometry, partners.dense, rover_from_pair)[kind], at)
    if raster.kind in {RasterKind.XYZ, RasterKind.NORMAL}:
        theirs = _in_site(raster, theirs, record)
    known = np.isfinite(ours).all(axis=1)
    if not known.any():
        raise ProductNotFoundError(f"{label.source}: none of its pixels was measured in {entry.id}")
    differences = _differences(raster.kind, theirs[known], ours[known])
    return Comparison(entry.id, int(known.sum()), float(known.mean()), differences)


def _image_of(label: Label, workspace: Workspace) -> tuple[RoverImage, OrientedMission, ImageEntry]:
    """The left image of a raster, by rover, motion counter and clock."""
    counter = label.require_numbers("", "ROVER_MOTION_COUNTER")
    if len(counter) < 2:  # noqa: PLR2004 - site, drive
        raise LabelError(f"{label.source}: ROVER_MOTION_COUNTER should have site and drive")
    host = mission_id(label.require("", "INSTRUMENT_HOST_ID", str))
    stop = StopId(host, int(counter[0]), int(counter[1]))
    text = label.require("", "SPACECRAFT_CLOCK_START_COUNT", str).rpartition("/")[2]
    try:
        clock = float(text)
    except ValueError:
        raise LabelError(
            f"{label.source}: SPACECRAFT_CLOCK_START_COUNT should be seconds, but is {text[:40]!a}"
        ) from None
    for entry in workspace.catalogue.images(stop=str(stop)):
        if entry.eye != Eye.LEFT or entry.partner is None:
            continue
        mission = OrientedMission.latest(entry.mission, workspace)
        record = mission.record(entry)
        if abs(record.clock - clock) <= MAX_CLOCK_DIFFERENCE:
            return record, mission, entry
    raise ProductNotFoundError(
        f"{label.source}: the store has no stereo pair of {stop} taken at clock {clock:.0f}; "
        "`solmap run` its images first"
    )


def _points_in_rover(
    raster: DerivedRaster,
    theirs: np.ndarray,
    pixels: np.ndarray,
    record: RoverImage,
    label: Label,
) -> ObjectPoints:
    """Points in the rover frame shown by the pixels."""
    if raster.kind is RasterKind.XYZ:
        return record.site_from_rover.inverse.apply(_in_site(raster, theirs, record))
    frame = label.optional(CAMERA, "REFERENCE_COORD_SYSTEM_NAME", str) or "ROVER_FRAME"
    if frame not in ROVER_FRAMES:
        raise LabelError(f"{label.source}: its camera model should be in the rover frame")
    camera = camera_model(label)
    distance_m = theirs if raster.kind is RasterKind.RANGE else FAR_M
    points: ObjectPoints = camera.centre + distance_m * camera.rays(pixels.astype(np.float64))
    return points


def _in_site(raster: DerivedRaster, theirs: np.ndarray, record: RoverImage) -> np.ndarray:
    """XYZ or normals of a raster in the frame of the image's site."""
    frame, pose = raster.frame, record.site_from_rover
    if frame in {None, pose.target}:
        return theirs
    if frame is None or frame.kind is not FrameKind.ROVER or frame.index[:2] != pose.source.index:
        raise LabelError(f"a raster in the frame {frame} is not compared with one in {pose.target}")
    return pose.turn(theirs) if raster.kind is RasterKind.NORMAL else pose.apply(theirs)


def _sampled(bands: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (n, bands) between pixels; NaN where one of the four is."""
    rows = [map_coordinates(band, at[:, ::-1].T, order=1, cval=math.nan) for band in bands]
    return np.stack(rows, axis=1).astype(np.float64)


def _differences(kind: RasterKind, theirs: np.ndarray, ours: np.ndarray) -> tuple[Difference, ...]:
    if kind is RasterKind.NORMAL:
        cosine = np.clip((theirs * ours).sum(axis=1) / np.linalg.norm(ours, axis=1), -1.0, 1.0)
        return (_difference("angle between normals", "degree", np.degrees(np.arccos(cosine))),)
    if kind is RasterKind.XYZ:
        names = ("north", "east", "down")
        return tuple(
            _difference(name, "m", apart)
            for name, apart in zip(names, (theirs - ours).T, strict=True)
        )
    unit = "degree" if kind is RasterKind.SLOPE else "m"
    return (_difference(str(kind), unit, (theirs - ours)[:, 0]),)


def _difference(name: str, unit: str, values: np.ndarray) -> Difference:
    median = float(np.median(values))
    spread = _NORMAL_SHARE * float(np.median(np.abs(values - median)))
    return Difference(name, unit, median, spread)
