"""Result of an adjustment: poses, points, control, the report, the marginal of earlier stops."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.adjustment.model.network import ControlFrame, StopControl
from solmap.photogrammetry.adjustment.model.variance_components import VarianceComponents
from solmap.photogrammetry.arrays import Covariances3, Float64, Int32, ObjectPoints, Vector3
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StopId, TieKind, TiePoints

USED, BLUNDER, UNUSED = 0, 1, 2
"""Status of an observation: used; set aside as a blunder; unused because its point was not
placed."""


KINDS = tuple(TieKind)
"""Kinds of tie points, from ties within a pair to ties between stops."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedStop:
    """Adjusted pose of a stop, its covariance, and what determines it."""

    stop: StopId
    lsl_from_rover: Pose
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of rotation vector (radians) and position (metres), both in the LSL, in this
    order."""
    held: bool
    """Held fixed as the datum in its last adjustment."""
    is_tied: bool
    """Whether cross-site ties or control join it, directly or through others, to the datum."""
    held_by: str
    """What holds the stop, as text: the datum, the number of ties with other stops, or
    telemetry."""

    @property
    def sigma_ned_m(self) -> Vector3:
        """Standard deviations of north, east and down, metres."""
        return np.sqrt(np.clip(np.diagonal(self.covariance)[3:], 0.0, None))


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedPair:
    """Pose of a stereo pair after correction of its mast pointing."""

    pair_id: str
    stop: StopId
    lsl_from_pair: Pose
    rover_from_pair: Pose
    pointing: Vector3
    """Rotation vector in the rover frame that rotates the pair from its label's pointing to the
    adjusted one, radians."""
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of the pair's pose: rotation vector (radians), then position of the left camera
    (metres), both in the LSL."""
    pointing_covariance: Float64[np.ndarray, "3 3"]
    ties: int
    """Used observations of points that other pairs see too; none: its pointing is the label's."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedTies:
    """The tie points in object space and the status of their observations."""

    observations: TiePoints
    points: ObjectPoints
    """Points in the LSL, by point number; NaN where not placed."""
    covariances: Covariances3
    kinds: tuple[TieKind, ...]
    """Kinds of tie points by number, counting only observations that were used."""
    status: Int32[np.ndarray, " rows"]
    """Status of each observation: USED, BLUNDER or UNUSED."""
    residuals_px: Float64[np.ndarray, "rows 3"]
    """Observed minus computed sample, line, parallax."""
    standardised: Float64[np.ndarray, "rows 3"]
    """Residual over its own standard deviation; NaN where no other observation checks it."""
    redundancy: Float64[np.ndarray, "rows 3"]
    """Fraction of an error that appears in the residual (redundancy number), 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What a sequential adjustment keeps of the observations of marginalised stops.

    |root z - right|^2 in the coordinates z of `marginal`, about poses and pointings as they were
    when the last stop was marginalised.
    """

    window: tuple[StopId, ...]
    """The stops that are not marginalised yet."""
    stops: tuple[StopId, ...]
    """Stops that occur in the marginal."""
    pair_ids: tuple[str, ...]
    rotations: Float64[np.ndarray, "stops 3 3"]
    centres: Float64[np.ndarray, "stops 3"]
    pointings: Float64[np.ndarray, "pairs 3"]
    root: Float64[np.ndarray, "r n"]
    right: Float64[np.ndarray, " r"]
    spent: float
    surplus: int
    grounded: tuple[bool, ...]
    frames: tuple[str, ...] = ()
    """Control frames that occur in the marginal."""
    frame_places: Float64[np.ndarray, "frames 5"] = field(default_factory=lambda: np.zeros((0, 5)))
    mast: Float64[np.ndarray, " k"] = field(default_factory=lambda: np.zeros(0))
    """Systematic errors of the mast, if they are unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedMast:
    """Systematic errors of the mast: elevation zero, axis tilt about x and y, azimuth zero."""

    values: Float64[np.ndarray, " 4"] = field(default_factory=lambda: np.zeros(4))
    """Radians."""
    covariance: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.zeros((4, 4)))
    """Zero where they were not unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedNetwork:
    """The network after adjustment."""

    stops: tuple[AdjustedStop, ...]
    pairs: tuple[AdjustedPair, ...]
    ties: AdjustedTies
    memory: Memory | None = None
    """Marginal of a sequential adjustment, once stops have been marginalised."""
    control: tuple[AdjustedControl, ...] = ()
    frames: tuple[AdjustedFrame, ...] = ()
    components: VarianceComponents = field(default_factory=VarianceComponents)
    mast: AdjustedMast = field(default_factory=AdjustedMast)

    @property
    def window(self) -> tuple[StopId, ...]:
        """Stops that a sequential adjustment still estimates: all that are not marginalised."""
        return self.memory.window if self.memory else tuple(stop.stop for stop in self.stops)

    def stop(self, stop: StopId) -> AdjustedStop:
        """The adjusted stop of that name."""
        for adjusted in self.stops:
            if adjusted.stop == stop:
                return adjusted
        raise AdjustmentError(f"{stop} is not in the adjusted network of {len(self.stops)} stops")

    def pair(self, pair_id: str) -> AdjustedPair:
        """The adjusted pair of that name."""
        for adjusted in self.pairs:
            if adjusted.pair_id == pair_id:
                return adjusted
        raise AdjustmentError(f"{pair_id} is not in the adjusted network: {len(self.pairs)} pairs")


@dataclass(frozen=True, slots=True)
class Consistency:
    """How well the same points agree when seen from different pairs (paper, section 3.3)."""

    comparisons: int
    mean_2d_px: float
    """Mean absolute difference between measured and back-projected image coordinates."""
    mean_3d_m: float
    """Mean absolute distance between the positions of a point by two pairs."""


class Lack(StrEnum):
    """What images do not determine of a stop."""

    NO_TIES = "no ties"
    BLUNDERS = "only ties that contradict"
    ONE_TIE = "one tie"
    LINE = "ties on a line"
    PARTLY = "ties that leave freedom"
    DETACHED = "detached from the datum"
    SAME_PLACE = "reported at one place"


@dataclass(frozen=True, slots=True)
class Finding:
    """A part of the network that images do not determine and whose pose remains at telemetry."""

    stop: StopId
    lack: Lack
    ties: int
    """Tie points with stops that were placed before it."""
    rank: int
    """Number of the six unknowns of its pose that images determine better than telemetry."""
    text: str


@dataclass(frozen=True, slots=True)
class AdjustmentReport:
    """Figures and findings of an adjustment."""

    name: str
    converged: bool
    iterations: int
    sigma0: float
    """Standard deviation of unit weight; 1 when all stated standard deviations are true."""
    redundancy: int
    stops: int
    pairs: int
    ties: dict[TieKind, int] = field(default_factory=dict)
    """Tie points used, by kind."""
    blunders: int = 0
    """Observations set aside as blunders."""
    control: int = 0
    """Number of positions in control frames that were used."""
    control_refused: tuple[str, ...] = ()
    """Positions set aside, with the reason."""
    before: dict[TieKind, Consistency] = field(default_factory=dict)
    after: dict[TieKind, Consistency] = field(default_factory=dict)
    untied: tuple[StopId, ...] = ()
    """Stops that no cross-site tie joins to the datum; their poses remain at telemetry."""
    message: str = ""
    findings: tuple[Finding, ...] = ()
    """What images do not determine, found before solving."""

    @property
    def is_usable(self) -> bool:
        """Whether it converged, with redundancy and a finite sigma0.

        A network that converged without any redundancy is telemetry unchanged: it is usable only
        with its covariances.
        """
        return self.converged and self.redundancy > 0 and bool(np.isfinite(self.sigma0))

    def __str__(self) -> str:
        if not self.redundancy:
            return (
                f"{self.name}: no tie points; {_counted(self.stops, 'position')} left at telemetry"
            )
        ties = ", ".join(f"{self.ties.get(kind, 0)} {kind.value}" for kind in TieKind)
        state = "converged" if self.converged else "NOT CONVERGED"
        cross, was = self.after.get(TieKind.CROSS_SITE), self.before.get(TieKind.CROSS_SITE)
        change = (
            f", cross-site {was.mean_3d_m:.2g} m / {was.mean_2d_px:.3g} px -> "
            f"{cross.mean_3d_m:.2g} m / {cross.mean_2d_px:.3g} px"
            if cross and was and cross.comparisons
            else ""
        )
        loose = f", {_counted(len(self.untied), 'stop')} left at telemetry" if self.untied else ""
        extra = f" ({self.message})" if self.message else ""
        if self.control or self.control_refused:
            refused = (
                f", REFUSED: {'; '.join(self.control_refused)}" if self.control_refused else ""
            )
            extra = f", control at {_counted(self.control, 'stop')}{refused}{extra}"
        return (
            f"{self.name}: {state} after {self.iterations} iterations, sigma0 {self.sigma0:.3f}, "
            f"redundancy {self.redundancy}, {_counted(self.stops, 'stop')}, "
            f"{_counted(self.pairs, 'pair')}, ties: {ties}, "
            f"{self.blunders} blunders{change}{loose}{extra}"
        )


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedControl:
    """Result of a control observation."""

    control: StopControl
    used: bool
    """Or set aside as a blunder."""
    residual: Float64[np.ndarray, " 4"]
    """Observed minus adjusted east, north, up (m) and azimuth (rad); NaN where not given."""
    test: float
    """Length of the residual in its own standard deviations; NaN where no other observation checks
    it."""
    redundancy: float
    """Mean redundancy number, 0 to 1."""
    note: str = ""
    """Why it was set aside, or that no other observation checks it."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedFrame:
    """Adjusted shift, rotation and scale of a control frame."""

    frame: ControlFrame
    place: Float64[np.ndarray, " 5"]
    """(t_east, t_north, t_up, b, a)."""
    covariance: Float64[np.ndarray, "5 5"]
