"""The adjustments of a mission, and differences between traverses.

All networks stay in the store: after each sol, after manual ties, after overall adjustments. Two of
them, or one and telemetry, are compared stop by stop, as the paper does in its section 3.3: both
traverses start at the same place, and differences accumulate along the way.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from pydantic import BaseModel

from solmap.gis_server.analysis.bodies import UNITS, UnanswerableError, json_number
from solmap.photogrammetry.adjustment.model.adjusted_network import AdjustedStop
from solmap.photogrammetry.adjustment.quality.network_quality import error_ellipse
from solmap.photogrammetry.traverse.differences import Differences, common_stops, differences
from solmap.photogrammetry.traverse.records import Traverse
from solmap.products.catalogue.catalogue import Catalogue, latest_network, published_networks
from solmap.products.errors import ProductNotFoundError
from solmap.products.formats.documents.network import (
    NetworkProduct,
    cached_whole_network,
    traverses,
)
from solmap.products.model import ProductKind, ProductRef
from solmap.products.store.product_store import ProductStore

LATEST = "latest"
TELEMETRY = "telemetry"
OVERALL = "-overall"
_DIGITS = 4

Place = tuple[float, float, float | None]
"""(east, north, up)."""


class Solution(BaseModel):
    """One adjustment of the network."""

    id: str
    """Scope and digest, for other requests."""
    scope: str
    digest: str
    sol: int
    is_overall: bool
    """All stops were adjusted again, not only those of the sol."""
    is_latest: bool
    """The map shows this one."""
    made_at: str


class TraverseRow(BaseModel):
    """A stop by two solutions."""

    stop: str
    label: str
    sol: int
    distance_m: float
    """Distance travelled up to here in plan, along the compared solution."""
    place: Place
    reference: Place
    """Position of the stop in the other solution."""
    offset_m: Place
    """Reference position minus this position, both traverses starting at the same stop."""
    horizontal_m: float
    """Accumulated difference in plan."""
    sigma_horizontal_m: float
    """Standard deviation of the difference in its direction; telemetry has none and is treated as
    exact."""
    percent: float | None
    """Difference as a percentage of the distance; null at the start."""
    leg_m: float | None
    """Difference of the last leg alone."""
    sigma_north_m: float
    sigma_east_m: float
    sigma_up_m: float | None
    reference_sigma_up_m: float | None
    """Standard deviation of the reference's height; null for telemetry."""
    ellipse_semi_major_m: float
    ellipse_semi_minor_m: float
    ellipse_azimuth_deg: float
    held: bool
    held_by: str


class TraverseAnswer(BaseModel):
    """Differences of a solution from a reference, in the order of the traverse."""

    units: str = UNITS
    solution: str
    reference: str
    """`telemetry`, or another solution."""
    rows: list[TraverseRow]
    end: int
    """Number of the last row."""
    worst: int
    """Number of the row with the greatest percentage, without the first 20 m."""
    farthest: int
    """Number of the row with the largest difference in metres."""
    by_sol: list[int]
    """Numbers of the last stop of every sol."""


def solutions(mission: str, catalogue: Catalogue, store: ProductStore) -> list[Solution]:
    """All adjustments of a mission that the store holds: newest sol first, of a sol the newest."""
    latest = latest_network(mission, catalogue)
    found = [
        _solution(ref, store, is_latest=ref == latest)
        for published in published_networks(mission, catalogue)
        for ref in store.versions(ProductKind.NETWORK, published.scope)
    ]
    return sorted(found, key=lambda one: (one.scope, one.made_at, one.is_latest), reverse=True)


def _solution(ref: ProductRef, store: ProductStore, *, is_latest: bool) -> Solution:
    name = ref.scope.name
    return Solution(
        id=f"{name}/{ref.digest}",
        scope=name,
        digest=ref.digest,
        sol=int(name.removesuffix(OVERALL).rpartition("-sol")[2]),
        is_overall=name.endswith(OVERALL),
        is_latest=is_latest,
        made_at=_made_at(ref, store),
    )


@lru_cache(maxsize=4096)
def _made_at(ref: ProductRef, store: ProductStore) -> str:
    return store.made_at(ref)


def network_named(
    mission: str, requested: str, catalogue: Catalogue, store: ProductStore
) -> tuple[ProductRef, NetworkProduct]:
    """The requested network: `latest`, or scope and digest.

    Raises:
        ProductNotFoundError: there is none of that name.
    """
    if requested == LATEST:
        ref = latest_network(mission, catalogue)
        return ref, cached_whole_network(ref, store)
    scope, _, digest = requested.partition("/")
    for ref in published_networks(mission, catalogue):
        same = ProductRef(ref.kind, ref.scope, digest)
        if ref.scope.name == scope and same in store.versions(ref.kind, ref.scope):
            return same, cached_whole_network(same, store)
    raise ProductNotFoundError(
        f"no adjustment {requested!r} of {mission} is in the store; /solutions lists them, "
        f"{LATEST!r} is the one on the map"
    )


