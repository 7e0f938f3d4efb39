"""Files for other programs: cameras, epipolar images, ties, and rasters of pairs."""

from __future__ import annotations

from collections.abc import Iterator

from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.oriented_images import OrientedMission
from solmap.products.catalogue.workspace import Workspace
from solmap.products.export.asp import csm_state, tsai_text
from solmap.products.export.camera_network import CameraNetwork, camera_network, view_image
from solmap.products.export.colmap import colmap_texts
from solmap.products.export.isis import control_network_text
from solmap.products.export.pair_rasters import pair_rasters
from solmap.products.export.selection import EPIPOLAR, EXCHANGE, Selection


def exchange_files(
    entry: MissionEntry, selection: Selection, workspace: Workspace
) -> Iterator[tuple[str, bytes | str]]:
    """Names and contents of the selected files of a map among `EXCHANGE`.

    CSM states and an ISIS control network are body-fixed: there are none for a map that is not tied
    to the lander.

    Raises:
        ProductNotFoundError: the map has not been adjusted yet.
    """
    if not any(selection.has(word) for word in EXCHANGE):
        return
    name, mission = entry.mission, OrientedMission.latest(entry.mission, workspace)
    images = [image for image in workspace.catalogue.images(name) if selection.has_image(image)]
    if any(selection.has(word) for word in ("colmap", "asp", "isis")):
        network = camera_network(mission, {image.id for image in images})
        for view in network.views:
            yield f"{EPIPOLAR}/{name}/{view.name}.png", view_image(view, mission)
        if selection.has("asp"):
            yield from _asp(network, entry)
        if selection.has("colmap"):
            for file, text in colmap_texts(network).items():
                yield f"colmap/{name}/{file}", text
        if selection.has("isis") and not entry.landing.origin:
            made_at = workspace.store.made_at(mission.ref)
            text = "".join(control_network_text(network, name, entry.landing, made_at))
            yield f"isis/{name}_control.pvl", text
    if selection.has("pds"):
        for image in images:
            yield from _rasters(image, name, mission)


def _asp(network: CameraNetwork, entry: MissionEntry) -> Iterator[tuple[str, str]]:
    for view in network.views:
        yield f"asp/{entry.mission}/{view.name}.tsai", tsai_text(view)
        if not entry.landing.origin:
            yield f"asp/{entry.mission}/{view.name}.json", csm_state(view, entry.landing)


def _rasters(image: ImageEntry, name: str, mission: OrientedMission) -> Iterator[tuple[str, bytes]]:
    """The rasters of the pair of a left image; empty for other images."""
    pair = mission.pairs.get(image.id)
    partners = mission.stereo_partners(image) if pair and image.partner else None
    if pair is None or partners is None:
        return
    record, stop = mission.record(image), mission.stops[pair.stop]
    rover_from_pair = stop.lsl_from_rover.inverse @ pair.lsl_from_pair
    made = pair_rasters(record, partners.geometry, partners.dense, rover_from_pair)
    for file, content in made:
        yield f"pds/{name}/{file}", content
