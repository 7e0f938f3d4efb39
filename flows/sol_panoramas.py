"""Draw the panoramas of a sol's stops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from prefect.futures import PrefectFuture

from solmap.flows.outcomes import settled
from solmap.flows.sol_inputs import SolInputs, SolReport
from solmap.photogrammetry.errors import TerrainError
from solmap.photogrammetry.imagery import StopId
from solmap.products.model import ProductKind, ProductRef
from solmap.tasks.orientations import read_orientations
from solmap.tasks.pairs import PairProducts
from solmap.tasks.panorama import draw_panorama, oriented_frames


def draw_panoramas(
    inputs: SolInputs,
    orientations: ProductRef,
    matched: Mapping[StopId, list[PairProducts]],
    mapped: Mapping[StopId, list[ProductRef]],
    report: SolReport,
) -> dict[StopId, tuple[ProductRef, ProductRef]]:
    """The panorama of every stop of the window, and what it knows of the ground."""
    wanted, workspace = inputs.config.panoramas, inputs.workspace
    if not wanted.enabled:
        return {}
    poses = read_orientations(
        orientations, workspace.store, [str(one.stop) for one in inputs.window]
    )
    futures: dict[StopId, PrefectFuture[Any]] = {}
    for stop in (one.stop for one in inputs.window if str(one.stop) in poses):
        entries = workspace.catalogue.images(inputs.mission.mission, stop=str(stop))
        frames = oriented_frames(
            [entry for entry in entries if entry.sol <= inputs.sol],
            {pair.files.id: pair.matches for pair in matched.get(stop, ())},
            poses[str(stop)].orientations,
            wanted.drawing.eye,
            workspace,
        )
        dtm = {ref.kind: ref for ref in mapped.get(stop, ())}.get(ProductKind.DTM)
        if frames:
            futures[stop] = draw_panorama.submit(stop, frames, dtm, wanted.drawing, workspace.store)
    done, failed = settled(f"sol {report.sol}: draw the panoramas", futures)
    causes = {f"panorama of {stop}": cause for stop, cause in failed.items()}
    report.tell("draw", causes, "no", TerrainError)
    return done
