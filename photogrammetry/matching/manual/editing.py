"""Edit requests: manual tie points to add, automatic ties to veto or move, and their application.

A manual tie names two images and a point in each, in pixels of the images as stored: (0, 0) is the
centre of the first pixel, samples run right, lines down. Images are given by their product
identifiers; a stereo pair is given by its left image, and the point in the right image may be
added. Files of requests are read by `products.formats.documents.edit_requests`.

    action    effect
    add       a new tie between the two points
    veto      automatic ties near the points are dropped; without points, all between the two
              images, or between two stops where stops are named; without second image, all that
              start at the point, whichever image they go to
    move      the automatic tie at the first point is moved to the second point

Ties are kept in the epipolar geometry of their pairs. The epipolar point e of an original point u
is the solution of the resampling map (`resampling`),

    project(C + d r(e)) = u,

solved by fixed-point steps from the ray through u, because the map is nearly a shift. With the same
point in the right image the tie has a parallax, x_l - x_r; otherwise the pair's dense parallax is
used, or, without it, the tie is two rays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from solmap.photogrammetry.arrays import Flags, Float64, ImagePoints, ParallaxMap
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.records import Ties, join_ties
from solmap.photogrammetry.matching.resampling import GROUND_M

SIGMA_PX = 1.0
"""Default standard deviation of a manually measured point."""
TOLERANCE_PX = 3.0
"""Default distance within which a point selects an automatic tie."""


_NAME = re.compile(r"[A-Za-z0-9_.()+ -]{0,100}", re.ASCII)


class EditAction(StrEnum):
    """Kind of an edit request."""

    ADD = "add"
    VETO = "veto"
    MOVE = "move"


@dataclass(frozen=True, slots=True)
class EditPoint:
    """An image, and optionally a point in it."""

    image: str
    """Product identifier, upper case; or a stop (`mer2-site0010-drive0064`); empty: any."""
    point: tuple[float, float] | None = None
    right: tuple[float, float] | None = None
    """The feature's point in the right image of the pair."""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.image):
            raise MatchingError(
                f"{self.image[:40]!a} is not the name of an image or stop: up to 100 letters, "
                "digits and _ . - + ( )"
            )

    @property
    def is_stop(self) -> bool:
        """Whether it names a stop rather than an image."""
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
    """File and row, for messages; not part of the request."""

    def __post_init__(self) -> None:
        if not (self.sigma_px > 0 and self.tolerance_px > 0):
            raise MatchingError("sigma_px and tolerance_px must be above zero")
        if not self.first.image:
            raise MatchingError("first_image is empty: name the first image of the tie")
        for point in (self.first, self.second):
            if point.is_stop and (point.point or self.action is not EditAction.VETO):
                raise MatchingError(
                    f"{point.image} is a stop, which is only allowed in a veto without points"
                )
        if self.action is not EditAction.VETO:
            self._check_points()
        elif not self.second.image and self.first.point is None:
            raise MatchingError("a veto needs a second image, or a point in the first")
        elif self.second.point is not None and self.first.point is None:
            raise MatchingError("a veto with a point in the second image needs one in the first")

    def _check_points(self) -> None:
        for side, point in (("first", self.first), ("second", self.second)):
            if not point.image or point.point is None:
                raise MatchingError(
                    f"{self.action} needs {side}_image, {side}_sample and {side}_line"
                )
        if self.first.image == self.second.image:
            raise MatchingError(f"both points are in {self.first.image}; a tie joins two images")


STEPS = 8
"""Number of steps; each reduces the error about fifty times."""
LARGEST_Y_PX = 5.0
"""Largest difference in rows between the two points of a pair of the same feature."""


@dataclass(frozen=True, slots=True, eq=False)
class ManualImage:
    """Data for locating picked points of a pair, or of a single image."""

    name: str
    geometry: EpipolarPair
    left: CameraModel
    right: CameraModel | None = None
    parallax: ParallaxMap | None = None
    """Dense parallax of the pair, where it is known."""


@dataclass(frozen=True, slots=True, eq=False)
class EditedTies:
    """The ties after the edit requests, and the result of every row."""

    ties: tuple[Ties, ...]
    added: int
    moved: int
    vetoed: int
    """Automatic ties dropped."""
    notes: tuple[str, ...]
    """Rows that changed nothing, and the reason."""

    def __str__(self) -> str:
        return f"manual ties: {self.added} added, {self.moved} moved, {self.vetoed} vetoed"


def apply_edits(
    ties: Sequence[Ties],
    requests: Sequence[EditRequest],
    images: Mapping[str, ManualImage],
    stop_of: Mapping[str, str],
) -> EditedTies:
    """Automatic ties with edit requests applied, row by row.

    `images` holds the images named in requests, `stop_of` the stop of every image in a tie.
    """
    kept, new, notes = list(ties), [], []
    counts = dict.fromkeys(EditAction, 0)
    for request in requests:
        try:
            made = None if request.action is EditAction.VETO else _make_tie(request, images)
            if request.action is not EditAction.ADD:
                rows = _affected_ties(request, kept, images, stop_of)
                kept = [t.select(~some) for t, some in zip(kept, rows, strict=True)]
                dropped = sum(int(some.sum()) for some in rows)
                counts[request.action] += dropped if request.action is EditAction.VETO else 1
            if made is not None:
                new.append(made)
                counts[EditAction.ADD] += request.action is EditAction.ADD
        except _UnplacedError as error:
            notes.append(f"{request.row}: {error}")
    every = (*kept, join_ties(new, tuple(images))) if new else tuple(kept)
    added, moved, vetoed = (counts[a] for a in (EditAction.ADD, EditAction.MOVE, EditAction.VETO))
    return EditedTies(every, added, moved, vetoed, tuple(notes))


