"""Match: the two images of a pair, made epipolar and matched sparsely and densely."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from solmap.photogrammetry.archive.images.reading import ReadImage
from solmap.photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from solmap.photogrammetry.imagery import RoverImage
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.dense import DenseParams, match_densely
from solmap.photogrammetry.matching.stereo.orientation import (
    FEWEST_POINTS,
    rig_rotation,
    vertical_parallax,
)
from solmap.photogrammetry.matching.stereo.sparse import SparseParams, match_sparsely
from solmap.products.formats.documents.archives import write_dense, write_matches
from solmap.products.model import ProductKind, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import (
    PairFiles,
    PairProducts,
    pair_frame,
    read_pair,
    resample_pair,
    turn_right_camera,
)
from solmap.tasks.scopes import pair_scope
from solmap.tasks.stage import stage

Turn = tuple[float, float, float]
"""A rotation vector in the rover frame, radians."""


@dataclass(frozen=True, slots=True)
class MatchParams:
    """How the images of a stereo pair are matched."""

    sparse: SparseParams = field(default_factory=SparseParams)
    dense: DenseParams = field(default_factory=DenseParams)


@stage(task_run_name="match-{pair.id}")
def match_stereo_pair(pair: PairFiles, params: MatchParams, store: ProductStore) -> PairProducts:
    """Match one stereo pair: interest points for the network, dense parallax for the terrain."""

    @cache
    def align() -> tuple[RoverImage, EpipolarImages, Turn | None]:
        left, right = read_pair(pair, store)
        return left.image, *align_rows(left, right)

    def write_sparse(path: Path) -> None:
        left, images, turn = align()
        matches = match_sparsely(pair.id, images, params.sparse)
        write_matches(path, images.geometry, matches, left.mast_in_rover, turn)

    def write_parallax(path: Path) -> None:
        write_dense(path, match_densely(align()[1], params.dense))

    inputs, scope = pair.inputs, pair_scope(pair.id)
    matches = Recipe(ProductKind.MATCHES, scope, inputs, params.sparse)
    parallax = Recipe(ProductKind.PARALLAX, scope, inputs, params.dense)
    return PairProducts(
        pair, store.make(matches, write_sparse), store.make(parallax, write_parallax)
    )


def align_rows(left: ReadImage, right: ReadImage) -> tuple[EpipolarImages, Turn | None]:
    """The epipolar images of a pair, and the turn of the right camera that this took.

    Where vertical parallax shows that the stereo bar is not as the labels have it, the right camera
    is turned to where it really points; where that does not help either, the labels stand.
    """
    images = resample_pair(left, right, pair_geometry(left.image, right.image))
    measured = vertical_parallax(images)
    if measured.fits_the_rig or len(measured.left) < FEWEST_POINTS:
        return images, None
    rover_from_pair = images.geometry.rover_from_pair
    x, y, z = (rover_from_pair.rotation @ rig_rotation(measured)).tolist()
    turned = turn_right_camera(right, (x, y, z))
    straight = resample_pair(left, turned, pair_geometry(left.image, turned.image))
    return (straight, (x, y, z)) if vertical_parallax(straight).fits_the_rig else (images, None)


def pair_geometry(left: RoverImage, right: RoverImage) -> EpipolarPair:
    """The epipolar geometry of a pair, in the rover frame of its stop."""
    return epipolar_pair(
        left.camera,
        right.camera,
        (left.samples, left.lines),
        (right.samples, right.lines),
        left.stop.frame,
        pair_frame(left),
    )
