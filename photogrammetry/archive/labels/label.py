"""PDS3 labels (ODL): text in, a flat record of groups out.

    statement :=  KEYWORD = value  |  END
               |  GROUP = name ... END_GROUP  |  OBJECT = name ... END_OBJECT
    value     :=  scalar  |  ( value, ... )  |  { value, ... }
    scalar    :=  number <unit>  |  "text"  |  'symbol'  |  word

Whitespace has no meaning, so lists and texts may continue over lines. Numbers may be quoted;
"NULL", "N/A" and "UNK" mean an unknown value and become None; a namespace (MSL:) is dropped. Groups
are looked up with or without the suffix _PARMS that later missions added, and nested ones as if
they were not nested. This parser is bounded, unlike available libraries: one pass, no backtracking,
limits to length and depth, and `LabelError` for every fault.
"""

from __future__ import annotations

import math
import re
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

from solmap.photogrammetry.errors import LabelError

Value: TypeAlias = "int | float | str | Quantity | tuple[Value, ...] | None"
"""Possible values of a keyword; None is an unknown value."""

MAX_LABEL_BYTES = 1 << 20
"""The longest label of the archive is some 50 kB; a file without END within a megabyte is not a
label."""
MAX_TOKENS = 50_000
"""Words, marks and gaps; the longest label of the archive has about 6,000."""
MAX_DEPTH = 16
MAX_NUMBER_LENGTH = 64
SHOWN = 40

_TOKEN = re.compile(
    r"""
    (?P<space>\s+ | /\*.*?\*/)
  | (?P<unclosed>/\*)
  | "(?P<text>[^"]*)"
  | '(?P<symbol>[^'\n]*)'
  | <(?P<unit>[^<>\n]*)>
  | (?P<mark>[=(){},])
  | (?P<word>[^\s=(){},"'<>]+)
    """,
    re.VERBOSE | re.DOTALL,
)
_EQUALS = re.compile(r"\s*=")
_INTEGER = re.compile(r"[+-]?\d+\Z")
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?\Z")
_BASED = re.compile(r"(\d+)#([+-]?[0-9A-Fa-f]+)#\Z")
_UNKNOWN = frozenset({"NULL", "N/A", "UNK"})

Scalar = TypeVar("Scalar", int, float, str)
_KIND_NAMES: dict[type, str] = {int: "a whole number", float: "a number", str: "a text"}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit."""

    value: int | float
    unit: str


@dataclass(frozen=True, slots=True)
class Label:
    """The keywords of a label, by group; the group "" holds those outside any group."""

    source: str
    """Name of the label's file; every message begins with it."""
    groups: Mapping[str, Mapping[str, Value]]

    def has_group(self, name: str) -> bool:
        """Whether the label has a group or object of this name."""
        return self._group(name) is not None

    def get(self, group: str, keyword: str) -> Value:
        """The value of a keyword; None where group or keyword is missing or the value unknown."""
        return (self._group(group) or {}).get(keyword)

    def require(self, group: str, keyword: str, kind: type[Scalar]) -> Scalar:
        """The value of a keyword as `int`, `float` or `str`.

        Raises:
            LabelError: it is missing, unknown or of another kind.
        """
        return self._convert(self._present(group, keyword), group, keyword, kind)

    def optional(self, group: str, keyword: str, kind: type[Scalar]) -> Scalar | None:
        """The value as `require` gives it, or None where it is missing or unknown."""
        value = self.get(group, keyword)
        return None if value is None else self._convert(value, group, keyword, kind)

    def require_numbers(self, group: str, keyword: str, count: int | None = None) -> np.ndarray:
        """The list of a keyword as float64, of exactly `count` numbers if given."""
        values = _sequence(self._present(group, keyword))
        if count is not None and len(values) != count:
            raise self._type_error(group, keyword, f"{count} numbers", values)
        return np.array([self._convert(value, group, keyword, float) for value in values])

    def optional_angle(self, group: str, keyword: str) -> float | None:
        """An angle in radians; labels give degrees unless their unit is rad."""
        value = self.get(group, keyword)
        if value is None:
            return None
        angle = self._convert(value, group, keyword, float)
        radians = isinstance(value, Quantity) and value.unit.lower().startswith("rad")
        return angle if radians else math.radians(angle)

    def _present(self, group: str, keyword: str) -> Value:
        items = self._group(group)
        if items is None:
            raise LabelError(f"{self.source}: the label has no group {group}")
        if keyword not in items:
            raise LabelError(f"{self.source}: {_path(group, keyword)} is missing from the label")
        return items[keyword]

    def _group(self, name: str) -> Mapping[str, Value] | None:
        short = name.removesuffix("_PARMS").replace("COORDINATE_SYSTEM", "COORD_SYSTEM")
        for spelling in (name, name + "_PARMS", short, short + "_PARMS"):
            if spelling in self.groups:
                return self.groups[spelling]
        return None

    def _convert(self, value: Value, group: str, keyword: str, kind: type[Scalar]) -> Scalar:
        bare = value.value if isinstance(value, Quantity) else value
        if kind is str:
            if isinstance(bare, str | int | float):
                return kind(bare)
        else:
            number = number_of(bare) if isinstance(bare, str) else bare
            whole = isinstance(number, int) or (isinstance(number, float) and number.is_integer())
            if (
                isinstance(number, int | float)
                and math.isfinite(number)
                and (kind is float or whole)
            ):
                return kind(number)
        raise self._type_error(group, keyword, _KIND_NAMES[kind], value)

    def _type_error(self, group: str, keyword: str, expected: str, value: Value) -> LabelError:
        found = "an unknown value" if value is None else _shorten(str(_plain(value)))
        return LabelError(
            f"{self.source}: {_path(group, keyword)} should be {expected}, but is {found}"
        )


