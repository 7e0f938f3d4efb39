"""Commands that process downlinks, whole missions, archives' images and manual ties; servers.

Arguments are checked before the engine starts, which takes seconds.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from solmap.flows.cli.console import (
    MISSION_HELP,
    POSE_FILES,
    JsonOption,
    MissionOption,
    PipelineOption,
    StoreOption,
    existing_store,
    fail,
    input_file,
    mission_name,
    mission_of,
    note,
    print_line,
    progress_shown,
    sols_named,
    store_of,
)

PortOption = Annotated[
    int | None,
    typer.Option(
        "--port",
        min=1,
        max=65535,
        help="Port of the map",
        envvar="SOLMAP_PORT",
        show_default="8765",
    ),
]


def run(
    downlink: Annotated[
        Path | None, typer.Argument(help="Folder searched for images and vector files")
    ] = None,
    store: StoreOption = None,
    pipeline: PipelineOption = None,
    places: Annotated[
        list[Path] | None,
        typer.Option(help=f"{POSE_FILES}; may be given again", parser=input_file, metavar="FILE"),
    ] = None,
    *,
    as_json: JsonOption = False,
) -> None:
    """Process a downlink from raw images to published layers; finished work is skipped.

    With only --places, the images in the store get these poses.
    """
    from solmap.tasks.images.folders import NO_FILES, files_of  # noqa: PLC0415 - as above

    stated = [file.resolve() for file in places or ()]
    if downlink is None and not stated:
        fail("name the folder that the downlink's files lie in")
    if downlink is not None and not downlink.is_dir():
        fail(f"{downlink} is not a folder; name the folder with the downlink's files")
    if downlink is not None and not files_of(downlink):
        fail(f"nothing to process in {downlink}: {NO_FILES}")
    if stated:
        from solmap.tasks.images.poses import open_pose_sources  # noqa: PLC0415 - slow to import

        with open_pose_sources(stated):  # refuse what is broken before the engine starts
            pass
    root = (store_of(store) if downlink else existing_store(store)).absolute()
    folder, recipe = downlink.resolve() if downlink else None, _pipeline_of(pipeline)
    if folder and not stated and not _holds_anything_of_use(folder):
        _note_faults(folder, root, as_json=as_json)
    with engine_of(root, "solmap.flows.downlink"):
        from solmap.flows.downlink import process_downlink  # noqa: PLC0415 - Prefect is ready now

        report = process_downlink(folder, root, recipe, places=stated)
    lines = [*report.lines, f"the store is {root}"]
    _print_report(report.warnings, report.failures, lines, as_json=as_json)


def _holds_anything_of_use(folder: Path) -> bool:
    """Whether a folder has at least one readable image file."""
    from solmap.photogrammetry.archive.rig import RIG_FILE  # noqa: PLC0415 - slow to import
    from solmap.tasks.images.files import may_be_of_use  # noqa: PLC0415
    from solmap.tasks.images.folders import files_of  # noqa: PLC0415

    files = files_of(folder)
    return any(may_be_of_use(file, folder) for file in files) or any(folder.rglob(RIG_FILE))


def _note_faults(folder: Path, root: Path, *, as_json: bool) -> NoReturn:
    """Record the fault of each file of a folder in the store, without the engine."""
    from solmap.config.radiometry import load_radiometry  # noqa: PLC0415 - slow to import
    from solmap.config.settings import Settings  # noqa: PLC0415
    from solmap.config.workspace import open_workspace  # noqa: PLC0415
    from solmap.flows.runtime.engine import import_prefect  # noqa: PLC0415

    import_prefect()
    from solmap.tasks.images.ingest import ingest_downlink  # noqa: PLC0415 - imports Prefect

    workspace = open_workspace(root)
    with workspace.run_turn():
        taken = ingest_downlink.fn(folder, workspace, load_radiometry(Settings().instruments))
    failure = f"nothing to process in {folder}: none of its {taken.files} files is a mapping image"
    notes = [note for fault in taken.faults for note in fault.notes]
    _print_report(notes, [failure], [f"the store is {root}"], as_json=as_json)
    raise typer.Exit(1)


def adjust(
    mission: MissionOption = None,
    store: StoreOption = None,
    pipeline: PipelineOption = None,
    *,
    overall: Annotated[  # noqa: ARG001 - the only adjustment of a whole mission
        bool, typer.Option("--overall", hidden=True)
    ] = True,
    as_json: JsonOption = False,
) -> None:
    """Adjust all stops of a mission in one adjustment, and map again the stops that move."""
    root, name = existing_store(store).absolute(), mission_of(mission, store)
    recipe = _pipeline_of(pipeline)
    with engine_of(root, "solmap.flows.overall"):
        from solmap.flows.overall import readjust  # noqa: PLC0415 - Prefect is ready now

        report = readjust(name, root, recipe)
    _print_report([], report.failures, report.notes, as_json=as_json)


def fetch(  # noqa: PLR0913 - options
    mission: Annotated[
        str, typer.Option(help=MISSION_HELP, parser=mission_name, metavar="MISSION")
    ],
    sols: Annotated[str, typer.Option(help="155, 155-157, or several with commas between")],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for the images")],
    instrument: Annotated[
        list[str] | None, typer.Option(help="navcam, pancam, mastcam, hazcam; may be given again")
    ] = None,
    archive: Annotated[
        Path | None, typer.Option(help="TOML file of addresses", envvar="SOLMAP_ARCHIVE")
    ] = None,
    *,
    raw: Annotated[
        bool, typer.Option("--raw", help="Public raw images (MSL, M20) in place of the archive's.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list the images.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Download the stereo pairs of some sols from the archive; a second call resumes."""
    from solmap.config.archive import load_archive  # noqa: PLC0415 - `solmap --help` answers at once
    from solmap.config.settings import Settings  # noqa: PLC0415

    folder = out_dir.absolute()
    addresses = (archive or Settings().archive).absolute()
    sols_named(sols)
    of_mission = load_archive(addresses).mission(mission)
    for name in () if raw else instrument or ():
        of_mission.volume(name)
    with engine_of(folder / ".fetch", "solmap.flows.fetch"):
        from solmap.flows.fetch import fetch_archive  # noqa: PLC0415 - Prefect is ready now

        report = fetch_archive(
            mission,
            sols,
            instrument or ["navcam"],
            folder,
            dry_run=dry_run,
            archive_file=addresses,
            raw=raw,
        )
    if as_json:
        typer.echo(json.dumps(asdict(report), indent=2))
    _print_report(report.warnings, report.failures, [] if as_json else report.lines)


