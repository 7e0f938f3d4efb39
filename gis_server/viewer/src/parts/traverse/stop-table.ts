/** Table of stops: corrections by the adjustment, and their precision. */

import type { FeatureLike } from "ol/Feature";
import type Point from "ol/geom/Point";
import { h } from "../../page/dom";
import { digits, HELD_M, sigmaText } from "../../page/format";
import type { MapPoint } from "../../server/records";
import { isAdjusted, stopLabel } from "../../map/styles";

export interface StopRow {
  readonly key: string;
  readonly label: string;
  readonly at: MapPoint;
  readonly telemetry: MapPoint | null;
  readonly held: boolean;
  readonly sigma_north_m: number | null;
  readonly sigma_east_m: number | null;
  readonly moved_m: number | null;
}

const place = (feature: FeatureLike): MapPoint => {
  const [east = 0, north = 0] = (feature.getGeometry() as Point).getCoordinates();
  return [east, north];
};
const known = (value: unknown) => (typeof value === "number" ? value : null);

/** One row per stop, in driving order; telemetry joined to its adjusted place. */
export function stopRows(features: readonly FeatureLike[]): readonly StopRow[] {
  const key = (feature: FeatureLike) => String(feature.get("stop") ?? stopLabel(feature));
  const telemetry = new Map(
    features
      .filter((feature) => !isAdjusted(feature.get("solution")))
      .map((feature) => [key(feature), place(feature)] as const),
  );
  return features
    .filter((feature) => isAdjusted(feature.get("solution")))
    .sort(
      (a, b) =>
        Number(a.get("site") ?? 0) - Number(b.get("site") ?? 0) ||
        Number(a.get("drive") ?? 0) - Number(b.get("drive") ?? 0),
    )
    .map((feature) => ({
      key: key(feature),
      label: stopLabel(feature),
      at: place(feature),
      telemetry: telemetry.get(key(feature)) ?? null,
      held: Boolean(feature.get("held")),
      sigma_north_m: known(feature.get("sigma_north_m")),
      sigma_east_m: known(feature.get("sigma_east_m")),
      moved_m: known(feature.get("moved_m")),
    }));
}

export function stopPanel(rows: readonly StopRow[], zoomTo: (at: MapPoint) => void): HTMLElement {
  if (rows.length === 0) return h("p", { class: "hint" }, "No stop is published yet.");
  const head = ["stop", "north", "east", "σ N", "σ E", "3D error"];
  const line = (row: StopRow) =>
    h(
      "tr",
      { "data-stop": row.key },
      h(
        "td",
        {},
        h("button", { type: "button", class: "link", onclick: () => zoomTo(row.at) }, row.label),
      ),
      h("td", { class: "number" }, digits(row.at[1], row.sigma_north_m, HELD_M)),
      h("td", { class: "number" }, digits(row.at[0], row.sigma_east_m, HELD_M)),
      h("td", { class: "number" }, row.held ? "held" : sigmaText(row.sigma_north_m, "")),
      h("td", { class: "number" }, row.held ? "held" : sigmaText(row.sigma_east_m, "")),
      h(
        "td",
        { class: "number" },
        digits(row.moved_m, Math.hypot(row.sigma_north_m ?? 0, row.sigma_east_m ?? 0), HELD_M),
      ),
    );
  return h(
    "div",
    {},
    h(
      "p",
      { class: "hint" },
      "Adjusted position with 1σ, and error of telemetry in space; metres.",
    ),
    h(
      "table",
      { class: "values" },
      h("thead", {}, h("tr", {}, ...head.map((name) => h("th", {}, name)))),
      h("tbody", {}, ...rows.map(line)),
    ),
  );
}
