"""TOML files and tables as frozen parameter records, with their errors.

A wrong key, a value of another type, outside the range of the field's type
(`photogrammetry.ranges`) or rejected by the record raises an error that names the key.
"""

from __future__ import annotations

import dataclasses
import difflib
import operator
import sys
import tomllib
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from annotated_types import Ge, GroupedMetadata, Gt, Le, Predicate

from solmap.photogrammetry.errors import PhotogrammetryError
from solmap.products.errors import ProductError

T = TypeVar("T")


class ConfigError(Exception):
    """A setting is missing, unknown or impossible; the message names the file and the key."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: it cannot be read, or is not TOML.
    """
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"{path} is not a file")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: {error}") from error


def record_of(kind: type[T], table: Any, where: str, default: T | None = None) -> T:  # noqa: ANN401 - as a file has it
    """The record of class `kind` for a TOML table; absent keys keep their defaults.

    Args:
        kind: A dataclass.
        table: From a file.
        where: File and table, for messages.
        default: The record with the values of absent keys; none: those of the class.

    Raises:
        ConfigError: an unknown key, a value of another type, or one that the record rejects.
    """
    if not isinstance(table, dict):
        raise ConfigError(f"{where} is a table, not {_shown(table)}")
    hints = _hints(kind)  # type: ignore[arg-type]
    for key in sorted(set(table) - set(_names(kind))):
        raise ConfigError(_describe_unknown_setting(kind, key, where))
    values = {
        key: record_of(hints[key], value, f"{where}.{key}", _default_of(kind, key, default))
        if dataclasses.is_dataclass(hints[key]) and isinstance(value, dict)
        else _value(hints[key], value, f"{where}.{key}")
        for key, value in table.items()
    }
    try:
        return kind(**values) if default is None else dataclasses.replace(default, **values)  # type: ignore[type-var]
    except (TypeError, ValueError, PhotogrammetryError, ProductError) as error:
        raise ConfigError(f"{where}: {error}") from error


def faults_of(kind: type, table: dict[str, Any], where: str) -> list[str]:
    """Every wrong key and value of a TOML table, one per line; empty if `record_of` accepts it."""
    hints, faults = _hints(kind), []
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


def _default_of(kind: type, key: str, default: Any) -> Any:  # noqa: ANN401 - any record
    """The default of a field: that of `default`, else that of the class."""
    if default is not None:
        return getattr(default, key)
    (field,) = (field for field in dataclasses.fields(kind) if field.name == key)
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return None if field.default is dataclasses.MISSING else field.default


@lru_cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _names(kind: type) -> list[str]:
    return sorted(field.name for field in dataclasses.fields(kind))


def _describe_unknown_setting(kind: type, key: str, where: str) -> str:
    names = _names(kind)
    return f"{where} has no setting {key!r}; it has {', '.join(names)}{nearest_name(key, names)}"


def nearest_name(name: str, names: list[str]) -> str:
    """The end of a message on an unknown name: the most similar known name, if any."""
    nearest = difflib.get_close_matches(name, names, 1)
    return f"; did you mean {nearest[0]}?" if nearest else ""


def range_of(hint: Any) -> str:  # noqa: ANN401 - any hint
    """The range of a field's type, as text; empty without one."""
    if get_origin(hint) is Annotated:
        base, *limits = get_args(hint)
        return ", ".join(filter(None, [limits_in_words(limits), range_of(base)]))
    return next(filter(None, map(range_of, get_args(hint))), "")


def limits_in_words(limits: Iterable[Any]) -> str:
    """Limits of a value, from `annotated_types`."""
    return ", ".join(words for words, _ in _limits(limits))


def _limits(limits: Iterable[Any]) -> Iterator[tuple[str, Callable[[Any], bool]]]:
    """Each limit as text, and as a test of a value."""
    for limit in limits:
        match limit:
            case GroupedMetadata():
                yield from _limits(limit)
            case Gt(low):
                yield f"more than {low:.9g}", partial(operator.lt, low)
            case Ge(low):
                yield f"at least {low:.9g}", partial(operator.le, low)
            case Le(high):
                yield f"at most {high:.9g}", partial(operator.ge, high)
            case Predicate(holds):
                yield holds.__name__.removeprefix("is_"), holds


def _shown(value: Any) -> str:  # noqa: ANN401 - any setting
    try:
        return f"{value!r:.60}"
    except ValueError:  # a number of thousands of digits
        return "such a number"


def _value(hint: Any, value: Any, where: str) -> Any:  # noqa: ANN401 - any setting
    if get_origin(hint) is Annotated:
        base, *limits = get_args(hint)
        taken = _value(base, value, where)
        if not all(holds(taken) for _, holds in _limits(limits)):
            raise ConfigError(f"{where} should be {range_of(hint)}, not {_shown(value)}")
        return taken
    if dataclasses.is_dataclass(hint) and not isinstance(value, hint):  # type: ignore[arg-type]
        return record_of(typing.cast("type[Any]", hint), value, where)
    readers: dict[Any, Callable[..., Any]] = {tuple: _items, Mapping: _items_by_name}
    if get_origin(hint) in readers:
        return readers[get_origin(hint)](get_args(hint), value, where)
    if get_origin(hint) in (types.UnionType, typing.Union):
        options = [option for option in get_args(hint) if option is not type(None)]
        return _value(options[0], value, where)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _member(hint, value, where)
    return _number(value, where) if hint is float else _plain(hint, value, where)


def _number(value: Any, where: str) -> float:  # noqa: ANN401 - any setting
    if type(value) not in (int, float):
        raise ConfigError(f"{where} takes float, not {_shown(value)}")
    if not abs(value) <= sys.float_info.max:
        raise ConfigError(f"{where} takes a finite number, not {_shown(value)}")
    return float(value)


def _plain(hint: Any, value: Any, where: str) -> Any:  # noqa: ANN401 - any setting
    if hint in (int, str, bool) and type(value) is not hint:
        raise ConfigError(f"{where} takes {hint.__name__}, not {_shown(value)}")
    return value


def _items_by_name(hints: tuple[Any, ...], value: Any, where: str) -> dict[str, Any]:  # noqa: ANN401
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} is a table, not {_shown(value)}")
    return {key: _value(hints[1], item, f"{where}.{key}") for key, item in value.items()}


def _items(hints: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:  # noqa: ANN401
    if not isinstance(value, list | tuple):
        raise ConfigError(f"{where} is a list, not {_shown(value)}")
    of_all = [hints[0]] * len(value) if hints[-1] is Ellipsis else list(hints)
    if len(of_all) != len(value):
        raise ConfigError(f"{where} is a list of {len(of_all)}, not of {len(value)}")
    return tuple(_value(hint, item, where) for hint, item in zip(of_all, value, strict=True))


def _member(hint: type[Enum], value: Any, where: str) -> Enum:  # noqa: ANN401 - any setting
    try:
        return hint(value)
    except (TypeError, ValueError) as error:
        choices = ", ".join(str(member.value) for member in hint)
        raise ConfigError(f"{where} is one of {choices}, not {_shown(value)}") from error
