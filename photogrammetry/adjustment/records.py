"""What enters an adjustment, and what comes out of it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.adjustment.control import (
    AdjustedControl,
    AdjustedFrame,
    ControlFrame,
    StopControl,
)
from solmap.photogrammetry.arrays import Covariances3, Float64, Int32, ObjectPoints, Vector3
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId, TieKind, TiePoints

USED, BLUNDER, UNUSED = 0, 1, 2
"""Status of an observation: in the adjustment; found wrong; without use for it (not placed)."""


@dataclass(frozen=True, slots=True, eq=False)
class StopPrior:
    """Where telemetry says the rover stood.

    What telemetry knows is the step from the stop before, the tilt, and, where the label says that
    the attitude was measured (FINE), the azimuth; see `priors`.
    """

    stop: StopId
    lsl_from_rover: Pose
    attitude_measured_by: str = "UNKNOWN"
    sols: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.lsl_from_rover.target != LSL or self.lsl_from_rover.source != self.stop.frame:
            raise AdjustmentError(
                f"the telemetry of {self.stop} must be the pose of {self.stop.frame} in {LSL}, not "
                f"{self.lsl_from_rover.target}_from_{self.lsl_from_rover.source}"
            )

    @property
    def is_fine(self) -> bool:
        """Whether the azimuth was measured rather than propagated."""
        return self.attitude_measured_by.upper() == "FINE"


@dataclass(frozen=True, slots=True, eq=False)
class PairGeometry:
    """A stereo pair as a rigid body, and the stop it was taken at."""

    pair_id: str
    stop: StopId
    geometry: EpipolarPair
    mast_in_rover: tuple[float, float, float] | None = None
    """The mast head, about which pointing errors turn the pair; None: about its own origin."""

    def __post_init__(self) -> None:
        if self.geometry.rover_from_pair.target != self.stop.frame:
            raise AdjustmentError(
                f"pair {self.pair_id} was taken at {self.stop.frame}, but its geometry is given in "
                f"{self.geometry.rover_from_pair.target}"
            )

    @property
    def pivot_in_rover(self) -> Vector3:
        """What pointing errors turn the pair about, in the rover frame, metres."""
        if self.mast_in_rover is None:
            return self.geometry.rover_from_pair.translation_m
        return np.array(self.mast_in_rover)


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The image network: stops in the order of the traverse, their pairs, and the tie points."""

    stops: tuple[StopPrior, ...]
    pairs: tuple[PairGeometry, ...]
    ties: TiePoints
    frames: tuple[ControlFrame, ...] = ()
    """Maps that stops were found in; `datum.with_control` adds them and what they say."""
    control: tuple[StopControl, ...] = ()

    def __post_init__(self) -> None:
        stops = {prior.stop for prior in self.stops}
        pairs = {pair.pair_id for pair in self.pairs}
        for what, names in (
            ("stop", [str(prior.stop) for prior in self.stops]),
            ("pair", [pair.pair_id for pair in self.pairs]),
        ):
            twice = sorted(name for name, count in Counter(names).items() if count > 1)
            if twice:
                raise AdjustmentError(f"{what} {', '.join(twice)} is in the network more than once")
        for pair in self.pairs:
            if pair.stop not in stops:
                raise AdjustmentError(
                    f"pair {pair.pair_id} was taken at {pair.stop}, which is not in the network; "
                    "give its telemetry or leave the pair out"
                )
        lost = sorted(set(self.ties.pair_ids) - pairs)
        if lost:
            raise AdjustmentError(
                f"tie points were measured in {len(lost)} pairs that are not in the network: "
                f"{', '.join(lost[:3])}; use `Network.within` to cut a network out of a larger one"
            )
        frames = {frame.name for frame in self.frames}
        for one in self.control:
            if one.stop not in stops or one.frame not in frames:
                raise AdjustmentError(
                    f"control of {one.stop} in {one.frame}: the network of {len(stops)} stops and "
                    f"{len(frames)} control frames lacks one of them; use `datum.with_control`"
                )

    @property
    def stop_ids(self) -> tuple[StopId, ...]:
        """The stops, in the order of the traverse."""
        return tuple(prior.stop for prior in self.stops)

    @property
    def datum_is_observed(self) -> bool:
        """Whether the place of a stop is observed in a frame whose own place is certain."""
        certain = {frame.name for frame in self.frames if frame.is_certain}
        return any(one.frame in certain for one in self.control)

    def within(
        self, stops: frozenset[StopId] | set[StopId], ties: TiePoints | None = None
    ) -> Network:
        """The part of the network at some stops: their pairs, what those saw, their control.

        Of what they saw, `ties` alone if these are given.
        """
        pairs = tuple(pair for pair in self.pairs if pair.stop in stops)
        if ties is None:
            kept = {pair.pair_id for pair in pairs}
            inside = np.array([name in kept for name in self.ties.pair_ids], dtype=bool)
            rows = inside[self.ties.pair] if len(self.ties) else np.zeros(0, dtype=bool)
            ties = select(self.ties, rows)
        return Network(
            tuple(prior for prior in self.stops if prior.stop in stops),
            pairs,
            ties,
            self.frames,
            tuple(one for one in self.control if one.stop in stops),
        )


