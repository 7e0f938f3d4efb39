"""Views of mathematical surfaces, whose parallax is found by walking along every ray."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Frame, FrameKind, Pose
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass, TerrainView

MAST_M = 1.5
Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Elevation at (east, north)."""


def looking(
    azimuth_deg: float, dip_deg: float, pair: int = 0, camera=(0.0, 0.0, MAST_M), **geometry
) -> tuple[EpipolarPair, Pose]:
    """A small mast camera at (east, north, up), and its pose in the LSL."""
    a, d = np.radians([azimuth_deg, dip_deg])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    forward = np.array([np.cos(a) * np.cos(d), np.sin(a) * np.cos(d), np.sin(d)])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    frame = Frame(FrameKind.PAIR, (pair,))
    east, north, up = camera
    lsl_from_pair = Pose(LSL, frame, rotation, np.array([north, east, -up]))
    sizes = {"base_m": 0.2, "focal_px": 300.0, "samples": 256, "lines": 256} | geometry
    centre = ((sizes["samples"] - 1) / 2, (sizes["lines"] - 1) / 2)
    pose = Pose.identity(Frame(FrameKind.ROVER, (0, 0)), frame)
    return EpipolarPair(pose, centre_px=centre, **sizes), lsl_from_pair


def view_of(*of_what: Any, **how: Any) -> TerrainView:
    """A view of a surface (`_view_of`) that may be changed."""
    seen = _view_of(*of_what, **how)
    return replace(
        seen, parallax=seen.parallax.copy(), image=seen.image.copy(), mask=seen.mask.copy()
    )


@cache
def _view_of(
    surface: Surface,
    azimuth_deg: float = 0.0,
    dip_deg: float = 20.0,
    pair: int = 0,
    albedo: Surface | None = None,
    **geometry,
) -> TerrainView:
    """A view of a surface; the image shows its albedo, or its distance from the camera."""
    pair_geometry, lsl_from_pair = looking(azimuth_deg, dip_deg, pair, **geometry)
    shape = (pair_geometry.lines, pair_geometry.samples)
    line, sample = np.indices(shape)
    rays = np.stack(
        [
            (sample - pair_geometry.centre_px[0]) / pair_geometry.focal_px,
            (line - pair_geometry.centre_px[1]) / pair_geometry.focal_px,
            np.ones(shape),
        ],
        axis=-1,
    )
    north, east, down = np.moveaxis(rays @ lsl_from_pair.rotation.T, -1, 0)
    depth = _first_meeting(surface, lsl_from_pair.translation_m, (north, east, down))
    with np.errstate(divide="ignore"):
        parallax = pair_geometry.focal_px * pair_geometry.base_m / depth
    place = [lsl_from_pair.translation_m[k] + depth * ray for k, ray in ((1, east), (0, north))]
    image = np.nan_to_num(albedo(*place) if albedo else depth, posinf=0.0)
    return TerrainView(
        pair_id=f"PAIR{pair}",
        instrument="NAVCAM",
        lsl_from_pair=lsl_from_pair,
        geometry=pair_geometry,
        parallax=parallax.astype(np.float32),
        image=image.astype(np.float32),
        mask=np.isfinite(parallax),
    )


def _first_meeting(surface: Surface, camera: np.ndarray, ray: tuple[np.ndarray, ...]) -> np.ndarray:
    """Depth at which rays first go below the surface; NaN where they never do."""
    rays = np.stack([part.ravel() for part in ray])
    depth = np.full(rays.shape[1], np.nan)
    todo = np.arange(rays.shape[1])

    def is_below(far, which):
        place = camera[:, None] + far * rays[:, which]
        return -place[2] <= surface(place[1], place[0])

    steps = np.geomspace(1.0, 40.0, 150)
    for near, far in pairwise(steps):
        below = is_below(far, todo)
        hit = todo[below]
        low, high = np.full(len(hit), near), np.full(len(hit), far)
        for _ in range(22):
            middle = (low + high) / 2
            under = is_below(middle, hit)
            low, high = np.where(under, low, middle), np.where(under, middle, high)
        depth[hit] = high
        todo = todo[~below]
    return depth.reshape(ray[0].shape)


def level(east, north):
    return np.zeros(np.broadcast(east, north).shape)


def tilted(east, north):
    return 0.05 * east - 0.1 * north


def with_boulder(east, north):
    """A block of 0.5 m, one metre wide, whose near side is five metres north of the camera."""
    return np.where((np.abs(east) < 0.5) & (north > 5) & (north < 6), 0.5, 0.0)


def dtm_of(surface: Surface, side: int = 128, cell_m: float = 0.04) -> Dtm:
    """A terrain model that is exact."""
    grid = MapGrid(-side * cell_m / 2, side * cell_m / 2, cell_m, side, side)
    east, north = np.meshgrid(*grid.centres())
    return Dtm(
        grid=grid,
        elevation=surface(east, north).astype(np.float32),
        sigma_m=np.full(grid.shape, 0.01, dtype=np.float32),
        observations=np.ones(grid.shape, dtype=np.float32),
        ground=np.full(grid.shape, GroundClass.MEASURED, dtype=np.uint8),
    )


@pytest.fixture(scope="session")
def scenes() -> ModuleType:
    """The functions of this file."""
    return sys.modules[__name__]
