/** The tab in which two layers are chosen and compared. */

import { colouringOfDifference, type Pair } from "../../map/difference";
import { kindTitle } from "../../map/layers";
import { legendOfColours } from "../../map/raster-style";
import type { Statistics } from "../../map/statistics";
import { h } from "../../page/dom";
import { measured, scopeTitle, sigmaText, unitSign } from "../../page/format";
import { colourLegend } from "../../page/legend";
import type { Layer } from "../../server/records";
import { type Comparison, COMPARISONS } from "../../session/state";

const TITLES: Readonly<Record<Comparison["mode"], string>> = {
  swipe: "Swipe",
  difference: "Difference",
};

export const layerName = ({ kind, scope, version }: Layer) =>
  [kindTitle(kind), scopeTitle(scope), ...(version ? [version] : [])].join(" · ");

export interface ComparisonActions {
  readonly change: (part: Partial<Comparison>) => void;
  readonly stop: () => void;
}

function choice(
  name: string,
  layers: readonly Layer[],
  chosen: string,
  choose: (id: string) => void,
): HTMLElement {
  const select = h(
    "select",
    { "aria-label": name, onchange: () => choose(select.value) },
    ...layers.map((layer) =>
      h("option", { value: layer.id, selected: layer.id === chosen }, layerName(layer)),
    ),
  );
  return h("label", { class: "inline" }, h("b", {}, name), select);
}

/** `running` is the current comparison, if any; `offered` the proposed one. */
export function comparisonPanel(
  layers: readonly Layer[],
  offered: Comparison | null,
  running: boolean,
  actions: ComparisonActions,
): HTMLElement {
  if (!offered) return h("p", { class: "hint" }, "Two rasters are needed to compare anything.");
  const modes = COMPARISONS.map((mode) =>
    h(
      "button",
      {
        type: "button",
        class: "mode",
        "data-mode": mode,
        "aria-pressed": String(running && offered.mode === mode),
        onclick: () =>
          running && offered.mode === mode ? actions.stop() : actions.change({ mode }),
      },
      TITLES[mode],
    ),
  );
  return h(
    "div",
    { class: "comparison" },
    choice("A", layers, offered.a, (a) => actions.change({ a })),
    choice("B", layers, offered.b, (b) => actions.change({ b })),
    h("div", { class: "modes", role: "group", "aria-label": "how to compare" }, ...modes),
    h(
      "p",
      { class: "hint" },
      "Swipe: A to the left of the divider, B to the right. Difference: A − B in every cell. " +
        "To flicker a layer, use its button in the list on the left. Earlier versions of a layer are listed " +
        "with its details there.",
    ),
  );
}

/** Legend of a difference, its settings, and its statistics. */
export function differenceBox(
  pair: Pair,
  most: number,
  found: Statistics | null,
  setMost: (most: number | null) => void,
): HTMLElement {
  const colouring = colouringOfDifference(pair, most);
  const unit = unitSign(colouring.unit);
  const input = h("input", {
    type: "number",
    class: "compact-number",
    step: "any",
    min: 0,
    value: Number(most.toPrecision(3)),
    "aria-label": "difference at the ends of the colours",
    onchange: () => setMost(Number(input.value) > 0 ? Number(input.value) : null),
  });
  const amounts = found
    ? `mean ${measured(found.mean, colouring.unit, null, found.sigma / 10)}, σ ${sigmaText(found.sigma, colouring.unit)} on the screen`
    : "the two have no ground in common on the screen";
  return h(
    "div",
    { class: "difference" },
    h("h2", {}, "Difference A − B"),
    colourLegend(legendOfColours(colouring)),
    h("label", { class: "inline" }, "colours to ±", input, unit),
    h("p", { class: "amounts" }, amounts),
    h("p", { class: "here", role: "status" }),
  );
}
