"""Two stops as one instrument, from files to a view that terrain can use."""

from pathlib import Path

import numpy as np
import pytest

from solmap.photogrammetry.archive.images.reading import read_image
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.stereo.wide_baseline import WideParams
from solmap.photogrammetry.synthetic.downlink import RenderJob
from solmap.photogrammetry.synthetic.scene import World, WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.products.catalogue.images import ImageFile
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.archives import read_matches
from solmap.products.model import ProductKind, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairFiles
from solmap.tasks.maps.far_ground import match_wide_pair, read_wide_view
from solmap.tasks.network.match import MatchParams, match_stereo_pair
from solmap.tasks.network.orientations import Orientation, OrientedPair
from solmap.tasks.scopes import image_scope

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def oriented(world: World, stop: int, pair: int, store: ProductStore) -> OrientedPair:
    """A pair taken, matched, and oriented as it truly stood."""
    shot = world.shot(stop, pair)
    files, images = [], []
    for eye in (Eye.LEFT, Eye.RIGHT):
        taken = RenderJob(shot, eye).run(world)
        image = read_image(taken.data, taken.path.rpartition("/")[2]).image
        recipe = Recipe(ProductKind.IMAGE, image_scope(image.id), ())
        data = taken.data

        def write(path: Path, data: bytes = data) -> None:
            path.write_bytes(data)

        files.append(ImageFile(store.make(recipe, write)))
        images.append(image)
    left = images[0]
    pair_files = PairFiles(left.id, left.stop, left.sol, left.instrument, *files)
    matched = match_stereo_pair.fn(pair_files, MatchParams(), store)
    geometry, _ = read_matches(store.path(matched.matches))
    true = world.true_lsl_from_label_rover(shot) @ geometry.rover_from_pair
    orientation = Orientation(
        left.id, tuple(true.rotation.ravel().tolist()), tuple(true.translation_m.tolist())
    )
    return OrientedPair(matched, orientation)


def test_two_pairs_make_one_view_of_far_ground(tmp_path):
    traverse = TraverseParams(stops=2, spacing_m=(9.0, 10.0), local_solar_hours=(11.0, 11.3))
    world = make_world(WorldParams("hills", traverse=traverse), 8)
    store = Workspace.open(tmp_path).store
    eyes = [oriented(world, stop, pair, store) for stop, pair in ((0, 1), (1, 2))]
    wide = match_wide_pair.fn(eyes[0], eyes[1], WideParams(), store)
    assert match_wide_pair.fn(eyes[0], eyes[1], WideParams(), store) == wide  # looked up
    view = read_wide_view(wide, store)
    geometry = view.geometry
    assert 9.0 < geometry.base_m < 10.0
    assert view.image.shape == view.parallax.shape == view.mask.shape
    known = np.isfinite(view.parallax)
    range_m = geometry.focal_px * geometry.base_m / view.parallax[known]
    assert ((range_m > 100) & (range_m < 300)).sum() > 20_000
    assert np.isfinite(view.sigma_px[known]).all()
    assert view.lsl_from_pair.translation_m == pytest.approx(
        np.array(eyes[1].orientation.translation_m), abs=1e-6
    )  # the eye on the left
