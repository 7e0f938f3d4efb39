"""Commands that make worlds with known truth, and evaluate results against it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.cli.console import (
    JsonOption,
    StoreOption,
    print_line,
    progress_shown,
    show_rows,
    store_of,
    workspace_of,
)


def simulate(
    out_dir: Annotated[Path, typer.Argument(help="Folder to write the downlink to")],
    stops: Annotated[int, typer.Option(help="Number of stops", min=1, max=100)] = 2,
    seed: Annotated[int, typer.Option(help="Repeats a world bit for bit", min=0)] = 1,
    terrain: Annotated[str, typer.Option(help="plains, hills or crater")] = "hills",
    *,
    realistic: Annotated[
        bool,
        typer.Option(
            "--realistic",
            help=(
                "Realistic errors of images and telemetry: bent stereo rig, mast errors, "
                "vignetting, dust, lossy coding, the rover in view, opposite suns, slip to 100 %"
            ),
        ),
    ] = False,
) -> None:
    """Make a synthetic downlink with known truth: PDS3 images, vector files and the truth."""
    from solmap.photogrammetry.synthetic.scene import WorldParams, realistic_params  # noqa: PLC0415
    from solmap.photogrammetry.synthetic.traverse import TraverseParams  # noqa: PLC0415

    params = WorldParams(terrain, TraverseParams(stops=stops))
    if realistic:
        params = realistic_params(params, seed)
    from solmap.flows.simulation import write_downlink  # noqa: PLC0415 - after the arguments are checked

    with progress_shown():
        files = write_downlink(out_dir, params, seed)
    print_line(f"{files} files in {out_dir}; {out_dir / 'truth'} is for evaluation only")


def simulate_mission(
    store: StoreOption = None,
    stops: Annotated[int, typer.Option(help="Number of stops", min=2, max=500)] = 500,
    distance: Annotated[float, typer.Option(help="Metres driven", min=1.0, max=1e6)] = 7000.0,
    gaps: Annotated[int, typer.Option(help="Gaps without ties", min=0, max=500)] = 10,
    control: Annotated[
        int, typer.Option(help="Stops per orbital tie; 0: none", min=0, max=500)
    ] = 10,
    seed: Annotated[int, typer.Option(help="Repeats a mission bit for bit", min=0)] = 1,
) -> None:
    """Fill an empty store with a simulated mission of many stops and no images, for the map."""
    root = store_of(store).absolute()
    from solmap.photogrammetry.synthetic.mission import MissionPlan  # noqa: PLC0415

    plan = MissionPlan(stops=stops, distance_m=distance, gaps=gaps, control_every=control)
    from solmap.flows.runtime.engine import start_engine  # noqa: PLC0415 - slow to import

    start_engine(root)
    with progress_shown():
        from solmap.flows.simulation import simulate_into  # noqa: PLC0415 - Prefect is ready now

        summary = simulate_into(root, plan, seed)
    print_line(summary)


def evaluate(
    truth: Annotated[Path, typer.Argument(help="Folder `truth` of a simulated downlink")],
    store: StoreOption = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """State the errors of positions and terrain against a simulated world's truth."""
    from solmap.flows.cli.evaluation import evaluate_positions, evaluate_terrain, true_stops  # noqa: PLC0415
    from solmap.flows.cli.tables import position_rows  # noqa: PLC0415

    workspace = workspace_of(store)
    positions = evaluate_positions(position_rows(workspace), true_stops(truth))
    terrain = evaluate_terrain(workspace, truth)
    if as_json:
        show_rows([{"positions": positions, "terrain": terrain}], [], as_json)
        return
    show_rows(positions, list(positions[0]) if positions else [], as_json)
    show_rows(terrain, list(terrain[0]) if terrain else [], as_json)
