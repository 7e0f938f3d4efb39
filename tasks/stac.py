"""The STAC catalogue, brought up to date with what was just published."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from solmap.products.catalogue.catalogue import ImageEntry, MissionEntry
from solmap.products.catalogue.workspace import Workspace
from solmap.products.model import Layer, ScopeLevel
from solmap.products.reports.stac import AcquisitionTimes, write_catalogue, write_items


def update_stac(mission: MissionEntry, fresh: Sequence[Layer], workspace: Workspace) -> None:
    """Write the items of fresh layers, and the collection and catalogue that list all latest."""
    if not fresh:
        return
    images, catalogue = workspace.catalogue.images(mission.mission), workspace.catalogue
    write_items(((layer, _taken(layer, images)) for layer in fresh), mission, workspace.store)
    times = [image.start_time for image in images]
    layers = catalogue.layers(mission.mission)
    write_catalogue(
        catalogue.missions(), layers, AcquisitionTimes.of(fresh[0], times), workspace.store
    )


def _taken(layer: Layer, images: Iterable[ImageEntry]) -> AcquisitionTimes:
    """When the images behind a layer were taken: those of its stop and sols."""
    of_stop = layer.ref.scope.level is ScopeLevel.STOP
    return AcquisitionTimes.of(
        layer,
        (
            image.start_time
            for image in images
            if image.sol in layer.sols and (not of_stop or image.stop == layer.ref.scope.name)
        ),
    )
