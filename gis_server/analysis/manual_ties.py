"""Manual tie points before they are saved: refining a picked point, and previewing the adjustment.

`refine_pick` measures the second of two picked points by least-squares matching;
`preview_adjustment` adjusts two stops with manual tie points and without. Nothing is stored.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, Field
from scipy.spatial.transform import Rotation

from solmap.gis_server.analysis.bodies import (
    TIE_STATUS,
    UNITS,
    NetworkUsed,
    Question,
    UnanswerableError,
    json_number,
    json_numbers,
)
from solmap.gis_server.rendering.images import linearised_image
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.preview import (
    Preview,
    Veto,
    adjust_without_manual_ties,
    part_of,
    preview_manual_ties,
)
from solmap.photogrammetry.arrays import Float64, ImagePoints
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.imagery import Eye, StopId
from solmap.photogrammetry.matching.conjugates import View
from solmap.photogrammetry.matching.manual.editing import (
    SIGMA_PX,
    TOLERANCE_PX,
    EditAction,
    EditPoint,
    EditRequest,
    ManualImage,
    apply_edits,
    epipolar_point,
)
from solmap.photogrammetry.matching.manual.picking import (
    LARGEST_REACH_PX,
    REACH_PX,
    PickedView,
    measure_pick,
)
from solmap.photogrammetry.matching.records import Ties, join_ties
from solmap.photogrammetry.matching.resampling import GROUND_M
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import (
    OrientedMission,
    StereoPartners,
    geometry_of,
    matches_of,
)
from solmap.products.model import ProductRef

PixelHere = Annotated[float, Field(ge=-1, le=1e5)]
ImageHere = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]
_MOST_TIES = 500
_MOST_SOLUTIONS = 4
"""Cached pairs of adjusted stops, a few megabytes each."""
_SOLUTIONS: OrderedDict[
    tuple[Path, ProductRef, frozenset[StopId]],
    tuple[Network, tuple[AdjustedNetwork, AdjustmentReport]],
] = OrderedDict()
_LOCK = threading.Lock()


class Picked(Question):
    """A point of an image as stored, pixels; of a pair, of its left image."""

    image: ImageHere
    sample: PixelHere
    line: PixelHere


class RefineQuestion(Question):
    """One feature as a person picked it in the left images of two pairs."""

    first: Picked
    second: Picked
    reach_px: Annotated[float, Field(gt=0, le=LARGEST_REACH_PX)] = REACH_PX
    """Radius of the search for the second point."""


class RefineAnswer(BaseModel):
    """The second point, measured; the first defines the tie."""

    units: str = UNITS
    found: bool
    said: str | None
    """Why it was not found."""
    image: str
    sample: float
    line: float
    """Line as picked if the point was not found."""
    moved_px: float
    sigma_px: float | None
    correlation: float | None
    network: NetworkUsed


def refine_pick(question: RefineQuestion, mission: OrientedMission) -> RefineAnswer:
    """Measure the second of two picked points by least-squares matching."""
    sides = [_picked_view(point, mission) for point in (question.first, question.second)]
    (first, at, _), (second, start, eyes) = sides
    picked = np.array([question.second.sample, question.second.line])
    try:
        found = measure_pick(first, second, at, start, question.reach_px)
        place = stored_point(eyes.left, eyes.geometry, np.array([found.place]))[0]
        reason, sigma, correlation = None, found.sigma_px, found.correlation
    except MatchingError as error:
        place, reason, sigma, correlation = picked, str(error), None, None
    return RefineAnswer(
        found=reason is None,
        said=reason,
        image=eyes.pair_id,
        sample=round(float(place[0]), 3),
        line=round(float(place[1]), 3),
        moved_px=round(float(np.linalg.norm(place - picked)), 3),
        sigma_px=None if sigma is None else round(sigma, 3),
        correlation=None if correlation is None else round(correlation, 3),
        network=NetworkUsed.of(mission.ref),
    )


def stored_point(camera: CameraModel, geometry: EpipolarPair, points: ImagePoints) -> ImagePoints:
    """Coordinates, in the image as stored, of points of an epipolar image."""
    return camera.project(camera.centre + GROUND_M * geometry.directions(points))


def left_entry(image: str, mission: OrientedMission) -> tuple[ImageEntry, StereoPartners]:
    """The left image of a matched pair by its name.

    Raises:
        UnanswerableError: the image is a right one, or its pair was not matched.
    """
    entry = mission.workspace.catalogue.image(image.upper())
    if entry.eye != Eye.LEFT:
        raise UnanswerableError(
            f"{entry.id} is a {entry.eye} image; ties are measured in left ones: pick in "
            f"{entry.partner or 'another image'}"
        )
    eyes = mission.stereo_partners(entry)
    if eyes is None or mission.pair_of(entry) is None:
        raise UnanswerableError(f"{entry.id} has no matched partner in the latest network")
    return entry, eyes


def _picked_view(
    point: Picked, mission: OrientedMission
) -> tuple[PickedView, Float64[np.ndarray, " 2"], StereoPartners]:
    entry, eyes = left_entry(point.image, mission)
    pair = mission.pair_of(entry)
    assert pair is not None  # noqa: S101 - checked by `left_entry`
    grey = linearised_image(entry, mission.workspace)
    mask = np.isfinite(grey)
    view = View.of(np.where(mask, grey, np.float32(0)), mask)
    place = epipolar_point(eyes.left, eyes.geometry, (point.sample, point.line))
    if not eyes.geometry.shows(place[None])[0]:
        raise UnanswerableError(
            f"sample {point.sample:g}, line {point.line:g} is not on {entry.id}"
        )
    picked = PickedView(view, eyes.geometry, eyes.dense.parallax_px, pair.lsl_from_pair)
    return picked, place, eyes


class TiePoint(Question):
    """A point of an image as stored; of a pair, of its left image, with or without the right."""

    image: ImageHere
    sample: PixelHere | None = None
    line: PixelHere | None = None
    right_sample: PixelHere | None = None
    right_line: PixelHere | None = None


class TieRequest(Question):
    """A row of a file of manual tie points."""

    action: Literal["add", "veto", "move"] = "add"
    first: TiePoint
    second: TiePoint
    sigma_px: Annotated[float, Field(gt=0, le=100)] = SIGMA_PX
    tolerance_px: Annotated[float, Field(gt=0, le=100)] = TOLERANCE_PX


class TrialQuestion(Question):
    """Manual tie points between images of two stops."""

    ties: Annotated[list[TieRequest], Field(min_length=1, max_length=_MOST_TIES)]


class TieResidual(BaseModel):
    """Fit of a manual tie point: observed minus computed, in epipolar pixels of each pair."""

    tie: int
    """Its number in the question."""
    status: str
    """used; blunder: it contradicts the others and was set aside."""
    residual_px: float | None
    """Root mean square of both images' residuals per coordinate."""
    first: list[float | None]
    """(sample, line, parallax)."""
    second: list[float | None]
    largest_standardised: float | None
    """Largest residual over its own standard deviation: above 4 it is a blunder."""


