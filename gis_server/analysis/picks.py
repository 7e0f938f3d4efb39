"""Points that a person picks in images: measured to a fraction of a pixel, and tried as ties."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field

from solmap.gis_server.analysis.bodies import UNITS, NetworkUsed, Question
from solmap.gis_server.analysis.refusal import RefusedError
from solmap.gis_server.rendering.images import linearised
from solmap.photogrammetry.arrays import Float64, ImagePoints
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.cameras.model import CameraModel
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.conjugates import View
from solmap.photogrammetry.matching.hand_editing import epipolar_point
from solmap.photogrammetry.matching.hand_refinement import (
    LARGEST_REACH_PX,
    PickedView,
    PickParams,
    measured_pick,
)
from solmap.photogrammetry.matching.resampling import GROUND_M
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.oriented_images import MatchedEyes, OrientedMission

PixelHere = Annotated[float, Field(ge=-1, le=1e5)]
ImageHere = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,127}$")]


class Picked(Question):
    """A point of an image as stored, pixels; of a pair, of its left image."""

    image: ImageHere
    sample: PixelHere
    line: PixelHere


class RefineQuestion(Question):
    """One feature as a person picked it in the left images of two pairs."""

    first: Picked
    second: Picked
    reach_px: Annotated[float, Field(gt=0, le=LARGEST_REACH_PX)] = PickParams().reach_px
    """Within which the second point is looked for."""


class RefineAnswer(BaseModel):
    """The second point, measured; the first is taken for what it is."""

    units: str = UNITS
    found: bool
    said: str | None
    """Why it was not found."""
    image: str
    sample: float
    line: float
    """As picked where it was not found."""
    moved_px: float
    sigma_px: float | None
    correlation: float | None
    network: NetworkUsed


def refined_pick(question: RefineQuestion, mission: OrientedMission) -> RefineAnswer:
    """Measure the second of two picked points by least-squares matching."""
    sides = [_side(point, mission) for point in (question.first, question.second)]
    (first, at, _), (second, start, eyes) = sides
    picked = np.array([question.second.sample, question.second.line])
    try:
        found = measured_pick(first, second, at, start, PickParams(reach_px=question.reach_px))
        place = stored_point(eyes.left, eyes.geometry, np.array([found.place]))[0]
        said, sigma, correlation = None, found.sigma_px, found.correlation
    except MatchingError as error:
        place, said, sigma, correlation = picked, str(error), None, None
    return RefineAnswer(
        found=said is None,
        said=said,
        image=eyes.pair_id,
        sample=round(float(place[0]), 3),
        line=round(float(place[1]), 3),
        moved_px=round(float(np.linalg.norm(place - picked)), 3),
        sigma_px=None if sigma is None else round(sigma, 3),
        correlation=None if correlation is None else round(correlation, 3),
        network=NetworkUsed.of(mission.ref),
    )


def stored_point(camera: CameraModel, geometry: EpipolarPair, points: ImagePoints) -> ImagePoints:
    """Where points of an epipolar image lie in the image as stored."""
    return camera.project(camera.centre + GROUND_M * geometry.directions(points))


def left_entry(image: str, mission: OrientedMission) -> tuple[ImageEntry, MatchedEyes]:
    """The left image of a matched pair by its name.

    Raises:
        RefusedError: the image is a right one, or its pair was not matched.
    """
    entry = mission.workspace.catalogue.image(image.upper())
    if entry.eye != Eye.LEFT:
        raise RefusedError(
            f"{entry.id} is a {entry.eye} image; ties are measured in left ones: pick in "
            f"{entry.partner or 'another image'}"
        )
    eyes = mission.eyes(entry)
    if eyes is None or mission.pair_of(entry) is None:
        raise RefusedError(f"{entry.id} has no matched partner in the latest network")
    return entry, eyes


def _side(
    point: Picked, mission: OrientedMission
) -> tuple[PickedView, Float64[np.ndarray, " 2"], MatchedEyes]:
    entry, eyes = left_entry(point.image, mission)
    pair = mission.pair_of(entry)
    assert pair is not None  # noqa: S101 - asked of by `left_entry`
    grey = linearised(entry, mission.workspace)
    mask = np.isfinite(grey)
    view = View.of(np.where(mask, grey, np.float32(0)), mask)
    place = epipolar_point(eyes.left, eyes.geometry, (point.sample, point.line))
    if not eyes.geometry.shows(place[None])[0]:
        raise RefusedError(f"sample {point.sample:g}, line {point.line:g} is not on {entry.id}")
    picked = PickedView(view, eyes.geometry, eyes.dense.parallax_px, pair.lsl_from_pair)
    return picked, place, eyes
