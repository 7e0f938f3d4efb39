/** The format of longitude and latitude: chosen below the map, kept in the browser. */

import { COORDINATE_FORMATS, type CoordinateFormat } from "../map/coordinates";
import { h } from "./dom";

const KEY = "solmap-coordinates";

export function keptFormat(): CoordinateFormat {
  const kept = localStorage.getItem(KEY);
  return COORDINATE_FORMATS.find(([format]) => format === kept)?.[0] ?? "degrees";
}

export const keepFormat = (format: CoordinateFormat) => localStorage.setItem(KEY, format);

export function formatChoice(
  now: CoordinateFormat,
  choose: (format: CoordinateFormat) => void,
): HTMLElement {
  const select = h(
    "select",
    {
      class: "coordinate-format",
      "aria-label": "coordinate format",
      onchange: () => choose(select.value as CoordinateFormat),
    },
    ...COORDINATE_FORMATS.map(([format, title]) =>
      h("option", { value: format, selected: format === now }, title),
    ),
  );
  return select;
}
