"""How well control agrees with the adjusted network, for the quality report."""

from __future__ import annotations

import numpy as np

from solmap.photogrammetry.adjustment.datum import MAP
from solmap.photogrammetry.adjustment.quality_records import ControlQuality, FrameQuality, Triple
from solmap.photogrammetry.adjustment.records import AdjustedNetwork


def control_quality(network: AdjustedNetwork) -> tuple[ControlQuality, ...]:
    """Every place of a stop in a control frame, the most doubtful first."""
    found = [
        ControlQuality(
            one.control.stop,
            one.control.frame,
            one.used,
            (float(one.residual[0]), float(one.residual[1])),
            one.test if np.isfinite(one.test) else None,
            one.redundancy,
            one.note,
        )
        for one in network.control
        if one.control.frame != MAP.name
    ]
    return tuple(sorted(found, key=lambda one: -(one.test or 0.0)))


def frame_quality(network: AdjustedNetwork) -> tuple[FrameQuality, ...]:
    """Where every control frame lies."""
    found = []
    for adjusted in network.frames:
        if adjusted.frame.is_certain:
            continue
        place, sigma = adjusted.place, np.sqrt(np.clip(np.diagonal(adjusted.covariance), 0, None))
        found.append(
            FrameQuality(
                adjusted.frame.name,
                _triple(place),
                _triple(sigma),
                float(np.degrees(place[3])),
                float(np.degrees(sigma[3])),
                float(place[4]),
                float(sigma[4]),
            )
        )
    return tuple(found)


def _triple(values: np.ndarray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])
