"""Control: positions of stops in orbital images, by registration or measured by people.

A product of control is one frame, an orbital image or a file of measured points, with the positions
of stops in it (see `photogrammetry.adjustment.control`). The latest version of a name is used.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedNetwork
from solmap.photogrammetry.adjustment.model.network import ControlFrame, StopControl
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.errors import AdjustmentError, PhotogrammetryError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.orbital.registration import stop_in_image
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint, east_north
from solmap.products.errors import ProductError, cause_of
from solmap.products.formats.documents.control import control_product, read_control
from solmap.products.formats.documents.control_files import ControlRow, parse_control
from solmap.products.formats.documents.network import read_network, whole_network
from solmap.products.model import ProductKind, ProductRef, Recipe, mission_of
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.files import keep_file, write_bytes
from solmap.tasks.mission.orbital import (
    RegisteredImage,
    RegistrationMethod,
    StopMap,
    find_registration,
    read_correction,
)
from solmap.tasks.network.orientations import MappedStop, Standing, read_orientations
from solmap.tasks.stage import stage

MAST_DEG = AdjustmentParams().pointing_deg
"""Rotation of a pair, and of a map by the mean of its pairs, against the rover."""
BEND = 0.25
"""Bending of an image over a distance, as a fraction of its scale error there: 8 m over 3 km remain
of an uncontrolled mosaic after its shift, rotation and scale (Di et al. 2008, section 4)."""


@dataclass(frozen=True, slots=True)
class FrameParams:
    """Accuracy of the position of an orbital image, or of the map of measured points.

    Standard deviations; zero if exact.
    """

    shift_m: float = 300.0
    """Standard deviation of the shift of an uncontrolled mosaic; a controlled one is accurate to
    about 5 m, on older maps to 50 m."""
    rotation_deg: float = 3.0
    """The same: an uncontrolled mosaic was turned by 1.3 degrees (Di et al. 2008, section 4), an
    orthoimage of HiRISE or CTX has errors of a few metres over kilometres, 0.1 degrees. An image
    declared more accurate than the azimuth of the first stop rotates the map
    (`adjustment.model.datum`)."""
    scale: float = 0.01

    def __post_init__(self) -> None:
        for name in ("shift_m", "rotation_deg", "scale"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ProductError(
                    f"{name} is a standard deviation: zero (exact) or more, not {value}"
                )

    def frame(
        self, name: str, places: Sequence[StopControl], up_m: Sequence[float] = ()
    ) -> ControlFrame:
        """The frame, with the middle of its points as centre of rotation.

        `up_m`: offset of its heights from the rover's, since they refer to another level.
        """
        middle = np.mean([one.values[:2] for one in places], axis=0) if places else np.zeros(2)
        centre = float(middle[0]), float(middle[1])
        frame = ControlFrame.from_sigmas(
            name, centre, shift_m=self.shift_m, rotation_deg=self.rotation_deg, scale=self.scale
        )
        level = np.array([0.0, 0.0, np.mean(up_m) if len(up_m) else 0.0, 0.0, 0.0])
        return replace(frame, place=level)

    def places_in(self, frame: ControlFrame, places: Sequence[StopControl]) -> list[StopControl]:
        """Positions in a frame that is also bent: less certain far from its middle."""
        found = []
        for one in places:
            away_m = float(np.hypot(*(one.values[:2] - frame.centre_m)))
            covariance = one.covariance.copy()
            covariance[[0, 1], [0, 1]] += (BEND * self.scale * away_m) ** 2
            found.append(replace(one, covariance=covariance))
        return found


@stage(task_run_name="control-{registered.image.scope}")
def control_by_image(
    registered: RegisteredImage,
    stops: dict[StopId, StopMap],
    standing: Standing,
    params: tuple[RegistrationMethod, FrameParams],
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Locate every stop separately in an orbital image, near the whole map's position in it."""
    image, registration = registered.image, registered.registration
    maps = tuple(ref for stop in stops.values() for ref in (stop.dtm, stop.orthophoto))
    inputs = (image, registration, standing.network, standing.orientations, *maps)
    settings = (*params[0].settings, params[1], landing)
    recipe = Recipe(ProductKind.CONTROL, image.scope, inputs, settings)

    def write(path: Path) -> None:
        names = [str(stop) for stop in stops]
        adjusted = read_network(standing.network, store).with_stops(names, store).adjusted
        mapped = read_orientations(standing.orientations, store, names)
        start = read_correction(registration, store)
        found: list[StopControl] = []
        up_m: list[float] = []
        refused: dict[str, str] = {}
        for stop, own in stops.items():
            try:
                outcome, _ = find_registration(image, [own], params[0], landing, store, start)
                if outcome.correction is None:
                    refused[str(stop)] = outcome.reason
                    continue
                pose = _mapped_pose(stop, adjusted, mapped)
                turn_deg = MAST_DEG / np.sqrt(len(mapped[str(stop)].orientations))
                found.append(
                    stop_in_image(stop, pose, outcome.correction, image.scope.name, turn_deg)
                )
            except (PhotogrammetryError, ProductError, ArithmeticError, ValueError) as error:
                refused[str(stop)] = cause_of(error)  # only of this stop
                continue
            up_m += [outcome.correction.up_m] if outcome.correction.up_m else []
        frame = params[1].frame(image.scope.name, found, up_m)
        places = params[1].places_in(frame, found)
        path.write_text(json.dumps(control_product(frame, places, refused)))

    return store.make(recipe, write)


