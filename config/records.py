"""TOML tables as frozen parameter records, and what is wrong with a table.

A wrong key, a value of another type and one that the record refuses are errors that name the key.
"""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from enum import Enum
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from solmap.photogrammetry.errors import PhotogrammetryError

T = TypeVar("T")


class ConfigError(Exception):
    """A setting is missing, unknown or impossible; names the file and the key."""


def record_of(kind: type[T], table: dict[str, Any], where: str) -> T:
    """The record of class `kind` that a TOML table describes; absent keys keep their defaults.

    Raises:
        ConfigError: an unknown key, a value of another type, or one that the record refuses.
    """
    hints = get_type_hints(kind)
    for key in sorted(set(table) - set(_names(kind))):
        raise ConfigError(_describe_unknown_setting(kind, key, where))
    values = {key: _value(hints[key], value, f"{where}.{key}") for key, value in table.items()}
    try:
        return kind(**values)
    except (TypeError, ValueError, PhotogrammetryError) as error:
        raise ConfigError(f"{where}: {error}") from error


def faults_of(kind: type, table: dict[str, Any], where: str) -> list[str]:
    """Every wrong key and value of a TOML table, a line each; none where `record_of` takes it."""
    hints, faults = get_type_hints(kind), []
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in _names(kind):
            faults.append(_describe_unknown_setting(kind, key, where))
        elif dataclasses.is_dataclass(hints[key]) and isinstance(value, dict):
            inner = faults_of(typing.cast("type", hints[key]), value, f"{where}.{key}")
            faults += inner
            values |= {} if inner else {key: value}
        else:
            try:
                _value(hints[key], value, f"{where}.{key}")
                values[key] = value
            except ConfigError as error:
                faults.append(str(error))
    try:
        record_of(kind, values, where)
    except ConfigError as error:
        faults.append(str(error))
    return faults


def _names(kind: type) -> list[str]:
    return sorted(field.name for field in dataclasses.fields(kind))


def _describe_unknown_setting(kind: type, key: str, where: str) -> str:
    names = _names(kind)
    return f"{where} has no setting {key!r}; it has {', '.join(names)}{nearest_name(key, names)}"


def nearest_name(name: str, names: list[str]) -> str:
    """The end of a message on an unknown name: which one may be meant, if any."""
    nearest = difflib.get_close_matches(name, names, 1)
    return f"; did you mean {nearest[0]}?" if nearest else ""


def _value(hint: Any, value: Any, where: str) -> Any:  # noqa: ANN401 - any setting
    if dataclasses.is_dataclass(hint) and not isinstance(value, hint):  # type: ignore[arg-type]
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is a table, not {value!r:.40}")
        return record_of(typing.cast("type[Any]", hint), value, where)
    if get_origin(hint) is tuple:
        return _items(get_args(hint), value, where)
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


def _items(hints: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:  # noqa: ANN401
    if not isinstance(value, list | tuple):
        raise ConfigError(f"{where} is a list, not {value!r:.40}")
    of_all = [hints[0]] * len(value) if hints[-1] is Ellipsis else list(hints)
    if len(of_all) != len(value):
        raise ConfigError(f"{where} is a list of {len(of_all)}, not of {len(value)}")
    return tuple(_value(hint, item, where) for hint, item in zip(of_all, value, strict=True))


def _member(hint: type[Enum], value: Any, where: str) -> Enum:  # noqa: ANN401 - any setting
    try:
        return hint(value)
    except ValueError as error:
        choices = ", ".join(str(member.value) for member in hint)
        raise ConfigError(f"{where} is one of {choices}, not {value!r}") from error
