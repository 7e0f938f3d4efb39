"""`solmap orbital` and `solmap control`: orbital images, and places of stops measured in them."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from solmap.flows.cli.console import (
    POSE_FILES,
    JsonOption,
    MissionOption,
    PipelineOption,
    StoreOption,
    input_file,
    mission_of,
    print_line,
    show_rows,
    store_of,
)
from solmap.flows.cli.processing import run

orbital = typer.Typer(
    name="orbital", help="Orbital images under the rover's map.", no_args_is_help=True
)


ShiftSigma = Annotated[
    float,
    typer.Option(
        min=0,
        max=1e6,
        help="Standard deviation of its georeference east and north, metres",
    ),
]
RotationSigma = Annotated[
    float,
    typer.Option(
        min=0,
        max=180,
        help="Standard deviation of its rotation, degrees; below 1 only for a controlled image",
    ),
]
ScaleSigma = Annotated[float, typer.Option(min=0, max=1, help="Standard deviation of its scale")]
poses = typer.Typer(
    name="poses", help="Where sites and stops are, by other sources.", no_args_is_help=True
)
control = typer.Typer(
    name="control", help="Places of stops in orbital images, as control.", no_args_is_help=True
)


@orbital.command("add")
def add_image(  # noqa: PLR0913 - options
    file: Annotated[
        Path, typer.Argument(help="A georeferenced image, any Mars CRS", parser=input_file)
    ],
    mission: MissionOption = None,
    store: StoreOption = None,
    reach: Annotated[
        float,
        typer.Option(help="Largest error of its georeference, metres", min=1.0, max=500.0),
    ] = 300.0,
    *,
    shift_sigma: ShiftSigma = 300.0,
    rotation_sigma: RotationSigma = 3.0,
    scale_sigma: ScaleSigma = 0.01,
    as_claimed: Annotated[
        bool, typer.Option("--as-claimed", help="Trust its georeference; register nothing.")
    ] = False,
    heights: Annotated[
        bool, typer.Option("--dtm", help="It is a terrain model: heights are compared.")
    ] = False,
    no_control: Annotated[
        bool, typer.Option("--no-control", help="Do not find the stops in it one by one.")
    ] = False,
    near: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="About where a map lies that is not tied to the lander: longitude, latitude; by "
            "default the middle of the image",
            metavar="LON LAT",
        ),
    ] = None,
    pipeline: PipelineOption = None,
) -> None:
    """Find where an orbital image lies on the rover's map, and show it there as base layer.

    A map that is not tied to the lander is located in the image instead, and its layers are remade
    in Mars coordinates with the pipeline.
    """
    from solmap.flows.external_data import (  # noqa: PLC0415 - slow to import
        OrbitalOptions,
        add_orbital,
        tie_by_image,
    )
    from solmap.photogrammetry.archive.tables.vector_files import vector_text  # noqa: PLC0415
    from solmap.products.model import origin_of  # noqa: PLC0415
    from solmap.tasks.mission.control import FrameParams  # noqa: PLC0415

    frame = None if no_control else FrameParams(shift_sigma, rotation_sigma, scale_sigma)
    options = OrbitalOptions(
        registered=not as_claimed, reach_m=reach, control=frame, heights=heights, near_deg=near
    )
    root = store_of(store)
    name = mission_of(mission, root)
    if not origin_of(name):
        for line in add_orbital(file, name, root, options):
            print_line(line)
        return
    line, vectors = tie_by_image(file, name, root, options)
    print_line(line)
    with TemporaryDirectory() as folder:
        svf = Path(folder) / vectors.source
        svf.write_text(vector_text(vectors))
        run(None, root, pipeline, [svf])


@poses.callback()
def poses_group() -> None:
    """Where sites and stops are, by other sources."""


@orbital.callback()
def group() -> None:
    """Orbital images under the rover's map."""


@poses.command("add")
def add_stated(
    files: Annotated[list[Path], typer.Argument(help=POSE_FILES, parser=input_file)],
    mission: MissionOption = None,
    store: StoreOption = None,
) -> None:
    """Take poses of sites and stops as priors; the next run places maps by them.

    SPICE kernels of one rover (CK, SPK, FK, LSK, SCLK) are named together.
    """
    from solmap.flows.external_data import add_poses  # noqa: PLC0415 - slow to import

    root = store_of(store)
    for line in add_poses(files, mission_of(mission, root), root):
        print_line(line)


@control.command("add")
def add_measured(
    file: Annotated[
        Path, typer.Argument(help="CSV or GeoJSON: stop, place, sigma_m ...", parser=input_file)
    ],
    mission: MissionOption = None,
    store: StoreOption = None,
    shift_sigma: ShiftSigma = 300.0,
    rotation_sigma: RotationSigma = 3.0,
    scale_sigma: ScaleSigma = 0.01,
) -> None:
    """Take measured places of stops as control; it replaces an earlier file of the same name.

    The places may be on an orbital image with a common georeference error, which the network
    estimates. With all three standard deviations zero they are places on the map itself.
    """
    from solmap.flows.external_data import add_control  # noqa: PLC0415 - slow to import
    from solmap.tasks.mission.control import FrameParams  # noqa: PLC0415

    params = FrameParams(shift_sigma, rotation_sigma, scale_sigma)
    root = store_of(store)
    print_line(add_control(file, mission_of(mission, root), root, params))


@control.command("list")
def show(
    mission: MissionOption = None,
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Every control point, by registration or manual."""
    from solmap.flows.external_data import control_rows  # noqa: PLC0415 - slow to import

    root = store_of(store)
    rows = control_rows(mission_of(mission, root), root)
    columns = ["frame", "stop", "east_m", "north_m", "sigma_m", "up_m", "azimuth_deg"]
    show_rows(rows, columns, as_json)
