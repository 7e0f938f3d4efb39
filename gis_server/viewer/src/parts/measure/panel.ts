/** The tab of measurements: the kinds to choose from, and the results. */

import { button, h } from "../../page/dom";
import type { Measurement } from "./export";
import { mainText } from "./drawn";
import type { Mode } from "./mode";
import { MODES } from "./modes";
import type { ChosenNumbers } from "./numbers";
import { quantityText, sourcesText } from "./quantities";

export interface PanelActions {
  readonly start: (mode: Mode) => void;
  /** Ends points that were picked one by one. */
  readonly finish: () => void;
  /** Raster layers that can be measured on: id and title. */
  readonly layers: readonly (readonly [id: string, title: string])[];
  readonly layer: string | null;
  readonly chooseLayer: (id: string) => void;
  readonly numbers: ChosenNumbers;
  readonly zoomTo: (one: Measurement) => void;
  readonly remove: (one: Measurement) => void;
  readonly openProfile: (one: Measurement) => void;
  readonly saveCsv: () => void;
  readonly saveProfiles: () => void;
  readonly saveGeojson: () => void;
}

export function modeButtons(active: Mode | null, start: (mode: Mode) => void): HTMLElement {
  const one = (mode: Mode) =>
    h(
      "button",
      {
        type: "button",
        class: "measure-mode",
        "data-mode": mode.key,
        "aria-pressed": String(mode === active),
        onclick: () => start(mode),
      },
      mode.title,
    );
  return h(
    "div",
    { class: "measure-modes", role: "group", "aria-label": "measure" },
    ...MODES.map(one),
  );
}

function layerChoice({ layers, layer, chooseLayer }: PanelActions): HTMLElement {
  const select = h(
    "select",
    { class: "measured-layer", "aria-label": "layer", onchange: () => chooseLayer(select.value) },
    ...layers.map(([id, title]) => h("option", { value: id, selected: id === layer }, title)),
  );
  return select;
}

function item(one: Measurement, actions: PanelActions): HTMLElement {
  const { number, mode, found } = one;
  const rows = found.quantities.map((quantity) =>
    h(
      "tr",
      { "data-quantity": quantity.name },
      h("th", { scope: "row" }, quantity.name),
      h("td", { class: "number" }, quantityText(quantity)),
    ),
  );
  return h(
    "li",
    { class: "measurement", "data-measured": mode.key },
    h(
      "details",
      { open: true },
      h("summary", {}, h("b", {}, `${number}  ${mode.title}`), h("span", {}, mainText(one))),
      h("table", { class: "values" }, h("tbody", {}, ...rows)),
      found.note ? h("p", { class: "hint note" }, found.note) : null,
      h("p", { class: "hint" }, `From ${sourcesText(found.layers)}.`),
      h(
        "div",
        { class: "actions" },
        found.profile || found.chart
          ? h(
              "button",
              {
                type: "button",
                class: "text open-profile",
                onclick: () => actions.openProfile(one),
              },
              "profile",
            )
          : null,
        h(
          "button",
          { type: "button", class: "text", onclick: () => actions.zoomTo(one) },
          "go there",
        ),
        found.overlay
          ? h("a", { class: "link", href: found.overlay.geotiff, download: "" }, "GeoTIFF")
          : null,
        button(`remove measurement ${number}`, "close", () => actions.remove(one), {
          class: "ghost remove",
        }),
      ),
    ),
  );
}

export function measurePanel(
  all: readonly Measurement[],
  active: Mode | null,
  actions: PanelActions,
): HTMLElement {
  const hasProfiles = all.some(({ found }) => found.profile);
  const save = (name: string, run: () => void) =>
    h("button", { type: "button", class: "text save", onclick: run }, name);
  return h(
    "div",
    { class: "measure-panel" },
    modeButtons(active, actions.start),
    h(
      "p",
      { class: "hint" },
      active?.hint ?? "Choose what to measure, then draw it on the map. Esc stops.",
    ),
    active?.needsLayer ? layerChoice(actions) : null,
    active?.numberFields ? actions.numbers.fields(active) : null,
    active?.shape === "point" && active.most !== 1
      ? h(
          "button",
          { type: "button", class: "text finish", onclick: actions.finish },
          "fit the plane",
        )
      : null,
    all.length > 0
      ? h(
          "div",
          { class: "actions saves" },
          save("CSV", actions.saveCsv),
          save("GeoJSON", actions.saveGeojson),
          hasProfiles ? save("profiles CSV", actions.saveProfiles) : null,
        )
      : null,
    h("ol", { class: "measurements" }, ...[...all].reverse().map((one) => item(one, actions))),
  );
}
