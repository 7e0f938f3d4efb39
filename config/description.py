"""The configuration as text: every parameter with its value, unit and reason.

Units come from the parameters' names (`cell_m`), reasons from the docstrings below the fields, read
from the records' source, so each is written only once.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any, get_args, get_type_hints

from solmap.config.pipeline import PipelineConfig
from solmap.config.records import limits_in_words, range_of
from solmap.config.settings import Settings

WIDTH = 100
UNITS = {
    "m": "metre",
    "m2": "square metre",
    "px": "pixel",
    "deg": "degree",
    "rad": "radian",
    "s": "second",
    "gb": "gigabyte",
    "percent": "percent",
    "cells": "cells",
    "sigmas": "standard deviations",
}
"""Units by the last part of a parameter's name."""

HEAD = """\
Every parameter of the pipeline. A pipeline file names only what differs: `solmap run --pipeline
FILE`. Units are in the names; where no unit is given, the parameter is a number, a ratio or a
choice.
"""
PAGE = """\
# Configuration

This page is generated from the parameter records (`solmap config docs`); do not edit it.

A **pipeline** is a TOML file with one table per stage, with only the differences from the defaults:

    solmap config show                  # the defaults as TOML, with units and reasons
    solmap config show --pipeline FILE  # the effective values of a file
    solmap config check FILE            # names wrong keys and values
    solmap run DOWNLINK --pipeline FILE

A value outside its range is an error when the file is read, which names its table and key. Names
end in their unit: `_m` metre, `_px` pixel, `_deg` degree, `_s` second. Ranges include the ends with
square brackets. `config show` also gives the reasons.

Locations are set by environment variables. A wrong value ends a command with a line that
names the variable; a name with `SOLMAP_` that is not a setting gives a warning.
"""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: its key, value and documentation."""

    name: str
    value: Any
    reason: str
    choices: tuple[str, ...] = ()
    """Values of an enumeration."""
    range: str = ""
    """Its permitted range."""

    @property
    def unit(self) -> str:
        """The unit in the name; empty if there is none."""
        rest, _, last = self.name.lower().rpartition("_")
        unit = UNITS.get(last, "") if rest else ""
        return f"per {unit}" if unit and rest.endswith("per") else unit


@dataclass(frozen=True, slots=True)
class Table:
    """A table of parameters: one record."""

    key: str
    """`models.terrain`; empty for parameters before the first table."""
    kind: type
    """Class of the record."""
    purpose: str
    parameters: tuple[Parameter, ...]

    @property
    def heading(self) -> str:
        """The table's name in the documentation."""
        return f"`[{self.key}]`" if self.key else "Before the first table"

    def unlike(self, other: Table) -> tuple[Parameter, ...]:
        """The parameters whose default differs from that in another table of the same class."""
        before = {one.name: one.value for one in other.parameters}
        return tuple(one for one in self.parameters if one.value != before[one.name])


def tables_of(record: Any, key: str = "") -> Iterator[Table]:  # noqa: ANN401 - any record
    """The tables of a record and of its nested records, in the order of the fields."""
    kind = type(record)
    values = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    own = {name: value for name, value in values.items() if not dataclasses.is_dataclass(value)}
    hints, descriptions = get_type_hints(kind, include_extras=True), reasons(kind)
    parameters = (
        Parameter(
            name, value, descriptions.get(name, ""), _choices(hints[name]), range_of(hints[name])
        )
        for name, value in own.items()
    )
    yield Table(key, kind, _purpose(kind), tuple(parameters))
    for name, value in values.items():
        if name not in own:
            yield from tables_of(value, f"{key}.{name}".lstrip("."))


def reasons(kind: type) -> dict[str, str]:
    """The docstring below each field of a record, including those of its base classes."""
    base = kind.__base__
    found = {} if base is None or base is object else reasons(base)
    if not dataclasses.is_dataclass(kind) and not issubclass(kind, Settings):
        return found
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    return found | dict(_field_docstrings(body.body if isinstance(body, ast.ClassDef) else []))


