"""A small store of a simulated traverse whose images, poses, matches and ground are all true.

Two stops with some Navcam pairs each, averaged to a quarter of their size; orientations and
parallaxes are those the images were rendered with, so that an answer about a pixel can be
compared with where it really is.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    USED,
    AdjustedNetwork,
    AdjustedPair,
    AdjustedStop,
    AdjustedTies,
    AdjustmentReport,
)
from solmap.photogrammetry.archive.images.reading import ReadImage, read_image
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import Eye, StereoMatches, TieKind, TiePoints
from solmap.photogrammetry.matching.records import DenseMatches
from solmap.photogrammetry.synthetic.downlink import RenderJob
from solmap.photogrammetry.synthetic.scene import Shot, World, WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import Stop, TraverseParams
from solmap.photogrammetry.synthetic.truth import true_parallax
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, GroundClass
from solmap.photogrammetry.terrain.dtm.resampling import sample_bilinear
from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, local_crs
from solmap.products.formats.documents.adjusted_network import network_document
from solmap.products.formats.documents.archives import (
    pose_document,
    write_dense,
    write_matches,
)
from solmap.products.formats.raster.raster import read_dtm, summarise, write_dtm
from solmap.products.model import Layer, ProductKind, ProductRef, Recipe, Scope, ScopeLevel
from solmap.tasks.images.pairs import pair_geometry
from tests.support.small_downlink import kept

LANDING = LandingPoint("Columbia Memorial Station", 175.4729, -14.5692, 3_393_000.0, "a test")
PARAMS = WorldParams(
    terrain="hills",
    traverse=TraverseParams(stops=2, stops_per_site=2, slip=(0.05, 0.1), spacing_m=(6.0, 7.0)),
    pairs=3,
    pair_step=float(np.deg2rad(40)),
    averaging=4,
)
SEED = 11
CELL_M = 0.04
STOP_SIGMA = np.diag([1e-4, 1e-4, 2e-4, 5e-3, 5e-3, 2e-3]) ** 2
POINTING_SIGMA = 2e-4
TIE_SIGMA_PX = 0.1


@dataclass(frozen=True)
class StereoStore:
    """The store and the world it is of."""

    world: World
    workspace: Workspace

    @cached_property
    def entries(self) -> list[ImageEntry]:
        return self.workspace.catalogue.images("MER2")

    @cached_property
    def truth(self) -> list[tuple[MapGrid, np.ndarray]]:
        """The true ground around the stops, a cell every 4 cm."""
        layers = [la for la in self.workspace.catalogue.layers("MER2") if la.type == "raster"]
        read = [read_dtm(self.workspace.store.path(layer.ref)) for layer in layers]
        return [(dtm.grid, dtm.elevation) for dtm in read]

    def elevation(self, places: np.ndarray) -> np.ndarray:
        """The true elevation at (east, north); NaN away from the stops."""
        found = np.full(len(places), np.nan)
        for grid, elevation in self.truth:
            known = sample_bilinear(elevation, grid, places)
            found = np.where(np.isfinite(found), found, known)
        return found

    def shot(self, image_id: str) -> tuple[Shot, Eye]:
        """What an image was taken as."""
        for shot in self.world.shots:
            for eye in (Eye.LEFT, Eye.RIGHT):
                if self.world.exposure(shot, eye).product_id.upper() == image_id.upper():
                    return shot, eye
        raise KeyError(image_id)


@dataclass(frozen=True)
class _Pair:
    shot: Shot
    left: ReadImage
    right: ReadImage
    geometry: EpipolarPair
    parallax: np.ndarray
    lsl_from_pair: Pose
    pointing: np.ndarray


def build_stereo_store(root: Path) -> StereoStore:
    """Render the world and publish it."""
    root.mkdir(parents=True, exist_ok=True)
    world, workspace = make_world(PARAMS, SEED), Workspace.open(root)
    truth = kept(_write_truth, PARAMS, SEED)
    pairs = [_pair(world, shot, truth, workspace) for shot in world.shots]
    network = workspace.store.make(
        Recipe(ProductKind.NETWORK, Scope(ScopeLevel.SOL, "mer2-sol0156")),
        lambda path: path.write_text(json.dumps(_network(world, pairs))),
    )
    layers = [_dtm(stop, truth, workspace) for stop in world.stops]
    mission = MissionEntry("MER2", "Spirit, Gusev crater", LANDING, None)
    workspace.catalogue.publish(missions=[mission], layers=layers, pointers=[network])
    return StereoStore(world, workspace)


def _write_truth(folder: Path, params: WorldParams, seed: int) -> None:
    """Images, parallaxes of pairs and elevations around stops."""
    world = make_world(params, seed)
    folder.mkdir(parents=True)
    for shot in world.shots:
        for job in (RenderJob(shot, eye) for eye in (Eye.LEFT, Eye.RIGHT)):
            file = job.run(world)
            (folder / Path(file.path).name).write_bytes(file.data)
        left, right = (read.image for read in _images(world, shot, folder))
        number = sum(1 for s in world.shots[: world.shots.index(shot)] if s.stop == shot.stop)
        parallax = true_parallax(world, shot.stop, number, pair_geometry(left, right))
        np.save(folder / f"{left.id}.npy", parallax)
    for stop in world.stops:
        np.save(folder / f"{stop.id}.npy", world.true_elevation(_grid(stop)).astype(np.float32))


def _images(world: World, shot: Shot, truth: Path) -> tuple[ReadImage, ReadImage]:
    names = [world.exposure(shot, eye).file_name for eye in (Eye.LEFT, Eye.RIGHT)]
    left, right = (read_image((truth / name).read_bytes(), name) for name in names)
    return left, right


def _pair(world: World, shot: Shot, truth: Path, workspace: Workspace) -> _Pair:
    left, right = _images(world, shot, truth)
    files = [truth / world.exposure(shot, eye).file_name for eye in (Eye.LEFT, Eye.RIGHT)]
    geometry = pair_geometry(left.image, right.image)
    parallax = np.load(truth / f"{left.image.id}.npy")
    data = [file.read_bytes() for file in files]
    _publish_pair((left, right), data, geometry, parallax, workspace)
    reported = world.true_lsl_from_label_rover(shot)
    lsl_from_label = Pose(
        reported.target, left.image.stop.frame, reported.rotation, reported.translation_m
    )
    turn = world.stops[shot.stop].lsl_from_rover.rotation.T @ lsl_from_label.rotation
    pointing = Rotation.from_matrix(turn).as_rotvec()
    lsl_from_pair = lsl_from_label @ geometry.rover_from_pair
    return _Pair(shot, left, right, geometry, parallax, lsl_from_pair, pointing)


def _publish_pair(reads, data, geometry, parallax, workspace: Workspace) -> None:
    ids = [read.image.id for read in reads]
    entries = [
        _entry(read, bytes_, partner, workspace)
        for read, bytes_, partner in zip(reads, data, reversed(ids), strict=True)
    ]
    scope = Scope(ScopeLevel.PAIR, ids[0].lower())
    none = StereoMatches.none(ids[0])
    dense = DenseMatches(parallax, np.full(parallax.shape, 0.1, np.float32), None)
    made = [
        workspace.store.make(
            Recipe(ProductKind.MATCHES, scope), lambda p: write_matches(p, geometry, none)
        ),
        workspace.store.make(Recipe(ProductKind.PARALLAX, scope), lambda p: write_dense(p, dense)),
    ]
    workspace.catalogue.publish(images=entries, pointers=made)


def _entry(read: ReadImage, data: bytes, partner: str, workspace: Workspace) -> ImageEntry:
    image = read.image
    scope = Scope(ScopeLevel.IMAGE, image.id.lower())

    def made(kind: ProductKind) -> ProductRef:
        return workspace.store.make(Recipe(kind, scope), lambda path: _write(path, data))

    return ImageEntry(
        id=image.id,
        mission=image.stop.mission,
        stop=str(image.stop),
        site=image.stop.site,
        drive=image.stop.drive,
        sol=image.sol,
        instrument=image.instrument,
        eye=str(image.eye),
        product_type=image.product_type,
        start_time=image.start_time,
        local_solar_time=image.local_solar_time,
        partner=partner,
        unpaired_because=None,
        ref=made(ProductKind.IMAGE),
        browse=made(ProductKind.BROWSE),
    )


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _network(world: World, pairs: list[_Pair]) -> dict:
    stops = tuple(
        AdjustedStop(
            stop.id,
            stop.lsl_from_rover,
            np.zeros((6, 6)) if k == 0 else STOP_SIGMA,
            held=k == 0,
            is_tied=True,
            held_by="the truth",
        )
        for k, stop in enumerate(world.stops)
    )
    adjusted = tuple(
        AdjustedPair(
            pair.left.image.id,
            pair.left.image.stop,
            pair.lsl_from_pair,
            pair.geometry.rover_from_pair,
            pair.pointing,
            1e-8 * np.eye(6),
            POINTING_SIGMA**2 * np.eye(3),
            10,
        )
        for pair in pairs
    )
    network = AdjustedNetwork(stops, adjusted, _ties(pairs))
    report = AdjustmentReport("true", converged=True, iterations=1, sigma0=1.0, redundancy=9,
                              stops=2, pairs=len(pairs))  # fmt: skip
    reported = [
        {
            "mission": stop.id.mission,
            "site": stop.id.site,
            "drive": stop.id.drive,
            "sols": [stop.sol],
            "telemetry": pose_document(stop.telemetry_lsl_from_rover),
        }
        for stop in world.stops
    ]
    document = network_document(network, [report])
    return {
        "mission": "MER2",
        "sol": 156,
        "stops": reported,
        "network": document,
        "reports": ["true"],
        "links": [],
    }


def _ties(pairs: list[_Pair]) -> AdjustedTies:
    """Places of the first stop's pairs in all pairs that truly see them, with a little noise."""
    rng = np.random.default_rng(4)
    points, rows = [], []
    for pair in pairs:
        lines, samples = np.nonzero(np.isfinite(pair.parallax))
        some = rng.choice(len(lines), 120, replace=False)
        left = np.column_stack([samples, lines])[some].astype(np.float64)
        found = pair.parallax[lines[some], samples[some]].astype(np.float64)
        for point in pair.lsl_from_pair.apply(pair.geometry.triangulate(left, found)):
            if np.linalg.norm(point - pair.lsl_from_pair.translation_m) < 15:
                seen = [(k, *_seen(other, point)) for k, other in enumerate(pairs)]
                seen = [row for row in seen if row[1] is not None]
                if len({pairs[k].shot.stop for k, *_ in seen}) > 1:
                    rows += [(len(points), *row) for row in seen]
                    points.append(point)
    point, pair, left, parallax = (list(column) for column in zip(*rows, strict=True))
    n, noise = len(rows), TIE_SIGMA_PX
    return AdjustedTies(
        TiePoints(
            tuple(p.left.image.id for p in pairs),
            np.array(point, np.int32),
            np.array(pair, np.int32),
            np.array(left) + rng.normal(0, noise, (n, 2)),
            np.array(parallax) + rng.normal(0, noise, n),
            *(np.full(n, noise) for _ in range(3)),
        ),
        np.array(points),
        np.tile(1e-4 * np.eye(3), (len(points), 1, 1)),
        (TieKind.CROSS_SITE,) * len(points),
        np.full(n, USED, np.int32),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        np.full((n, 3), 0.5),
    )


