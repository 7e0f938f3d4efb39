"""Frames of one mast swing on their way through the tasks, without a stereo partner."""

import shutil

import cv2
import numpy as np
import pytest

from solmap.photogrammetry.adjustment.model.params import AdjustmentMode
from solmap.photogrammetry.terrain.measure.oriented_image import apply_pointing
from solmap.products.catalogue.images import image_record, image_records
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import read_network
from solmap.products.model import ProductKind, Recipe
from solmap.tasks.images.ingest import ingest_downlink
from solmap.tasks.images.telemetry import read_telemetry
from solmap.tasks.network.adjust import NetworkParams, NetworkStep, adjust_network
from solmap.tasks.network.singles import (
    MonoParams,
    read_singles,
    singles_notes,
    singles_of,
    tie_singles,
)


@pytest.fixture(scope="module")
def spirit(shared_data, tmp_path_factory):
    """(workspace, ties of the single images, network) of Spirit's two frames of sol 1869."""
    folder = tmp_path_factory.mktemp("spirit")
    downlink = folder / "downlink"
    downlink.mkdir()
    for number in ("938", "989"):
        name = f"2n292280{number}effb100p0703l0m1.img"
        shutil.copy(shared_data / "mer_spirit_sol1869_troy" / name, downlink)
    workspace = Workspace.open(folder / "store")
    ingest_downlink.fn(downlink, workspace)
    entries = workspace.catalogue.images()
    ((stop, files),) = singles_of(entries).items()
    ties = tie_singles.fn(stop, files, (), MonoParams(), workspace.store, previews=True)
    telemetry = read_telemetry(image_records(entries, workspace), ())
    step = NetworkStep(
        mission="MER2",
        sol=1869,
        mode=AdjustmentMode.STEPWISE,
        previous=None,
        stops=telemetry.stops,
        new_stops=(stop,),
        window=(stop,),
        pairs=(),
        ties=(),
        links=(),
        singles=(ties,),
    )
    return workspace, ties, adjust_network.fn(step, NetworkParams(), workspace.store)


def test_mono_ties_are_kept_with_the_geometry_of_both_images(spirit):
    workspace, ref, _ = spirit
    kept = read_singles(ref, workspace.store)
    assert [body.pair_id[-23:-16] for body in kept.bodies] == ["2280938", "2280989"]
    assert kept.bodies[0].geometry.mast_in_rover == pytest.approx((0.45781, 0.02779, -1.09668))
    assert len(kept.ties) > 423  # the data README's inliers
    (note,) = singles_notes(kept.bodies[0].stop, kept)
    assert "2 images of mer2-site0137-drive0000 without a stereo pair are tied" in note


def test_a_figure_shows_mono_ties(spirit):
    workspace, ref, _ = spirit
    recipe = Recipe(ProductKind.QUICKLOOK, ref.scope, (ref,))
    png = cv2.imread(str(workspace.store.path(recipe.ref)))
    green = (png[:, :, 1] > 200) & (png[:, :, 0] < 120)
    assert green.sum() > 1000


def test_the_pointing_of_single_frames_is_adjusted(spirit):
    workspace, _, network = spirit
    one, other = read_network(network, workspace.store).adjusted.pairs
    apart = np.degrees(np.linalg.norm(other.pointing - one.pointing))
    assert apart == pytest.approx(0.18, abs=0.02)  # data README: about 0.18 degrees


def test_outlines_of_single_frames_follow_the_adjusted_pointing(spirit):
    workspace, _, network = spirit
    adjusted = {p.pair_id: p for p in read_network(network, workspace.store).adjusted.pairs}
    for entry in workspace.catalogue.images():
        image = image_record(entry, workspace)
        pair = adjusted[entry.id]
        turned = apply_pointing(image, pair.pointing).camera
        middle = np.array([[(image.samples - 1) / 2, (image.lines - 1) / 2]])
        axis = pair.rover_from_pair.rotation[:, 2]
        np.testing.assert_allclose(turned.rays(middle)[0], axis, atol=1e-7)
        np.testing.assert_allclose(turned.centre, pair.rover_from_pair.translation_m, atol=1e-9)
        assert np.linalg.norm(pair.pointing) > 1e-3  # most of it a turn about the view