def parse_label(text: str, source: str) -> Label:
    """The label at the start of `text`, up to its END; `source` names it in messages.

    Raises:
        LabelError: the text is not a label; the message names the line and what was expected there.
    """
    return _Parser(text[:MAX_LABEL_BYTES], source).label()


def label_text(data: bytes) -> str:
    """The part of a file that may be its label, one character per byte."""
    return data[:MAX_LABEL_BYTES].decode("latin-1")


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    start: int


@dataclass(frozen=True, slots=True)
class _Open:
    """A group or object that has not been closed yet."""

    word: str
    name: str
    start: int
    items: dict[str, Value]


class _Parser:
    """One pass over the tokens of a label."""

    def __init__(self, text: str, source: str) -> None:
        self._text, self._source = text, source
        self._tokens = self._tokenise()
        self._ahead: _Token | None = None
        self._has_ahead = False
        self._groups: dict[str, dict[str, Value]] = {"": {}}

    def label(self) -> Label:
        """All statements up to END."""
        stack = [_Open("label", "", 0, self._groups[""])]
        end = self._statement(stack)
        while end is None:
            end = self._statement(stack)
        if len(stack) > 1:
            opened = stack[-1]
            raise self._error(
                f"END came before the END_{opened.word} of {opened.name}, "
                f"opened in line {self._line(opened.start)}",
                end,
            )
        self._tokens.close()  # it refers to this parser: the text of the label is freed at once
        return Label(self._source, self._groups)

    def _statement(self, stack: list[_Open]) -> _Token | None:
        """Read one statement; return the token of END if it was that."""
        token = self._take("KEYWORD = value, or END")
        if token.kind != "word":
            raise self._error(f"expected KEYWORD = value, found {_shorten_token(token)}", token)
        keyword = token.text.upper()
        if keyword == "END" and not _EQUALS.match(self._text, token.start + len(token.text)):
            return token  # and do not read on: pixels may follow
        closing = keyword in {"END_GROUP", "END_OBJECT"}
        following = self._peek()
        if following is None or following.text != "=" or following.kind != "mark":
            if not closing:
                raise self._error(f"expected = after {_shorten_token(token)}", token)
            self._close(stack, keyword, None, token)
            return None
        self._take("=")
        value = self._value(0)
        if keyword in {"GROUP", "OBJECT", "BEGIN_GROUP", "BEGIN_OBJECT"}:
            self._open(stack, keyword.removeprefix("BEGIN_"), value, token)
        elif closing:
            self._close(stack, keyword, value, token)
        else:
            stack[-1].items.setdefault(keyword.rpartition(":")[2], value)
        return None

    def _open(self, stack: list[_Open], word: str, value: Value, token: _Token) -> None:
        if not isinstance(value, str):
            raise self._error(f"{word} needs a name", token)
        if len(stack) > MAX_DEPTH:
            raise self._error(f"groups are nested deeper than {MAX_DEPTH}", token)
        name = value.upper().rpartition(":")[2]
        items: dict[str, Value] = {}
        self._groups.setdefault(name, items)
        stack.append(_Open(word, name, token.start, items))

    def _close(self, stack: list[_Open], keyword: str, value: Value, token: _Token) -> None:
        if len(stack) == 1:
            raise self._error(f"{keyword} without a beginning", token)
        opened = stack.pop()
        name = value.upper().rpartition(":")[2] if isinstance(value, str) else None
        if keyword != f"END_{opened.word}" or name not in {None, opened.name}:
            raise self._error(
                f"expected END_{opened.word} of {opened.name}, opened in line "
                f"{self._line(opened.start)}, found {keyword} of {name}",
                token,
            )

    def _value(self, depth: int) -> Value:
        token = self._take("a value")
        if token.kind == "text":
            return none_if_unknown(" ".join(token.text.split()))
        if token.kind == "symbol":
            return token.text
        if token.kind == "word":
            return self._number_or_word(token)
        if token.kind == "mark" and token.text in "({":
            return self._list(")" if token.text == "(" else "}", depth, token)
        raise self._error(f"expected a value, found {_shorten_token(token)}", token)

    def _number_or_word(self, token: _Token) -> Value:
        number = number_of(token.text)
        if number is None:
            return none_if_unknown(token.text)
        following = self._peek()
        if following is not None and following.kind == "unit":
            return Quantity(number, self._take("a unit").text)
        return number

    def _list(self, end: str, depth: int, opening: _Token) -> Value:
        if depth >= MAX_DEPTH:
            raise self._error(f"lists are nested deeper than {MAX_DEPTH}", opening)
        values: list[Value] = []
        while True:
            token = self._peek()
            if token is not None and token.kind == "mark" and token.text in {end, ","}:
                self._take(end)
                if token.text == end:
                    return tuple(values)
                continue
            values.append(self._value(depth + 1))

    def _take(self, expected: str) -> _Token:
        token = self._peek()
        self._has_ahead = False
        if token is None:
            raise LabelError(
                f"{self._source}: the label ends in line {self._line(len(self._text))} without END "
                f"where {expected} was expected"
            )
        return token

    def _peek(self) -> _Token | None:
        """The next token, without consuming it."""
        if not self._has_ahead:
            self._ahead, self._has_ahead = next(self._tokens, None), True
        return self._ahead

    def _tokenise(self) -> Generator[_Token, None, None]:
        position, count = 0, 0
        while position < len(self._text):
            count += 1
            if count > MAX_TOKENS:
                raise self._error(
                    f"more than {MAX_TOKENS} words, but no END", _Token("", "", position)
                )
            match = _TOKEN.match(self._text, position)
            if match is None or match.lastgroup == "unclosed":
                raise self._error(
                    "a quotation, unit or comment is not closed", _Token("", "", position)
                )
            if match.lastgroup != "space":
                kind = match.lastgroup or ""
                yield _Token(kind, match[kind], position)
            position = match.end()

    def _line(self, position: int) -> int:
        return self._text.count("\n", 0, position) + 1

    def _error(self, what: str, token: _Token | None) -> LabelError:
        line = self._line(token.start if token else len(self._text))
        return LabelError(f"{self._source}: line {line} of the label: {what}")


