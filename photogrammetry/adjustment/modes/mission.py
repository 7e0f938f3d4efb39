"""Adjust the network of a mission as new images arrive (Di et al. 2008, section 3.2)."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import (
    AdjustedNetwork,
    AdjustmentReport,
)
from solmap.photogrammetry.adjustment.model.assembly import merge_networks
from solmap.photogrammetry.adjustment.model.network import Network, select
from solmap.photogrammetry.adjustment.model.params import AdjustmentMode, AdjustmentParams
from solmap.photogrammetry.adjustment.modes.overall import adjust
from solmap.photogrammetry.adjustment.modes.sequential import adjust_sequential, begin
from solmap.photogrammetry.adjustment.modes.stepwise import add_stop_covariance, adjust_stepwise
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId


def advance(
    mode: AdjustmentMode,
    start: AdjustedNetwork | None,
    network: Network,
    new_stops: Collection[StopId],
    params: AdjustmentParams,
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """The network with its new part adjusted; `start` is the previous adjustment.

    A step that does not converge is reported, and its stops remain at telemetry.

    Raises:
        AdjustmentError: an overall adjustment did not converge; keep `start`.
    """
    if mode is AdjustmentMode.OVERALL:
        return _overall(network, params, start)
    if start is not None and not new_stops:
        return _adjust_pointing(start, network, params)
    step = adjust_sequential if mode is AdjustmentMode.SEQUENTIAL else adjust_stepwise
    adjusted, report = step(start, network, new_stops, params)
    if report.converged:
        return adjusted, report
    untied = replace(network, ties=select(network.ties, np.zeros(0, np.int64)))
    stands, _ = step(start, untied, new_stops, params)
    return stands, replace(report, message="its stops remain at telemetry")


def _overall(
    network: Network, params: AdjustmentParams, start: AdjustedNetwork | None
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """Adjust all stops, then marginalise the oldest, so that later steps continue exactly."""
    adjusted, report = begin(network, params, start)
    if not report.converged:
        raise AdjustmentError(f"{report}; the previous network is kept")
    return adjusted, report


def _adjust_pointing(
    start: AdjustedNetwork, network: Network, params: AdjustmentParams
) -> tuple[AdjustedNetwork, AdjustmentReport]:
    """New images of known stops: only mast pointing is estimated, poses and covariances stay.

    The marginal of a sequential adjustment stays too: it contains the old images only.
    """
    known = {stop.stop: stop for stop in start.stops}
    part = network.within(set(known))
    held = set(part.stop_ids)
    as_known = replace(params, sigma_freedoms=math.inf)
    adjusted, report = adjust(part, held, as_known, start, "pointing at known stops")
    kept = replace(
        adjusted,
        stops=tuple(known[stop.stop] for stop in adjusted.stops),
        pairs=tuple(
            add_stop_covariance(pair, known[pair.stop].lsl_from_rover, known[pair.stop].covariance)
            for pair in adjusted.pairs
        ),
        memory=start.memory,
        control=start.control,
        frames=start.frames,
        components=start.components,
        mast=start.mast,
    )
    return merge_networks(start, kept, network), report
