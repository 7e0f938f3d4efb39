"""Images without a stereo partner as matching takes them, and how they are tied."""

from __future__ import annotations

from dataclasses import dataclass, field

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.conjugates import ConjugateParams, View
from solmap.photogrammetry.matching.interest_points import FoerstnerParams
from solmap.photogrammetry.matching.verification import VerificationParams


@dataclass(frozen=True, slots=True)
class MonoParams:
    """How single images of a stop are tied."""

    interest: FoerstnerParams = field(default_factory=FoerstnerParams)
    conjugates: ConjugateParams = field(default_factory=lambda: ConjugateParams(half_px=8))
    verification: VerificationParams = field(default_factory=VerificationParams)
    pointing_sigma: float = 0.0026
    """Radians (0.15 degrees) an axis and image, as in `alignment`."""
    nearest_m: float = 1.5
    """Nearest ground, as deep as the mast is high."""
    scouts: int = 400
    """Interest points that are looked for first, over all depths."""
    candidates: int = 2500
    """Interest points of the overlap that are looked for with depth and turn known."""
    cell_px: int = 32
    """Cell in which the strongest are taken in turn."""
    relief_px: int = 4
    """Half the window of the second search: relief between neighbouring matches."""
    least_parallax_px: float = 1.0
    """Along the epipolar line. Below, the rays of the adjusted images may diverge, and a point
    behind infinity has no place."""
    least_base_m: float = 0.01
    """Between the cameras: nearer together, as through two filters, images say nothing of depth."""
    least_ties: int = 12
    """Four times the three unknowns of the turn: with fewer there is no link."""

    def __post_init__(self) -> None:
        if not (self.candidates >= self.scouts >= self.least_ties > 2):  # noqa: PLR2004
            raise MatchingError(
                "single images need candidates >= scouts >= least_ties > 2, not "
                f"{self.candidates}, {self.scouts}, {self.least_ties}"
            )
        if not (self.pointing_sigma > 0 and self.nearest_m > 0 and self.relief_px > 0):
            raise MatchingError("pointing_sigma, nearest_m and relief_px must be above zero")


@dataclass(frozen=True, slots=True, eq=False)
class SingleView:
    """An image without stereo partner, resampled to the geometry of `cameras.single`."""

    image_id: str
    geometry: EpipolarPair
    view: View