def ties(
    file: Annotated[
        Path, typer.Argument(help="Manual ties, CSV or GeoJSON", parser=input_file, metavar="FILE")
    ],
    store: StoreOption = None,
) -> None:
    """Take a file of manual ties into the store; the next run adds, vetoes and moves them."""
    root = existing_store(store)
    from solmap.flows.external_data import take_ties_file  # noqa: PLC0415 - slow to import

    taken = take_ties_file(file, root)
    for name in taken.unknown:
        note("warning", f"{name} is not in the store (yet)")
    print_line(taken)


def serve(
    store: StoreOption = None,
    port: PortOption = None,
    host: Annotated[
        str | None, typer.Option(help="Address", envvar="SOLMAP_HOST", show_default="127.0.0.1")
    ] = None,
) -> None:
    """Serve the map, its tiles and features; the API is described at /docs."""
    root = existing_store(store).resolve()
    import uvicorn  # noqa: PLC0415 - `solmap --help` answers at once

    from solmap.config.settings import Settings  # noqa: PLC0415

    settings = Settings()
    address, listening_port = host or settings.host, port or settings.port
    _require_free(address, listening_port)
    os.environ["SOLMAP_STORE"] = str(root)
    print_line(f"map at http://{address}:{listening_port}/  (Ctrl-C stops)")
    uvicorn.run(
        "solmap.gis_server.app:create_app_from_settings",
        factory=True,
        host=address,
        port=listening_port,
        log_level="warning",
        # longer than a proxy's 60 s, which may otherwise reuse a closed connection
        timeout_keep_alive=75,
        timeout_graceful_shutdown=2,  # browsers that listen for events never hang up
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=settings.trusted_proxies,
    )