class StopChange(BaseModel):
    """Movement of the second stop, and its standard deviation."""

    east_m: float
    north_m: float
    up_m: float
    turn_deg: float
    """Angle of the rotation between both solutions."""
    azimuth_deg: float
    """Clockwise."""
    sigma_east_m: float
    sigma_north_m: float
    sigma_up_m: float


class TrialReport(BaseModel):
    """Result of a trial adjustment."""

    summary: str
    is_usable: bool
    sigma0: float | None
    redundancy: int
    blunders: int
    cross_site_ties: int


class TrialAnswer(BaseModel):
    """The effect that manual tie points would have."""

    units: str = UNITS
    held_stop: str
    moved_stop: str
    change: StopChange
    """Movement caused by the manual tie points alone."""
    before: TrialReport
    after: TrialReport
    ties: list[TieResidual]
    notes: list[str]
    """Ties that could not be applied, and the reasons."""
    vetoed: int
    """Automatic observations dropped."""
    network: NetworkUsed


def preview_adjustment(question: TrialQuestion, mission: OrientedMission) -> TrialAnswer:
    """Adjust two stops with manual tie points between them, and without."""
    stops = _stops(question, mission)
    images = {name: _manual_image(name, mission) for name in _names(question)}
    requests = [_tie_request(k, tie) for k, tie in enumerate(question.ties)]
    manual, placed, notes = _make_ties(requests, images)
    vetoes = [veto for request in requests if (veto := _veto(request, images))]
    if not (len(manual) or vetoes):
        raise UnanswerableError(f"no tie could be applied: {'; '.join(notes)}")
    network, solution = _current_solution(mission, frozenset(stops))
    found = preview_manual_ties(network, solution, manual, vetoes, AdjustmentParams())
    return _answer(found, network.stop_ids, placed, notes, mission)


