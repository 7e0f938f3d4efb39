"""Parameters of the adjustment, with units and reasons."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from solmap.photogrammetry.errors import AdjustmentError
from solmap.photogrammetry.ranges import (
    Count,
    Degrees,
    Factor,
    Few,
    FewOrZero,
    Freedoms,
    Metres,
    Share,
    Tolerance,
)


class AdjustmentMode(StrEnum):
    """How the stops of a mission are adjusted as its sols come in."""

    STEPWISE = "stepwise"
    """Earlier stops are held, new ones estimated: the paper's mode during the mission."""
    SEQUENTIAL = "sequential"
    """The last stops are estimated again with every new one; earlier ones enter exactly, as a
    marginal."""
    OVERALL = "overall"
    """Sequential, then one adjustment of all stops and ties after the last sol of a downlink."""


@dataclass(frozen=True, slots=True)
class AdjustmentParams:
    """Weights of the telemetry and how the adjustment iterates.

    Standard deviations of the telemetry describe a rover's attitude sensor and wheel odometry;
    those of image coordinates come from matching. All of them are priors; the mission's own are
    estimated (`variance_components`).
    """

    pointing_deg: Degrees = 0.1
    """Mast pointing, per axis and pair: 0.077 deg assumed for the rovers' masts by the operations
    software, 0.1-0.2 deg found on archived panoramas."""
    mast_deg: Degrees = 0.017
    """Systematic errors of a mast, the same at all stops: zeros of elevation and azimuth, and tilts
    of the axis of azimuth about the rover's x and y. The operations software assumes 0.077 deg of
    all errors together; pairs of one archived panorama differ by 0.1 deg and more. That leaves at
    most (0.077^2 - 0.1^2 / 2)^0.5 = 0.03 deg, and anything up to it is equally likely: 0.03 /
    3^0.5."""
    tilt_deg: Degrees = 0.3
    """Roll and pitch from accelerometers, absolute because gravity is."""
    azimuth_fine_deg: Degrees = 1.0
    """Azimuth marked as measured (FINE): a sun sighting is good to 0.6 deg when it is fresh, and
    the label does not state the drift of the gyroscopes since."""
    azimuth_step_deg: Degrees = 2.0
    """Azimuth that is only propagated: drift of the gyroscopes over a drive of some tens of
    minutes at up to 3 deg an hour, relative to the stop before."""
    slip: Share = 0.1
    """Standard deviation of wheel odometry, as a fraction of the distance driven: 10 % is the
    largest correction usually found on firm slopes."""
    position_floor_m: Metres = 0.1
    """Error of odometry on even the shortest drive: about half a wheel."""
    critical_value: Factor = 4.0
    """Standardised residual that makes an observation a blunder: one good coordinate in 16,000 is
    lost, so a mission keeps its ties. Baarda's 3.29 loses one in 1,000."""
    max_iterations: Few = 50
    """Gauss-Newton steps per solution; a network from the alignment needs about six."""
    tolerance: Tolerance = 1e-6
    """Squared length of a step, in its own standard deviations, at which the adjustment has
    converged."""
    max_rounds: FewOrZero = 12
    """Rounds of data snooping per step."""
    sigma_freedoms: Freedoms = 3.0
    """The standard deviations stated above, and those of ties, have the weight of this many
    observations of each kind: with 3, the estimated factor may be 0.6 to 3.7 (95 %). From 1e9 on
    they are taken as stated."""
    window_stops: Count = 4
    """Stops that the sequential adjustment estimates again at every step. Ties that reach back
    further re-open the whole traverse; drives and turns seldom show ground of more than the third
    stop before."""

    def __post_init__(self) -> None:
        for name in (
            "pointing_deg",
            "mast_deg",
            "tilt_deg",
            "azimuth_fine_deg",
            "azimuth_step_deg",
            "position_floor_m",
            "critical_value",
            "tolerance",
            "sigma_freedoms",
        ):
            if not getattr(self, name) > 0:
                raise AdjustmentError(
                    f"{name} must be above zero, not {getattr(self, name)}: to fix a value "
                    "exactly, use `held`"
                )