def _seen(pair: _Pair, point: np.ndarray):
    """Left point and parallax of a place in a pair; None where it is hidden or off the image."""
    left, parallax = pair.geometry.project(pair.lsl_from_pair.inverse.apply(point[None]))
    if not pair.geometry.shows(left)[0]:
        return None, None
    column, line = np.round(left[0]).astype(int)
    there = pair.parallax[line, column]
    hidden = not abs(there - parallax[0]) < 0.5
    return (None, None) if hidden else (left[0], float(parallax[0]))


def _grid(stop: Stop) -> MapGrid:
    north, east, _ = stop.lsl_from_rover.translation_m
    return MapGrid.covering((east - 8, north - 8, east + 8, north + 8), CELL_M)


def _dtm(stop: Stop, truth: Path, workspace: Workspace) -> Layer:
    grid, elevation = _grid(stop), np.load(truth / f"{stop.id}.npy")
    sigma = np.full(grid.shape, 0.005, np.float32)
    ones = np.ones(grid.shape, np.float32)
    ground = np.full(grid.shape, GroundClass.MEASURED, np.uint8)
    dtm = Dtm(grid, elevation, sigma, ones, ground)
    scope = Scope(ScopeLevel.STOP, str(stop.id))
    ref = workspace.store.make(
        Recipe(ProductKind.DTM, scope), lambda path: write_dtm(path, dtm, local_crs(LANDING))
    )
    box, bands = summarise(workspace.store.path(ref))
    return Layer(ref, "MER2", "terrain", "raster", box.bounds, box.cell_m, "m", bands[0].range,
                 (156,), "2026-01-01")  # fmt: skip
