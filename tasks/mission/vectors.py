"""The vector layers of a mission: traverse, stops, footprints, pointing lines and tie points."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from solmap.photogrammetry.adjustment.model.adjusted_network import USED, AdjustedStop
from solmap.photogrammetry.adjustment.quality.network_quality import error_ellipse
from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.photogrammetry.frames import Pose
from solmap.photogrammetry.imagery import RoverImage, StopId
from solmap.photogrammetry.mars import map_from_lsl
from solmap.photogrammetry.terrain.measure.oriented_image import apply_pointing
from solmap.photogrammetry.terrain.visibility.footprints import (
    FootprintParams,
    Ground,
    footprint,
    pointing_line,
)
from solmap.products.catalogue.catalogue import ImageEntry
from solmap.products.catalogue.images import image_record
from solmap.products.catalogue.workspace import Workspace
from solmap.products.crs import LandingPoint
from solmap.products.errors import ProductError, cause_of
from solmap.products.formats.documents.network import (
    NetworkProduct,
    cached_whole_network,
    read_network,
)
from solmap.products.formats.vector.geojson import (
    Feature,
    WrittenFeature,
    write_features,
    written_features,
)
from solmap.products.model import ProductKind, ProductRef, Recipe
from solmap.tasks.scopes import region_scope
from solmap.tasks.stage import stage

log = logging.getLogger(__name__)
WHEELS_M = 0.294
"""The ground below the rover origin on level ground (VICAR's default ground plane)."""

POSITIONS = (ProductKind.TRAVERSE, ProductKind.STOPS)
VECTORS = (*POSITIONS, ProductKind.TIE_POINTS, ProductKind.FOOTPRINTS, ProductKind.POINTING)


@stage(task_run_name="vectors-{mission}")
def draw_vectors(  # noqa: PLR0913 - all that features describe
    mission: str,
    network: ProductRef,
    entries: Sequence[ImageEntry],
    params: FootprintParams,
    landing: LandingPoint,
    workspace: Workspace,
    *,
    kinds: Collection[ProductKind] = VECTORS,
    sigmas_m: Mapping[StopId, float] | None = None,
) -> list[ProductRef]:
    """Draw the vector layers of a mission, or some of them, from its network and images.

    `sigmas_m` are standard deviations of telemetry's positions relative to the map's origin.
    """
    origins = tuple((str(stop), round(sigma_m, 2)) for stop, sigma_m in (sigmas_m or {}).items())
    read = _Reading(network, entries, workspace)
    images = tuple(entry.ref for entry in entries)
    pairing = tuple((entry.partner, entry.unpaired_because, entry.repeats) for entry in entries)
    made = []
    for kind, inputs, extra, features in (
        (ProductKind.TRAVERSE, (), None, lambda _: traverse_features(read.network)),
        (ProductKind.STOPS, (), origins, lambda _: stop_features(read.network, dict(origins))),
        (ProductKind.TIE_POINTS, (), "sols", lambda _: tie_point_features(read.network)),
        (ProductKind.FOOTPRINTS, images, pairing, partial(read.outlines, footprint_feature)),
        (ProductKind.POINTING, images, pairing, partial(read.outlines, pointing_feature)),
    ):
        if kind not in kinds:
            continue
        recipe = Recipe(kind, region_scope(mission), (network, *inputs), (params, landing, extra))

        def write(path: Path, features: Any = features, recipe: Recipe = recipe) -> None:  # noqa: ANN401 - a function
            write_features(path, features(recipe), landing, tags={"mission": mission})

        made.append(workspace.store.make(recipe, write))
    return made


class _Reading:
    """The network and labels, read once and only if a layer has to be drawn."""

    def __init__(
        self, network: ProductRef, entries: Sequence[ImageEntry], workspace: Workspace
    ) -> None:
        self._ref, self._entries, self._workspace = network, entries, workspace
        self._network: NetworkProduct | None = None

    @property
    def network(self) -> NetworkProduct:
        if self._network is None:
            self._network = cached_whole_network(self._ref, self._workspace.store)
        return self._network

    def outlines(self, draw: Any, recipe: Recipe) -> Iterator[Feature | WrittenFeature]:  # noqa: ANN401
        """Features of the images, those that the published layer has already as they stand."""
        written = self._still_valid(recipe)
        params = recipe.params[0]
        poses = {stop.stop: stop.lsl_from_rover for stop in self.network.adjusted.stops}
        pointings = {pair.pair_id: pair.pointing for pair in self.network.adjusted.pairs}
        for entry in self._entries:
            if entry.repeats is not None:  # drawn with the image that replaces it
                continue
            if entry.id in written:
                yield {**written[entry.id], "properties": _image_properties(entry)}
                continue
            try:
                image = image_record(entry, self._workspace)
                if image.stop not in poses:
                    continue
                pointing = pointings.get(entry.id, pointings.get(entry.partner or ""))
                if pointing is not None:
                    image = apply_pointing(image, pointing)
                drawn = draw(image, entry, poses[image.stop], params)
            except (PhotogrammetryError, ArithmeticError, ValueError) as error:  # of this image
                log.warning("%s is not drawn: %s", entry.id, cause_of(error))
                continue
            if drawn is not None:
                yield drawn

    def _still_valid(self, recipe: Recipe) -> dict[str, WrittenFeature]:
        """Features of the published layer whose image, orientation and parameters did not change.

        A stop that two networks take from the same product has the same orientations in both.
        """
        store, document = self._workspace.store, recipe.document
        latest = self._workspace.catalogue.latest(recipe.scope.name, recipe.kind)
        if latest is None:
            return {}
        published = ProductRef(recipe.kind, recipe.scope, latest)
        try:
            old = store.provenance(published)["recipe"]
            if (old["params"][:2], old["science"]) != (document["params"][:2], document["science"]):
                return {}
            _, name, digest = old["inputs"][0].split("/")
            network = replace(self._ref, scope=replace(self._ref.scope, name=name), digest=digest)
            before = read_network(network, store).references
            features = written_features(store.path(published))
        except (ProductError, LookupError, ValueError) as error:  # pruned, or of another version
            log.info("%s is drawn again: %s", recipe.kind, cause_of(error))
            return {}
        now = read_network(self._ref, store).references
        stops = {name for name, ref in now.items() if before.get(name) == ref}
        same = set(old["inputs"]) & set(document["inputs"])
        images = {
            entry.id
            for entry, text in zip(self._entries, document["inputs"][1:], strict=True)
            if entry.stop in stops and text in same
        }
        return {one["id"]: one for one in features if one["id"] in images}


def traverse_features(network: NetworkProduct) -> list[Feature]:
    """The traverse by telemetry and as adjusted; a single stop has no line."""
    stops = [stop.stop for stop in network.adjusted.stops]
    if len(stops) < 2:  # noqa: PLR2004 - a line has two ends
        return []
    solutions = {
        "telemetry": [network.telemetry[stop].translation_m for stop in stops],
        "adjusted": [stop.lsl_from_rover.translation_m for stop in network.adjusted.stops],
    }
    return [
        Feature(
            "LineString",
            map_from_lsl(np.array(places)),
            {
                "solution": solution,
                "length_m": round(_length_m(places), 3),
                "stops": len(places),
            },
            id=solution,
        )
        for solution, places in solutions.items()
    ]


def stop_features(
    network: NetworkProduct, sigmas_m: Mapping[str, float] | None = None
) -> Iterator[Feature]:
    """Every stop at its positions by telemetry and adjustment, with its ellipse.

    The ellipse is relative to the held stop, `origin_sigma_m` to the origin of the map.
    """
    for stop in network.adjusted.stops:
        telemetry = network.telemetry[stop.stop].translation_m
        adjusted = stop.lsl_from_rover.translation_m
        known = {
            "stop": str(stop.stop),
            "site": stop.stop.site,
            "drive": stop.stop.drive,
            "sols": list(network.sols[stop.stop]),
            "moved_m": round(float(np.linalg.norm(adjusted - telemetry)), 4),
            "origin_sigma_m": (sigmas_m or {}).get(str(stop.stop)),
        }
        yield Feature(
            "Point",
            map_from_lsl(telemetry[None]),
            {**known, "solution": "telemetry"},
            id=f"{stop.stop}-telemetry",
        )
        yield Feature(
            "Point",
            map_from_lsl(adjusted[None]),
            {**known, "solution": "adjusted", **_certainty(stop)},
            id=f"{stop.stop}-adjusted",
        )


def _certainty(stop: AdjustedStop) -> dict[str, Any]:
    """Standard deviations and the 1-sigma error ellipse on the map."""
    (major, minor), azimuth_deg = error_ellipse(stop)
    sigma_ned = stop.sigma_ned_m
    return {
        "held": stop.held,
        "held_by": stop.held_by,
        "sigma_north_m": round(float(sigma_ned[0]), 4),
        "sigma_east_m": round(float(sigma_ned[1]), 4),
        "sigma_down_m": round(float(sigma_ned[2]), 4),
        "ellipse_semi_major_m": round(major, 4),
        "ellipse_semi_minor_m": round(minor, 4),
        "ellipse_azimuth_deg": round(azimuth_deg, 1),
    }


def tie_point_features(network: NetworkProduct) -> Iterator[Feature]:
    """The tie points of the last adjustment between pairs, with residuals and sols."""
    ties = network.adjusted.ties
    sols = {pair.pair_id: network.sols[pair.stop] for pair in network.adjusted.pairs}
    used = np.flatnonzero(ties.status == USED)
    order = used[np.argsort(ties.observations.point[used], kind="stable")]
    numbers, starts = np.unique(ties.observations.point[order], return_index=True)
    ends = np.append(starts[1:], len(order)) if len(starts) else starts
    for number, start, end in zip(numbers.tolist(), starts, ends, strict=True):
        rows, point, kind = order[start:end], ties.points[number], ties.kinds[number]
        if len(rows) < 2 or not np.isfinite(point).all():  # noqa: PLR2004 - joins nothing
            continue
        sigma_m = math.sqrt(max(float(np.trace(ties.covariances[number])), 0.0))
        pairs = [ties.observations.pair_ids[ties.observations.pair[row]] for row in rows]
        properties = {
            "kind": str(kind),
            "pairs": pairs,
            "sols": sorted({sol for pair in pairs for sol in sols.get(pair, ())}),
            "residual_px": round(float(np.sqrt(np.nanmean(ties.residuals_px[rows] ** 2))), 3),
            "sigma_m": round(sigma_m, 4),
        }
        yield Feature("Point", map_from_lsl(point[None]), properties, id=str(number))


def footprint_feature(
    image: RoverImage, entry: ImageEntry, lsl_from_rover: Pose, params: FootprintParams
) -> Feature | None:
    """The ground in an image; None where there is none."""
    outline = footprint(
        image.camera,
        (image.samples, image.lines),
        lsl_from_rover,
        _ground(lsl_from_rover),
        params.max_range_m,
    )
    distinct = np.unique(np.round(outline, 3), axis=0)
    if len(distinct) < 3:  # noqa: PLR2004 - no area
        return None
    return Feature("Polygon", outline, _image_properties(entry), id=entry.id)


def pointing_feature(
    image: RoverImage, entry: ImageEntry, lsl_from_rover: Pose, params: FootprintParams
) -> Feature:
    """Line from the camera to the ground in the middle of the image."""
    line = pointing_line(
        image.camera,
        (image.samples, image.lines),
        lsl_from_rover,
        _ground(lsl_from_rover),
        params.max_range_m,
    )
    return Feature("LineString", line, _image_properties(entry), id=entry.id)


def _ground(lsl_from_rover: Pose) -> Ground:
    below = lsl_from_rover.apply(np.array([[0.0, 0.0, WHEELS_M]]))[0]
    return Ground(elevation_m=-float(below[2]))


def _image_properties(entry: ImageEntry) -> dict[str, Any]:
    return {
        "image": entry.id,
        "instrument": entry.instrument,
        "eye": entry.eye,
        "sol": entry.sol,
        "stop": entry.stop,
        "partner": entry.partner,
        "unpaired_because": entry.unpaired_because,
    }


def _length_m(places: Iterable[np.ndarray]) -> float:
    steps = np.diff(np.array(list(places)), axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
