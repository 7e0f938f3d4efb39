"""`solmap stl`: the terrain of a stop as a solid that can be printed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.console import fail, workspace_of
from solmap.flows.options import StoreOption, store_of


def stl(
    stop: Annotated[str, typer.Argument(help="As `solmap positions` names it")],
    file: Annotated[Path, typer.Argument(help="The STL file to write")],
    base_m: Annotated[
        float, typer.Option(min=0, help="How far the base lies below; 0: no base")
    ] = 0.5,
    tolerance_m: Annotated[float, typer.Option(min=0.005, help="Of the surface, metres")] = 0.05,
    store: StoreOption = None,
) -> None:
    """Write the terrain model of a stop as a watertight solid (binary STL, metres)."""
    from solmap.photogrammetry.errors import PhotogrammetryError  # noqa: PLC0415 - slow to import
    from solmap.photogrammetry.terrain.printable import SolidParams, solid_of  # noqa: PLC0415
    from solmap.products.errors import ProductError, ProductNotFoundError  # noqa: PLC0415
    from solmap.products.formats.mesh.stl import stl_bytes  # noqa: PLC0415
    from solmap.products.formats.raster.raster import read_dtm  # noqa: PLC0415
    from solmap.products.model import ProductKind  # noqa: PLC0415

    workspace = workspace_of(store_of(store))
    try:
        ref = workspace.catalogue.layer(stop, ProductKind.DTM).ref
        solid = solid_of(read_dtm(workspace.store.path(ref)), SolidParams(tolerance_m, base_m))
        file.write_bytes(stl_bytes(solid))
    except ProductNotFoundError:
        fail(f"no stop {stop} has a terrain model; `solmap products` lists those that have one")
    except (PhotogrammetryError, ProductError, OSError) as error:
        fail(str(error))
    kind = "watertight" if solid.is_watertight else "open"
    typer.echo(
        f"{file}: {len(solid.triangles)} triangles, {kind}, {abs(solid.volume_m3):.1f} m3 inside"
    )
