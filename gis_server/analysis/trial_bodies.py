"""What is asked of a trial of hand ties, and what it answers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field

from solmap.gis_server.analysis.bodies import UNITS, NetworkUsed, Question
from solmap.gis_server.analysis.picks import ImageHere, PixelHere
from solmap.photogrammetry.matching.hand_ties import SIGMA_PX, TOLERANCE_PX

_MOST_TIES = 500


class TiePoint(Question):
    """A point of an image as stored; of a pair, of its left image, with or without the right."""

    image: ImageHere
    sample: PixelHere | None = None
    line: PixelHere | None = None
    right_sample: PixelHere | None = None
    right_line: PixelHere | None = None


class TieWish(Question):
    """A row of a file of hand ties."""

    action: Literal["add", "veto", "move"] = "add"
    first: TiePoint
    second: TiePoint
    sigma_px: Annotated[float, Field(gt=0, le=100)] = SIGMA_PX
    tolerance_px: Annotated[float, Field(gt=0, le=100)] = TOLERANCE_PX


class TrialQuestion(Question):
    """Hand ties between images of two stops."""

    ties: Annotated[list[TieWish], Field(min_length=1, max_length=_MOST_TIES)]


class TieResidual(BaseModel):
    """How well a hand tie fits: observed minus computed, in epipolar pixels of each pair."""

    tie: int
    """Its number in the question."""
    status: str
    """used; blunder: it contradicts the others and was set aside."""
    residual_px: float | None
    """Length of both images' residuals together, root mean square of a coordinate."""
    first: list[float | None]
    """(sample, line, parallax)."""
    second: list[float | None]
    largest_standardised: float | None
    """Largest residual over its own standard deviation: above 4 it is a blunder."""


class StopChange(BaseModel):
    """By how much the second stop moves, and how sure it is."""

    east_m: float
    north_m: float
    up_m: float
    turn_deg: float
    """Angle of the rotation between both solutions."""
    azimuth_deg: float
    """Clockwise."""
    sigma_east_m: float
    sigma_north_m: float
    sigma_up_m: float


class TrialReport(BaseModel):
    """What an adjustment found."""

    summary: str
    is_usable: bool
    sigma0: float | None
    redundancy: int
    blunders: int
    cross_site_ties: int


class TrialAnswer(BaseModel):
    """What hand ties would do."""

    units: str = UNITS
    held_stop: str
    moved_stop: str
    change: StopChange
    """By the hand ties alone."""
    before: TrialReport
    after: TrialReport
    ties: list[TieResidual]
    notes: list[str]
    """Ties that could not be carried out, and why."""
    vetoed: int
    """Automatic observations dropped."""
    network: NetworkUsed
