"""Truth of a world: poses and cameras as a file, parallaxes as a map.

The file has the keys of `rendered_husband`, an independently rendered traverse, and also the
complete camera models, because R_cam_to_lsl with one focal length is less than a CAHVOR.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float32, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.body import entered
from solmap.photogrammetry.synthetic.lighting import LitGround
from solmap.photogrammetry.synthetic.render import View, first_hits, rotate_rays
from solmap.photogrammetry.synthetic.scene import Shot, World
from solmap.photogrammetry.synthetic.traverse import LATITUDE, LONGITUDE_DEG, Stop

MARS_RADIUS_M = 3_396_190


def true_parallax(world: World, stop: int, pair: int, geometry: EpipolarPair) -> ParallaxMap:
    """Parallax of every pixel of the left epipolar image, from the landscape itself.

    NaN for the sky, at outlines, where the right camera does not see the point, and where the rover
    hides it.
    """
    shot = world.shot(stop, pair)
    lsl_from_pair = world.true_lsl_from_label_rover(shot) @ geometry.rover_from_pair
    ground = world.ground(stop)
    rays = rotate_rays(lsl_from_pair, _pair_rays(geometry))
    view = View.of_rays(lsl_from_pair.translation_m, rays, 1 / geometry.focal_px)
    points = lsl_from_pair.inverse.apply(first_hits(ground, view))
    parallax_px = geometry.focal_px * geometry.base_m / points[:, 2]
    visible = _visible_to_right(geometry, lsl_from_pair, ground, points)
    if world.params.rover_in_view:
        visible &= _beside_rover(world.stops[stop].lsl_from_rover, lsl_from_pair, geometry, points)
    parallax_px[~visible] = np.nan
    return parallax_px.reshape(geometry.lines, geometry.samples).astype(np.float32)


def _pair_rays(geometry: EpipolarPair) -> Float32[np.ndarray, "3 lines samples"]:
    line, sample = np.mgrid[: geometry.lines, : geometry.samples].astype(np.float32)
    x = (sample - np.float32(geometry.centre_px[0])) / np.float32(geometry.focal_px)
    y = (line - np.float32(geometry.centre_px[1])) / np.float32(geometry.focal_px)
    return np.stack([x, y, np.ones_like(x)]) / np.sqrt(x * x + y * y + 1)


def _visible_to_right(
    geometry: EpipolarPair, lsl_from_pair: Pose, ground: LitGround, points: np.ndarray
) -> np.ndarray:
    """Whether the right camera's first intersection towards every point is the point itself."""
    towards = points - [geometry.base_m, 0.0, 0.0]
    distance_m = np.linalg.norm(towards, axis=1)
    known = np.isfinite(distance_m)
    rays = np.where(known[:, None], towards / distance_m[:, None], [0.0, 0.0, 1.0]).T
    rays = rays.reshape(3, geometry.lines, geometry.samples).astype(np.float32)
    centre = lsl_from_pair.apply(np.array([[geometry.base_m, 0.0, 0.0]]))[0]
    view = View.of_rays(centre, rotate_rays(lsl_from_pair, rays), 1 / geometry.focal_px)
    hit_m = np.linalg.norm(first_hits(ground, view) - centre, axis=1)
    return known & (np.abs(hit_m - distance_m) < 0.01 + 0.01 * distance_m)


def _beside_rover(
    lsl_from_rover: Pose, lsl_from_pair: Pose, geometry: EpipolarPair, points: np.ndarray
) -> Flags:
    """Whether the rays from both cameras to points miss the rover."""
    rover_from_pair = lsl_from_rover.inverse @ lsl_from_pair
    aims = rover_from_pair.apply(points)
    beside = np.ones(len(points), np.bool_)
    for centre in np.array([[0.0, 0.0, 0.0], [geometry.base_m, 0.0, 0.0]]):
        origin = rover_from_pair.apply(centre[None])[0]
        distance_m = np.linalg.norm(aims - origin, axis=1)
        rays = (aims - origin) / distance_m[:, None]
        beside &= entered(origin, rays.astype(np.float32))[0] > distance_m
    return beside


def truth_document(world: World) -> dict[str, object]:
    """The truth, in the keys of `rendered_husband`, with the complete camera models."""
    latitude = float(np.rad2deg(LATITUDE))
    return {
        "frame": f"{LSL}: origin at the rover origin of the first stop, X north, Y east, Z down, "
        "metres",
        "crs": f"+proj=eqc +lat_0={latitude:.4f} +lat_ts={latitude:.4f} +lon_0={LONGITUDE_DEG} "
        f"+R={MARS_RADIUS_M} +units=m +no_defs",
        "seed": world.seed,
        "terrain": world.params.terrain,
        "rig": asdict(world.params.rig),
        "camera": asdict(world.params.camera),
        "stops": [_stop_truth(stop) for stop in world.stops],
        "images": [
            _image_truth(world, shot, eye) for shot in world.shots for eye in (Eye.LEFT, Eye.RIGHT)
        ],
    }


def _stop_truth(stop: Stop) -> dict[str, object]:
    true, telemetry = stop.lsl_from_rover, stop.telemetry_lsl_from_rover
    return {
        "sol": stop.sol,
        "site": stop.id.site,
        "drive": stop.id.drive,
        "position": true.translation_m.tolist(),
        "rover_to_lsl_quaternion_wxyz": true.quaternion.tolist(),
        "telemetry_position": telemetry.translation_m.tolist(),
        "telemetry_quaternion_wxyz": telemetry.quaternion.tolist(),
        "slip": stop.slip,
        "sun_azimuth_deg": float(np.rad2deg(stop.sun.azimuth)),
        "sun_elevation_deg": float(np.rad2deg(stop.sun.elevation)),
    }


def _image_truth(world: World, shot: Shot, eye: Eye) -> dict[str, object]:
    camera = world.true_camera(shot, eye)
    h_c, v_c = float(camera.a @ camera.h), float(camera.a @ camera.v)
    right = camera.h - h_c * camera.a
    focal_px = float(np.linalg.norm(right))
    right = right / focal_px
    return {
        "product_id": world.exposure(shot, eye).product_id,
        "stop": shot.stop,
        "C_lsl": camera.c.tolist(),
        "R_cam_to_lsl": np.column_stack([camera.a, right, np.cross(camera.a, right)]).tolist(),
        "columns": "view, right, down",
        "f_px": focal_px,
        "c_px": [h_c, v_c],
        "cahvor_lsl": {name: getattr(camera, name.lower()).tolist() for name in "CAHVOR"},
        "mast_miss_rpy_deg": np.rad2deg(shot.miss).tolist(),
    }
