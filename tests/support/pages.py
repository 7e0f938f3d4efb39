"""The generated parts of the documentation: commands from the Typer app, routes from OpenAPI.

python -m tests.support.pages

rewrites the part below the marker in `docs/reference/commands.md` and `http-api.md`;
`tests/unit/test_documents.py` holds it current.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from solmap.flows.cli import app
from solmap.gis_server.app import create_app

REFERENCE = Path(__file__).resolve().parents[2] / "docs" / "reference"
MARKER = "<!-- generated from here on: python -m tests.support.pages -->\n"


def all_commands(
    group: TyperGroup | None = None, prefix: str = "solmap"
) -> Iterator[tuple[str, TyperCommand]]:
    """Full name and command of all that are not hidden; those of a group in its place."""
    group = typer.main.get_group(app) if group is None else group
    for name, command in group.commands.items():
        if isinstance(command, TyperGroup):
            yield from all_commands(command, f"{prefix} {name}")
        elif isinstance(command, TyperCommand) and not command.hidden:
            yield f"{prefix} {name}", command


FEWEST_COMMANDS = 5
"""An option that at least this many commands have alike is described once for all of them."""


def commands_section() -> str:
    """Heading, help, arguments and options of every command; common options come first."""
    commands = {name: (command, _parameters(command)) for name, command in all_commands()}
    uses = Counter(row for _, rows in commands.values() for row in rows)
    common = [row for row, count in uses.items() if count >= FEWEST_COMMANDS]
    described = (_described(name, *one, common) for name, one in commands.items())
    return "\n".join(["## Common options", "", *common, "", *described])


def _parameters(command: TyperCommand) -> list[str]:
    return [_parameter(one) for one in command.params if not getattr(one, "hidden", False)]


def _described(name: str, command: TyperCommand, rows: list[str], common: list[str]) -> str:
    own = [row for row in rows if row not in common]
    shared = [row.split("**")[1] for row in rows if row in common]
    lines = [*own, *([f"- {', '.join(shared)}"] if shared else [])]
    return "\n".join([f"## {name}", "", _line(command.help), "", *lines, *([""] if lines else [])])


def _parameter(one: TyperOption | TyperArgument) -> str:
    is_option = isinstance(one, TyperOption)
    name = (
        ", ".join([*one.opts, *one.secondary_opts])
        if is_option
        else (one.metavar or one.name).upper()
    )
    parts = [f"- **`{name}`**{_default(one)}", _line(one.help)]
    return ": ".join(filter(None, parts))


def _default(one: TyperOption | TyperArgument) -> str:
    if one.required:
        return " (required)"
    return "" if one.default in {None, False} else f" = `{one.default}`"


def _line(text: str | None) -> str:
    return " ".join((text or "").split())


def routes_section() -> str:
    """The requests of each tag of the API's description."""
    with tempfile.TemporaryDirectory() as folder:
        described = create_app(Path(folder) / "store").openapi()
    tables: dict[str, list[str]] = {}
    for path, operations in described["paths"].items():
        for method, operation in operations.items():
            text = operation.get("description") or operation.get("summary", "")
            tag = (operation.get("tags") or ["other"])[0]
            row = f"- `{method.upper()} {path}`: {_line(text.split(chr(10) * 2)[0])}"
            tables.setdefault(tag, []).append(row)
    return "\n".join("\n".join([f"## {tag}", "", *rows, ""]) for tag, rows in tables.items())


GENERATED: dict[str, Callable[[], str]] = {
    "commands.md": commands_section,
    "http-api.md": routes_section,
}


def page(name: str) -> str:
    """The page as it should be: the part written by hand, the marker, the generated part."""
    written, _, _ = (REFERENCE / name).read_text(encoding="utf-8").partition(MARKER)
    return f"{written.rstrip()}\n\n{MARKER}\n{GENERATED[name]()}"


if __name__ == "__main__":
    for _name in GENERATED:
        (REFERENCE / _name).write_text(page(_name), encoding="utf-8")
