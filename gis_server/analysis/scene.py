"""Poses of the rover and viewing rays of its cameras, for the 3D view.

Places are (east, north, up) in metres of the mission's local map. A stop's rover frame (x forward,
y right, z down) is turned onto the map by `map_from_rover`, row by row. The error ellipsoid has the
standard deviations of the stop's place as semi-axes, against the stop that the network holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import UNITS
from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedStop
from solmap.photogrammetry.archive.tables.vector_files import VectorFile
from solmap.photogrammetry.arrays import ObjectPoints, Vector3
from solmap.photogrammetry.frames import LSL, Pose, site_frame
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.photogrammetry.terrain.dtm.rover_body import BODIES
from solmap.photogrammetry.terrain.measure.oriented_image import (
    OrientedImage,
    Pointing,
    StopPose,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import NetworkProduct
from solmap.products.model import ProductRef

Place = tuple[float, float, float]
"""(east, north, up)."""
_DIGITS = 4


class Ellipsoid(BaseModel):
    """Standard error ellipsoid: semi-axes, largest first, and their directions."""

    semi_axes_m: Place
    directions: tuple[Place, Place, Place]


class SceneStop(BaseModel):
    """A stop: adjusted and telemetry positions, and the attitude of the rover."""

    stop: str
    site: int
    drive: int
    sols: tuple[int, ...]
    held: bool
    """Whether it defines the datum: its position is fixed."""
    place: Place
    telemetry: Place
    map_from_rover: tuple[Place, Place, Place]
    ellipsoid: Ellipsoid


class Body(BaseModel):
    """The box around a rover in its own frame (forward, right, down), metres from its origin."""

    back_m: float
    front_m: float
    half_width_m: float
    deck_m: float
    """Height of the deck above level ground."""
    ground_m: float
    """Depth of level ground below the origin."""


class SceneSite(BaseModel):
    """A site frame (x north, y east, z down) on the map, as telemetry chains it to the LSL."""

    site: int
    place: Place
    map_from_site: tuple[Place, Place, Place]


class SceneStops(BaseModel):
    """All stops of a mission, in the order of the traverse."""

    units: str = UNITS
    network: str | None
    """Digest of the adjusted network; null while none has been adjusted."""
    body: Body | None
    """Box of the rover; null for a rover of unknown dimensions."""
    stops: list[SceneStop]
    sites: list[SceneSite] = []
    """The sites of the stops whose frames are known."""


class SceneCamera(BaseModel):
    """An image's camera: its projection centre and the rays through the corners of the image."""

    image: str
    stop: str
    sol: int
    instrument: str
    eye: str
    partner: str | None
    centre: Place
    corners: tuple[Place, Place, Place, Place]
    """Unit directions: upper left, upper right, lower right, lower left."""
    axis: Place
    """Unit direction through the middle of the image."""


class SceneCameras(BaseModel):
    """The cameras of one stop."""

    units: str = UNITS
    network: str | None
    cameras: list[SceneCamera]


def scene_stops(ref: ProductRef, network: NetworkProduct, sites: Mapping[int, Pose]) -> SceneStops:
    """The stops of a network, and the frames of sites in the LSL."""
    box = BODIES.get(network.mission)
    body = Body(**{name: getattr(box, name) for name in Body.model_fields}) if box else None
    stops = [_stop(stop, network) for stop in network.adjusted.stops]
    frames = [
        SceneSite(
            site=site,
            place=on_map(pose.translation_m),
            map_from_site=_rows(MAP_FROM_LSL @ pose.rotation, 8),
        )
        for site, pose in sites.items()
    ]
    return SceneStops(network=ref.digest, body=body, stops=stops, sites=frames)


