"""Image features on bird's-eye views, and the place of a later stop that they vote for.

Pictures of two stops differ by a perspective that no descriptor stands. Drawn from above they
differ by a turn of some degrees and a shift only, and so Landform describes its features there
(arXiv 2509.18330). Here they are found and described by SIFT (Lowe 2004) in both channels of the
bird's-eye view, grey and relief, every one upright and with the size it was found with: azimuth and
scale are known, and need not be given away. The conjugate of a feature is that one of the other
stop with the nearest descriptor among those that the gate can bring to its place, if it is the
nearest in turn. Every such pair votes for the place of the later stop (`voting`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from solmap.photogrammetry.arrays import Bool, Float32, Float64, Int32, PerPoint
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.matching.cross_site.birds_eye import (
    CLIP,
    BirdsEyeParams,
    BirdsEyeView,
    Channel,
    SearchGate,
    channels,
)
from solmap.photogrammetry.matching.cross_site.hypotheses.voting import (
    Landmarks,
    VotedPlace,
    VotingParams,
    vote_for_places,
)
from solmap.photogrammetry.ranges import Count, Factor, FactorFromOne, Share

DESCRIPTOR_CELLS = 9
"""Side of the square around a feature that must have been seen: what its descriptor looks at."""


SEEN_SHARE = 0.7
"""Of the ground under a feature's descriptor, so much must have been seen."""


@dataclass(frozen=True, slots=True)
class FeatureParams:
    """How features on the ground are found and matched."""

    features: Count = 1500
    """In a channel, the strongest."""
    contrast: Share = 0.01
    """Of a feature against the ground around it (Lowe 2004, section 4), of the channel's range."""
    size_ratio: FactorFromOne = 1.5
    """Features whose sizes differ by more than this factor are not the same."""
    sigma_cells: Factor = 1.0
    """Of a feature's place, along north and east."""
    voting: VotingParams = field(default_factory=VotingParams)

    def __post_init__(self) -> None:
        if self.features < 1 or self.size_ratio <= 1 or self.sigma_cells <= 0:
            raise MatchingError(
                f"{self.features} features with sizes alike up to a factor of {self.size_ratio}, "
                f"placed to {self.sigma_cells} cells, match nothing: give 1 or more features, a "
                "factor above 1 and a sigma above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features on the ground around a stop, in its level frame."""

    landmarks: Landmarks
    size_m: PerPoint
    channel: Int32[np.ndarray, " n"]
    """Features of different channels are never the same."""
    descriptors: Float32[np.ndarray, "n 128"]
    """Square roots of SIFT's shares, of unit length (Arandjelovic & Zisserman 2012)."""


def find_features(view: BirdsEyeView, birds_eye: BirdsEyeParams, params: FeatureParams) -> Features:
    """Features of both channels of a view from above."""
    described = [_describe(channel, params) for channel in channels(view, birds_eye)]
    at, size, descriptors = (np.concatenate(part) for part in zip(*described, strict=True))
    middle = (view.grey.shape[0] - 1) / 2
    places = np.column_stack([middle - at[:, 1], at[:, 0] - middle]) * view.cell_m
    sigma_m = params.sigma_cells * view.cell_m
    return Features(
        Landmarks(places, np.broadcast_to(np.eye(2) * sigma_m**2, (len(at), 2, 2))),
        size * view.cell_m,
        np.repeat(np.arange(len(described), dtype=np.int32), [len(d[0]) for d in described]),
        descriptors,
    )


def match_features(
    earlier: Features, later: Features, gate: SearchGate, most: int, params: FeatureParams
) -> list[VotedPlace]:
    """The places of the later stop that matched features vote for."""
    pairs = conjugate_features(earlier, later, gate, params)
    return vote_for_places(earlier.landmarks, later.landmarks, pairs, gate, most, params.voting)


def conjugate_features(
    earlier: Features, later: Features, gate: SearchGate, params: FeatureParams
) -> Int32[np.ndarray, "n 2"]:
    """Pairs of features of one channel that are each other's nearest within the gate."""
    found = [np.zeros((0, 2), np.int32)]
    for channel in np.intersect1d(earlier.channel, later.channel):
        one, other = (np.flatnonzero(f.channel == channel) for f in (earlier, later))
        likeness = earlier.descriptors[one] @ later.descriptors[other].T
        likeness[~_can_be_same(earlier, one, later, other, gate, params)] = -1.0
        forth, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
        rows = np.arange(len(one))
        mutual = (back[forth] == rows) & (likeness[rows, forth] > 0)
        found.append(np.column_stack([one[mutual], other[forth[mutual]]]).astype(np.int32))
    return np.concatenate(found)


def _can_be_same(
    earlier: Features,
    one: np.ndarray,
    later: Features,
    other: np.ndarray,
    gate: SearchGate,
    params: FeatureParams,
) -> Bool[np.ndarray, "one other"]:
    """Whether the gate can bring a later feature to the place of an earlier one, of its size."""
    p, q = earlier.landmarks.places[one], later.landmarks.places[other]
    off = p[:, None] - q[None] - (gate.north_m, gate.east_m)
    reach_m = gate.reach_m + gate.azimuth_reach * np.hypot(*q.T)
    ratio = np.log(earlier.size_m[one][:, None] / later.size_m[other][None])
    near = np.hypot(off[..., 0], off[..., 1]) < reach_m[None, :]
    return near & (np.abs(ratio) < np.log(params.size_ratio))


def _describe(
    channel: Channel, params: FeatureParams
) -> tuple[Float64[np.ndarray, "n 2"], PerPoint, Float32[np.ndarray, "n 128"]]:
    """(column and row, size in cells, descriptor) of a channel's features."""
    grey = np.clip(128 + channel.value * (127 / CLIP), 0, 255).astype(np.uint8)
    sift = cv2.SIFT.create(nfeatures=0, contrastThreshold=params.contrast)
    # A feature with several orientations is listed with each of them.
    once = {(*p.pt, p.size): p for p in sift.detect(grey, None)}
    seen = cv2.blur(channel.weight, (DESCRIPTOR_CELLS, DESCRIPTOR_CELLS))
    points = [p for p in once.values() if seen[int(p.pt[1]), int(p.pt[0])] > SEEN_SHARE]
    points = sorted(points, key=lambda p: (-p.response, p.pt))[: params.features]
    for point in points:
        point.angle = 0.0
    if not points:
        return np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32)
    kept, described = sift.compute(grey, points)
    share = described / np.maximum(described.sum(axis=1, keepdims=True), 1e-6)
    return (
        np.array([p.pt for p in kept], np.float64),
        np.array([p.size for p in kept], np.float64),
        np.sqrt(share).astype(np.float32),
    )
