"""Which part of the network an adjustment estimates (Di et al. 2008, section 3.2)."""

from __future__ import annotations

from enum import StrEnum


class AdjustmentMode(StrEnum):
    """How the stops of a mission are adjusted as its sols come in."""

    STEPWISE = "stepwise"
    """Earlier stops are held, new ones estimated: the paper's mode during the mission."""
    OVERALL = "overall"
    """After the last sol of a downlink all stops and all ties in one adjustment."""
