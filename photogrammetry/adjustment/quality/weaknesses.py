"""The weak parts of an adjusted network, as text.

A network that converged may still have weak parts: a stop at telemetry, a link of a few points, a
pair at its label's pointing, observations that nothing checks. Each is named with its figures, so
that a person can see where a manual tie point would help.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    BLUNDER,
    USED,
    AdjustedNetwork,
)
from solmap.photogrammetry.adjustment.model.network import MAP
from solmap.photogrammetry.adjustment.model.variance_components import COMPONENTS, TIES
from solmap.photogrammetry.adjustment.quality.records import (
    CameraResiduals,
    QualityParams,
    Weakness,
)
from solmap.photogrammetry.imagery import StopId

Links = dict[tuple[StopId, StopId], int]


def weaknesses(
    network: AdjustedNetwork,
    links: Links,
    cameras: tuple[CameraResiduals, ...],
    params: QualityParams,
) -> tuple[Weakness, ...]:
    """All weak parts, the worst first."""
    return (
        *_doubtful_control(network),
        *_stops_on_telemetry(network),
        *_thin_links(links, params),
        *_unchecked_stops(network, params),
        *_doubtful_pairs(network, params),
        *_pairs_on_their_label(network),
        *_misfits(cameras, params),
        *_wide_ties(network, params),
    )


def shared_ties(network: AdjustedNetwork) -> Links:
    """Number of tie points that two stops share in used observations, the earlier stop first."""
    ties, seen = network.ties, network.ties.observations
    order = [stop.stop for stop in network.stops]
    numbers = {stop: k for k, stop in enumerate(order)}
    stop_of = {pair.pair_id: numbers[pair.stop] for pair in network.pairs}
    stops = np.array([stop_of.get(name, -1) for name in seen.pair_ids], dtype=np.int64)
    rows = np.flatnonzero(ties.status == USED)
    met = np.unique(np.column_stack([seen.point[rows], stops[seen.pair[rows]]]), axis=0)
    met = met[met[:, 1] >= 0] if len(met) else met
    counts: Links = {}
    for lag in range(1, len(met)):
        same = met[lag:, 0] == met[:-lag, 0]
        if not same.any():
            break
        couples = np.column_stack([met[:-lag, 1], met[lag:, 1]])[same]
        for (a, b), n in zip(*np.unique(couples, axis=0, return_counts=True), strict=True):
            link = (order[a], order[b])
            counts[link] = counts.get(link, 0) + int(n)
    return dict(sorted(counts.items(), key=lambda link: [numbers[stop] for stop in link[0]]))


def _doubtful_control(network: AdjustedNetwork) -> Iterator[Weakness]:
    for one in network.control:
        where = f"{one.control.stop} in {one.control.frame}"
        if not one.used:
            yield Weakness(where, f"its position was set aside: {one.note}")
        elif one.note and one.control.frame != MAP.name:
            yield Weakness(where, f"its position is used, but {one.note}")


def _stops_on_telemetry(network: AdjustedNetwork) -> Iterator[Weakness]:
    for stop in network.stops:
        if not stop.is_tied and not stop.held:
            yield Weakness(str(stop.stop), f"left at telemetry: {stop.held_by}")


def _thin_links(links: Links, params: QualityParams) -> Iterator[Weakness]:
    for (one, other), count in links.items():
        if count < params.few_ties:
            why = f"rests on {count} tie points, fewer than {params.few_ties}"
            yield Weakness(f"link {one} - {other}", why)


def _unchecked_stops(network: AdjustedNetwork, params: QualityParams) -> Iterator[Weakness]:
    ties = network.ties
    numbers = {stop.stop: k for k, stop in enumerate(network.stops)}
    of_pair = {pair.pair_id: numbers.get(pair.stop, -1) for pair in network.pairs}
    stops = np.array([of_pair.get(name, -1) for name in ties.observations.pair_ids], dtype=np.int64)
    rows = np.flatnonzero((ties.status == USED) & (ties.redundancy > 0).any(axis=1))
    rows = rows[stops[ties.observations.pair[rows]] >= 0]
    stop = stops[ties.observations.pair[rows]]
    counts = np.bincount(stop, minlength=len(numbers))
    sums = np.bincount(stop, ties.redundancy[rows].mean(axis=1), minlength=len(numbers))
    means = sums / np.maximum(counts, 1)
    for k in np.flatnonzero((counts > 0) & (means < params.thin_redundancy)).tolist():
        why = f"its {counts[k]} tied observations have a mean redundancy of {means[k]:.2f}"
        yield Weakness(str(network.stops[k].stop), f"{why}: blunders may remain undetected")


def _doubtful_pairs(network: AdjustedNetwork, params: QualityParams) -> Iterator[Weakness]:
    ties = network.ties
    names = ties.observations.pair_ids
    used = np.bincount(ties.observations.pair[ties.status == USED], minlength=len(names))
    wrong = np.bincount(ties.observations.pair[ties.status == BLUNDER], minlength=len(names))
    share = wrong / np.maximum(used + wrong, 1)
    for k in np.flatnonzero(share > params.many_blunders).tolist():
        why = f"{wrong[k]} of its {used[k] + wrong[k]} observations were set aside"
        yield Weakness(f"pair {names[k]}", why)


def _pairs_on_their_label(network: AdjustedNetwork) -> Iterator[Weakness]:
    for pair in network.pairs:
        if not pair.ties:
            why = f"no tie joins it to another pair of {pair.stop}: it has its label's pointing"
            yield Weakness(f"pair {pair.pair_id}", why)


def _misfits(cameras: tuple[CameraResiduals, ...], params: QualityParams) -> Iterator[Weakness]:
    for camera in cameras:
        for kind, figures in camera.figures.items():
            if figures.rms_standardised > params.large_misfit:
                why = (
                    f"residuals of its {kind} ties are {figures.rms_standardised:.2f} times those "
                    "of all: see their map"
                )
                yield Weakness(f"camera {camera.instrument}", why)


def _wide_ties(network: AdjustedNetwork, params: QualityParams) -> Iterator[Weakness]:
    for component, sigma in network.components.sigmas.items():
        if COMPONENTS.index(component) >= TIES and sigma > params.large_misfit:
            why = (
                f"they scatter {sigma:.2f} times as much as matching states: see residuals by "
                "camera"
            )
            yield Weakness(str(component), why)
