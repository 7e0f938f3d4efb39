"""Records of matching: epipolar images, matched pairs and stops, and ties between pairs.

A tie is one feature measured in two images, with its parallax in each that belongs to a pair.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial

import numpy as np

from solmap.photogrammetry.arrays import (
    Flags,
    Float64,
    GreyImage,
    ImagePoints,
    Int32,
    Mask,
    ParallaxMap,
    PerPoint,
    Vector3,
)
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import StereoMatches, StopId


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarImages:
    """Both images of a pair, resampled to its epipolar geometry; masks are True where usable."""

    geometry: EpipolarPair
    left: GreyImage
    left_mask: Mask
    right: GreyImage
    right_mask: Mask

    def __post_init__(self) -> None:
        size = (self.geometry.lines, self.geometry.samples)
        for name in ("left", "left_mask", "right", "right_mask"):
            shape = getattr(self, name).shape
            if shape != size:
                raise MatchingError(f"the {name} of an epipolar pair of {size} is {shape}")


@dataclass(frozen=True, slots=True)
class SharedSigma:
    """Standard deviation of the error common to all parallaxes of a pair.

    It does not average out over pixels: hypot(offset, stretch x parallax).
    """

    offset_px: float = 0.0
    """Change of parallax by a rotation of one camera about the vertical."""
    stretch: float = 0.0
    """Relative change of parallax by the length of the baseline."""


@dataclass(frozen=True, slots=True, eq=False)
class DenseMatches:
    """Parallax of every pixel that was matched, with its standard deviation."""

    parallax_px: ParallaxMap
    sigma_px: ParallaxMap
    shared: SharedSigma | None = None
    """The part of `sigma_px` common to all pixels; None where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPair:
    """The left epipolar image of a stereo pair, with all matches."""

    pair_id: str
    instrument: str
    geometry: EpipolarPair
    left: GreyImage
    left_mask: Mask
    read_right: Callable[[], tuple[GreyImage, Mask]]
    """The right image and its mask, in the same geometry: needed only where ties are found."""
    matches: StereoMatches
    parallax: ParallaxMap
    """Dense parallax on the grid of the left epipolar image."""
    sun: Vector3 | None = None
    """Unit vector towards the Sun in the axes of site and LSL (north, east, down), if known."""

    @classmethod
    def of(
        cls,
        pair_id: str,
        instrument: str,
        images: EpipolarImages,
        matches: StereoMatches,
        parallax: ParallaxMap,
        sun: Vector3 | None = None,
    ) -> MatchedPair:
        """A pair whose images are both in memory."""
        return cls(
            pair_id=pair_id,
            instrument=instrument,
            geometry=images.geometry,
            left=images.left,
            left_mask=images.left_mask,
            read_right=partial(_right_of, images),
            matches=matches,
            parallax=parallax,
            sun=sun,
        )


def _right_of(images: EpipolarImages) -> tuple[GreyImage, Mask]:
    return images.right, images.right_mask


@dataclass(frozen=True, slots=True, eq=False)
class MatchedStop:
    """All matched pairs of a stop, and its pose by telemetry (or an earlier adjustment)."""

    stop: StopId
    pairs: tuple[MatchedPair, ...]
    lsl_from_rover: Pose
    covariance: Float64[np.ndarray, "6 6"]
    """Covariance of the pose: rotation vector in the LSL (radians), then position in the LSL
    (metres)."""


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """n features, each measured in the pairs `pair_ids[first[k]]` and `pair_ids[second[k]]`.

    Sigmas are standard deviations, in pixels, of the sample, of the parallax and of the line: on
    grazing ground the sample is less certain than the line.
    """

    pair_ids: tuple[str, ...]
    first: Int32[np.ndarray, " n"]
    second: Int32[np.ndarray, " n"]
    first_left: ImagePoints
    second_left: ImagePoints
    first_parallax_px: PerPoint
    second_parallax_px: PerPoint
    first_sigma_px: PerPoint
    second_sigma_px: PerPoint
    first_sigma_parallax_px: PerPoint
    second_sigma_parallax_px: PerPoint
    first_sigma_line_px: PerPoint
    second_sigma_line_px: PerPoint
    surface_matched: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))
    """Whether surface-matched rather than image-matched; if not given, none is."""

    def __post_init__(self) -> None:
        if not len(self.surface_matched):
            object.__setattr__(self, "surface_matched", np.zeros(len(self.first), dtype=bool))
        lengths = {f.name: len(getattr(self, f.name)) for f in fields(self)[1:]}
        if len(set(lengths.values())) > 1:
            raise MatchingError(f"the columns of ties differ in length: {lengths}")

    def __len__(self) -> int:
        return len(self.first)

    @classmethod
    def none(cls, pair_ids: tuple[str, ...]) -> Ties:
        """No ties at all."""
        whole, flat = np.zeros(0, np.int32), np.zeros(0)
        return cls(
            pair_ids,
            whole,
            whole,
            np.zeros((0, 2)),
            np.zeros((0, 2)),
            *[flat.copy() for _ in "12345678"],
        )

    def select(self, rows: Flags) -> Ties:
        """The ties of some rows."""
        return Ties(self.pair_ids, *(getattr(self, f.name)[rows] for f in fields(self)[1:]))

    def swap(self) -> Ties:
        """First and second exchanged."""
        names = [f.name for f in fields(self)[1:]]
        others = [
            name.replace("first", "second") if "first" in name else name.replace("second", "first")
            for name in names
        ]
        return Ties(self.pair_ids, *(getattr(self, name) for name in others))

    def counts(self) -> dict[tuple[str, str], int]:
        """Number of ties by (first, second) pair."""
        found = Counter(zip(self.first.tolist(), self.second.tolist(), strict=True))
        return {(self.pair_ids[i], self.pair_ids[j]): n for (i, j), n in sorted(found.items())}


def join_ties(ties: Sequence[Ties], pair_ids: tuple[str, ...]) -> Ties:
    """All ties of several sets that share the list of pairs."""
    for some in ties:
        if some.pair_ids != pair_ids:
            raise MatchingError("only ties that share one list of pairs can be joined")
    if not ties:
        return Ties.none(pair_ids)
    columns = (np.concatenate([getattr(t, f.name) for t in ties]) for f in fields(Ties)[1:])
    return Ties(pair_ids, *columns)
