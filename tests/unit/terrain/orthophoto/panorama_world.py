"""A bowl painted with a pattern, and a mast's images of it, all in closed form."""

from __future__ import annotations

import math

import numpy as np

from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.synthetic.rig import CAMERAS, Instrument, Pointing
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm
from solmap.photogrammetry.terrain.orthophoto.panorama import PanoramaImage
from solmap.photogrammetry.terrain.orthophoto.panorama_grid import StandingPlane

STOP = StopId("MER2", 10, 64)
BOWL_M = 60.0
"""The ground at distance d from the stop lies d^2 / BOWL_M above it."""
ROVER_M = 0.294
GRID = MapGrid.covering((-30.0, -30.0, 30.0, 30.0), 0.08)
PLANE = StandingPlane(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
LANDMARKS = [(0.8, 6.0), (5.0, 4.0), (-5.0, 2.5), (-2.0, -5.0), (6.0, -1.5), (1.5, 2.5)]
"""Bright dots on the ground: east and north."""
DOT_RAD = math.radians(0.3)
"""Size of a dot as it is seen from the mast: a pixel and a half."""
MAST = np.array([0.53, 0.0, -1.53])


def elevation(east, north):
    return (east**2 + north**2) / BOWL_M


def dtm() -> Dtm:
    east, north = GRID.centres()
    ground = elevation(east[None, :], north[:, None]).astype(np.float32)
    ones = np.ones_like(ground)
    return Dtm(GRID, ground, 0.01 * ones, ones, ones.astype(np.uint8))


def painted(east, north):
    """Waves of nine pixels, and dots as landmarks, that look round from the mast."""
    azimuth, above = angles(east, north)
    grey = 100 + 15 * np.sin(211 * azimuth + 3 * above) + 15 * np.sin(205 * above + 7 * azimuth)
    grey = grey + 10 * np.sin(97 * azimuth - 61 * above)
    for landmark in LANDMARKS:
        at_azimuth, at_above = angles(*landmark)
        aside = ((azimuth - at_azimuth + math.pi) % (2 * math.pi) - math.pi) * np.cos(at_above)
        apart = aside**2 + (above - at_above) ** 2
        grey = grey + 900 * np.exp(-apart / (2 * DOT_RAD**2))
    return grey


def angles(east, north):
    """Azimuth and elevation of ground as seen from the mast, radians."""
    along, across, down = north - MAST[0], east - MAST[1], -elevation(east, north) - MAST[2]
    return np.arctan2(across, along), np.arctan2(-down, np.hypot(along, across))


def ground_of(origins, rays):
    """Where rays (north, east, down) meet the bowl; NaN where they do not."""
    north, east, down = origins.T
    dn, de, dd = rays.T
    # -down - t dd = ((north + t dn)^2 + (east + t de)^2) / B
    a = (dn**2 + de**2) / BOWL_M
    b = 2 * (north * dn + east * de) / BOWL_M + dd
    c = (north**2 + east**2) / BOWL_M + down
    root = np.sqrt(np.maximum(b**2 - 4 * a * c, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (-b + np.where(c < 0, root, -root)) / (2 * a)
    return origins + t[:, None] * rays


def lsl_from_rover() -> Pose:
    return Pose(LSL, STOP.frame, np.eye(3), np.array([0.0, 0.0, -ROVER_M]))


def camera(azimuth_deg: float, elevation_deg: float, eye: Eye = Eye.LEFT):
    pointing = Pointing(math.radians(azimuth_deg), math.radians(elevation_deg))
    in_mast = CAMERAS[Instrument.NAVCAM, eye].in_mast.average(4, 4, correct_half_pixel=False)
    return in_mast.transform(pointing.rover_from_mast(STOP)).transform(lsl_from_rover())


def image(azimuth_deg: float, elevation_deg: float = -25.0, *, gain: float = 1.0, seen_as=None):
    """An image of the bowl; `seen_as` is where its label has the camera, else where it is."""
    true = camera(azimuth_deg, elevation_deg)
    line, sample = np.mgrid[:256, :256]
    points = np.column_stack([sample.ravel(), line.ravel()]).astype(np.float64)
    north, east, _ = ground_of(true.ray_origins(points), true.rays(points)).T
    grey = np.nan_to_num(painted(east, north), nan=180.0).reshape(256, 256)
    reported = seen_as or true
    mask = np.ones((256, 256), dtype=bool)
    return PanoramaImage.of(f"at {azimuth_deg:g}", reported, (gain * grey).astype(np.float32), mask)