class _UnplacedError(Exception):
    """A row that cannot be applied."""


def epipolar_point(
    camera: CameraModel, geometry: EpipolarPair, point: tuple[float, float]
) -> Float64[np.ndarray, " 2"]:
    """Epipolar point of a point of an original image; NaN where it is outside."""
    pixel = np.array([point])
    ray = geometry.rover_from_pair.rotation.T @ camera.rays(pixel)[0]
    if not ray[2] > 0:
        return np.full(2, np.nan)
    found = np.array([geometry.centre_px]) + geometry.focal_px * ray[None, :2] / ray[2]
    for _ in range(STEPS):
        ground = camera.centre + GROUND_M * geometry.directions(found)
        found = found + pixel - camera.project(ground)
    return found[0]


def _affected_ties(
    request: EditRequest,
    ties: Sequence[Ties],
    images: Mapping[str, ManualImage],
    stop_of: Mapping[str, str],
) -> list[Flags]:
    """The automatic ties selected by a veto or a move, set by set."""
    second = (
        request.second if request.action is EditAction.VETO else EditPoint(request.second.image)
    )
    marks = _Mark.of(request.first, images), _Mark.of(second, images)
    rows = [_select_ties(marks, request.tolerance_px, some, stop_of) for some in ties]
    if not any(some.any() for some in rows):
        raise _UnplacedError(f"no automatic tie here to {request.action}")
    return rows


@dataclass(frozen=True, slots=True, eq=False)
class _Mark:
    """Selection of a veto: an image or a stop (empty: any), and a point in the image."""

    name: str
    place: Float64[np.ndarray, " 2"] | None

    @classmethod
    def of(cls, point: EditPoint, images: Mapping[str, ManualImage]) -> _Mark:
        if point.point is None:
            return cls(point.image, None)
        image = _image(point, images)
        return cls(point.image, epipolar_point(image.left, image.geometry, point.point))

    def covers(
        self,
        names: Sequence[str],
        left: ImagePoints,
        tolerance_px: float,
        stop_of: Mapping[str, str],
    ) -> Flags:
        """Which measurements, each in the pair of that name, are selected."""
        meant = np.array(
            [not self.name or self.name in {n, stop_of.get(n)} for n in names], dtype=bool
        )
        if self.place is None:
            return meant
        return meant & (np.linalg.norm(left - self.place, axis=1) <= tolerance_px)


def _select_ties(
    marks: tuple[_Mark, _Mark], tolerance_px: float, ties: Ties, stop_of: Mapping[str, str]
) -> Flags:
    """The ties of a set between both selections, in either order."""
    first = [ties.pair_ids[k] for k in ties.first.tolist()], ties.first_left
    second = [ties.pair_ids[k] for k in ties.second.tolist()], ties.second_left
    rows = np.zeros(len(ties), dtype=bool)
    for one, other in ((first, second), (second, first)):
        rows |= marks[0].covers(*one, tolerance_px, stop_of) & marks[1].covers(
            *other, tolerance_px, stop_of
        )
    return rows


def _make_tie(request: EditRequest, images: Mapping[str, ManualImage]) -> Ties:
    """A tie that a person measured."""
    names = tuple(images)
    columns = []
    for point in (request.first, request.second):
        image = _image(point, images)
        left, parallax = _measure(point, image)
        sigma = request.sigma_px * np.sqrt(2.0) if np.isfinite(parallax) else np.nan
        columns.append((names.index(image.name), left, parallax, request.sigma_px, sigma))
    index, left, parallax, sigma, of_parallax = zip(*columns, strict=True)
    return Ties(
        names,
        *(np.array([k], np.int32) for k in index),
        *(place[None] for place in left),
        *(np.array([v]) for v in (*parallax, *sigma, *of_parallax, *sigma)),
    )


def _image(point: EditPoint, images: Mapping[str, ManualImage]) -> ManualImage:
    if point.image not in images:
        raise _UnplacedError(
            f"{point.image} is not a left image or a tied single image of this network"
        )
    return images[point.image]


def _measure(point: EditPoint, image: ManualImage) -> tuple[Float64[np.ndarray, " 2"], float]:
    """(left epipolar point, parallax) of a point that a person clicked."""
    if point.point is None:
        raise _UnplacedError(f"no point is given in {point.image}")
    left = epipolar_point(image.left, image.geometry, point.point)
    if not image.geometry.shows(left[None]).all():
        raise _UnplacedError(f"{point.point} lies outside the usable part of {point.image}")
    if point.right is None:
        return left, _dense_parallax(image, left)
    if image.right is None:
        raise _UnplacedError(f"{point.image} has no right image")
    right = epipolar_point(image.right, image.geometry, point.right)
    parallax, across = float(left[0] - right[0]), float(left[1] - right[1])
    if not (parallax > 0 and abs(across) <= LARGEST_Y_PX):
        raise _UnplacedError(
            f"left and right point in {point.image} cannot be the same feature: parallax "
            f"{parallax:.1f} px, rows {across:.1f} px apart"
        )
    return left, parallax


def _dense_parallax(image: ManualImage, left: Float64[np.ndarray, " 2"]) -> float:
    """Dense parallax at a left point; NaN where it is not known."""
    if image.parallax is None:
        return float("nan")
    col, row = np.round(left).astype(np.int64)
    return float(image.parallax[row, col])