def site_frames(network: NetworkProduct, vectors: VectorFile | None) -> dict[int, Pose]:
    """The frames of a network's sites in the LSL, by the site vectors that were published with it.

    Without them, all stops belong to one site: the one whose frame the LSL is.
    """
    known = {stop.stop.site for stop in network.adjusted.stops}
    if vectors is None:
        return {site: Pose.identity(LSL, site_frame(site)) for site in known if len(known) == 1}
    placed = {one.counter[0]: one.pose for one in vectors.solutions}
    origins = {one.reference_site for one in vectors.solutions}
    return {
        site: placed.get(site, Pose.identity(LSL, site_frame(site)))
        for site in sorted(known)
        if site in placed or site in origins
    }


def scene_cameras(
    ref: ProductRef, network: NetworkProduct, entries: Iterable[ImageEntry], workspace: Workspace
) -> SceneCameras:
    """The cameras of images, except those of stops outside the network."""
    poses = {stop.stop: stop for stop in network.adjusted.stops}
    pointings = {pair.pair_id: pair.pointing for pair in network.adjusted.pairs}
    cameras = []
    for entry in entries:
        if entry.stop_id in poses:
            turn = pointings.get(entry.id, pointings.get(entry.partner or "", np.zeros(3)))
            image = image_record(entry, workspace)
            cameras.append(_camera(entry, _orient(image, poses[entry.stop_id], turn)))
    return SceneCameras(network=ref.digest, cameras=cameras)


def _stop(stop: AdjustedStop, network: NetworkProduct) -> SceneStop:
    known: StopId = stop.stop
    return SceneStop(
        stop=str(known),
        site=known.site,
        drive=known.drive,
        sols=network.sols[known],
        held=stop.held,
        place=on_map(stop.lsl_from_rover.translation_m),
        telemetry=on_map(network.telemetry[known].translation_m),
        map_from_rover=_rows(MAP_FROM_LSL @ stop.lsl_from_rover.rotation, 8),
        ellipsoid=_ellipsoid(stop),
    )


def _ellipsoid(stop: AdjustedStop) -> Ellipsoid:
    covariance = MAP_FROM_LSL @ stop.covariance[3:, 3:] @ MAP_FROM_LSL.T
    variances, axes = np.linalg.eigh((covariance + covariance.T) / 2)
    deviations = np.sqrt(np.maximum(variances[::-1], 0.0))
    return Ellipsoid(
        semi_axes_m=_numbers(deviations, _DIGITS), directions=_rows(axes[:, ::-1].T, 6)
    )


def _orient(image: RoverImage, stop: AdjustedStop, turn: Vector3) -> OrientedImage:
    pose = StopPose(stop.stop, stop.lsl_from_rover, stop.covariance)
    return OrientedImage.of(image, pose, Pointing(turn, np.zeros((3, 3))))


def _camera(entry: ImageEntry, image: OrientedImage) -> SceneCamera:
    right, bottom = image.size[0] - 0.5, image.size[1] - 0.5
    corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)]
    middle = ((image.size[0] - 1) / 2, (image.size[1] - 1) / 2)
    rays: ObjectPoints = image.camera.rays(np.array([*corners, middle])) @ MAP_FROM_LSL.T
    upper_left, upper_right, lower_right, lower_left, axis = (_numbers(ray, 6) for ray in rays)
    return SceneCamera(
        image=entry.id,
        stop=entry.stop,
        sol=entry.sol,
        instrument=entry.instrument,
        eye=entry.eye,
        partner=entry.partner,
        centre=on_map(image.camera.centre),
        corners=(upper_left, upper_right, lower_right, lower_left),
        axis=axis,
    )


def on_map(place_in_lsl: Vector3) -> Place:
    """A place of the LSL on the map, to a tenth of a millimetre."""
    return _numbers(MAP_FROM_LSL @ place_in_lsl, _DIGITS)


def _rows(matrix: np.ndarray, digits: int) -> tuple[Place, Place, Place]:
    first, second, third = (_numbers(row, digits) for row in matrix)
    return first, second, third


def _numbers(vector: np.ndarray, digits: int) -> Place:
    x, y, z = np.round(vector, digits).tolist()
    return x + 0.0, y + 0.0, z + 0.0