def _field_docstrings(body: list[ast.stmt]) -> Iterator[tuple[str, str]]:
    for statement, below in zip(body, [*body[1:], ast.Pass()], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            yield statement.target.id, " ".join(str(below.value.value).split())


def _purpose(kind: type) -> str:
    text = inspect.cleandoc(kind.__doc__ or "")
    return "" if text.startswith(f"{kind.__name__}(") else " ".join(text.split("\n\n")[0].split())


def _choices(hint: Any) -> tuple[str, ...]:  # noqa: ANN401 - any hint
    for option in (hint, *get_args(hint)):
        if isinstance(option, type) and issubclass(option, Enum):
            return tuple(str(member.value) for member in option)
    return ()


def pipeline_toml(config: PipelineConfig) -> str:
    """A pipeline as TOML with the unit and reason of every parameter as comments."""
    blocks = ["\n".join(_comment(HEAD))]
    for table in tables_of(config):
        if not table.parameters:
            continue
        lines = [*_comment(table.purpose), f"[{table.key}]"] if table.key else []
        for parameter in table.parameters:
            lines += _comment(parameter.reason)
            lines.append(_setting(parameter))
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in textwrap.wrap(" ".join(text.split()), WIDTH - 2)]


def _setting(parameter: Parameter) -> str:
    notes = [parameter.unit, " | ".join(parameter.choices)]
    if parameter.value is None:
        return f"# {parameter.name} =" + _note(["not set", *notes])
    return f"{parameter.name} = {toml_value(parameter.value)}" + _note(notes)


def _note(notes: list[str]) -> str:
    comment = "; ".join(filter(None, notes))
    return f"  # {comment}" if comment else ""


def toml_value(value: Any) -> str:  # noqa: ANN401 - any setting
    """A value as TOML writes it."""
    if isinstance(value, Enum):
        return toml_value(value.value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, str) else repr(value)


def configuration_page() -> str:
    """The page of the documentation: all parameters of the pipeline, and all settings."""
    parts = [PAGE, "## Pipeline\n"]
    described: dict[type, Table] = {}
    known: dict[Parameter, str] = {}
    for table in tables_of(PipelineConfig()):
        if not table.parameters:
            continue
        first = described.setdefault(table.kind, table)
        if first is table:
            text, rows = _prose(table.purpose), table.parameters
        else:
            rows = table.unlike(first)
            text = f"The parameters of {first.heading}" + (" with other defaults:" if rows else ".")
        new = tuple(one for one in rows if known.setdefault(one, table.heading) == table.heading)
        lines = [_rows(new)] if new else []
        for before in dict.fromkeys(known[one] for one in rows if one not in new):
            names = (f"`{one.name}`" for one in rows if known[one] == before)
            lines.append(f"- as in {before}: {', '.join(names)}")
        body = "\n\n" + "\n".join(lines) if lines else ""
        parts.append(f"### {table.heading}\n\n{text}{body}\n")
    descriptions = reasons(Settings)
    variables = (
        Parameter(
            f"SOLMAP_{name.upper()}",
            _display_value(field.default),
            descriptions.get(name, ""),
            range=limits_in_words(field.metadata),
        )
        for name, field in Settings.model_fields.items()
    )
    parts.append(f"## Environment\n\n{_prose(Settings.__doc__ or '')}\n\n{_rows(tuple(variables))}")
    return "\n".join(parts).rstrip() + "\n"


def _display_value(value: Any) -> Any:  # noqa: ANN401 - any setting
    """A default without the folder of this machine's installation."""
    text = str(value)
    return "as shipped" if "/config/" in text else value.value if isinstance(value, Enum) else value


def _rows(parameters: tuple[Parameter, ...]) -> str:
    lines = []
    for one in parameters:
        default = "none" if one.value is None else f"`{toml_value(_plain(one.value))}`"
        values = ", ".join(filter(None, [default, _interval(one.range)]))
        meaning = _prose(_SENTENCE_END.split(one.reason)[0])
        if one.choices:
            meaning = f"{meaning} One of {', '.join(f'`{choice}`' for choice in one.choices)}."
        lines.append(f"- **`{one.name}`** = {values}: {meaning.strip()}")
    return "\n".join(lines)


_SENTENCE_END = re.compile(r"(?<!al[.])(?<=[a-z0-9)`%][.]) (?=[A-Z`])")
"""Later sentences give reasons, which `solmap config show` prints; `et al.` ends no sentence."""


def _interval(words: str) -> str:
    """`at least 3, at most 101, odd` as `[3, 101], odd`, `more than 0` as `>0`."""
    both = re.sub(r"at least (\S+), at most ([^ ,]+)", r"[\1, \2]", words)
    both = re.sub(r"more than (\S+), at most ([^ ,]+)", r"(\1, \2]", both)
    return both.replace("at least ", "≥").replace("at most ", "≤").replace("more than ", "\\>")


def _plain(value: Any) -> Any:  # noqa: ANN401 - any setting
    return value if isinstance(value, str | int | float | tuple | Enum) else str(value)


def _prose(text: str) -> str:
    """A docstring as Markdown in a line."""
    return re.sub(r"([|<>])", r"\\\1", " ".join(text.split()))
