"""A landscape, a traverse and the exposures of its panoramas, drawn from one seed.

The mast has small pointing errors against its motors, and the stereo rig bends; labels do not
include either (`rig.RigErrors`). Every random quantity has its own stream, so that an additional
stop or pair does not change the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solmap.photogrammetry.arrays import Raster
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.synthetic.camera import CameraParams
from solmap.photogrammetry.synthetic.edr import Exposure
from solmap.photogrammetry.synthetic.lattice import stream_of
from solmap.photogrammetry.synthetic.lighting import LitGround, Sun, light_ground
from solmap.photogrammetry.synthetic.rig import (
    CAMERAS,
    Instrument,
    Pointing,
    RigErrors,
    rig_temperature,
)
from solmap.photogrammetry.synthetic.terrain import TERRAINS, Terrain
from solmap.photogrammetry.synthetic.traverse import (
    Stop,
    TraverseParams,
    drive_traverse,
    plan_stops,
    solar_longitude,
    standing_pose,
    stop_ids,
)
from solmap.photogrammetry.terrain.dtm.grid import MapGrid

SOL_S = 88_775.42064
CLOCK_OF_SOL_0 = 126_322_960
"""Spirit's clock at the start of sol 0, seconds (public AI4Mars scripts)."""
PAIR_S = 53
"""Time from one pair to the next, seconds."""
MAST_ELEVATION = float(np.deg2rad(-18.0))
"""Mast elevations of the panorama's pairs."""


@dataclass(frozen=True, slots=True)
class WorldParams:
    """Parameters of a simulated world."""

    terrain: str = "plains"
    traverse: TraverseParams = field(default_factory=TraverseParams)
    pairs: int = 10
    """Navcam pairs of a panorama."""
    pair_step: float = float(np.deg2rad(36.0))
    pancam: bool = False
    """Pancam pairs towards the neighbouring stops as well (right Pancam: synthetic model)."""
    averaging: int = 1
    """Pixels averaged to one, in both directions: 1, 2 or 4."""
    rig: RigErrors = field(default_factory=RigErrors)
    camera: CameraParams = field(default_factory=CameraParams)
    rover_in_view: bool = False
    """Whether images show the rover itself and its shadow."""

    def __post_init__(self) -> None:
        if self.terrain not in TERRAINS:
            raise PhotogrammetryError(
                f"there is no terrain {self.terrain!r}: choose from {', '.join(TERRAINS)}"
            )
        if self.averaging not in (1, 2, 4) or self.pairs < 1:
            raise PhotogrammetryError(
                "a panorama needs at least one pair, averaged over 1, 2 or 4 pixels, not "
                f"{self.pairs} pairs averaged over {self.averaging}"
            )


def realistic_params(params: WorldParams, rng_seed: int) -> WorldParams:
    """The same terrain, traverse and panoramas, with all errors of real images and rovers.

    Every seed has its own rig, cameras and suns: stops alternate between morning and afternoon.
    Wheels slip by up to 100 %.
    """
    rng = stream_of(rng_seed, 108)
    traverse = params.traverse
    suns = [_morning_or_afternoon(rng, is_morning=stop % 2 == 0) for stop in range(traverse.stops)]
    rig = RigErrors(
        pointing=float(np.deg2rad(0.08)),
        mast_zero=_two(rng, np.deg2rad(0.05)),
        mast_axis=_two(rng, np.deg2rad(0.03)),
        bend=_three(rng, 3e-4),
        bend_per_kelvin=_three(rng, 5e-6),
    )
    return replace(
        params,
        traverse=replace(traverse, slip=(0.0, 1.0), suns=tuple(suns)),
        rig=rig,
        camera=CameraParams(
            psf_px=float(rng.uniform(0.5, 0.9)),
            vignetting=1.0,
            dust_specks=20,
            bits_per_pixel=float(np.exp(rng.uniform(*np.log([0.6, 3.0])))),
        ),
        rover_in_view=True,
    )


def _two(rng: np.random.Generator, sigma: float) -> tuple[float, float]:
    one, other = rng.normal(0.0, sigma, 2).tolist()
    return one, other


def _three(rng: np.random.Generator, sigma: float) -> tuple[float, float, float]:
    x, y, z = rng.normal(0.0, sigma, 3).tolist()
    return x, y, z


def _morning_or_afternoon(rng: np.random.Generator, *, is_morning: bool) -> Sun:
    azimuth = rng.uniform(60.0, 120.0) + (0.0 if is_morning else 180.0)
    return Sun(float(np.deg2rad(azimuth)), float(np.deg2rad(rng.uniform(25.0, 50.0))))