def _mapped_pose(stop: StopId, adjusted: AdjustedNetwork, mapped: dict[str, MappedStop]) -> Pose:
    """The pose of a rover in its maps: up to the reissue limit different from the latest."""
    pose = adjusted.stop(stop).lsl_from_rover
    today = {pair.pair_id: pair.lsl_from_pair for pair in adjusted.pairs}
    old = [o for o in mapped[str(stop)].orientations if o.pair_id in today]
    if not old:
        return pose
    moves = [o.lsl_from(today[o.pair_id].source) @ today[o.pair_id].inverse for o in old]
    turn = Rotation.from_matrix([move.rotation for move in moves]).mean().as_matrix()
    place = np.mean([move.apply(pose.translation_m[None])[0] for move in moves], axis=0)
    return Pose(pose.target, pose.source, turn @ pose.rotation, place)


def take_control(
    name: str,
    data: bytes,
    network: ProductRef,
    params: FrameParams,
    landing: LandingPoint,
    store: ProductStore,
) -> ProductRef:
    """Store a file of measured control.

    Raises:
        AdjustmentError: it cannot be read, or names a stop that is not in the network.
    """
    standing = whole_network(network, store)
    mission, adjusted = standing.mission, standing.adjusted
    try:
        rows = parse_control(data.decode("utf-8"), mission_of(mission), name)
    except UnicodeDecodeError as error:
        raise AdjustmentError(f"{name}: control should be UTF-8 text, but {error}") from error
    found = [_control_of_row(row, adjusted, params, landing, name) for row in rows]
    file = keep_file(ProductKind.CONTROL_FILE, name, data, store)
    inputs = (file, *((network,) if any(row.map_point for row in rows) else ()))
    recipe = Recipe(ProductKind.CONTROL, file.scope, inputs, (params, landing, mission))
    frame = params.frame(file.scope.name, found)
    text = json.dumps(control_product(frame, params.places_in(frame, found), {}))
    return store.make(recipe, lambda draft: write_bytes(draft, text.encode()))


def _control_of_row(
    row: ControlRow,
    adjusted: AdjustedNetwork,
    params: FrameParams,
    landing: LandingPoint,
    source: str,
) -> StopControl:
    """Control of a stop from a row; a point on its map is transferred to the rover."""
    known = {stop.stop: stop for stop in adjusted.stops}
    if row.stop not in known:
        raise AdjustmentError(
            f"{source}: {row.stop} is not in the network of {len(known)} stops, from "
            f"{adjusted.stops[0].stop} to {adjusted.stops[-1].stop}; `solmap status` lists them"
        )
    place = np.array(row.place)
    if row.in_degrees:
        place = np.concatenate(east_north(landing, *row.place))
    variances = [row.sigma_m**2] * 2
    if row.map_point:
        north, east, _ = known[row.stop].lsl_from_rover.translation_m.tolist()
        arm = np.array([east, north]) - row.map_point
        turned = np.radians(params.rotation_deg) * float(np.linalg.norm(arm))
        place, variances = place + arm, [row.sigma_m**2 + turned**2] * 2
    variances += [row.up[1] ** 2] if row.up else []
    variances += [float(np.radians(row.azimuth[1])) ** 2] if row.azimuth else []
    frame = source.lower().replace(".", "-")
    return StopControl(
        row.stop,
        frame,
        float(place[0]),
        float(place[1]),
        np.diag(variances),
        row.up[0] if row.up else None,
        row.azimuth[0] if row.azimuth else None,
    )


def control_of(mission: str, workspace: Workspace) -> tuple[ProductRef, ...]:
    """All published control of a mission."""
    pointers = workspace.catalogue.pointers(ProductKind.CONTROL)
    return tuple(ref for ref in pointers if holds_control_of(ref, mission, workspace.store))


def holds_control_of(ref: ProductRef, mission: str, store: ProductStore) -> bool:
    """Whether the stops of some control belong to a mission, or control has none any more."""
    _, control = read_control(ref, store)
    return not control or control[0].stop.mission == mission_of(mission)
