/** What is known of a stop: when, where and how well, how far telemetry was off, and what was made of it. */

import { kindTitle } from "../../map/layers";
import { facts, h } from "../../page/dom";
import { fixed, scopeTitle } from "../../page/format";
import { urls } from "../../server/api";
import type { TraverseRow } from "../../server/network";
import type { ImageEntry, Layer } from "../../server/records";

export interface StopFacts {
  readonly mission: string;
  readonly stop: string;
  readonly sols: readonly number[];
  /** Semi-major axis of the error ellipse, one sigma; null: not known. */
  readonly sigma_m: number | null;
  /** Null before the first adjustment. */
  readonly row: TraverseRow | null;
  readonly images: readonly ImageEntry[];
  /** Layers of this stop alone. */
  readonly layers: readonly Layer[];
}

const plusMinus = (sigma: number | null) => (sigma === null ? "" : ` ± ${fixed(sigma, 3)}`);

/** How far telemetry was off: on the map, and in space where both have an elevation. */
export function telemetryError({ horizontal_m, percent, offset_m }: TraverseRow): string {
  const share = percent === null ? "" : ` (${fixed(percent, 2)} % of the way)`;
  const [, , up] = offset_m;
  const inSpace = up === null ? "" : `, 3D ${fixed(Math.hypot(horizontal_m, up), 3)} m`;
  return `horizontal ${fixed(horizontal_m, 3)} m${share}${inSpace}`;
}

/** Local solar time of the first and of the last image. */
export function localTimes(images: readonly ImageEntry[]): string | null {
  const times = images.flatMap(({ local_solar_time: time }) => (time ? [time.slice(0, 5)] : []));
  const sorted = times.toSorted();
  const [first, last] = [sorted[0], sorted.at(-1)];
  if (!first || !last) return null;
  return first === last ? first : `${first} to ${last}`;
}

function positionText({ row, sigma_m }: StopFacts): string | null {
  if (!row) return null;
  const [east, north, up] = row.place;
  const height = up === null ? "" : `, ${fixed(up, 3)}${plusMinus(row.sigma_up_m)} m up`;
  return `N ${fixed(north, 3)}, E ${fixed(east, 3)}${plusMinus(sigma_m)} m${height}`;
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
    h("h3", {}, scopeTitle(stop)),
    facts([
      ["sol", sols.join(", ") || null],
      ["local time", localTimes(images)],
      ["position (1σ)", positionText(known)],
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
