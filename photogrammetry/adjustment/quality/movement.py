"""How far the ground moves on the map when a pair's orientation is corrected.

The pose of a pair was (R, c) and is now (R', c'). A point of its frame at the vector X from its
left camera moves by (R' - R) X + c' - c. Over all X up to the length r this is at most

    s = 2 r sin(a/2) + |c' - c|          a, angle of R' R^T

for any field of view, so s bounds the movement of all ground nearer than r.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.ranges import MetresOrZero


@dataclass(frozen=True, slots=True)
class ReissueParams:
    """When to map a stop again after its pairs were adjusted again."""

    range_m: MetresOrZero = 10.0
    """Range to which a map must be accurate: where a Navcam's stereo is good to a decimetre, and a
    pair of a full panorama still overlaps its neighbours."""
    shift_m: MetresOrZero = 0.02
    """Movement of ground at that range that justifies a new map: half a cell of the terrain model
    and two of the orthophoto, at 10 m two and a half Navcam pixels."""

    def __post_init__(self) -> None:
        for name in ("range_m", "shift_m"):
            if not getattr(self, name) >= 0:
                raise AdjustmentError(f"{name} must not be negative, but is {getattr(self, name)}")


def ground_shift_m(before: Pose, after: Pose, range_m: float) -> float:
    """Largest movement of ground within `range_m` of a pair between two of its poses.

    Raises:
        AdjustmentError: the poses are not of the same pair.
    """
    if (before.source, before.target) != (after.source, after.target):
        raise AdjustmentError(
            f"{before.target}_from_{before.source} and {after.target}_from_{after.source} are not "
            "two poses of one pair"
        )
    chord = np.linalg.norm(after.rotation - before.rotation) / np.sqrt(2)  # 2 sin(a/2), both > 0
    return float(range_m * chord + np.linalg.norm(after.translation_m - before.translation_m))
