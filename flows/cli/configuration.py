"""`solmap config`: the effective configuration, whether a file is right, and the docs page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from solmap.flows.cli.console import PipelineOption, note, say

config = typer.Typer(name="config", help="Parameters of the pipeline.", no_args_is_help=True)

OutOption = Annotated[Path | None, typer.Option("--out", help="File to write; else it is printed")]


@config.command()
def show(
    pipeline: PipelineOption = None,
    file: OutOption = None,
) -> None:
    """Print every parameter with its effective value, unit and reason, as a pipeline file."""
    from solmap.config.description import pipeline_toml  # noqa: PLC0415 - slow to import
    from solmap.config.pipeline import load_pipeline  # noqa: PLC0415
    from solmap.config.settings import Settings  # noqa: PLC0415

    _put(pipeline_toml(load_pipeline(pipeline or Settings().pipeline)), file)


@config.command()
def check(
    file: Annotated[str, typer.Argument(help="TOML file, or the name of a shipped pipeline")],
) -> None:
    """Name every wrong key and value of a pipeline file; exit code 1 if there is any."""
    from solmap.config.pipeline import faults_of_pipeline  # noqa: PLC0415 - slow to import

    faults = faults_of_pipeline(file)
    for fault in faults:
        note("error", fault)
    if faults:
        raise typer.Exit(1)
    say(f"{file} is a valid pipeline")


@config.command()
def docs(file: OutOption = None) -> None:
    """Print the documentation's page of all parameters and settings, as Markdown."""
    from solmap.config.description import configuration_page  # noqa: PLC0415 - slow to import

    _put(configuration_page(), file)


def _put(text: str, file: Path | None) -> None:
    if file is None:
        typer.echo(text, nl=False)
        return
    file.write_text(text, encoding="utf-8")
