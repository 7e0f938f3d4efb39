"""Panoramas of the store of true images: their orientations are the true ones."""

from __future__ import annotations

from solmap.photogrammetry.imagery import Eye
from solmap.photogrammetry.terrain.orthophoto.panorama import PanoramaParams
from solmap.products.catalogue.catalogue import latest_network
from solmap.products.catalogue.oriented_images import matches_of
from solmap.products.catalogue.workspace import Workspace
from solmap.products.formats.documents.network import cached_whole_network
from solmap.products.model import ProductKind
from solmap.tasks.maps.panorama import draw_panorama, oriented_frames
from solmap.tasks.mission.publish import layer_of
from solmap.tasks.network.orientations import Orientation

SOL = 156


def publish_panoramas(workspace: Workspace, eye: Eye = Eye.LEFT) -> None:
    """Draw the panorama of every stop and publish it."""
    network = cached_whole_network(latest_network("MER2", workspace.catalogue), workspace.store)
    layers, grounds = [], []
    for stop in (one.stop for one in network.adjusted.stops):
        entries = workspace.catalogue.images("MER2", str(stop))
        matches = {
            entry.id if entry.eye == Eye.LEFT else entry.partner: matches_of(entry, workspace)
            for entry in entries
        }
        poses = [Orientation.of(pair) for pair in network.adjusted.pairs if pair.stop == stop]
        frames = oriented_frames(entries, matches, poses, eye, workspace)
        dtm = next(
            layer.ref
            for layer in workspace.catalogue.layers("MER2")
            if (layer.ref.kind, layer.ref.scope.name) == (ProductKind.DTM, str(stop))
        )
        params = PanoramaParams(eye=eye)
        landing = workspace.catalogue.mission("MER2").landing
        image, ground = draw_panorama.fn(stop, frames, dtm, params, landing, workspace.store)
        layers.append(layer_of("MER2", image, (SOL,), workspace))
        grounds.append(ground)
    workspace.catalogue.publish(layers=layers, pointers=grounds)
