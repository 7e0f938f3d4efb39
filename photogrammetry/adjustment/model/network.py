"""Input of an adjustment: stops, stereo pairs, tie points, and control.

Telemetry gives the poses of stops (`StopPrior`), calibration the geometry of a pair
(`PairGeometry`). Control gives positions of stops in maps of other origin, usually orbital images.
Such an image is rigid and sharp, but as a whole it may be shifted by metres and turned by tenths of
a degree. Its observations are therefore positions of stops *in the image*; the image's own position
on the map, a shift, a rotation and a change of scale, is an unknown of the network with its own
standard deviation (`ControlFrame`). A frame without uncertainty is the map itself: see `datum`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import StopId, TiePoints

FRAME_UNKNOWNS = 5
"""Number of unknowns of a control frame: shift east, north and up (metres), rotation (radians) and
change of scale."""
SYMMETRIC = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ControlFrame:
    """A map in which stops are located, and the prior of its own position.

    A point of the frame at u lies on the map (east, north) at c + (I + [[a, -b], [b, a]]) (u - c) +
    t, with the centre c, the shift t, the rotation b (counter-clockwise) and the change of scale a.
    """

    name: str
    centre_m: tuple[float, float]
    """Centre of its rotation, (east, north): where its own error is smallest."""
    place: Float64[np.ndarray, " 5"]
    """Most likely (t_east, t_north, t_up, b, a)."""
    covariance: Float64[np.ndarray, "5 5"]
    """Covariance of the position; a component without variance is fixed, not an unknown."""

    @classmethod
    def from_sigmas(
        cls,
        name: str,
        centre_m: tuple[float, float],
        *,
        shift_m: float = 50.0,
        rotation_deg: float = 0.5,
        scale: float = 1e-3,
    ) -> ControlFrame:
        """A frame at its nominal position, within standard deviations; zero: exactly.

        The defaults are those of an image that was registered to older maps by hand.
        """
        sigma = np.array([shift_m, shift_m, shift_m, np.radians(rotation_deg), scale])
        return cls(name, centre_m, np.zeros(FRAME_UNKNOWNS), np.diag(sigma**2))

    def __post_init__(self) -> None:
        sigma2 = np.diagonal(self.covariance)
        if not (np.isfinite(self.covariance).all() and (sigma2 >= 0).all()):
            raise AdjustmentError(
                f"the place of control frame {self.name} must have a finite covariance: give large "
                "standard deviations where nothing is known"
            )

    @property
    def is_free(self) -> tuple[bool, ...]:
        """Which of its five unknowns are unknown."""
        return tuple((np.diagonal(self.covariance) > 0).tolist())

    @property
    def is_certain(self) -> bool:
        """Whether it is the map itself."""
        return not any(self.is_free)


MAP = ControlFrame.from_sigmas("the map", (0.0, 0.0), shift_m=0.0, rotation_deg=0.0, scale=0.0)
"""The frame of the datum: see `datum`."""


@dataclass(frozen=True, slots=True, eq=False)
class StopControl:
    """Position of a stop in a control frame, with its covariance."""

    stop: StopId
    frame: str
    east_m: float
    """East coordinate of the origin of the rover frame, in the control frame."""
    north_m: float
    covariance: Float64[np.ndarray, "k k"]
    """Covariance of east, north, and of up (m) and azimuth (rad) if given, in this order."""
    up_m: float | None = None
    azimuth_deg: float | None = None
    """Azimuth of the rover's x axis, clockwise from the frame's north."""

    def __post_init__(self) -> None:
        C, size = self.covariance, len(self.components)
        if C.shape != (size, size):
            raise AdjustmentError(
                f"control of {self.stop} in {self.frame} gives {size} values, its covariance must "
                f"be {size} x {size}, not {' x '.join(map(str, C.shape))}"
            )
        even = np.abs(C - C.T).max() <= SYMMETRIC * np.abs(C).max()
        if not (np.isfinite(C).all() and even and (np.linalg.eigvalsh(C) > 0).all()):
            raise AdjustmentError(
                f"the covariance of the control of {self.stop} in {self.frame} must be symmetric "
                "and positive definite: give standard deviations above zero"
            )

    @property
    def components(self) -> tuple[int, ...]:
        """Which of east, north, up and azimuth are given, by number."""
        return (
            0,
            1,
            *((2,) if self.up_m is not None else ()),
            *((3,) if self.azimuth_deg is not None else ()),
        )

    @property
    def values(self) -> Float64[np.ndarray, " 4"]:
        """East, north, up (m) and azimuth (rad); zero where not given."""
        azimuth = np.radians(self.azimuth_deg or 0.0)
        return np.array([self.east_m, self.north_m, self.up_m or 0.0, azimuth])

    def is_same(self, other: StopControl) -> bool:
        """Whether another one has the same values."""
        return (
            (self.stop, self.frame, self.components) == (other.stop, other.frame, other.components)
            and bool((self.values == other.values).all())
            and bool((self.covariance == other.covariance).all())
        )


@dataclass(frozen=True, slots=True, eq=False)
class StopPrior:
    """Pose of a stop by telemetry.

    Telemetry measures the step from the stop before, the tilt, and, where the label marks the
    attitude as measured (FINE), the azimuth; see `telemetry`.
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

    def __post_init__(self) -> None:
        if self.geometry.rover_from_pair.target != self.stop.frame:
            raise AdjustmentError(
                f"pair {self.pair_id} was taken at {self.stop.frame}, but its geometry is given in "
                f"{self.geometry.rover_from_pair.target}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The image network: stops in the order of the traverse, their pairs, and the tie points."""

    stops: tuple[StopPrior, ...]
    pairs: tuple[PairGeometry, ...]
    ties: TiePoints
    frames: tuple[ControlFrame, ...] = ()
    """Maps in which stops were located; `datum.with_control` adds them and their control."""
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
        """Whether the position of a stop is observed in the frame of the datum."""
        return any(one.frame == MAP.name for one in self.control)

    def within(
        self, stops: frozenset[StopId] | set[StopId], ties: TiePoints | None = None
    ) -> Network:
        """The part of the network at some stops: their pairs, tie points and control.

        Of the tie points only `ties`, if these are given.
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
        ties.surface_matched[rows],
    )
