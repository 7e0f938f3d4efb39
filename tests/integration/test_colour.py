"""A simulated Pancam pair and frames through other filters become a map in colour."""

import re
from dataclasses import replace

import numpy as np
import pytest
import rasterio

from solmap.photogrammetry.archive.images.reading import read_colour, read_image
from solmap.photogrammetry.archive.missions import M2020
from solmap.photogrammetry.frames import LSL, Pose
from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.matching.stereo.orientation import turn_in_place
from solmap.photogrammetry.synthetic.downlink import RenderJob
from solmap.photogrammetry.synthetic.scene import WorldParams, make_world
from solmap.photogrammetry.synthetic.traverse import TraverseParams
from solmap.photogrammetry.terrain.dtm.stop_dtm import DtmParams
from solmap.photogrammetry.terrain.orthophoto.rendering import OrthophotoParams
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.formats.documents.archives import read_matches
from solmap.tasks.images.ingest import ingest_downlink
from solmap.tasks.images.pairs import pairs_of
from solmap.tasks.maps import orthophoto as colour
from solmap.tasks.maps.orthophoto import colour_frames, render_colour, render_orthophoto
from solmap.tasks.maps.terrain import build_dtm
from solmap.tasks.network.match import MatchParams, match_stereo_pair
from solmap.tasks.network.orientations import Orientation, OrientedPair
from solmap.tasks.network.singles import drop_repeats
from tests.support.product_readers import read_sources
from tests.support.small_downlink import kept

LANDING = LandingPoint("a simulated plain", 175.47, -14.57, 3_393_000.0, "a test")
ORTHOPHOTO = OrthophotoParams(cell_m=0.02)
TERRAIN = DtmParams(cell_m=0.08)
GAINS = {4: 0.9, 5: 0.6, 6: 0.4}
"""How bright the ground is through each filter, of what L2 shows."""


def parted(data: bytes) -> tuple[bytes, np.ndarray]:
    """Label and pixels of an image file."""
    record = int(re.search(rb"RECORD_BYTES\s*=\s*(\d+)", data)[1])
    start = (int(re.search(rb"\^IMAGE\s*=\s*(\d+)", data)[1]) - 1) * record
    return data[:start], np.frombuffer(data[start:], ">u2")


def through(data: bytes, number: int, seconds: int) -> tuple[str, bytes]:
    """The image that the same camera takes some seconds later through another filter."""
    head, pixels = parted(data)
    clock = re.search(rb'SPACECRAFT_CLOCK_START_COUNT\s*=\s*"(\d+)', data)[1]
    head = head.replace(clock, str(int(clock) + seconds).encode())
    head = re.sub(rb"L2(M\d\")", rf"L{number}\1".encode(), head)
    name = re.search(rb'PRODUCT_ID\s*=\s*"([^"]+)"', head)[1].decode()
    dimmed = np.rint(pixels * GAINS[number]).astype(">u2")
    return f"{name.lower()}.img", head + dimmed.tobytes()


WORLD = WorldParams("plains", TraverseParams(stops=2, spacing_m=(14.0, 15.0)), pancam=True)


def write_downlink(folder, params, seed):
    """A pair with its left camera's frames through L4, L5 and L6, one of which looked elsewhere."""
    world = make_world(params, seed)
    shot = next(s for s in world.shots if s.stop == 0 and s.instrument == "PANCAM")
    folder.mkdir()
    left, right = (RenderJob(shot, eye).run(world) for eye in (Eye.LEFT, Eye.RIGHT))
    for file in (left, right):
        (folder / file.path.rsplit("/", 1)[-1]).write_bytes(file.data)
    for seconds, number in enumerate(GAINS, start=2):
        name, data = through(left.data, number, seconds)
        (folder / name).write_bytes(data)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory):
    folder = tmp_path_factory.mktemp("colour")
    downlink = kept(write_downlink, WORLD, 41)
    workspace = Workspace.open(folder / "store")
    ingest_downlink.fn(downlink, workspace)
    return workspace


@pytest.fixture(scope="module")
def pair(workspace):
    """The pair, matched, with the pose of its label."""
    (files,) = pairs_of(workspace.catalogue.images())
    products = match_stereo_pair.fn(files, MatchParams(), workspace.store)
    geometry, _ = read_matches(workspace.store.path(products.matches))
    rover = geometry.rover_from_pair.target
    level = Pose(LSL, rover, np.eye(3), np.zeros(3)) @ geometry.rover_from_pair
    numbers = (tuple(level.rotation.ravel().tolist()), tuple(level.translation_m.tolist()))
    return OrientedPair(products, Orientation(files.id, *numbers))


def test_the_frames_of_one_pointing_are_found_by_their_filters(workspace, pair):
    entries = workspace.catalogue.images()
    (frame,) = colour_frames([pair], entries, workspace)
    assert frame.filters == (4, 5, 6)
    names = [image.image.scope.name for image in frame.images]
    assert [name[-4:] for name in names] == ["l4m1", "l5m1", "l6m1"]
    without_green = [entry for entry in entries if "L5M" not in entry.id.upper()]
    assert colour_frames([pair], without_green, workspace) == ()