@dataclass(frozen=True, slots=True)
class Shot:
    """One stereo exposure: the values common to both images."""

    stop: int
    """Number of the stop in the world."""
    pair: int
    """Number of the pair at the stop."""
    instrument: Instrument
    pointing: Pointing
    """Pointing as reported by the motors."""
    miss: tuple[float, float, float]
    """True roll, pitch, yaw of the mast head beyond that, radians."""
    clock: int
    sequence: str


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Landscape, traverse and exposures, with their truth."""

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
        rover = here.lsl_from_rover if self.params.rover_in_view else None
        return light_ground(self.terrain, float(north), float(east), here.sun, rover)

    def exposure(self, shot: Shot, eye: Eye) -> Exposure:
        """Data for the label of an image."""
        stop, averaging = self.stops[shot.stop], self.params.averaging
        in_mast = CAMERAS[shot.instrument, eye].in_mast
        # as in MER labels
        in_mast = in_mast.average(averaging, averaging, correct_half_pixel=False)
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
            camera=in_mast.transform(shot.pointing.rover_from_mast(stop.id)),
            clock=shot.clock,
            pma=shot.pair + 1,
            sequence=shot.sequence,
            averaging=averaging,
            celsius=self.celsius(shot.stop),
            bits_per_pixel=self.params.camera.bits_per_pixel,
        )

    def celsius(self, stop: int) -> float:
        """Temperature of cameras and bar at a stop."""
        return rig_temperature(self.stops[stop].local_solar_hour)

    def true_lsl_from_mast(self, shot: Shot) -> Pose:
        """True pose of the mast head."""
        stop = self.stops[shot.stop]
        miss = np.array(shot.miss)
        return stop.lsl_from_rover @ shot.pointing.rover_from_mast(stop.id, turned_by=miss)

    def true_lsl_from_label_rover(self, shot: Shot) -> Pose:
        """Maps points as seen by the label's cameras in the rover frame to their true positions."""
        stop = self.stops[shot.stop]
        return self.true_lsl_from_mast(shot) @ shot.pointing.rover_from_mast(stop.id).inverse

    def true_camera(self, shot: Shot, eye: Eye) -> Cahvor:
        """The true camera of the image, in the LSL."""
        camera = self.params.rig.camera_in_mast(shot.instrument, eye, self.celsius(shot.stop))
        averaging = self.params.averaging
        return camera.average(averaging, averaging).transform(self.true_lsl_from_mast(shot))

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
    places = plan_stops(drive, stream_of(rng_seed, 101))
    ids = stop_ids(drive, stream_of(rng_seed, 102))
    turns = stream_of(rng_seed, 103).normal(0.0, np.deg2rad(25), drive.stops)
    headings = _headings(places) + turns
    terrain = Terrain(rng_seed, params.terrain, places)
    first = standing_pose(terrain, *places[0], float(headings[0]), ids[0].frame)
    terrain = terrain.lower(-float(first.translation_m[2]))
    truths = tuple(
        standing_pose(terrain, *place, float(heading), stop_id.frame)
        for place, heading, stop_id in zip(places, headings, ids, strict=True)
    )
    truths = (replace(truths[0], translation_m=np.zeros(3)), *truths[1:])  # rounding of the datum
    stops = drive_traverse(truths, ids, drive, stream_of(rng_seed, 104))
    shots = tuple(shot for k in range(len(stops)) for shot in _shots(params, stops, k, rng_seed))
    return World(params, rng_seed, terrain, stops, shots)


def _headings(places: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Azimuths of the drives to the next stop; the last stop keeps that of its arrival."""
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
            Pointing((first + pair * params.pair_step) % (2 * np.pi), MAST_ELEVATION),
        )
        for pair in range(params.pairs)
    ]
    if params.pancam:
        plan += [(Instrument.PANCAM, pointing) for pointing in _towards_neighbours(stops, k)]
    day = stops[k].sol + stops[k].local_solar_hour / 24
    clock = CLOCK_OF_SOL_0 + round(day * SOL_S)
    shots = []
    for pair, (instrument, pointing) in enumerate(plan):
        miss = params.rig.draw_miss(pointing, rng)
        sequence = f"P{1500 + k % 8000}"
        shots.append(Shot(k, pair, instrument, pointing, miss, clock + pair * PAIR_S, sequence))
    return shots


def _towards_neighbours(stops: tuple[Stop, ...], k: int) -> list[Pointing]:
    """Two adjacent Pancam pointings towards the previous and the next stop."""
    rover_from_lsl = stops[k].lsl_from_rover.inverse
    pointings = []
    for other in (k - 1, k + 1):
        if 0 <= other < len(stops):
            x, y, _ = rover_from_lsl.apply(stops[other].lsl_from_rover.translation_m[None])[0]
            for side in (-6.5, 6.5):
                azimuth = float(np.arctan2(y, x) + np.deg2rad(side))
                pointings.append(Pointing(azimuth % (2 * np.pi), float(np.deg2rad(-6.0))))
    return pointings
