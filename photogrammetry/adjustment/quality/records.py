"""Records of the quality of an adjusted network."""

from __future__ import annotations

from dataclasses import dataclass, field

from solmap.photogrammetry.adjustment.model.variance_components import Component
from solmap.photogrammetry.imagery import StopId, TieKind
from solmap.photogrammetry.ranges import CountOrZero, Factor, Share

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PairCamera:
    """The camera of a stereo pair; residuals are grouped by camera."""

    instrument: str
    samples: int
    """Size of the pair's epipolar images, pixels."""
    lines: int


@dataclass(frozen=True, slots=True)
class QualityParams:
    """Thresholds below which a part of a network is called weak."""

    few_ties: CountOrZero = 7
    """A link between stops that rests on fewer tie points: the paper's example had seven."""
    thin_redundancy: Share = 0.2
    """Mean redundancy number below which a stop's observations hardly check each other: a blunder
    shows by less than a fifth of its size."""
    many_blunders: Share = 0.25
    """Fraction of a pair's observations set aside as blunders above which the pair is weak."""
    large_misfit: Factor = 1.5
    """Root mean square of a camera's standardised residuals above which it is significant."""


@dataclass(frozen=True, slots=True)
class Precision:
    """Mean standard deviations of a part of the network, from the covariances (paper, section 3.3).

    Position and angles are about north, east and down of the LSL.
    """

    pairs: int
    position_mm: Triple
    """Standard deviations of the left cameras' positions."""
    angles_arcmin: Triple
    """Standard deviations of the cameras' rotation."""


@dataclass(frozen=True, slots=True)
class TiePrecision:
    """Mean standard deviations of tie points of a kind, north, east and down, metres."""

    points: int
    mean_m: Triple
    median_m: Triple


@dataclass(frozen=True, slots=True)
class ResidualFigures:
    """Residuals of a camera for one kind of tie: sample, line and parallax, pixels."""

    observations: int
    mean_px: Triple
    rms_px: Triple
    rms_standardised: float
    """1 when the standard deviations, as estimated, are true."""


@dataclass(frozen=True, slots=True)
class CameraResiduals:
    """Residuals of one camera, by kind of tie and by position in the image."""

    instrument: str
    pairs: int
    figures: dict[TieKind, ResidualFigures]
    cell_px: float
    grid: tuple[tuple[Triple | None, ...], ...]
    """Weighted mean residual (sample, line, parallax) by row and column of cells; None where too
    few."""


@dataclass(frozen=True, slots=True)
class Redundancy:
    """Redundancy of the observations of a kind of tie."""

    observations: int
    mean: float
    """Mean redundancy number: the fraction of an error that appears in its residual."""
    unchecked: int
    """Coordinates in whose residual less than a tenth of an error would appear."""


@dataclass(frozen=True, slots=True)
class Blunder:
    """An observation that the adjustment set aside."""

    pair_id: str
    stop: StopId
    point: int
    left_px: tuple[float, float]
    """Sample and line in the pair's left epipolar image."""
    parallax_px: float
    residual_px: Triple
    """Measured minus computed from the point as placed by the other observations."""
    others: tuple[str, ...]
    """Pairs whose observations of the point are used."""


@dataclass(frozen=True, slots=True)
class StopQuality:
    """Accuracy of one stop, and what determines its pose."""

    stop: StopId
    held_by: str
    is_tied: bool
    precision: Precision | None
    """Precision of the stop; None if it has no pairs in this network."""
    ellipse_m: tuple[float, float]
    """Semi-axes of the 1-sigma error ellipse on the map."""
    ellipse_azimuth_deg: float
    """Azimuth of the major axis, clockwise from north."""
    sigma_down_m: float
    moved_m: float
    """Distance from its position by telemetry."""
    driven_m: float
    """Distance along the adjusted traverse up to here."""


@dataclass(frozen=True, slots=True)
class ControlQuality:
    """Result of the position of a stop in a control frame."""

    stop: StopId
    frame: str
    used: bool
    """Or set aside as a blunder."""
    sigma_m: tuple[float, float]
    """Prior standard deviations, east and north."""
    residual_m: tuple[float, float]
    """Observed minus adjusted, east and north."""
    test: float | None
    """Length of the residual in its own standard deviations; None where no other observation checks
    it."""
    redundancy: float
    """Redundancy number."""
    note: str


@dataclass(frozen=True, slots=True)
class FrameQuality:
    """Adjusted position of an orbital image, or another control frame, on the map."""

    name: str
    shift_m: Triple
    """Error of its georeference at its centre, east, north and up."""
    sigma_shift_m: Triple
    rotation_deg: float
    """Counter-clockwise."""
    sigma_rotation_deg: float
    scale: float
    """Change of scale."""
    sigma_scale: float


@dataclass(frozen=True, slots=True)
class ComponentQuality:
    """Stated and estimated standard deviation of a kind of observation."""

    component: Component
    unit: str
    prior: float
    """Stated standard deviation."""
    estimate: float
    """Standard deviation used in the adjustment."""
    redundancy: float
    """Redundancy numbers of all observations of the kind that it was estimated from, summed."""


@dataclass(frozen=True, slots=True)
class MastQuality:
    """A systematic error of the mast, the same at all stops."""

    what: str
    value_deg: float
    sigma_deg: float


@dataclass(frozen=True, slots=True)
class Weakness:
    """A weak part of the network, with the reason."""

    what: str
    why: str


@dataclass(frozen=True, slots=True)
class Quality:
    """The quality of an adjusted network."""

    stops: tuple[StopQuality, ...]
    precision: Precision | None
    """Mean over all pairs of estimated stops; over all pairs where every stop was held."""
    ties: dict[TieKind, TiePrecision] = field(default_factory=dict)
    redundancy: dict[TieKind, Redundancy] = field(default_factory=dict)
    cameras: tuple[CameraResiduals, ...] = ()
    blunders: tuple[Blunder, ...] = ()
    links: dict[tuple[StopId, StopId], int] = field(default_factory=dict)
    """Tie points shared by two stops."""
    weaknesses: tuple[Weakness, ...] = ()
    control: tuple[ControlQuality, ...] = ()
    """Control of every stop that is in a control frame, except the datum."""
    frames: tuple[FrameQuality, ...] = ()
    components: tuple[ComponentQuality, ...] = ()
    mast: tuple[MastQuality, ...] = ()
