"""Which stops are worth linking: near enough to have seen the same ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId


@dataclass(frozen=True, slots=True)
class LinkParams:
    """Which stops are tried for links."""

    max_distance_m: float = 50.0
    """Farther apart, Navcam stereo sees no common ground well enough."""
    max_earlier: int = 4
    """Nearest earlier stops tried for each new one: m-1, m-2 and revisits decide the drift."""


def link_candidates(
    lsl_from_rover: Pose, earlier: Mapping[StopId, Pose], params: LinkParams
) -> list[StopId]:
    """The earlier stops that one at `lsl_from_rover` may share ground with, nearest first."""
    here = lsl_from_rover.translation_m[:2]
    distances = sorted(
        (float(np.linalg.norm(pose.translation_m[:2] - here)), stop)
        for stop, pose in earlier.items()
    )
    near = [stop for distance_m, stop in distances if distance_m <= params.max_distance_m]
    return near[: params.max_earlier]
