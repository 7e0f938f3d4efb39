"""Simulated stops with their pairs matched, kept on disk: a stop takes half a minute to make.

A file is named after what made it: parameters, seed, and the code that renders and matches. With
`SOLMAP_KEEP_STOPS=1` the code is left out of the name, for work on what comes after matching.
"""

import hashlib
import os
import pickle
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from solmap.photogrammetry.archive.images.reading import ReadImage, read_image
from solmap.photogrammetry.cameras.cahvor import Cahvor
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.matching.records import EpipolarImages, MatchedPair, MatchedStop
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.matching.stereo.sparse import SparseParams, match_sparsely
from solmap.photogrammetry.synthetic.downlink import RenderJob
from solmap.photogrammetry.synthetic.scene import Shot, World, WorldParams, make_world
from solmap.photogrammetry.synthetic.truth import true_parallax
from solmap.tasks.images.pairs import pair_geometry
from tests.support.stereo_pairs import resample_pair

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / ".cache" / "cross_site"
AS_LABELLED = WorldParams()
MADE_BY = (
    "synthetic/**/*.py",
    "synthetic/**/edr.lbl",
    "cameras/**/*.py",
    "archive/**/*.py",
    "matching/[lpr]*.py",
    "matching/stereo/*.py",
)
"""Code that renders, reads and matches pairs, below `photogrammetry`; tying comes after."""


@dataclass(frozen=True, slots=True)
class WorldOfStops:
    """A small world: four stops on one kind of terrain, so far apart, under suns of their own."""

    terrain: str
    spacing_m: tuple[float, float]
    seed: int
    stops: int = 4
    pairs: int = 10
    like: WorldParams = AS_LABELLED
    """What else is true of rig, camera and telemetry, and the suns; the rest is as above."""

    @property
    def params(self) -> WorldParams:
        """The world's parameters; sites and sols differ from seed to seed, as their names do."""
        traverse = replace(
            self.like.traverse,
            stops=self.stops,
            stops_per_site=1,
            first_site=10 * self.seed,
            first_sol=40 * self.seed,
            spacing_m=self.spacing_m,
        )
        step = 2 * np.pi / self.pairs
        return replace(
            self.like, terrain=self.terrain, traverse=traverse, pairs=self.pairs, pair_step=step
        )

    def world(self) -> World:
        """The world itself."""
        return _world(self)


@cache
def _world(which: WorldOfStops) -> World:
    return make_world(which.params, which.seed)


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedStop:
    """A stop as matching hands it on, and where it truly stood in its world."""

    world: WorldOfStops
    number: int
    matched: MatchedStop
    """Placed by telemetry."""
    true: Pose

    @property
    def stop(self) -> StopId:
        """Site and drive."""
        return self.matched.stop

    def reported_at(self, pose: Pose) -> MatchedStop:
        """The stop as if telemetry had put it elsewhere."""
        return replace(self.matched, lsl_from_rover=pose)


def simulated_stop(which: WorldOfStops, number: int) -> SimulatedStop:
    """A stop of a world, from the disk if it was made before."""
    path = CACHE / f"{_digest(which, number)}.pickle"
    if path.exists():
        kept = pickle.loads(path.read_bytes())  # noqa: S301 - written by this module
        return replace(kept, world=which)
    made = _made(which, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(f".{os.getpid()}.part")
    draft.write_bytes(pickle.dumps(made, protocol=5))
    draft.replace(path)
    return made


def _made(which: WorldOfStops, number: int) -> SimulatedStop:
    world = which.world()
    stop = world.stops[number]
    pairs = tuple(_matched(world, shot) for shot in world.shots if shot.stop == number)
    reported = stop.telemetry_lsl_from_rover
    return SimulatedStop(
        which, number, MatchedStop(stop.id, pairs, reported, np.zeros((6, 6))), stop.lsl_from_rover
    )


def _matched(world: World, shot: Shot) -> MatchedPair:
    left, images = images_of(world, shot)
    name = left.image.id
    matches = match_sparsely(name, images, SparseParams())
    parallax, sun = match_densely(images).parallax_px, left.image.sun
    return MatchedPair.of(name, left.image.instrument, images, matches, parallax, sun)


def images_of(world: World, shot: Shot) -> tuple[ReadImage, EpipolarImages]:
    """The left image of a pair, and both as epipolar images in the geometry of the true rig."""
    left, right = (_read(world, shot, eye) for eye in (Eye.LEFT, Eye.RIGHT))
    right = replace(right, image=replace(right.image, camera=_right_camera(world, shot)))
    return left, resample_pair(left, right, pair_geometry(left.image, right.image))


def _right_camera(world: World, shot: Shot) -> Cahvor:
    """The right camera of the true rig, which `tasks.network.rig` finds to 0.003 degrees."""
    averaging = world.params.averaging
    camera = world.params.rig.camera_in_mast(
        shot.instrument, Eye.RIGHT, world.celsius(shot.stop)
    ).average(averaging, averaging, correct_half_pixel=False)
    return camera.transform(shot.pointing.rover_from_mast(world.stops[shot.stop].id))


def _read(world: World, shot: Shot, eye: Eye) -> ReadImage:
    file = RenderJob(shot, eye).run(world)
    return read_image(file.data, file.path.rsplit("/", 1)[-1])


def true_pair(stop: SimulatedStop, pair: int) -> tuple[Pose, np.ndarray]:
    """(lsl_from_pair, parallax of the left epipolar image) of a pair, as they truly are."""
    path = CACHE / f"{_digest(stop.world, stop.number)}-truth{pair}.npy"
    world, geometry = stop.world.world(), stop.matched.pairs[pair].geometry
    if not path.exists():
        np.save(path, true_parallax(world, stop.number, pair, geometry))
    shot = world.shot(stop.number, pair)
    return world.true_lsl_from_label_rover(shot) @ geometry.rover_from_pair, np.load(path)


def _digest(which: WorldOfStops, number: int) -> str:
    short = (which.terrain, which.spacing_m, which.seed, which.stops, which.pairs, number)
    key = short if which.like == AS_LABELLED else (*short, which.like)
    return f"{_short(repr(key).encode())}-{code_digest()}"


@cache
def code_digest() -> str:
    """Represents the code that renders, reads and matches; `kept` if that is not to matter."""
    if os.environ.get("SOLMAP_KEEP_STOPS"):
        return "kept"
    folder = ROOT / "photogrammetry"
    files = sorted(path for pattern in MADE_BY for path in folder.glob(pattern))
    return _short(b"".join(path.read_bytes() for path in files))


def _short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
