"""A world with known truth, and the downlink of a rover that drives through it.

One seed fixes landscape, traverse, telemetry and mast errors, and the noise of every picture, each
from a stream of its own: files come out the same one by one, in threads, or in processes.

The mast points by its motors, and misses by small turns of its head that both eyes share and no
label knows. Pixels count electrons: with the radiance L and an exposure that brings level ground to
some 1800 of 4095,

    DN = g L B(phase) + noise,     variance = DN / 41.5 + 0.6^2     (full well 170,000 e-, 25 e-),

B = 1 + 0.35 / (1 + tan(phase / 2) / 0.12) being the brightening opposite the sun (Hapke 1986).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from photogrammetry.arrays import Float32, GreyImage, Int32, ParallaxMap, Raster
from photogrammetry.cameras.cahvor import Cahvor
from photogrammetry.cameras.epipolar import EpipolarPair
from photogrammetry.errors import PhotogrammetryError
from photogrammetry.frames import LSL, Pose
from photogrammetry.imagery import Eye
from photogrammetry.synthetic.edr import CLOCK_ZERO, Exposure, edr_bytes
from photogrammetry.synthetic.lattice import stream_of
from photogrammetry.synthetic.lighting import SKY_LIGHT, LitGround, Sun, light
from photogrammetry.synthetic.render import Rays, View, first_hits, picture
from photogrammetry.synthetic.rig import CAMERAS, FULL_FRAME, Instrument, Pointing
from photogrammetry.synthetic.terrain import TERRAINS, Terrain
from photogrammetry.synthetic.traverse import (
    LATITUDE,
    LONGITUDE_DEG,
    Stop,
    TraverseParams,
    driven,
    planned,
    solar_longitude,
    standing,
    stop_ids,
)
from photogrammetry.synthetic.vector_files import rover_vector_files, site_vector_file
from photogrammetry.terrain.grid import MapGrid

SOL_S = 88_775.42064
CLOCK_OF_SOL_0 = 126_322_960
"""Spirit's clock at the start of sol 0, seconds (facts 6.2)."""
PAIR_S = 53
"""Time from one pair to the next, seconds."""
LEVEL_DN = 1800.0
ELECTRONS_PER_DN = 41.5
READ_DN = 0.6
MARS_RADIUS_M = 3_396_190


@dataclass(frozen=True, slots=True)
class WorldParams:
    """What to simulate."""

    terrain: str = "plains"
    traverse: TraverseParams = field(default_factory=TraverseParams)
    pairs: int = 10
    """Navcam pairs of a panorama."""
    pair_step: float = float(np.deg2rad(36.0))
    mast_elevation: float = float(np.deg2rad(-18.0))
    pancam: bool = False
    """Pancam pairs towards the neighbouring stops as well (right Pancam: synthetic model)."""
    pointing_error: float = float(np.deg2rad(0.12))
    """Standard deviation of the mast head's azimuth and elevation, radians; roll has half."""
    averaging: int = 1
    """Pixels averaged to one, in both directions: 1, 2 or 4."""

    def __post_init__(self) -> None:
        if self.terrain not in TERRAINS:
            raise PhotogrammetryError(
                f"there is no terrain {self.terrain!r}: choose from {', '.join(TERRAINS)}"
            )
        if self.averaging not in (1, 2, 4) or self.pairs < 1:
            raise PhotogrammetryError(
                f"a panorama has at least one pair, averaged over 1, 2 or 4 pixels, not "
                f"{self.pairs} pairs averaged over {self.averaging}"
            )


@dataclass(frozen=True, slots=True)
class Shot:
    """One stereo exposure: both eyes share everything here."""

    stop: int
    """Which stop of the world."""
    pair: int
    """Which pair of the stop."""
    instrument: Instrument
    pointing: Pointing
    """As the motors report it."""
    miss: tuple[float, float, float]
    """Roll, pitch, yaw of the mast head beyond that, radians: the truth."""
    clock: int
    sequence: str


