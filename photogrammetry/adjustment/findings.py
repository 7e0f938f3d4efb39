"""What a diagnosis found, written where it will be read: at each stop, and in the report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solmap.photogrammetry.adjustment.collinearity import Observations
from solmap.photogrammetry.adjustment.records import (
    AdjustedNetwork,
    AdjustmentReport,
    Finding,
    Lack,
    Network,
    select,
)
from solmap.photogrammetry.adjustment.result import merged_ties

Result = tuple[AdjustedNetwork, AdjustmentReport]

SAID = {Lack.NO_TIES, Lack.DETACHED}
"""What `AdjustedStop.held_by` says in any case."""


def with_findings(result: Result, findings: tuple[Finding, ...]) -> Result:
    """An adjustment whose stops and report say what images did not determine."""
    adjusted, report = result
    told = {finding.stop: finding.text for finding in findings if finding.lack not in SAID}
    stops = tuple(
        replace(stop, held_by=f"{stop.held_by}; {told[stop.stop]}")
        if told.get(stop.stop, stop.held_by) not in stop.held_by
        else stop
        for stop in adjusted.stops
    )
    return replace(adjusted, stops=stops), replace(report, findings=findings)


def without_unchecked(network: Network, observations: Observations, rows: np.ndarray) -> Network:
    """The network without some ties: what their stops saw of their points."""
    lost = np.zeros(len(observations), dtype=bool)
    for row in rows.tolist():
        same = observations.point == observations.point[row]
        lost |= same & (observations.stop == observations.stop[row])
    return replace(network, ties=select(network.ties, ~lost))


def completed(result: Result, network: Network, findings: tuple[Finding, ...]) -> Result:
    """An adjustment of a part of the ties, with the others as unused and what was found of them."""
    adjusted, report = result
    whole = replace(adjusted, ties=merged_ties(network.ties, (adjusted.ties,)))
    return with_findings((whole, report), findings)