def _current_solution(
    mission: OrientedMission, stops: frozenset[StopId]
) -> tuple[Network, tuple[AdjustedNetwork, AdjustmentReport]]:
    """Two stops adjusted without manual tie points, cached while a person edits."""
    key = (mission.workspace.store.root, mission.ref, stops)
    with _LOCK:
        if key not in _SOLUTIONS:
            network = _network_of(stops, mission)
            adjusted = adjust_without_manual_ties(
                network, mission.network.adjusted, AdjustmentParams()
            )
            _SOLUTIONS[key] = network, adjusted
            while len(_SOLUTIONS) > _MOST_SOLUTIONS:
                _SOLUTIONS.popitem(last=False)
        _SOLUTIONS.move_to_end(key)
        return _SOLUTIONS[key]


def _names(question: TrialQuestion) -> list[str]:
    points = (point for tie in question.ties for point in (tie.first, tie.second))
    return list(dict.fromkeys(point.image.upper() for point in points))


def _stops(question: TrialQuestion, mission: OrientedMission) -> set[StopId]:
    stops = {mission.workspace.catalogue.image(name).stop_id for name in _names(question)}
    unknown = sorted(str(stop) for stop in stops if stop not in mission.stops)
    if unknown:
        raise UnanswerableError(f"{unknown[0]} is not in the latest network of this mission")
    if len(stops) != 2:  # noqa: PLR2004
        named = ", ".join(sorted(str(stop) for stop in stops))
        raise UnanswerableError(
            f"a preview needs ties between two stops; these images are at {named}"
        )
    return stops


def _manual_image(name: str, mission: OrientedMission) -> ManualImage:
    _, eyes = left_entry(name, mission)
    parallax = eyes.dense.parallax_px
    return ManualImage(eyes.pair_id, eyes.geometry, eyes.left, eyes.right, parallax)


def _tie_request(row: int, tie: TieRequest) -> EditRequest:
    first, second = (_point(point) for point in (tie.first, tie.second))
    action = EditAction(tie.action)
    return EditRequest(action, first, second, tie.sigma_px, tie.tolerance_px, f"tie {row}")


def _point(point: TiePoint) -> EditPoint:
    pairs = ((point.sample, point.line), (point.right_sample, point.right_line))
    places = []
    for sample, line in pairs:
        if (sample is None) != (line is None):
            raise UnanswerableError(f"sample and line go together: {point.image} lacks one")
        places.append(None if sample is None or line is None else (sample, line))
    return EditPoint(point.image.upper(), places[0], places[1])


def _make_ties(
    requests: list[EditRequest], images: dict[str, ManualImage]
) -> tuple[Ties, list[int], list[str]]:
    """The added ties, the numbers of their requests, and ties that could not be applied."""
    made: list[Ties] = []
    numbers: list[int] = []
    notes: list[str] = []
    for k, request in enumerate(requests):
        if request.action is EditAction.VETO:
            continue
        added = EditRequest(
            EditAction.ADD, request.first, request.second, request.sigma_px, row=request.row
        )
        outcome = apply_edits([], [added], images, {})
        notes += outcome.notes
        made += outcome.ties
        numbers += [k] * len(outcome.ties)
    return join_ties(made, tuple(images)), numbers, notes


