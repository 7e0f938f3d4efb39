"""Control: where stops lie in maps that the rover did not make, orbital images as a rule.

An orbital image is rigid and sharp, but as a whole it may lie metres off and be turned by some
tenths of a degree. What it tells is therefore where stops lie *in it*; its own place on the map, a
shift, a turn and a change of scale, is an unknown of the network with a standard deviation of its
own (`ControlFrame`). A frame whose place is certain is the map itself: see `datum`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solmap.photogrammetry.arrays import Float64
from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.imagery import StopId

FRAME_UNKNOWNS = 5
"""Of a control frame: shift east, north and up (metres), turn (radians) and change of scale."""
COMPONENTS = ("east_m", "north_m", "up_m", "azimuth_rad")
"""What control may tell of a stop, in the order of its covariance."""
SYMMETRIC = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ControlFrame:
    """A map that stops are found in, and what is known of its place beforehand.

    What it shows at u lies on the map (east, north) at c + (I + [[a, -b], [b, a]]) (u - c) + t,
    with the centre c, the shift t, the turn b (counter-clockwise) and the change of scale a.
    """

    name: str
    centre_m: tuple[float, float]
    """About which it is turned, (east, north): where its own error is smallest."""
    place: Float64[np.ndarray, " 5"]
    """Most likely (t_east, t_north, t_up, b, a)."""
    covariance: Float64[np.ndarray, "5 5"]
    """Of the place; what has no variance is certain, and no unknown."""

    @classmethod
    def claimed(
        cls,
        name: str,
        centre_m: tuple[float, float],
        *,
        shift_m: float = 50.0,
        rotation_deg: float = 0.5,
        scale: float = 1e-3,
    ) -> ControlFrame:
        """A frame that lies where it claims to, within standard deviations; zero: exactly.

        The defaults are those of an image that was laid on older maps by hand.
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


MAP = ControlFrame.claimed("the map", (0.0, 0.0), shift_m=0.0, rotation_deg=0.0, scale=0.0)
"""The frame of the datum: see `datum`."""


@dataclass(frozen=True, slots=True, eq=False)
class StopControl:
    """Where a stop lies in a control frame, and how well that is known."""

    stop: StopId
    frame: str
    east_m: float
    """Of the origin of the rover frame, as the control frame has it."""
    north_m: float
    covariance: Float64[np.ndarray, "k k"]
    """Of east, north, and what else is given: up (m), azimuth (rad), in this order."""
    up_m: float | None = None
    azimuth_deg: float | None = None
    """Of the rover's x axis, clockwise from the frame's north."""

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
        """Which of `COMPONENTS` are given."""
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
        """Whether another one says the same."""
        return (
            (self.stop, self.frame, self.components) == (other.stop, other.frame, other.components)
            and bool((self.values == other.values).all())
            and bool((self.covariance == other.covariance).all())
        )


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedControl:
    """What became of a control observation."""

    control: StopControl
    used: bool
    """Or set aside as a blunder."""
    residual: Float64[np.ndarray, " 4"]
    """Observed minus adjusted east, north, up (m) and azimuth (rad); NaN where not given."""
    test: float
    """Length of the residual in its own standard deviations; NaN where nothing checks it."""
    redundancy: float
    """Mean share of an error that shows in the residual, 0 to 1."""
    note: str = ""
    """Why it was set aside, or that nothing checks it."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustedFrame:
    """Where a control frame lies after adjustment."""

    frame: ControlFrame
    place: Float64[np.ndarray, " 5"]
    """(t_east, t_north, t_up, b, a)."""
    covariance: Float64[np.ndarray, "5 5"]
