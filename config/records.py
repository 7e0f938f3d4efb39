"""From TOML tables to frozen parameter records: an unknown key is an error that names itself.

The error of the settings.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from enum import Enum
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from solmap.photogrammetry.errors import PhotogrammetryError


class ConfigError(Exception):
    """A setting is missing, unknown or impossible; names the file and the key."""


T = TypeVar("T")


def record_of(kind: type[T], table: dict[str, Any], where: str) -> T:
    """The record of class `kind` that a TOML table describes; absent keys keep their defaults.

    Raises:
        ConfigError: an unknown key, a value of another type, or one that the record refuses.
    """
    hints = get_type_hints(kind)
    known = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(table) - known)
    if unknown:
        raise ConfigError(
            f"{where} has no setting {unknown[0]!r}; it has {', '.join(sorted(known))}"
        )
    values = {key: _value(hints[key], value, f"{where}.{key}") for key, value in table.items()}
    try:
        return kind(**values)
    except (TypeError, ValueError, PhotogrammetryError) as error:
        raise ConfigError(f"{where}: {error}") from error


def _value(hint: Any, value: Any, where: str) -> Any:  # noqa: ANN401 - any setting
    if dataclasses.is_dataclass(hint) and isinstance(value, dict):
        return record_of(typing.cast("type[Any]", hint), value, where)
    if get_origin(hint) is tuple and isinstance(value, list):
        inner = get_args(hint)
        hints = [inner[0]] * len(value) if inner[-1] is Ellipsis else list(inner)
        return tuple(_value(h, v, where) for h, v in zip(hints, value, strict=True))
    if get_origin(hint) in (types.UnionType, typing.Union):
        options = [option for option in get_args(hint) if option is not type(None)]
        return _value(options[0], value, where)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _member(hint, value, where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if hint in (int, float, str, bool) and type(value) is not hint:
        raise ConfigError(f"{where} takes {hint.__name__}, not {value!r}")
    return value


def _member(hint: type[Enum], value: Any, where: str) -> Enum:  # noqa: ANN401 - any setting
    try:
        return hint(value)
    except ValueError as error:
        choices = ", ".join(str(member.value) for member in hint)
        raise ConfigError(f"{where} is one of {choices}, not {value!r}") from error
