"""Match: the two images of a pair, made epipolar and matched sparsely and densely."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from prefect import task
from prefect.cache_policies import NO_CACHE

from photogrammetry.cameras.epipolar import EpipolarPair, epipolar_pair
from photogrammetry.imagery import RoverImage
from photogrammetry.matching.dense import DenseParams, match_densely
from photogrammetry.matching.records import EpipolarImages
from photogrammetry.matching.sparse import SparseParams, match_sparsely
from products.arrays import write_matches, write_parallax
from products.model import ProductKind, Recipe
from products.store import ProductStore
from tasks.pairs import PairFiles, PairProducts, pair_frame, read_pair, resampled
from tasks.scopes import pair_scope


@dataclass(frozen=True, slots=True)
class MatchParams:
    """How the images of a stereo pair are matched."""

    sparse: SparseParams = field(default_factory=SparseParams)
    dense: DenseParams = field(default_factory=DenseParams)


@task(cache_policy=NO_CACHE, task_run_name="match-{pair.id}")
def match_stereo_pair(pair: PairFiles, params: MatchParams, store: ProductStore) -> PairProducts:
    """Match one stereo pair: interest points for the network, dense parallax for the terrain."""

    @cache
    def images() -> tuple[RoverImage, EpipolarImages]:
        left, right = read_pair(pair, store)
        return left.image, resampled(left, right, geometry_of(left.image, right.image))

    def write_sparse(path: Path) -> None:
        left, epipolar = images()
        matches = match_sparsely(pair.id, epipolar, params.sparse)
        write_matches(path, epipolar.geometry, matches, left.mast_in_rover)

    def write_dense(path: Path) -> None:
        write_parallax(path, match_densely(images()[1], params.dense))

    inputs, scope = (pair.left, pair.right), pair_scope(pair.id)
    matches = Recipe(ProductKind.MATCHES, scope, inputs, params.sparse)
    parallax = Recipe(ProductKind.PARALLAX, scope, inputs, params.dense)
    return PairProducts(pair, store.make(matches, write_sparse), store.make(parallax, write_dense))


def geometry_of(left: RoverImage, right: RoverImage) -> EpipolarPair:
    """The epipolar geometry of a pair, in the rover frame of its stop."""
    return epipolar_pair(
        left.camera,
        right.camera,
        (left.samples, left.lines),
        (right.samples, right.lines),
        left.stop.frame,
        pair_frame(left),
    )