def select(ties: TiePoints, rows: np.ndarray) -> TiePoints:
    """Some observations of the ties; points keep their numbers, unused pairs are dropped."""
    used = np.flatnonzero(np.bincount(ties.pair[rows], minlength=len(ties.pair_ids)))
    renumber = np.zeros(len(ties.pair_ids), dtype=np.int32)
    renumber[used] = np.arange(len(used), dtype=np.int32)
    return TiePoints(
        tuple(ties.pair_ids[k] for k in used),
        ties.point[rows],
        renumber[ties.pair[rows]],
        ties.left[rows],
        ties.parallax_px[rows],
        ties.sigma_px[rows],
        ties.sigma_parallax_px[rows],
        ties.sigma_line_px[rows],
    )


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedStop:
    """Where a stop is, how sure that is, and what holds it there."""

    stop: StopId
    lsl_from_rover: Pose
    covariance: Float64[np.ndarray, "6 6"]
    """Of rotation vector (radians) and position (metres), both in the LSL, one after the other."""
    held: bool
    """Held fixed as the datum of the adjustment that it was last in."""
    is_tied: bool
    """Whether cross-site ties or control join it, directly or through others, to the datum."""
    held_by: str
    """In words: the datum, how many ties with which stops, or the telemetry increment."""

    @property
    def sigma_ned_m(self) -> Vector3:
        """Standard deviations of north, east and down, metres."""
        return np.sqrt(np.clip(np.diagonal(self.covariance)[3:], 0.0, None))


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedPair:
    """Where a stereo pair looks from, after its mast pointing was corrected."""

    pair_id: str
    stop: StopId
    lsl_from_pair: Pose
    rover_from_pair: Pose
    pointing: Vector3
    """Rotation vector in the rover frame that turns the label's pair into the true one, radians."""
    covariance: Float64[np.ndarray, "6 6"]
    """Of the pair's pose: rotation vector (radians), then position of the left camera (metres),
    both in the LSL."""
    pointing_covariance: Float64[np.ndarray, "3 3"]
    ties: int
    """Observations used that join it to another pair; none: its pointing is the label's."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedTies:
    """The tie points in object space and what became of their observations."""

    observations: TiePoints
    points: ObjectPoints
    """In the LSL, by point number; NaN where not placed."""
    covariances: Covariances3
    kinds: tuple[TieKind, ...]
    """By point number, counting only observations that were used."""
    status: Int32[np.ndarray, " rows"]
    """Per observation: USED, BLUNDER or UNUSED."""
    residuals_px: Float64[np.ndarray, "rows 3"]
    """Observed minus computed sample, line, parallax."""
    standardised: Float64[np.ndarray, "rows 3"]
    """Residual over its own standard deviation; NaN where nothing checks it."""
    redundancy: Float64[np.ndarray, "rows 3"]
    """Share of an error that shows in the residual, 0 to 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What a sequential adjustment keeps of the observations that it no longer looks at.

    |root z - right|^2 in the coordinates z of `marginal`, about poses and pointings as they were
    when the last stop left.
    """

    window: tuple[StopId, ...]
    """The stops that have not left yet."""
    stops: tuple[StopId, ...]
    """Those of them that are spoken of."""
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
    """Control frames that are spoken of."""
    frame_places: Float64[np.ndarray, "frames 5"] = field(default_factory=lambda: np.zeros((0, 5)))


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedNetwork:
    """The network after adjustment."""

    stops: tuple[AdjustedStop, ...]
    pairs: tuple[AdjustedPair, ...]
    ties: AdjustedTies
    memory: Memory | None = None
    """Of a sequential adjustment, once stops have left its window."""
    control: tuple[AdjustedControl, ...] = ()
    frames: tuple[AdjustedFrame, ...] = ()

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
    """Mean absolute difference between the places that two pairs give the same point."""


class Lack(StrEnum):
    """What images do not tell of a stop."""

    NO_TIES = "no ties"
    BLUNDERS = "only ties that contradict"
    ONE_TIE = "one tie"
    LINE = "ties on a line"
    PARTLY = "ties that leave freedom"
    DETACHED = "detached from the datum"
    SAME_PLACE = "reported at one place"


@dataclass(frozen=True, slots=True)
class Finding:
    """A part of the network that images do not determine, so that telemetry holds it."""

    stop: StopId
    lack: Lack
    ties: int
    """Tie points with stops that were placed before it."""
    rank: int
    """Of the six unknowns of its pose, how many images know better than telemetry."""
    text: str


@dataclass(frozen=True, slots=True)
class AdjustmentReport:
    """What an adjustment found, good or bad."""

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
    """Observations found wrong and set aside."""
    control: int = 0
    """Places of stops in control frames that were used."""
    control_refused: tuple[str, ...] = ()
    """Those set aside, with the reason."""
    before: dict[TieKind, Consistency] = field(default_factory=dict)
    after: dict[TieKind, Consistency] = field(default_factory=dict)
    untied: tuple[StopId, ...] = ()
    """Stops that no cross-site tie joins to the datum: telemetry alone holds them."""
    message: str = ""
    findings: tuple[Finding, ...] = ()
    """What images do not determine, found before anything was solved."""

    @property
    def is_usable(self) -> bool:
        """Whether it converged, with redundancy to judge it by and a sigma0 that is a number.

        A network without any redundancy that converged is telemetry unchanged: usable as such only
        by its covariances, and said so here.
        """
        return self.converged and self.redundancy > 0 and bool(np.isfinite(self.sigma0))

    def __str__(self) -> str:
        if not self.redundancy:
            return f"{self.name}: nothing to adjust by, {self.stops} stops stand by telemetry"
        ties = ", ".join(f"{self.ties.get(kind, 0)} {kind.value}" for kind in TieKind)
        state = "converged" if self.converged else "NOT CONVERGED"
        cross, was = self.after.get(TieKind.CROSS_SITE), self.before.get(TieKind.CROSS_SITE)
        change = (
            f", cross-site {was.mean_3d_m:.2g} m / {was.mean_2d_px:.3g} px -> "
            f"{cross.mean_3d_m:.2g} m / {cross.mean_2d_px:.3g} px"
            if cross and was and cross.comparisons
            else ""
        )
        loose = f", {len(self.untied)} stops held by telemetry alone" if self.untied else ""
        extra = f" ({self.message})" if self.message else ""
        if self.control or self.control_refused:
            refused = (
                f", REFUSED: {'; '.join(self.control_refused)}" if self.control_refused else ""
            )
            extra = f", control at {self.control} stops{refused}{extra}"
        return (
            f"{self.name}: {state} after {self.iterations} iterations, sigma0 {self.sigma0:.3f}, "
            f"redundancy {self.redundancy}, {self.stops} stops, {self.pairs} pairs, ties: {ties}, "
            f"{self.blunders} blunders{change}{loose}{extra}"
        )
