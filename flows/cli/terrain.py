"""`solmap dip` and `solmap stl`: strike and dip, and the terrain of a stop as a solid to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.cli.console import (
    JsonOption,
    PipelineOption,
    StoreOption,
    fail,
    print_line,
    show_rows,
    workspace_of,
)

dip = typer.Typer(name="dip", help="Strike and dip of planes.", no_args_is_help=True)

Stop = Annotated[str, typer.Argument(help="As `solmap positions` names it")]
ANGLES = ["strike_deg", "sigma_strike_deg", "dip_deg", "sigma_dip_deg"]


@dip.command()
def ground(
    stop: Stop,
    corner: Annotated[
        list[str], typer.Option(help="Corner of the outline, `EAST,NORTH` in metres; in order")
    ],
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Strike and dip of the ground inside an outline, from the stop's terrain model."""
    from solmap.flows.dips import dip_of_ground  # noqa: PLC0415 - slow to import
    from solmap.photogrammetry.terrain.measure.strike_dip import CellPlaneParams  # noqa: PLC0415

    found = dip_of_ground(stop, _corners(corner), CellPlaneParams(), workspace_of(store))
    show_rows([found.row()], [*ANGLES, "dip_direction_deg", "rms_m", "cells"], as_json)


@dip.command()
def rocks(
    stop: Stop,
    pipeline: PipelineOption = None,
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Strike and dip of the planar facets of rocks that a stop's pairs see, put on the map."""
    from solmap.config.pipeline import load_pipeline  # noqa: PLC0415 - slow to import
    from solmap.config.settings import Settings  # noqa: PLC0415
    from solmap.flows.dips import dips_of_rocks  # noqa: PLC0415 - slow to import

    rows = dips_of_rocks(
        stop, load_pipeline(pipeline or Settings().pipeline).models.facets, workspace_of(store)
    )
    columns = [*ANGLES, "length_m", "width_m", "distance_m", "east", "north", "pair"]
    if not rows and not as_json:
        fail(f"the pairs of {stop} show no facet that is steep, flat and large enough")
    show_rows(rows, columns, as_json)


def _corners(texts: list[str]) -> list[tuple[float, float]]:
    try:
        pairs = [tuple(float(part) for part in text.split(",")) for text in texts]
        return [(east, north) for east, north in pairs]
    except ValueError:
        fail(f"corners are given as `--corner EAST,NORTH` in metres, not {' '.join(texts)}")


def stl(
    stop: Annotated[str, typer.Argument(help="As `solmap positions` names it")],
    file: Annotated[Path, typer.Argument(help="The STL file to write")],
    base_m: Annotated[
        float,
        typer.Option(min=0, max=1000, help="How far the base lies below; 0: no base"),
    ] = 0.5,
    tolerance_m: Annotated[
        float, typer.Option(min=0.005, max=100, help="Largest error of the surface, metres")
    ] = 0.05,
    store: StoreOption = None,
) -> None:
    """Write the terrain model of a stop as a watertight solid (binary STL, metres)."""
    from solmap.photogrammetry.terrain.mesh.solid import SolidParams, build_solid  # noqa: PLC0415
    from solmap.products.errors import ProductNotFoundError  # noqa: PLC0415
    from solmap.products.formats.mesh.stl import stl_bytes  # noqa: PLC0415
    from solmap.products.formats.raster.raster import read_dtm  # noqa: PLC0415
    from solmap.products.model import ProductKind  # noqa: PLC0415

    workspace = workspace_of(store)
    try:
        ref = workspace.catalogue.layer(stop, ProductKind.DTM).ref
    except ProductNotFoundError:
        fail(f"no stop {stop} has a terrain model; `solmap products` lists those that have one")
    solid = build_solid(read_dtm(workspace.store.path(ref)), SolidParams(tolerance_m, base_m))
    file.write_bytes(stl_bytes(solid))
    kind = "watertight" if solid.is_watertight else "open"
    print_line(
        f"{file}: {len(solid.triangles)} triangles, {kind}, {abs(solid.volume_m3):.1f} m3 inside"
    )