@dataclass(frozen=True, slots=True)
class DownlinkFile:
    """A file of the downlink: its path in the folder, and its content."""

    path: str
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Landscape, traverse and exposures, with all that is true of them."""

    params: WorldParams
    seed: int
    terrain: Terrain
    stops: tuple[Stop, ...]
    shots: tuple[Shot, ...]

    def shot(self, stop: int, pair: int) -> Shot:
        """A pair of a stop."""
        return next(shot for shot in self.shots if (shot.stop, shot.pair) == (stop, pair))

    def ground(self, stop: int) -> LitGround:
        """The ground around a stop under the sun of its sol."""
        here = self.stops[stop]
        north, east, _ = here.lsl_from_rover.translation_m
        return light(self.terrain, float(north), float(east), here.sun)

    def exposure(self, shot: Shot, eye: Eye) -> Exposure:
        """What the label of an image says."""
        stop, averaging = self.stops[shot.stop], self.params.averaging
        in_mast = CAMERAS[shot.instrument, eye].in_mast
        in_mast = in_mast.averaged(averaging, averaging, correct_half_pixel=False)  # as MER labels
        return Exposure(
            stop=stop.id,
            sol=stop.sol,
            local_solar_hour=stop.local_solar_hour + shot.pair * PAIR_S / 3600,
            solar_longitude=solar_longitude(stop.sol),
            sun=stop.sun,
            site_from_rover=stop.site_from_rover,
            instrument=shot.instrument,
            eye=eye,
            pointing=shot.pointing,
            camera=in_mast.moved(shot.pointing.rover_from_mast(stop.id)),
            clock=shot.clock,
            pma=shot.pair + 1,
            sequence=shot.sequence,
            averaging=averaging,
        )

    def true_lsl_from_mast(self, shot: Shot) -> Pose:
        """Where the mast head truly is, and how it is turned."""
        stop = self.stops[shot.stop]
        miss = np.array(shot.miss)
        return stop.lsl_from_rover @ shot.pointing.rover_from_mast(stop.id, turned_by=miss)

    def true_lsl_from_label_rover(self, shot: Shot) -> Pose:
        """Carries what the label's cameras see in the rover frame to where it truly is."""
        stop = self.stops[shot.stop]
        return self.true_lsl_from_mast(shot) @ shot.pointing.rover_from_mast(stop.id).inverse

    def true_camera(self, shot: Shot, eye: Eye) -> Cahvor:
        """The camera that took the picture, in the LSL."""
        averaging = self.params.averaging
        in_mast = CAMERAS[shot.instrument, eye].in_mast.averaged(averaging, averaging)
        return in_mast.moved(self.true_lsl_from_mast(shot))

    def true_elevation(self, grid: MapGrid) -> Raster:
        """Elevation of the ground, rocks included, at the cell centres of a map grid."""
        east, north = grid.centres()
        return self.terrain.elevation(north[:, None], east[None, :]).astype(np.float32)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(west, south, east, north) of 25 m around all stops, metres."""
        places = np.array([stop.lsl_from_rover.translation_m[:2] for stop in self.stops])
        south, west = places.min(axis=0) - 25
        north, east = places.max(axis=0) + 25
        return float(west), float(south), float(east), float(north)


def make_world(params: WorldParams, rng_seed: int) -> World:
    """The world of a seed."""
    drive = params.traverse
    places = planned(drive, stream_of(rng_seed, 101))
    ids = stop_ids(drive, stream_of(rng_seed, 102))
    turns = stream_of(rng_seed, 103).normal(0.0, np.deg2rad(25), drive.stops)
    headings = _headings(places) + turns
    terrain = Terrain(rng_seed, params.terrain, places)
    first = standing(terrain, *places[0], float(headings[0]), ids[0].frame)
    terrain = terrain.lowered(-float(first.translation_m[2]))
    truths = tuple(
        standing(terrain, *place, float(heading), stop_id.frame)
        for place, heading, stop_id in zip(places, headings, ids, strict=True)
    )
    truths = (replace(truths[0], translation_m=np.zeros(3)), *truths[1:])  # rounding of the datum
    stops = driven(truths, ids, drive, stream_of(rng_seed, 104))
    shots = tuple(shot for k in range(len(stops)) for shot in _shots(params, stops, k, rng_seed))
    return World(params, rng_seed, terrain, stops, shots)


def _headings(places: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Azimuths of the drives on to the next stop; the last stop keeps that of its arrival."""
    ways = np.diff(np.array(places), axis=0) if len(places) > 1 else np.array([[1.0, 1.0]])
    headings = np.arctan2(ways[:, 1], ways[:, 0])
    return np.append(headings, headings[-1])[: len(places)]


