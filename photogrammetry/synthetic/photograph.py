"""The camera's part: from the radiance of the ground to the numbers in the image.

Pixels count electrons: with the radiance L and an exposure that brings level ground to some 1800 of
4095,

    DN = g L B(phase) + noise,     variance = DN / 41.5 + 0.6^2     (full well 170,000 e-, 25 e-),

B = 1 + 0.35 / (1 + tan(phase / 2) / 0.12) being the brightening opposite the sun (Hapke 1986).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solmap.photogrammetry.arrays import GreyImage, Int32
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.lattice import stream_of
from solmap.photogrammetry.synthetic.lighting import SKY_LIGHT, Sun
from solmap.photogrammetry.synthetic.render import Rays, View, picture, turned
from solmap.photogrammetry.synthetic.rig import CAMERAS, FULL_FRAME, Instrument
from solmap.photogrammetry.synthetic.scene import Shot, World

LEVEL_DN = 1800.0
ELECTRONS_PER_DN = 41.5
READ_DN = 0.6


def photograph(world: World, shot: Shot, eye: Eye) -> Int32[np.ndarray, "lines samples"]:
    """The pixels of one image."""
    sun = world.stops[shot.stop].sun
    view, rays = view_of(world, shot, eye)
    gain = LEVEL_DN / (np.sin(sun.elevation) + SKY_LIGHT)
    signal = picture(world.ground(shot.stop), view)
    signal *= _opposition(rays, sun)
    signal *= np.float32(gain)
    rng = stream_of(world.seed, 106, shot.stop, shot.pair, 0 if eye is Eye.LEFT else 1)
    noise = rng.standard_normal(signal.shape, dtype=np.float32)
    share = np.float32(1 / (ELECTRONS_PER_DN * world.params.averaging**2))
    noise *= np.sqrt(np.maximum(signal, 0) * share + np.float32(READ_DN**2))
    signal += noise
    return np.clip(np.rint(signal), 1, 4095).astype(np.int32)


def _opposition(rays: Rays, sun: Sun) -> GreyImage:
    north, east, up = (np.float32(part) for part in sun.direction)
    cosine = up * rays[2] - north * rays[0] - east * rays[1]
    tangent = np.sqrt(np.maximum(1 - cosine, 0) / np.maximum(1 + cosine, np.float32(1e-6)))
    return 1 + np.float32(0.35) / (1 + tangent * np.float32(1 / 0.12))


def view_of(world: World, shot: Shot, eye: Eye) -> tuple[View, Rays]:
    """Where the pixels of one image truly look."""
    pose = world.true_lsl_from_mast(shot)
    in_mast = _rays_in_mast(shot.instrument, eye, world.params.averaging)
    rays = turned(pose, in_mast)
    centre = pose.apply(CAMERAS[shot.instrument, eye].in_mast.c[None])[0]
    return View.of_rays(centre, rays, _pixel_rad(shot.instrument, world.params.averaging)), rays


def _pixel_rad(instrument: Instrument, averaging: int) -> float:
    h = CAMERAS[instrument, Eye.LEFT].in_mast.h
    return averaging / float(np.linalg.norm(h - h[0] * np.array([1.0, 0, 0])))


@lru_cache(maxsize=4)
def _rays_in_mast(instrument: Instrument, eye: Eye, averaging: int) -> Rays:
    camera = CAMERAS[instrument, eye].in_mast.averaged(averaging, averaging)
    side = FULL_FRAME // averaging
    line, sample = np.mgrid[:side, :side].reshape(2, -1)
    rays = camera.rays(np.column_stack([sample, line]).astype(np.float64))
    return np.ascontiguousarray(rays.T, np.float32).reshape(3, side, side)
