"""Files of rows written by people: CSV with a line of names at its head, or GeoJSON.

Both have the same columns. In GeoJSON they are the properties of the features of a
FeatureCollection; the features may be points, whose coordinates become the columns `longitude` and
`latitude`, or have a geometry that is ignored.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from solmap.photogrammetry.errors import PhotogrammetryError

Row = Mapping[str, Any]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RowFormat:
    """Columns of a file of rows, and the error class for its faults."""

    columns: tuple[str, ...]
    key: str
    """The column that is required."""
    error: type[PhotogrammetryError]
    has_places: bool = False
    """Whether features of GeoJSON are points whose coordinates are read."""
    may_end_short: bool = False
    """Whether a row of CSV may omit its last columns."""

    def parse(self, text: str, source: str, record: Callable[[Row, str], T]) -> tuple[T, ...]:
        """The records of a file, made by `record` from each row and its location.

        Raises:
            PhotogrammetryError: an `error` that names the file, the row (the first below the
                names is 1), and the fault.
        """
        text = text.removeprefix("\ufeff")
        is_geojson = text.lstrip().startswith("{")
        records = []
        for number, row in self._features(text, source) if is_geojson else self._csv(text, source):
            where = f"{source}, row {number}"
            try:
                records.append(record(row, where))
            except self.error as error:
                raise self.error(f"{where}: {error}") from error
        return tuple(records)

    def _csv(self, text: str, source: str) -> Iterator[tuple[int, Row]]:
        try:
            lines = list(csv.reader(io.StringIO(text), strict=True))
        except csv.Error as error:
            raise self.error(f"{source}: this is not CSV: {error}") from error
        names = [name.strip().lower() for name in lines[0]] if lines else []
        self._check_head(names, source)
        for number, values in enumerate(lines[1:], 1):
            if not any(value.strip() for value in values):
                continue
            is_short = len(values) < len(names) and not self.may_end_short
            if is_short or len(values) > len(names):
                raise self.error(
                    f"{source}, row {number}: {len(values)} values for {len(names)} columns"
                )
            yield number, dict(zip(names, (value.strip() for value in values), strict=False))

    def _check_head(self, names: list[str], source: str) -> None:
        unknown = [name for name in names if name not in self.columns]
        if self.key not in names or unknown:
            raise self.error(
                f"{source}: the first line should name the columns, of {', '.join(self.columns)}; "
                + (
                    f"{unknown[0][:60]!a} is not one of them"
                    if unknown
                    else f"{self.key!r} is missing"
                )
            )

    def _features(self, text: str, source: str) -> Iterator[tuple[int, Row]]:
        kind = "points" if self.has_places else "features with properties"
        try:
            features = json.loads(text)["features"]
            rows = [(feature["properties"], feature.get("geometry")) for feature in features]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise self.error(
                f"{source}: a FeatureCollection of {kind} is expected: "
                f"{type(error).__name__} {error}"
            ) from error
        for number, (properties, geometry) in enumerate(rows, 1):
            if not isinstance(properties, dict):
                raise self.error(f"{source}, row {number}: a feature without properties")
            row = {str(name).lower(): value for name, value in properties.items()}
            if self.has_places:
                row |= self._place(geometry, f"{source}, row {number}")
            yield number, row

    def _place(self, geometry: object, where: str) -> dict[str, Any]:
        try:
            longitude, latitude, *_ = geometry["coordinates"]  # type: ignore[index]
            is_point = geometry["type"] == "Point"  # type: ignore[index]
        except (KeyError, TypeError, ValueError):
            is_point = False
        if not is_point:
            raise self.error(f"{where}: a Point is expected as geometry")
        return {"longitude": longitude, "latitude": latitude}