def _shots(params: WorldParams, stops: tuple[Stop, ...], k: int, seed: int) -> list[Shot]:
    """The exposures of a stop: the panorama, then the Pancam pairs."""
    rng = stream_of(seed, 105, k)
    first = rng.uniform(0, params.pair_step)
    plan = [
        (
            Instrument.NAVCAM,
            Pointing((first + pair * params.pair_step) % (2 * np.pi), params.mast_elevation),
        )
        for pair in range(params.pairs)
    ]
    if params.pancam:
        plan += [(Instrument.PANCAM, pointing) for pointing in _towards_neighbours(stops, k)]
    day = stops[k].sol + stops[k].local_solar_hour / 24
    clock = CLOCK_OF_SOL_0 + round(day * SOL_S)
    shots = []
    for pair, (instrument, pointing) in enumerate(plan):
        miss = rng.normal(0.0, params.pointing_error, 3) * (0.5, 1.0, 1.0)
        roll, pitch, yaw = map(float, miss)
        sequence = f"P{1500 + k % 8000}"
        shots.append(
            Shot(k, pair, instrument, pointing, (roll, pitch, yaw), clock + pair * PAIR_S, sequence)
        )
    return shots


def _towards_neighbours(stops: tuple[Stop, ...], k: int) -> list[Pointing]:
    """Two Pancam pointings side by side towards the stop before and the stop after."""
    rover_from_lsl = stops[k].lsl_from_rover.inverse
    pointings = []
    for other in (k - 1, k + 1):
        if 0 <= other < len(stops):
            x, y, _ = rover_from_lsl.apply(stops[other].lsl_from_rover.translation_m[None])[0]
            for side in (-6.5, 6.5):
                azimuth = float(np.arctan2(y, x) + np.deg2rad(side))
                pointings.append(Pointing(azimuth % (2 * np.pi), float(np.deg2rad(-6.0))))
    return pointings


@dataclass(frozen=True, slots=True)
class RenderJob:
    """One picture still to be taken. Jobs depend on nothing but the world."""

    shot: Shot
    eye: Eye

    def path(self, world: World) -> str:
        """Where the picture belongs in the downlink."""
        exposure = world.exposure(self.shot, self.eye)
        return f"sol{exposure.sol:04d}/edr/{exposure.file_name}"

    def run(self, world: World) -> DownlinkFile:
        """Take the picture."""
        exposure = world.exposure(self.shot, self.eye)
        data = edr_bytes(exposure, photograph(world, self.shot, self.eye))
        return DownlinkFile(self.path(world), data)


def render_jobs(world: World) -> list[RenderJob]:
    """Every picture of the downlink, stop after stop."""
    return [RenderJob(shot, eye) for shot in world.shots for eye in (Eye.LEFT, Eye.RIGHT)]


def simulate_downlink(params: WorldParams, rng_seed: int) -> Iterator[DownlinkFile]:
    """The files of a downlink, one after the other: vector files, truth, pictures."""
    world = make_world(params, rng_seed)
    yield from text_files(world)
    for job in render_jobs(world):
        yield job.run(world)


def text_files(world: World) -> list[DownlinkFile]:
    """Site and rover vector files, and the truth."""
    added = CLOCK_ZERO.replace(year=2004, month=6, day=10, microsecond=0)
    texts = {"masters/mer2_master.svf": site_vector_file(world.stops, added)}
    for site, text in rover_vector_files(world.stops, added).items():
        texts[f"masters/mer2_site_{site:03d}_master.rvf"] = text
    texts["truth/truth.json"] = json.dumps(truth(world), indent=1)
    return [DownlinkFile(path, text.encode("ascii")) for path, text in texts.items()]


def photograph(world: World, shot: Shot, eye: Eye) -> Int32[np.ndarray, "lines samples"]:
    """The pixels of one image."""
    sun = world.stops[shot.stop].sun
    view, rays = _view(world, shot, eye)
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


def _view(world: World, shot: Shot, eye: Eye) -> tuple[View, Rays]:
    pose = world.true_lsl_from_mast(shot)
    in_mast = _rays_in_mast(shot.instrument, eye, world.params.averaging)
    rays = turned(pose, in_mast)
    centre = pose.apply(CAMERAS[shot.instrument, eye].in_mast.c[None])[0]
    return View.of_rays(centre, rays, _pixel_rad(shot.instrument, world.params.averaging)), rays


def _pixel_rad(instrument: Instrument, averaging: int) -> float:
    h = CAMERAS[instrument, Eye.LEFT].in_mast.h
    return averaging / float(np.linalg.norm(h - h[0] * np.array([1.0, 0, 0])))


def turned(pose: Pose, rays: Rays) -> Rays:
    """Rays carried into the target frame of a pose, sum by sum, so that no library orders them."""
    r = pose.rotation.astype(np.float32)
    return np.stack([r[i, 0] * rays[0] + r[i, 1] * rays[1] + r[i, 2] * rays[2] for i in range(3)])