def _veto(request: EditRequest, images: dict[str, ManualImage]) -> Veto | None:
    if request.action is EditAction.ADD:
        return None
    image, point = images[request.first.image], request.first.point
    left = None if point is None else epipolar_point(image.left, image.geometry, point)
    return Veto(image.name, left, images[request.second.image].name, request.tolerance_px)


def _network_of(stops: Collection[StopId], mission: OrientedMission) -> Network:
    """The network of two stops, as far as its pairs were matched."""
    geometries, attitudes = {}, {}
    for pair in mission.pairs.values():
        if pair.stop not in stops:
            continue
        entry = mission.workspace.catalogue.image(pair.pair_id)
        matches = matches_of(entry, mission.workspace) if entry.partner else None
        if matches is not None:
            geometries[pair.pair_id] = geometry_of(matches, mission.workspace)
            attitudes[pair.stop] = mission.record(entry).attitude_measured_by
    known = mission.network
    priors = {
        stop: StopPrior(
            stop, known.telemetry[stop], attitudes.get(stop, "UNKNOWN"), known.sols[stop]
        )
        for stop in stops
    }
    return part_of(known.adjusted, priors, geometries)


def _answer(
    found: Preview,
    stops: tuple[StopId, ...],
    placed: list[int],
    notes: list[str],
    mission: OrientedMission,
) -> TrialAnswer:
    return TrialAnswer(
        held_stop=str(stops[0]),
        moved_stop=str(stops[1]),
        change=_change(found.before, found.after),
        before=_report(found.report_before),
        after=_report(found.report),
        ties=[_residual(k, row, found) for row, k in enumerate(placed)],
        notes=notes,
        vetoed=found.vetoed,
        network=NetworkUsed.of(mission.ref),
    )


def _change(before: AdjustedStop, after: AdjustedStop) -> StopChange:
    one, other = before.lsl_from_rover, after.lsl_from_rover
    east, north, up = (MAP_FROM_LSL @ (other.translation_m - one.translation_m)).tolist()
    turn = np.degrees(Rotation.from_matrix(other.rotation @ one.rotation.T).as_rotvec())
    sigma_north, sigma_east, sigma_down = after.sigma_ned_m.tolist()
    return StopChange(
        east_m=round(east, 5),
        north_m=round(north, 5),
        up_m=round(up, 5),
        turn_deg=round(float(np.linalg.norm(turn)), 5),
        azimuth_deg=round(float(turn[2]), 5),
        sigma_east_m=round(sigma_east, 5),
        sigma_north_m=round(sigma_north, 5),
        sigma_up_m=round(sigma_down, 5),
    )


def _report(report: AdjustmentReport) -> TrialReport:
    return TrialReport(
        summary=str(report),
        is_usable=report.is_usable,
        sigma0=json_number(report.sigma0),
        redundancy=report.redundancy,
        blunders=report.blunders,
        cross_site_ties=sum(n for kind, n in report.ties.items() if str(kind) == "cross-site"),
    )


def _residual(tie: int, row: int, found: Preview) -> TieResidual:
    residuals = found.residuals_px[row]
    known = residuals[np.isfinite(residuals)]
    standardised = np.abs(found.standardised[row])
    worst = float(np.nanmax(standardised)) if np.isfinite(standardised).any() else None
    status = {TIE_STATUS.get(int(k), "unused") for k in found.status[row]}
    return TieResidual(
        tie=tie,
        status="blunder" if "blunder" in status else "used" if status == {"used"} else "unused",
        residual_px=json_number(float(np.sqrt(np.mean(known**2)))) if len(known) else None,
        first=json_numbers(residuals[0]),
        second=json_numbers(residuals[1]),
        largest_standardised=json_number(worst, 2),
    )
