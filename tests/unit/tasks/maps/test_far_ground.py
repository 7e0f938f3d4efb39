"""Which pairs of two stops are used as one instrument."""

import numpy as np
import pytest

from solmap.photogrammetry.cameras.epipolar import EpipolarPair
from solmap.photogrammetry.frames import Frame, FrameKind, Pose, rover_frame
from solmap.photogrammetry.imagery import StereoMatches, StopId
from solmap.photogrammetry.matching.stereo.wide_baseline import WideParams
from solmap.products.catalogue.images import ImageFile
from solmap.products.formats.documents.archives import write_matches
from solmap.products.model import ProductKind, Recipe
from solmap.products.store.product_store import ProductStore
from solmap.tasks.images.pairs import PairFiles, PairProducts
from solmap.tasks.maps.far_ground import choose_wide_pairs
from solmap.tasks.network.orientations import Orientation, OrientedPair
from solmap.tasks.scopes import pair_scope


@pytest.fixture
def store(tmp_path) -> ProductStore:
    return ProductStore.open(tmp_path)


def looking(
    store: ProductStore,
    name: str,
    azimuth_deg: float,
    east_m: float,
    instrument: str = "NAVCAM",
    ground_m: float = 60.0,
) -> OrientedPair:
    """A pair `east_m` east of the lander that looks level to an azimuth, at ground that far."""
    frame = Frame(FrameKind.PAIR, (10, 0, 0, 1))
    geometry = EpipolarPair(
        Pose.identity(rover_frame(10, 0), frame), 0.2, 1200.0, (511.5, 511.5), 1024, 1024
    )
    left = np.stack(np.meshgrid(*(np.arange(0.0, 1024.0, 64.0),) * 2), axis=-1).reshape(-1, 2)
    parallax_px = np.full(len(left), 1200.0 * 0.2 / ground_m)
    seen = StereoMatches(name, left, parallax_px, np.full(len(left), 0.1))
    matches = store.make(
        Recipe(ProductKind.MATCHES, pair_scope(name)),
        lambda path: write_matches(path, geometry, seen),
    )
    image = ImageFile(matches)
    files = PairFiles(name, StopId("MER2", 10, 0), 155, instrument, image, image)
    a = np.deg2rad(azimuth_deg)
    right, down = np.array([-np.sin(a), np.cos(a), 0.0]), np.array([0.0, 0.0, 1.0])
    forward = np.array([np.cos(a), np.sin(a), 0.0])
    rotation = np.column_stack([right, down, forward])
    place = (0.0, east_m, -1.5)
    orientation = Orientation(name, tuple(rotation.ravel().tolist()), place)
    return OrientedPair(PairProducts(files, matches, matches), orientation)


def chosen(ones, others, store) -> list[tuple[str, str]]:
    pairs = choose_wide_pairs(ones, others, WideParams(), store)
    return [(one.orientation.pair_id, other.orientation.pair_id) for one, other in pairs]


def test_a_pair_is_combined_with_the_one_of_the_same_direction(store):
    ones = [looking(store, "north", 0.0, 10.0)]
    others = [looking(store, f"at-{a}", a, 0.0) for a in (340.0, 5.0, 40.0)]
    assert chosen(ones, others, store) == [("at-5.0", "north")]  # that on the left first


def test_views_along_the_baseline_or_from_one_place_are_not_combined(store):
    away = looking(store, "away", 90.0, 10.0)
    along = looking(store, "along", 90.0, 0.0)
    assert chosen([away], [along], store) == []
    north, same = looking(store, "north", 0.0, 0.0), looking(store, "same", 0.0, 1.0)
    assert chosen([same], [north], store) == []


def test_pairs_that_share_no_far_ground_are_not_combined(store):
    west = looking(store, "west", 0.0, 0.0, ground_m=61.0)
    assert chosen([looking(store, "east", 0.0, 30.0, ground_m=61.0)], [west], store)
    near = [looking(store, f"near-{e}", 0.0, e, ground_m=20.0) for e in (0.0, 30.0)]
    assert chosen(near[:1], near[1:], store) == []
    diverging = [
        looking(store, f"at-{a}", a, e, ground_m=61.0) for a, e in ((346.0, 0.0), (14.0, 30.0))
    ]
    assert chosen(diverging[:1], diverging[1:], store) == []


def test_only_mast_cameras_of_one_kind_are_combined(store):
    navcam = looking(store, "navcam", 0.0, 10.0)
    pancam = looking(store, "pancam", 0.0, 0.0, "PANCAM")
    assert chosen([navcam], [pancam], store) == []
    hazcams = [looking(store, f"h-{e}", 0.0, e, "FRONT_HAZCAM") for e in (0.0, 10.0)]
    assert chosen(hazcams[:1], hazcams[1:], store) == []
