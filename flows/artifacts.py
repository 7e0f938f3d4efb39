"""What a run leaves on its page: the outcome of every sol as a table, and where to look."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from prefect.artifacts import create_markdown_artifact, create_table_artifact

if TYPE_CHECKING:
    from flows.downlink import DownlinkReport
    from flows.sol_inputs import SolReport


def leave_report(report: DownlinkReport) -> None:
    """Leave the outcome of a downlink on the page of the run."""
    if report.sols:
        rows = [_row(sol) for sol in report.sols]
        create_table_artifact(rows, key="sols", description="Every sol that was processed")
    create_markdown_artifact(_text(report), key="downlink", description="How the downlink went")


def _row(sol: SolReport) -> dict[str, Any]:
    return {
        "mission": sol.mission,
        "sol": sol.sol,
        "layers": sol.layers,
        "failures": len(sol.failures),
        "notes": "; ".join(sol.notes),
    }


def _text(report: DownlinkReport) -> str:
    parts = [f"{report.images} images, {len(report.sols)} sols"]
    for title, lines in (
        ("Failures", report.failures),
        ("Warnings", report.warnings),
        ("Seams of regions", report.seams),
    ):
        if lines:
            parts.append(f"## {title}\n" + "\n".join(f"- {line}" for line in lines))
    return "\n\n".join(parts)
