"""Previews: figures of matches, ties and links, for checking a stage.

They are products like any other, below `quicklook/` in the store, but not layers of the map.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from solmap.photogrammetry.arrays import EightBits, PerPoint
from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.errors import MatchingError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.matching.alignment import AlignmentParams
from solmap.photogrammetry.matching.cross_site.birds_eye import PlaneFit
from solmap.photogrammetry.matching.cross_site.ground_views import StopViews
from solmap.photogrammetry.matching.cross_site.linking import CrossSiteParams
from solmap.photogrammetry.matching.cross_site.links import SiteLink
from solmap.photogrammetry.matching.records import MatchedPair, MatchedStop, Ties
from solmap.photogrammetry.matching.stereo.sparse import SparseParams
from solmap.products.errors import ProductError
from solmap.products.formats.documents.archives import read_matches, read_right_turn
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.products.reports.matching_figures import (
    FigureImage,
    caption,
    draw_overlay,
    draw_pair,
    draw_sheet,
    misfits,
)
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairProducts, read_epipolar, stored_parallax
from solmap.tasks.network.match import find_candidates
from solmap.tasks.scopes import pair_scope
from solmap.tasks.stage import stage

MAX_WIDTH = 1024
"""Width of a preview, pixels: two images side by side at half their width."""
ENCODING = (
    *(cv2.IMWRITE_PNG_COMPRESSION, 1),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE),
)
"""Few levels of grey need no filter: that of the left neighbour takes a tenth longer and six
percent more bytes."""
FROM_ABOVE = (
    "relief, then grey values, from above, north up: earlier stop in red, later in cyan, grey "
    "where they agree"
)


@stage(task_run_name="preview-matches-{pairs[0].files.stop}")
def preview_pairs(
    pairs: tuple[PairProducts, ...], params: SparseParams, store: ProductStore
) -> tuple[ProductRef, ...]:
    """Matches of each pair of a stop: points, matches by residual, dense parallax, parallax curve.

    A pair that cannot be drawn does not stop the others; its error is raised after them.
    """
    made, errors = [], []
    for pair in pairs:
        try:
            made.append(_preview_pair(pair, params, store))
        except (MatchingError, ProductError) as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return tuple(made)


def _preview_pair(pair: PairProducts, params: SparseParams, store: ProductStore) -> ProductRef:
    def write(path: Path) -> None:
        turn = read_right_turn(store.path(pair.matches))
        images = read_epipolar(pair.files, turn, store)
        _, matches = read_matches(store.path(pair.matches))
        candidates = find_candidates(pair.files, turn, params, store)
        dense = stored_parallax(pair.parallax, store).dense()
        scale = min(1.0, MAX_WIDTH / (2 * images.left.shape[1]))
        write_preview(
            path, draw_pair(images, candidates, matches, dense, params.verification, scale)
        )

    return store.make(
        Recipe(ProductKind.QUICKLOOK, pair_scope(pair.files.id), pair.made, params), write
    )


def write_ties_preview(path: Path, stop: MatchedStop, ties: Ties, params: AlignmentParams) -> None:
    """Every two pairs of a stop with their ties, coloured by their agreement."""
    rest = Pose.identity(stop.stop.frame, stop.stop.frame)
    share = misfits(ties, _geometries(stop.pairs), rest, None, params)
    write_sheet(path, [FigureImage.of(pair) for pair in stop.pairs], ties, share)


def write_sheet(path: Path, images: Iterable[FigureImage], ties: Ties, misfit: PerPoint) -> None:
    """Every two images joined by ties, side by side, the ties coloured by their misfit."""
    write_preview(path, draw_sheet(images, ties, misfit))


def write_link_preview(
    path: Path, earlier: StopViews, later: StopViews, link: SiteLink, params: CrossSiteParams
) -> None:
    """The result, both stops from above in the relative pose of the link, and all its ties.

    The earlier stop is left, and red in the overlay.
    """
    if link.fit is None:
        above = np.zeros((16, MAX_WIDTH, 3), np.uint8)  # no pose was found for the overlay
    else:
        above = _from_above(earlier, later, link.fit)
    pairs = [pair for views in (earlier, later) for pair in views.stop.pairs]
    alignment = params.trials.alignment
    share = misfits(
        link.ties, _geometries(pairs), link.earlier_from_later, link.covariance, alignment
    )
    sheet = draw_sheet(map(FigureImage.of, pairs), link.ties, share, first_left=True)
    heads = [caption(text, sheet.shape[1]) for text in (str(link), FROM_ABOVE)]
    write_preview(path, np.vstack([*heads, _stack(above, sheet)]))


ENLARGED = 3
"""Pixels per cell of the bird's-eye view, along either axis."""


def _from_above(earlier: StopViews, later: StopViews, fit: PlaneFit) -> EightBits:
    """Two stops from above, overlaid."""
    over = draw_overlay(earlier.birds_eye, later.birds_eye, fit)
    return over.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)[:, :, ::-1]


def _geometries(pairs: Iterable[MatchedPair]) -> dict[str, EpipolarPair]:
    return {pair.pair_id: pair.geometry for pair in pairs}


def _stack(above: EightBits, below: EightBits) -> EightBits:
    """Two images of the width of the second, stacked."""
    scale = below.shape[1] / above.shape[1]
    size = (below.shape[1], max(1, round(above.shape[0] * scale)))
    return np.vstack([cv2.resize(above, size, interpolation=cv2.INTER_AREA), below])


def write_preview(path: Path, image: EightBits) -> None:
    """Write an image (BGR or BGRA) as PNG, no wider than `MAX_WIDTH`."""
    shrink = MAX_WIDTH / image.shape[1]
    if shrink < 1:
        image = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    encoded, png = cv2.imencode(".png", image, ENCODING)
    if not encoded:
        raise ProductError(f"{path.name} could not be encoded as PNG")
    path.write_bytes(png.tobytes())
