"""From a rover's stereo images to terrain in a few calls: the names of `import solmap`.

Thin over the functions that the pipeline calls, with the pipeline's parameters. Points may be given
as lists or arrays. Lengths are metres, angles radians, image coordinates pixels as
(sample, line) with (0, 0) at the centre of the first pixel; rasters and points have NaN where
nothing was measured. Frames (`docs/reference/conventions.md`):

    rover   x forward, y right, z down, where the rover stood
    local   x north, y east, z down from the origin of a site: what `adjust` and `build_dtm` work in
    map     east = y and north = x of the local frame; elevation = -z

Failures raise a `PhotogrammetryError` with the reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from solmap.config.radiometry import load_radiometry
from solmap.config.settings import Settings
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedPair,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, PairGeometry, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust as adjust_network
from solmap.photogrammetry.archive.images import reading
from solmap.photogrammetry.archive.images.radiometry import Radiometry
from solmap.photogrammetry.arrays import Float64, ParallaxMap, Raster
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import AdjustmentError, TerrainError
from solmap.photogrammetry.frames import LSL, Pose, site_frame
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.imagery import StereoPair as PairRecord
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams, tie_cross_site
from solmap.photogrammetry.matching.inter_stereo import (
    InterStereoParams,
    point_pairs,
    tie_inter_stereo,
)
from solmap.photogrammetry.matching.records import (
    DenseMatches,
    EpipolarImages,
    MatchedPair,
    MatchedStop,
    Ties,
)
from solmap.photogrammetry.matching.resampling import epipolar_images
from solmap.photogrammetry.matching.stereo.dense import match_densely
from solmap.photogrammetry.matching.stereo.sparse import match_sparsely
from solmap.photogrammetry.matching.tracks import TrackParams, build_tie_points
from solmap.photogrammetry.synthetic.downlink import RenderJob, render_jobs, simulate_downlink
from solmap.photogrammetry.synthetic.scene import World, WorldParams, make_world, realistic_params
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.grid import MapGrid
from solmap.photogrammetry.terrain.dtm.records import Dtm, TerrainView
from solmap.photogrammetry.terrain.dtm.rover_body import mask_rover
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import build_dtm as model_terrain
from solmap.photogrammetry.terrain.orthophoto.rendering import OrthophotoParams, prepare_orthophoto
from solmap.tasks.images.pairs import pair_frame


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera model, CAHV, CAHVOR or CAHVORE, in the rover frame of its image."""

    model: CameraModel

    def project(self, points: ArrayLike) -> np.ndarray:
        """Image points, (n, 2) pixels, of (n, 3) points in the rover frame; NaN behind the camera.

        A single point (3,) has one image (2,).
        """
        given = _points(points, 3)
        return self.model.project(given.reshape(-1, 3)).reshape(*given.shape[:-1], 2)

    def rays(self, image_points: ArrayLike) -> np.ndarray:
        """Unit directions in the rover frame, (n, 3), through (n, 2) image points; (3,) of one."""
        given = _points(image_points, 2)
        return self.model.rays(given.reshape(-1, 2)).reshape(*given.shape[:-1], 3)

    @property
    def centre(self) -> np.ndarray:
        """The projection centre in the rover frame, (3,) metres."""
        return self.model.centre


def _points(values: ArrayLike, width: int) -> np.ndarray:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim not in {1, 2} or array.shape[-1] != width:
        raise ValueError(f"points of {width} coordinates are (n, {width}), not {array.shape}")
    return array


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """An image as it was read: its record, grey values (lines, samples) and usable pixels."""

    read: reading.ReadImage

    @property
    def id(self) -> str:
        """Product identifier."""
        return self.read.image.id

    @property
    def record(self) -> Any:  # noqa: ANN401 - see RoverImage
        """All data of its label (`photogrammetry.imagery.RoverImage`)."""
        return self.read.image

    @property
    def pixels(self) -> np.ndarray:
        """Grey values, (lines, samples) float32."""
        return self.read.pixels

    @property
    def mask(self) -> np.ndarray:
        """(lines, samples), True where a pixel shows the scene."""
        return self.read.mask

    @property
    def camera(self) -> Camera:
        """Its camera, in the rover frame."""
        return Camera(self.read.image.camera)