def test_frames_that_repeat_a_pair_are_not_tied_separately(workspace):
    entries = workspace.catalogue.images()
    assert len(entries) == 5
    left = [entry for entry in drop_repeats(entries, workspace) if entry.partner is None]
    assert left == []
    alone = [entry for entry in entries if entry.partner is None]
    (one,) = drop_repeats(alone, workspace)  # of three filters of one pointing
    assert one in alone


def test_a_frame_of_another_direction_is_left_out(workspace, pair, monkeypatch):
    def turned(entry, known):
        image = original(entry, known)
        if image.filter_number != 5:
            return image
        turn = np.array([0.0, 0.0, 1e-3])
        return replace(image, camera=turn_in_place(image.camera, image.stop.frame, turn))

    original = colour.image_record
    monkeypatch.setattr(colour, "image_record", turned)
    assert colour_frames([pair], workspace.catalogue.images(), workspace) == ()


def three_bands(data: bytes) -> bytes:
    """The image as a camera with a colour detector takes it: red, green and blue."""
    head, pixels = parted(data)
    bands = [np.rint(pixels * gain).astype(">u2").tobytes() for gain in DETECTOR]
    return re.sub(rb"(\bBANDS\s*= )1", rb"\g<1>3", head) + b"".join(bands)


def bayer_mosaic(data: bytes) -> bytes:
    """The same before its colours are interpolated: RGGB in every square of two by two."""
    head, pixels = parted(data)
    side = round(pixels.size**0.5)
    line, sample = np.indices((side, side)) % 2
    mosaic = np.rint(pixels.reshape(side, side) * np.array(DETECTOR)[line + sample])
    message = b"  COLOR_FILTER_ARRAY_STATE        = ENCODED "
    plain = re.search(rb"  SAMPLE_BIT_MASK +=[^\r\n]*", head)[0]
    return head.replace(plain, message.ljust(len(plain))) + mosaic.astype(">u2").tobytes()


DETECTOR = (1.2, 1.0, 0.8)
"""Brightness of the ground in red, green and blue, of what L2 shows."""


@pytest.mark.parametrize(
    ("change", "cell_m", "alike"),
    # of a Bayer frame a quarter of all pixels saw red: the others are interpolated
    [(three_bands, 0.02, 0.99), (bayer_mosaic, 0.04, 0.98)],
)
def test_colour_frames_make_a_colour_map_automatically(
    workspace, pair, monkeypatch, change, cell_m, alike
):
    monkeypatch.setattr(colour, "MER", M2020)  # its detectors have no colours
    monkeypatch.setattr(colour, "CAMERA", "MASTCAM")
    assert colour_frames([pair], workspace.catalogue.images(), workspace) == ()  # one band
    data = workspace.store.path(pair.products.files.left.image).read_bytes()
    name = f"{pair.products.files.id}.img"
    seen, plain = read_image(change(data), name).pixels, read_image(data, name).pixels
    # what is matched shows no chequers: edges of rocks are smoothed, nothing else
    assert np.isclose(seen, plain, rtol=0.1, atol=20).mean() > 0.99
    monkeypatch.setattr(colour, "read_colour", lambda data, name: read_colour(change(data), name))
    (frame,) = colour_frames([pair], workspace.catalogue.images(), workspace)
    assert frame.filters is None
    check_colours(workspace.store, pair, (frame,), DETECTOR, cell_m, alike)


def test_the_colour_map_is_registered_to_the_grey_map(workspace, pair):
    frames = colour_frames([pair], workspace.catalogue.images(), workspace)
    sources = check_colours(workspace.store, pair, frames, GAINS.values())
    _, source, names = read_sources(workspace.store.path(sources))
    assert names == (pair.products.files.id,)
    assert set(np.unique(source)) == {0, 1}


def check_colours(store, pair, frames, gains, cell_m=ORTHOPHOTO.cell_m, alike=0.99):
    """Hold a map in colour against that in grey; what each cell of that came from."""
    params = replace(ORTHOPHOTO, cell_m=cell_m)
    dtm = build_dtm.fn(pair.products.files.stop, (pair,), TERRAIN, LANDING, store)
    grey, sources = render_orthophoto.fn(dtm, (pair,), params, LANDING, store)
    made = render_colour.fn(dtm, frames, params, LANDING, store)
    with rasterio.open(store.path(grey)) as one, rasterio.open(store.path(made)) as other:
        assert one.bounds == other.bounds
        assert other.tags()["FILTERS"] == ("RGB" if frames[0].filters is None else "L4, L5, L6")
        png = one.read(1).astype(float) * one.scales[0] + one.offsets[0]
        seen = one.read(1) > 0
        for index, gain in enumerate(gains, start=1):
            stored = other.read(index)
            band = stored * other.scales[index - 1] + other.offsets[index - 1]
            both = seen & (stored > 1) & (stored < 255)
            assert both.sum() > 0.9 * seen.sum()
            # a step of grey is 1/254 of each band's range; brightness runs over thousands
            np.testing.assert_allclose(np.median(band[both] / png[both]), gain, rtol=0.02)
            assert np.corrcoef(band[both], png[both])[0, 1] > alike
    return sources
