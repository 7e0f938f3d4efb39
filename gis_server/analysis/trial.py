"""Hand ties tried on two stops: what they change, and how well they fit. Nothing is kept."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from solmap.gis_server.analysis.bodies import NetworkUsed, number, numbers
from solmap.gis_server.analysis.picks import left_entry
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.gis_server.analysis.trial_bodies import (
    StopChange,
    TiePoint,
    TieResidual,
    TieWish,
    TrialAnswer,
    TrialQuestion,
    TrialReport,
)
from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    USED,
    AdjustedNetwork,
    AdjustedStop,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.network import Network, StopPrior
from solmap.photogrammetry.adjustment.model.params import AdjustmentParams
from solmap.photogrammetry.adjustment.modes.preview import (
    Preview,
    Veto,
    as_it_stands,
    part_of,
    preview,
)
from solmap.photogrammetry.imagery import StopId
from solmap.photogrammetry.matching.hand_editing import HandBody, edited, epipolar_point
from solmap.photogrammetry.matching.hand_ties import HandAction, HandPoint, HandTie
from solmap.photogrammetry.matching.records import Ties, joined
from solmap.photogrammetry.terrain.dtm.ground import MAP_FROM_LSL
from solmap.products.catalogue.oriented_images import OrientedMission, geometry_of, matches_of
from solmap.products.model import ProductRef

_MOST_STANDING = 4
"""Pairs of stops that are remembered as they stand, a few megabytes each."""
_STANDING: OrderedDict[
    tuple[Path, ProductRef, frozenset[StopId]],
    tuple[Network, tuple[AdjustedNetwork, AdjustmentReport]],
] = OrderedDict()
_LOCK = threading.Lock()
_STATUS = {USED: "used", BLUNDER: "blunder"}


def tried(question: TrialQuestion, mission: OrientedMission) -> TrialAnswer:
    """Adjust the two stops of hand ties, with these and without."""
    stops = _stops(question, mission)
    bodies = {name: _body(name, mission) for name in _names(question)}
    wishes = [_wish(k, tie) for k, tie in enumerate(question.ties)]
    hand, placed, notes = _placed(wishes, bodies)
    vetoes = [veto for wish in wishes if (veto := _veto(wish, bodies))]
    if not (len(hand) or vetoes):
        raise RefusedError(f"no tie could be carried out: {'; '.join(notes)}")
    network, standing = _standing(mission, frozenset(stops))
    found = preview(network, standing, hand, vetoes, AdjustmentParams())
    return _answer(found, network.stop_ids, placed, notes, mission)


def _standing(
    mission: OrientedMission, stops: frozenset[StopId]
) -> tuple[Network, tuple[AdjustedNetwork, AdjustmentReport]]:
    """Two stops and how they stand without hand ties, remembered while a person edits."""
    key = (mission.workspace.store.root, mission.ref, stops)
    with _LOCK:
        if key not in _STANDING:
            network = _part(stops, mission)
            adjusted = as_it_stands(network, mission.network.adjusted, AdjustmentParams())
            _STANDING[key] = network, adjusted
            while len(_STANDING) > _MOST_STANDING:
                _STANDING.popitem(last=False)
        _STANDING.move_to_end(key)
        return _STANDING[key]


def _names(question: TrialQuestion) -> list[str]:
    points = (point for tie in question.ties for point in (tie.first, tie.second))
    return list(dict.fromkeys(point.image.upper() for point in points))


def _stops(question: TrialQuestion, mission: OrientedMission) -> set[StopId]:
    stops = {mission.workspace.catalogue.image(name).stop_id for name in _names(question)}
    unknown = sorted(str(stop) for stop in stops if stop not in mission.stops)
    if unknown:
        raise RefusedError(f"{unknown[0]} is not in the latest network of this mission")
    if len(stops) != 2:  # noqa: PLR2004
        named = ", ".join(sorted(str(stop) for stop in stops))
        raise RefusedError(f"a trial is of ties between two stops; these images are at {named}")
    return stops


def _body(name: str, mission: OrientedMission) -> HandBody:
    _, eyes = left_entry(name, mission)
    parallax = eyes.dense.parallax_px
    return HandBody(eyes.pair_id, eyes.geometry, eyes.left, eyes.right, parallax)


def _wish(row: int, tie: TieWish) -> HandTie:
    first, second = (_point(point) for point in (tie.first, tie.second))
    action = HandAction(tie.action)
    return HandTie(action, first, second, tie.sigma_px, tie.tolerance_px, f"tie {row}")


def _point(point: TiePoint) -> HandPoint:
    pairs = ((point.sample, point.line), (point.right_sample, point.right_line))
    places = []
    for sample, line in pairs:
        if (sample is None) != (line is None):
            raise RefusedError(f"sample and line go together; one is missing in {point.image}")
        places.append(None if sample is None or line is None else (sample, line))
    return HandPoint(point.image.upper(), places[0], places[1])


def _placed(
    wishes: list[HandTie], bodies: dict[str, HandBody]
) -> tuple[Ties, list[int], list[str]]:
    """The ties that are added, the numbers of their wishes, and what could not be carried out."""
    made: list[Ties] = []
    numbers_made: list[int] = []
    notes: list[str] = []
    for k, wish in enumerate(wishes):
        if wish.action is HandAction.VETO:
            continue
        added = HandTie(HandAction.ADD, wish.first, wish.second, wish.sigma_px, row=wish.row)
        outcome = edited([], [added], bodies, {})
        notes += outcome.notes
        made += outcome.ties
        numbers_made += [k] * len(outcome.ties)
    return joined(made, tuple(bodies)), numbers_made, notes


def _veto(wish: HandTie, bodies: dict[str, HandBody]) -> Veto | None:
    if wish.action is HandAction.ADD:
        return None
    body, point = bodies[wish.first.image], wish.first.point
    left = None if point is None else epipolar_point(body.left, body.geometry, point)
    return Veto(body.name, left, bodies[wish.second.image].name, wish.tolerance_px)


def _part(stops: Collection[StopId], mission: OrientedMission) -> Network:
    """The network of two stops, as far as its pairs were matched."""
    geometries, pivots, attitudes = {}, {}, {}
    for pair in mission.pairs.values():
        if pair.stop not in stops:
            continue
        entry = mission.workspace.catalogue.image(pair.pair_id)
        matches = matches_of(entry, mission.workspace) if entry.partner else None
        if matches is not None:
            image = mission.record(entry)
            geometries[pair.pair_id] = geometry_of(matches, mission.workspace)
            pivots[pair.pair_id] = image.mast_in_rover
            attitudes[pair.stop] = image.attitude_measured_by
    known = mission.network
    priors = {
        stop: StopPrior(
            stop, known.telemetry[stop], attitudes.get(stop, "UNKNOWN"), known.sols[stop]
        )
        for stop in stops
    }
    return part_of(known.adjusted, priors, geometries, pivots)


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
        sigma0=number(report.sigma0),
        redundancy=report.redundancy,
        blunders=report.blunders,
        cross_site_ties=sum(n for kind, n in report.ties.items() if str(kind) == "cross-site"),
    )


def _residual(tie: int, row: int, found: Preview) -> TieResidual:
    residuals = found.residuals_px[row]
    known = residuals[np.isfinite(residuals)]
    standardised = np.abs(found.standardised[row])
    worst = float(np.nanmax(standardised)) if np.isfinite(standardised).any() else None
    status = {_STATUS.get(int(k), "unused") for k in found.status[row]}
    return TieResidual(
        tie=tie,
        status="blunder" if "blunder" in status else "used" if status == {"used"} else "unused",
        residual_px=number(float(np.sqrt(np.mean(known**2)))) if len(known) else None,
        first=numbers(residuals[0]),
        second=numbers(residuals[1]),
        largest_standardised=number(worst, 2),
    )
