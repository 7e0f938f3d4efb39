/** Card of a stop: time, position, precision, error of telemetry, and its products. */

import { kindTitle } from "../../map/layers";
import { facts, h } from "../../page/dom";
import { HELD_M, measured, percentText, scopeTitle } from "../../page/format";
import { urls } from "../../server/api";
import type { TraverseRow } from "../../server/network";
import type { ImageEntry, Layer } from "../../server/records";

export interface StopFacts {
  readonly mission: string;
  readonly stop: string;
  readonly sols: readonly number[];
  /** Row of the traverse; null before the first adjustment. */
  readonly row: TraverseRow | null;
  readonly images: readonly ImageEntry[];
  /** Layers of this stop alone. */
  readonly layers: readonly Layer[];
}

/** Error of telemetry: on the map, and in space if both have an elevation. */
export function telemetryError(row: TraverseRow): string {
  const { horizontal_m, sigma_horizontal_m, sigma_up_m, percent, offset_m } = row;
  const share = percent === null ? "" : ` (${percentText(row)} of the way)`;
  const up = offset_m[2] ?? 0;
  const length = Math.hypot(horizontal_m, up);
  const sigma = Math.hypot(horizontal_m * sigma_horizontal_m, up * (sigma_up_m ?? 0)) / length;
  const inSpace = offset_m[2] === null ? "" : `, 3D ${measured(length, "m", sigma, HELD_M)}`;
  return `horizontal ${measured(horizontal_m, "m", sigma_horizontal_m, HELD_M)}${share}${inSpace}`;
}

/** Local solar time of the first and of the last image. */
export function localTimes(images: readonly ImageEntry[]): string | null {
  const times = images.flatMap(({ local_solar_time: time }) => (time ? [time.slice(0, 5)] : []));
  const sorted = times.toSorted();
  const [first, last] = [sorted[0], sorted.at(-1)];
  if (!first || !last) return null;
  return first === last ? first : `${first} to ${last}`;
}

export function positionText({ place, ...row }: TraverseRow): string {
  const one = (value: number, sigma: number | null) => measured(value, "m", sigma, HELD_M);
  const [east, north, up] = place;
  const height = up === null ? "" : `, ${one(up, row.sigma_up_m)} up`;
  return `N ${one(north, row.sigma_north_m)}, E ${one(east, row.sigma_east_m)}${height}`;
}

export interface StopAction {
  readonly name: string;
  readonly run: () => void;
}

export function stopCard(known: StopFacts, actions: readonly StopAction[]): HTMLElement {
  const { mission, stop, sols, row, images, layers } = known;
  const pairs = images.filter(({ eye, partner }) => eye === "left" && partner !== null).length;
  const reports = sols.map((sol) =>
    h("a", { class: "text", href: urls.solReport(mission, sol), target: "_blank" }, `sol ${sol}`),
  );
  const files = layers.map((layer) =>
    h("li", {}, h("a", { class: "text", href: layer.download }, kindTitle(layer.kind))),
  );
  return h(
    "section",
    { class: "stop-card", "data-stop": stop },
    h("h2", {}, scopeTitle(stop)),
    facts([
      ["sol", sols.join(", ") || null],
      ["local time", localTimes(images)],
      ["position (1σ)", row && positionText(row)],
      ["telemetry error", row && telemetryError(row)],
      ["held by", row?.held_by || null],
      ["images", `${images.length}, ${pairs} stereo pairs`],
      ["report", reports.length > 0 ? h("span", {}, ...reports) : null],
    ]),
    h(
      "div",
      { class: "actions" },
      ...actions.map(({ name, run }) =>
        h("button", { type: "button", class: "plain", onclick: run }, name),
      ),
    ),
    files.length > 0
      ? h("details", {}, h("summary", {}, `Products (${files.length})`), h("ul", {}, ...files))
      : null,
  );
}
