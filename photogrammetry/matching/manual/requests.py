"""Edit requests: manual tie points to add, automatic ties to veto or move.

A manual tie names two images and a point in each, in pixels of the images as stored: (0, 0) is the
centre of the first pixel, samples run right, lines down. Images are named by their product
identifiers; of a stereo pair it is the left one that is named, and the place in the right one may
be added. Files of them are read by `products.formats.documents.edit_requests`.

    action    what is done
    add       a new tie between the two points
    veto      automatic ties near the points are dropped; without points, all between the two
              images, or between two stops where stops are named; without second image, all that
              start at the point, whichever image they go to
    move      the automatic tie at the first point goes to the second point instead
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from solmap.photogrammetry.errors import MatchingError

SIGMA_PX = 1.0
"""Of a point placed by hand, where the file does not say."""
TOLERANCE_PX = 3.0
"""Within which an automatic tie is meant by a point, where the file does not say."""


class EditAction(StrEnum):
    """What a person wants done."""

    ADD = "add"
    VETO = "veto"
    MOVE = "move"


@dataclass(frozen=True, slots=True)
class EditPoint:
    """An image, and a point in it where one is given."""

    image: str
    """Product identifier, upper case; or a stop (`mer2-site0010-drive0064`); empty: any."""
    point: tuple[float, float] | None = None
    right: tuple[float, float] | None = None
    """The same feature in the right image of the pair."""

    @property
    def is_stop(self) -> bool:
        """Whether a stop is named rather than an image."""
        return "-drive" in self.image


@dataclass(frozen=True, slots=True)
class EditRequest:
    """One row of a file of edit requests."""

    action: EditAction
    first: EditPoint
    second: EditPoint
    sigma_px: float = SIGMA_PX
    tolerance_px: float = TOLERANCE_PX
    row: str = ""
    """File and row, for messages; no part of what is wanted."""

    def __post_init__(self) -> None:
        if not (self.sigma_px > 0 and self.tolerance_px > 0):
            raise MatchingError("sigma_px and tolerance_px must be above zero")
        if not self.first.image:
            raise MatchingError("first_image is empty: name the image that the tie starts in")
        for point in (self.first, self.second):
            if point.is_stop and (point.point or self.action is not EditAction.VETO):
                raise MatchingError(
                    f"{point.image} is a stop; only a veto without points takes one"
                )
        if self.action is not EditAction.VETO:
            self._check_points()
        elif not self.second.image and self.first.point is None:
            raise MatchingError("a veto takes a second image, or a point in the first")
        elif self.second.point is not None and self.first.point is None:
            raise MatchingError("a veto with a point in the second image takes one in the first")

    def _check_points(self) -> None:
        for side, point in (("first", self.first), ("second", self.second)):
            if not point.image or point.point is None:
                raise MatchingError(
                    f"{self.action} takes {side}_image, {side}_sample and {side}_line"
                )
        if self.first.image == self.second.image:
            raise MatchingError(f"both points lie in {self.first.image}; a tie joins two images")
