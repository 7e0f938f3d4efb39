"""Match the two images of a pair in epipolar geometry, sparsely and densely."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from solmap.photogrammetry.adjustment.modes.rig_pooling import CameraRows
from solmap.photogrammetry.arrays import Vector3
from solmap.photogrammetry.matching.records import EpipolarImages
from solmap.photogrammetry.matching.stereo.dense import DenseParams, match_densely
from solmap.photogrammetry.matching.stereo.interest_points import InterestPoints
from solmap.photogrammetry.matching.stereo.orientation import (
    FEWEST_POINTS,
    RowCells,
    VerticalParallax,
    rows_of_rig,
    straightened,
)
from solmap.photogrammetry.matching.stereo.sparse import (
    Candidates,
    SparseParams,
    match_interest_points,
    points_of_pair,
    refine_candidates,
)
from solmap.products.formats.documents.archives import write_dense, write_matches
from solmap.products.formats.documents.rig import PairRows, write_pair_rows
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import (
    PAIRS_KEPT,
    PairFiles,
    PairProducts,
    Turn,
    read_epipolar,
    read_left,
)
from solmap.tasks.scopes import pair_scope
from solmap.tasks.stage import stage


@dataclass(frozen=True, slots=True)
class MatchParams:
    """How the images of a stereo pair are matched."""

    sparse: SparseParams = field(default_factory=SparseParams)
    dense: DenseParams = field(default_factory=DenseParams)


@stage(task_run_name="rows-{pair.id}")
def measure_rows(pair: PairFiles, store: ProductStore) -> ProductRef:
    """Measure the correspondence of the rows of a stereo pair, with the rig as labelled."""

    def write(path: Path) -> None:
        images, left = read_epipolar(pair, None, store), read_left(pair, None, store).record
        rover_from_pair = images.geometry.rover_from_pair.rotation

        def turned(rotation: Vector3) -> EpipolarImages:
            x, y, z = (rover_from_pair @ rotation).tolist()
            return read_epipolar(pair, (x, y, z), store)

        points = find_points(pair, None, SparseParams(), store)
        measured = rows_of_rig(images, turned, points)
        rows = rows_of_pair(measured)
        found = PairRows(
            pair.id,
            str(pair.stop),
            pair.instrument,
            str(measured),
            rover_from_pair,
            replace(rows, celsius=left.camera_celsius) if rows else None,
        )
        write_pair_rows(path, found)

    recipe = Recipe(ProductKind.VERTICAL_PARALLAX, pair_scope(pair.id), pair.inputs)
    return store.make(recipe, write)


def rows_of_pair(measured: VerticalParallax) -> CameraRows | None:
    """The rig rotation by the rows of a pair; None where no rotation makes them correspond."""
    if len(measured.left) < FEWEST_POINTS or not straightened(measured).fits_the_rig:
        return None
    geometry = measured.geometry
    return CameraRows(RowCells.of(measured), 1, geometry.focal_px, geometry.samples)


@stage(task_run_name="match-{pair.id}")
def match_stereo_pair(
    pair: PairFiles, params: MatchParams, store: ProductStore, turn: Turn | None = None
) -> PairProducts:
    """Match one stereo pair: interest points for the network, dense parallax for the terrain.

    Args:
        pair: The images.
        params: Parameters of matching.
        store: The product store.
        turn: Rotation of the right camera from its label.
    """

    def write_sparse(path: Path) -> None:
        images = read_epipolar(pair, turn, store)
        candidates = find_candidates(pair, turn, params.sparse, store)
        matches = refine_candidates(pair.id, images, candidates, params.sparse)
        write_matches(path, images.geometry, matches, turn)

    def write_parallax(path: Path) -> None:
        write_dense(path, match_densely(read_epipolar(pair, turn, store), params.dense))

    inputs, scope = pair.inputs, pair_scope(pair.id)
    sparse, dense = ((one, turn) if turn else one for one in (params.sparse, params.dense))
    matches = Recipe(ProductKind.MATCHES, scope, inputs, sparse)
    parallax = Recipe(ProductKind.PARALLAX, scope, inputs, dense)
    return PairProducts(
        pair, store.make(matches, write_sparse), store.make(parallax, write_parallax)
    )


@lru_cache(maxsize=PAIRS_KEPT)
def find_candidates(
    pair: PairFiles, turn: Turn | None, params: SparseParams, store: ProductStore
) -> Candidates:
    """The interest points of a pair that may correspond; kept for the preview of its matches."""
    images = read_epipolar(pair, turn, store)
    return match_interest_points(images, params, find_points(pair, turn, params, store))


@lru_cache(maxsize=PAIRS_KEPT)
def find_points(
    pair: PairFiles, turn: Turn | None, params: SparseParams, store: ProductStore
) -> tuple[InterestPoints, InterestPoints]:
    """The interest points of both images; kept because rows are measured with the same ones."""
    return points_of_pair(read_epipolar(pair, turn, store), params)