def read_image(path: str | Path) -> Image:
    """Read an image of a rover: PDS3 or VICAR, or with a label beside it (.lbl, .xml, .json).

    Raises:
        PhotogrammetryError: it has no label, or one that does not describe its pixels.
        OSError: it cannot be read.
    """
    from solmap.tasks.images.files import image_bytes  # noqa: PLC0415 - for files alone

    file = Path(path)
    data = image_bytes(file)
    known = load_radiometry(Settings().instruments)
    mission = reading.read_image_record(data, file.name).stop.mission
    radiometry = known.get(mission, Radiometry())
    return Image(reading.read_image(data, file.name, radiometry=radiometry))


class StereoPair:
    """The left and the right image of one exposure; it is matched when that is first needed."""

    def __init__(self, left: Image | str | Path, right: Image | str | Path) -> None:
        """A pair of two images, or of their files.

        Raises:
            PhotogrammetryError: a file cannot be read, or they were taken at different places.
        """
        self.left, self.right = (
            one if isinstance(one, Image) else read_image(one) for one in (left, right)
        )
        self.record = PairRecord(self.left.read.image, self.right.read.image)

    @property
    def id(self) -> str:
        """The pair is identified by its left image."""
        return self.record.id

    @property
    def stop(self) -> StopId:
        """Mission, site and drive where it was taken."""
        return self.record.stop

    @cached_property
    def images(self) -> EpipolarImages:
        """Both images resampled so that rows correspond, with the geometry of the pair."""
        left, right = self.record.left, self.record.right
        geometry = epipolar_pair(
            left.camera,
            right.camera,
            (left.samples, left.lines),
            (right.samples, right.lines),
            left.stop.frame,
            pair_frame(left),
        )
        sources = ((one.pixels, one.mask, one.camera.model) for one in (self.left, self.right))
        return epipolar_images(geometry, *sources)

    def match(self) -> StereoMatch:
        """Match both images, sparsely and densely; a second call returns the same."""
        return self._match

    @cached_property
    def _match(self) -> StereoMatch:
        sparse = match_sparsely(self.id, self.images)
        return StereoMatch(self, sparse, match_densely(self.images))


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatch:
    """Matches of a pair."""

    pair: StereoPair
    sparse: StereoMatches
    """Interest points: `left` (n, 2) in the left epipolar image, `parallax_px` and `sigma_px`."""
    dense: DenseMatches
    """`parallax_px` and `sigma_px` of every pixel of the left epipolar image; NaN: not matched."""

    @property
    def geometry(self) -> EpipolarPair:
        """Base, focal length and place of the epipolar images."""
        return self.pair.images.geometry

    @property
    def disparity_px(self) -> ParallaxMap:
        """Left sample minus right sample, (lines, samples) pixels; NaN where not matched."""
        return self.dense.parallax_px

    def points(self) -> Float64[np.ndarray, "n 3"]:
        """Places of the sparse matches in the rover frame, (n, 3) metres."""
        found = self.geometry.triangulate(self.sparse.left, self.sparse.parallax_px)
        return self.geometry.rover_from_pair.apply(found)

    def point_map(self) -> Float64[np.ndarray, "lines samples 3"]:
        """Places of all pixels of the left epipolar image in the rover frame; NaN: not matched."""
        lines, samples = self.disparity_px.shape
        rows, cols = np.mgrid[:lines, :samples]
        left = np.column_stack([cols.ravel(), rows.ravel()]).astype(np.float64)
        found = self.geometry.triangulate(left, self.disparity_px.ravel().astype(np.float64))
        return self.geometry.rover_from_pair.apply(found).reshape(lines, samples, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Stereo pairs placed by a bundle adjustment, and how sure that is."""

    pairs: tuple[StereoPair, ...]
    network: AdjustedNetwork
    report: AdjustmentReport
    notes: tuple[str, ...]
    """Results of linking stops, one line each."""

    @property
    def stops(self) -> tuple[StopId, ...]:
        """The stops, in the order of the rows below."""
        return tuple(one.stop for one in self.network.stops)

    @property
    def positions(self) -> Float64[np.ndarray, "stops 3"]:
        """North, east, down of the stops in the local frame, metres."""
        return np.array([one.lsl_from_rover.translation_m for one in self.network.stops])

    @property
    def sigmas(self) -> Float64[np.ndarray, "stops 3"]:
        """Standard deviations of `positions`, metres; zero for the stop that is held."""
        return np.array([one.sigma_ned_m for one in self.network.stops])

    def adjusted(self, pair: StereoPair) -> AdjustedPair:
        """Pose and covariance of a pair."""
        return next(one for one in self.network.pairs if one.pair_id == pair.id)


def adjust(pairs: Iterable[StereoPair], sites: Mapping[int, ArrayLike] | None = None) -> Adjustment:
    """Tie the pairs of some stops to each other and adjust them together; the first stop is held.

    Args:
        pairs: Of one rover, any order. They are matched if they are not yet.
        sites: Origin of every site in the local frame, (north, east, down) metres; needed where
            the pairs are of several sites, whose labels do not give their relative position.

    Raises:
        AdjustmentError: there is no pair, or a site without an origin.
    """
    given = tuple(sorted(pairs, key=lambda pair: (pair.stop, pair.id)))
    if not given:
        raise AdjustmentError("an adjustment needs at least one stereo pair")
    stops = sorted({pair.stop for pair in given})
    poses = {pair.stop: _local_from_rover(pair, sites or {}, given[0]) for pair in given}
    matched = {stop: _matched_stop(given, stop, poses[stop]) for stop in stops}
    ties: list[Ties] = []
    for stop in stops:
        within = tie_inter_stereo(matched[stop], InterStereoParams()).ties
        params = CrossSiteParams()
        matched[stop] = point_pairs(matched[stop], within, params.trials.alignment)
        ties.append(within)
    notes = []
    for earlier, later in pairwise(stops):
        link = tie_cross_site(matched[earlier], matched[later], CrossSiteParams())
        notes.append(f"{earlier} - {later}: {link.reason}")
        ties.append(link.ties)
    network = Network(
        tuple(
            StopPrior(stop, poses[stop], _first_at(given, stop).left.record.attitude_measured_by)
            for stop in stops
        ),
        tuple(PairGeometry(pair.id, pair.stop, pair.images.geometry) for pair in given),
        build_tie_points([pair.match().sparse for pair in given], ties, TrackParams()),
    )
    adjusted, report = adjust_network(network, {stops[0]}, AdjustmentParams())
    return Adjustment(given, adjusted, report, tuple(notes))


def _first_at(pairs: Sequence[StereoPair], stop: StopId) -> StereoPair:
    return next(pair for pair in pairs if pair.stop == stop)


def _local_from_rover(pair: StereoPair, sites: Mapping[int, ArrayLike], first: StereoPair) -> Pose:
    """By telemetry: the label's pose in its site, and where that site is."""
    site = pair.stop.site
    if site not in sites and (sites or site != first.stop.site):
        raise AdjustmentError(
            f"{pair.id} is of site {site}, and no origin of that site is given: "
            f"sites={{{site}: (north, east, down)}}"
        )
    origin = _points(sites.get(site, (0.0, 0.0, 0.0)), 3)
    return Pose(LSL, site_frame(site), np.eye(3), origin) @ pair.record.left.site_from_rover


def _matched_stop(pairs: Sequence[StereoPair], stop: StopId, pose: Pose) -> MatchedStop:
    def matched(pair: StereoPair) -> MatchedPair:
        found = pair.match()
        instrument = pair.record.left.instrument
        return MatchedPair.of(pair.id, instrument, pair.images, found.sparse, found.disparity_px)

    here = tuple(matched(pair) for pair in pairs if pair.stop == stop)
    return MatchedStop(stop, here, pose, np.zeros((6, 6)))


Placed = StereoPair | Adjustment | Sequence[StereoPair]
"""Input of a terrain model: pairs with poses by telemetry, or an adjustment."""


def _views(placed: Placed) -> list[TerrainView]:
    if isinstance(placed, Adjustment):
        oriented = [(pair, placed.adjusted(pair)) for pair in placed.pairs]
        return [_view(p, one.lsl_from_pair, one.covariance) for p, one in oriented]
    pairs = [placed] if isinstance(placed, StereoPair) else list(placed)
    if not pairs:
        raise TerrainError("terrain needs at least one stereo pair")
    return [
        _view(pair, _local_from_rover(pair, {}, pairs[0]) @ pair.images.geometry.rover_from_pair)
        for pair in pairs
    ]


def _view(pair: StereoPair, pose: Pose, covariance: np.ndarray | None = None) -> TerrainView:
    images, dense = pair.images, pair.match().dense
    view = TerrainView(
        pair_id=pair.id,
        instrument=pair.record.left.instrument,
        lsl_from_pair=pose,
        geometry=images.geometry,
        parallax=dense.parallax_px,
        image=images.left,
        mask=images.left_mask,
        sigma_px=dense.sigma_px,
        covariance=covariance,
    )
    return mask_rover(view, pair.stop.mission)


def build_dtm(placed: Placed, cell_m: float | None = None) -> Dtm:
    """The terrain model of one pair, of the pairs of one site, or of an adjustment.

    Args:
        placed: Pairs, placed by their labels in the frame of their site; or an adjustment.
        cell_m: Side of a cell: 0.01 m times a power of two; 0.04 if not given.

    Returns:
        `elevation`, `sigma_m`, `observations` and `ground`, (rows, cols) on the map `grid`;
        elevation counts from the origin of the local frame.

    Raises:
        TerrainError: there is nothing to map, or no such cell.
    """
    params = DtmParams() if cell_m is None else DtmParams(cell_m=cell_m)
    return model_terrain(_views(placed), params)


@dataclass(frozen=True, slots=True, eq=False)
class Orthophoto:
    """Brightness on the map, in the units of the images; NaN where no image shows the ground."""

    grid: MapGrid
    brightness: Raster
    """(rows, cols)."""


def orthophoto(dtm: Dtm, placed: Placed, cell_m: float | None = None) -> Orthophoto:
    """The images on a terrain model, blended and balanced.

    Args:
        dtm: As `build_dtm` made it.
        placed: What it was made of.
        cell_m: Side of a cell; that of the terrain model, or a half, a quarter ... of it.

    Raises:
        TerrainError: the model is empty, or no image looks at it.
    """
    params = OrthophotoParams(cell_m=cell_m or dtm.grid.cell_m)
    made = prepare_orthophoto(dtm, _views(placed), params)
    brightness = np.full(made.grid.shape, np.nan, dtype=np.float32)
    for block in made.blocks():
        rows, cols = block.brightness.shape[1:]
        brightness[block.row : block.row + rows, block.col : block.col + cols] = block.brightness[0]
    return Orthophoto(made.grid, brightness)


class Simulation:
    """A simulated traverse with known truth; its images are rendered on request."""

    def __init__(self, world: World) -> None:
        """As `simulate` makes it."""
        self.world = world

    @cached_property
    def pairs(self) -> tuple[StereoPair, ...]:
        """The stereo pairs of all stops, read back from the images as a rover would send them."""
        jobs = render_jobs(self.world)
        with ThreadPoolExecutor(2) as pool:
            images = list(pool.map(self._image, jobs))
        return tuple(StereoPair(*two) for two in zip(images[::2], images[1::2], strict=True))

    def _image(self, job: RenderJob) -> Image:
        file = job.run(self.world)
        return Image(reading.read_image(file.data, Path(file.path).name))

    @property
    def sites(self) -> dict[int, np.ndarray]:
        """Origin of every site in the local frame by telemetry, (3,) metres."""
        return {stop.id.site: stop.lsl_from_site.translation_m for stop in self.world.stops}

    @property
    def positions(self) -> Float64[np.ndarray, "stops 3"]:
        """True positions of the stops: north, east, down in the local frame, metres."""
        return np.array([stop.lsl_from_rover.translation_m for stop in self.world.stops])

    def elevation(self, grid: MapGrid) -> Raster:
        """The true elevation at the cells of a map grid, (rows, cols) metres."""
        return self.world.true_elevation(grid)

    def write(self, folder: str | Path) -> Path:
        """Write the downlink as `solmap simulate` does: images, vector files, `truth`; the folder.

        It is what `solmap run FOLDER` processes.
        """
        for file in simulate_downlink(self.world.params, self.world.seed):
            path = Path(folder) / file.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.data)
        return Path(folder)


def simulate(
    stops: int = 1,
    pairs: int = 10,
    terrain: str = "hills",
    seed: int = 1,
    *,
    averaging: int = 1,
    realistic: bool = False,
) -> Simulation:
    """A rover's traverse with Navcam panoramas over fractal ground with rocks; `seed` repeats it.

    Args:
        stops: Number of stops, 10 to 22 m apart, all of one site by twos.
        pairs: Stereo pairs of a stop, 36 degrees apart.
        terrain: plains, hills or crater.
        seed: Of everything.
        averaging: Pixels averaged to one along either side, 1, 2 or 4: fewer pixels take less time.
        realistic: Images and telemetry with the errors of real ones.

    Raises:
        PhotogrammetryError: there is no such terrain, or a number is out of range.
    """
    params = WorldParams(terrain, TraverseParams(stops=stops), pairs=pairs, averaging=averaging)
    return Simulation(make_world(realistic_params(params, seed) if realistic else params, seed))