@lru_cache(maxsize=4)
def _rays_in_mast(instrument: Instrument, eye: Eye, averaging: int) -> Rays:
    camera = CAMERAS[instrument, eye].in_mast.averaged(averaging, averaging)
    side = FULL_FRAME // averaging
    line, sample = np.mgrid[:side, :side].reshape(2, -1)
    rays = camera.rays(np.column_stack([sample, line]).astype(np.float64))
    return np.ascontiguousarray(rays.T, np.float32).reshape(3, side, side)


def true_parallax(world: World, stop: int, pair: int, geometry: EpipolarPair) -> ParallaxMap:
    """Parallax of every pixel of the left epipolar image, from the landscape itself.

    NaN for the sky, at outlines, and where the right camera does not see the point.
    """
    shot = world.shot(stop, pair)
    lsl_from_pair = world.true_lsl_from_label_rover(shot) @ geometry.rover_from_pair
    ground = world.ground(stop)
    rays = turned(lsl_from_pair, _pair_rays(geometry))
    view = View.of_rays(lsl_from_pair.translation_m, rays, 1 / geometry.focal_px)
    points = lsl_from_pair.inverse.apply(first_hits(ground, view))
    parallax_px = geometry.focal_px * geometry.base_m / points[:, 2]
    visible = _seen_from_the_right(geometry, lsl_from_pair, ground, points)
    parallax_px[~visible] = np.nan
    return parallax_px.reshape(geometry.lines, geometry.samples).astype(np.float32)


def _pair_rays(geometry: EpipolarPair) -> Float32[np.ndarray, "3 lines samples"]:
    line, sample = np.mgrid[: geometry.lines, : geometry.samples].astype(np.float32)
    x = (sample - np.float32(geometry.centre_px[0])) / np.float32(geometry.focal_px)
    y = (line - np.float32(geometry.centre_px[1])) / np.float32(geometry.focal_px)
    return np.stack([x, y, np.ones_like(x)]) / np.sqrt(x * x + y * y + 1)


def _seen_from_the_right(
    geometry: EpipolarPair, lsl_from_pair: Pose, ground: LitGround, points: np.ndarray
) -> np.ndarray:
    """Whether the right camera's first hit along the way to every point is the point itself."""
    towards = points - [geometry.base_m, 0.0, 0.0]
    distance_m = np.linalg.norm(towards, axis=1)
    known = np.isfinite(distance_m)
    rays = np.where(known[:, None], towards / distance_m[:, None], [0.0, 0.0, 1.0]).T
    rays = rays.reshape(3, geometry.lines, geometry.samples).astype(np.float32)
    centre = lsl_from_pair.apply(np.array([[geometry.base_m, 0.0, 0.0]]))[0]
    view = View.of_rays(centre, turned(lsl_from_pair, rays), 1 / geometry.focal_px)
    hit_m = np.linalg.norm(first_hits(ground, view) - centre, axis=1)
    return known & (np.abs(hit_m - distance_m) < 0.01 + 0.01 * distance_m)


def truth(world: World) -> dict[str, object]:
    """What is true, in the keys of `rendered_husband`, with the whole camera models beside."""
    latitude = float(np.rad2deg(LATITUDE))
    return {
        "frame": f"{LSL}: origin at the rover origin of the first stop, X north, Y east, Z down, "
        "metres",
        "crs": f"+proj=eqc +lat_0={latitude:.4f} +lat_ts={latitude:.4f} +lon_0={LONGITUDE_DEG} "
        f"+R={MARS_RADIUS_M} +units=m +no_defs",
        "seed": world.seed,
        "terrain": world.params.terrain,
        "stops": [_stop_truth(stop) for stop in world.stops],
        "images": [
            _image_truth(world, shot, eye) for shot in world.shots for eye in (Eye.LEFT, Eye.RIGHT)
        ],
    }


def _stop_truth(stop: Stop) -> dict[str, object]:
    true, told = stop.lsl_from_rover, stop.telemetry_lsl_from_rover
    return {
        "sol": stop.sol,
        "site": stop.id.site,
        "drive": stop.id.drive,
        "position": true.translation_m.tolist(),
        "rover_to_lsl_quaternion_wxyz": true.quaternion.tolist(),
        "telemetry_position": told.translation_m.tolist(),
        "telemetry_quaternion_wxyz": told.quaternion.tolist(),
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
