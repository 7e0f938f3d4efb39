/** Attributes of the features of dropped files at a place. */

import { h } from "../../page/dom";
import type { GeoJsonFeature } from "../../map/mars-geojson";

export interface Found {
  /** Name of the file's layer. */
  readonly name: string;
  readonly properties: GeoJsonFeature["properties"];
}

const textOf = (value: unknown) =>
  value === null || value === undefined || value === ""
    ? "–"
    : typeof value === "object"
      ? JSON.stringify(value)
      : String(value);

export function attributes({ name, properties }: Found): HTMLElement {
  const known = Object.entries(properties ?? {}).filter(([key]) => key !== "geometry");
  const rows = known.map(([key, value]) =>
    h("tr", {}, h("td", {}, key), h("td", { class: "label" }, textOf(value))),
  );
  return h(
    "section",
    { class: "file-attributes", "data-file": name },
    h("h2", {}, name),
    rows.length > 0
      ? h("table", { class: "values" }, h("tbody", {}, ...rows))
      : h("p", { class: "hint" }, "The feature has no attributes."),
  );
}