def none_if_unknown(text: str) -> str | None:
    """The text, or None where it marks an unknown value."""
    return None if text in _UNKNOWN else text


def number_of(word: str) -> int | float | None:
    """The number in a word, or None."""
    word = word.strip()
    if len(word) > MAX_NUMBER_LENGTH:
        return None
    if _INTEGER.match(word):
        return int(word)
    if _REAL.match(word):
        return float(word.upper().replace("D", "E"))
    based = _BASED.match(word)
    if based and 2 <= int(based[1]) <= 16:  # noqa: PLR2004 - the bases of ODL
        try:
            return int(based[2], int(based[1]))
        except ValueError:
            return None
    return None


def _sequence(value: Value) -> tuple[Value, ...]:
    return value if isinstance(value, tuple) else (value,)


def _plain(value: Value) -> object:
    """A value as readable text."""
    if isinstance(value, Quantity):
        return f"{value.value} <{value.unit}>"
    if isinstance(value, tuple):
        return tuple(_plain(item) for item in value[:10])
    return value


def _path(group: str, keyword: str) -> str:
    return f"{group}/{keyword}" if group else keyword


def _shorten_token(token: _Token) -> str:
    return _shorten(token.text)


def _shorten(text: str) -> str:
    return ascii(text if len(text) <= SHOWN else text[:SHOWN] + "...")