def up(
    store: StoreOption = None,
    inbox: Annotated[
        Path | None, typer.Option(help="Folder that downlinks arrive in", envvar="SOLMAP_INBOX")
    ] = None,
    port: PortOption = None,
) -> None:
    """Run everything: the map, the schedules, and the processing of the inbox. Ctrl-C stops."""
    from solmap.config.settings import Settings  # noqa: PLC0415 - `solmap --help` answers at once
    from solmap.flows.runtime.engine import password_file  # noqa: PLC0415
    from solmap.flows.runtime.stopping import end_on_signals  # noqa: PLC0415
    from solmap.flows.service.machine import CHECK_EVERY_S, Machine  # noqa: PLC0415
    from solmap.products.store.locks import try_lock  # noqa: PLC0415

    settings = Settings()
    root, folder = (store or settings.store).resolve(), inbox or settings.inbox
    files = {name: value.absolute() for name, value in settings if isinstance(value, Path)}
    given = {
        **files,
        "store": root,
        "inbox": folder.resolve() if folder else None,
        "port": port or settings.port,
        "pipeline": _pipeline_of(None),
    }
    settings = settings.model_copy(update=given)
    stopping = threading.Event()
    with end_on_signals(stopping.set), try_lock(root / "up.lock") as is_alone:
        if not is_alone:
            fail(f"another `solmap up` runs on {root}; stop it first")
        _require_free(settings.host, settings.port)
        machine = Machine(settings, print_line)
        try:
            machine.start()
            print_line(f"map at http://{settings.host}:{settings.port}/")
            print_line(f"runs at {machine.engine_url}/, password in {password_file(root)}")
            print_line("Ctrl-C stops both")
            while not stopping.wait(CHECK_EVERY_S):
                machine.check()
        finally:
            machine.stop()
    print_line("stopped; what was made is kept")


def _require_free(host: str, port: int) -> None:
    """End the command if nothing can listen at an address; called before the address is printed."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        fail(f"cannot listen at {host}:{port}: {error.strerror}; choose another with --port")


@contextmanager
def engine_of(store: Path, flows: str) -> Iterator[None]:
    """Run an engine for the flows of a module in the block, and show its progress."""
    from solmap.flows.runtime.engine import BY_COMMAND, start_engine  # noqa: PLC0415 - slow to import
    from solmap.flows.runtime.stopping import end_on_signals  # noqa: PLC0415

    with end_on_signals():
        start_engine(store, flows)
        from prefect import tags  # noqa: PLC0415 - after the engine's settings

        with progress_shown(), tags(BY_COMMAND):
            yield


def _pipeline_of(given: str | None) -> str:
    """The name of a shipped pipeline, or the absolute path of a file, validated."""
    from solmap.config.settings import PIPELINES, Settings  # noqa: PLC0415 - as above

    name = given or Settings().pipeline
    if (PIPELINES / f"{name}.toml").is_file():
        return name
    from solmap.config.pipeline import load_pipeline  # noqa: PLC0415 - it takes half a second

    load_pipeline(name)
    return str(Path(name).absolute())


def _print_report(
    warnings: Sequence[str],
    failures: Sequence[str],
    lines: Sequence[str],
    *,
    as_json: bool = False,
) -> None:
    """Print how a flow ended, and exit with 1 where something failed."""
    if as_json:
        document = {"warnings": [*warnings], "failures": [*failures], "lines": [*lines]}
        typer.echo(json.dumps(document, indent=2))
    else:
        for line in warnings:
            note("warning", line)
        for line in failures:
            note("failed", line)
        for line in lines:
            print_line(line)
    if failures:
        raise typer.Exit(1)