def compare_traverses(
    named: tuple[ProductRef, NetworkProduct],
    reference: tuple[ProductRef, NetworkProduct] | None,
) -> TraverseAnswer:
    """A solution against another one, or against telemetry.

    Raises:
        UnanswerableError: they have fewer than two stops in common.
    """
    telemetry, adjusted = traverses(named[1])
    other = telemetry if reference is None else traverses(reference[1])[1]
    common, adjusted = common_stops(other, adjusted)
    if len(common) < 2:  # noqa: PLR2004 - a leg has two ends
        raise UnanswerableError(
            f"{_name(named)} and {_name(reference)} have {len(common)} stops in common; "
            "a traverse is compared from two on"
        )
    found = differences(common, adjusted)
    summary, by_sol = found.summary(), {row.stop for row in found.by_sol()}
    others = _stops(reference[1]) if reference else {}
    return TraverseAnswer(
        solution=_name(named),
        reference=_name(reference),
        rows=_rows(named[1], found, adjusted, common, others),
        end=len(common) - 1,
        worst=found.stops.index(summary.worst.stop),
        farthest=found.stops.index(summary.farthest.stop),
        by_sol=[k for k, stop in enumerate(found.stops) if stop in by_sol],
    )


def _name(named: tuple[ProductRef, NetworkProduct] | None) -> str:
    return TELEMETRY if named is None else f"{named[0].scope.name}/{named[0].digest}"


def _label(stop: AdjustedStop) -> str:
    return f"{stop.stop.site}/{stop.stop.drive}"


def _stops(network: NetworkProduct) -> dict[str, AdjustedStop]:
    return {_label(stop): stop for stop in network.adjusted.stops}


def _sigma_along(offset_m: np.ndarray, stops: Iterable[AdjustedStop | None]) -> float:
    """Standard deviation of the difference of two stops in the direction of an offset.

    The offset is (east, north, up); if it is zero, the worst direction is used.
    """
    known = [stop.covariance[3:5, 3:5] for stop in stops if stop]
    covariance: np.ndarray = np.sum(known, axis=0)
    length = float(np.hypot(*offset_m[:2]))
    if length > 0.0:
        along = offset_m[[1, 0]] / length
        return float(np.sqrt(max(along @ covariance @ along, 0.0)))
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def _rows(
    network: NetworkProduct,
    found: Differences,
    adjusted: Traverse,
    reference: Traverse,
    others: dict[str, AdjustedStop],
) -> list[TraverseRow]:
    stops = _stops(network)
    legs = [None, *found.leg_m.tolist()]
    rows = []
    for k, label in enumerate(found.stops):
        stop = stops[label]
        (major, minor), azimuth = error_ellipse(stop)
        north, east, up = stop.sigma_ned_m.tolist()
        other = others.get(label)
        rows.append(
            TraverseRow(
                stop=str(stop.stop),
                label=label,
                sol=int(found.sols[k]),
                distance_m=round(float(found.distance_m[k]), _DIGITS),
                place=_place(adjusted.places_m[k]),
                reference=_place(reference.places_m[k]),
                offset_m=_place(found.offset_m[k]),
                horizontal_m=round(float(found.horizontal_m[k]), _DIGITS),
                sigma_horizontal_m=round(_sigma_along(found.offset_m[k], (stop, other)), _DIGITS),
                percent=json_number(float(found.percent[k]), 3),
                leg_m=json_number(legs[k], _DIGITS),
                sigma_north_m=round(north, _DIGITS),
                sigma_east_m=round(east, _DIGITS),
                sigma_up_m=round(up, _DIGITS),
                reference_sigma_up_m=json_number(
                    float(other.sigma_ned_m[2]) if other else None, _DIGITS
                ),
                ellipse_semi_major_m=round(major, _DIGITS),
                ellipse_semi_minor_m=round(minor, _DIGITS),
                ellipse_azimuth_deg=round(azimuth, 1),
                held=stop.held,
                held_by=stop.held_by,
            )
        )
    return rows


def _place(enu: np.ndarray) -> Place:
    east, north, up = (json_number(float(value) + 0.0, _DIGITS) for value in enu)
    return east or 0.0, north or 0.0, up
