/** Choice of the drawn quantity of a raster, its colours and its range. */

import { kindTitle } from "../../map/layers";
import { RAMP_NAMES, type RampName } from "../../map/ramps";
import {
  colouringOf,
  canFade,
  formatStyle,
  mostSigma,
  ownStyle,
  PLAIN,
  quantitiesOf,
  type Quantity,
  quantityTitle,
  type RasterStyle,
} from "../../map/raster-style";
import { h } from "../../page/dom";
import type { RasterLayer } from "../../server/records";
import type { Following, LayerActions } from "./actions";

export function choice<T extends string>(
  name: string,
  entries: readonly (readonly [T, string])[],
  choose: (value: T) => void,
): HTMLSelectElement {
  const select = h(
    "select",
    { "aria-label": name, onchange: () => choose(select.value as T) },
    ...entries.map(([value, title]) => h("option", { value }, title)),
  );
  return select;
}

export function number(name: string, set: (value: number | null) => void): HTMLInputElement {
  const input = h("input", {
    type: "number",
    step: "any",
    "aria-label": name,
    onchange: () => {
      const value = input.value === "" ? Number.NaN : Number(input.value);
      set(Number.isFinite(value) ? value : null);
    },
  });
  return input;
}

const numberText = (value: number | null) =>
  value === null ? "" : String(Number(value.toPrecision(5)));

export function styleEditor(layer: RasterLayer, actions: LayerActions): Following {
  const own = ownStyle(layer.kind) ?? PLAIN;
  const isOwn = (one: RasterStyle) => formatStyle(one) === formatStyle(own);
  const style = () => actions.stateOf(layer).style ?? own;
  const change = (part: Partial<RasterStyle>) => {
    const next = { ...style(), ...part };
    actions.setStyle(layer, isOwn(next) ? null : next);
  };
  const quantities = quantitiesOf(layer);
  const quantity = choice<Quantity>(
    "what is drawn",
    quantities.map((one) => [one, one === "value" ? kindTitle(layer.kind) : quantityTitle(one)]),
    (one) => change({ ...PLAIN, quantity: one }), // another quantity has another range
  );
  const ramp = choice<RampName | "">(
    "colours",
    [["", "usual colours"], ...RAMP_NAMES.map((name) => [name, name] as const)],
    (name) => change({ ramp: name || null }),
  );
  const low = number("lowest colour at", (value) => change({ low: value }));
  const high = number("highest colour at", (value) => change({ high: value }));
  const floor = number("hide values below", (value) => change({ floor: value }));
  const fades = h("input", {
    type: "checkbox",
    onchange: () => change({ fade: fades.checked ? mostSigma(layer) : null }),
  });
  const most = number("not drawn from this standard deviation on", (value) =>
    change({ fade: value !== null && value > 0 ? value : mostSigma(layer) }),
  );
  const fading = h("label", { class: "inline" }, "not drawn from σ", most);
  const stretch = h(
    "button",
    { type: "button", class: "text stretch", onclick: () => actions.stretch(layer) },
    "stretch to view",
  );
  const reset = h(
    "button",
    { type: "button", class: "text", onclick: () => actions.setStyle(layer, null) },
    "reset",
  );
  const follow = () => {
    const now = style();
    const shown = colouringOf(layer, now);
    quantity.value = now.quantity;
    ramp.value = now.ramp ?? "";
    [low.value, high.value] = [numberText(shown.low), numberText(shown.high)];
    floor.value = numberText(now.floor);
    reset.hidden = isOwn(now);
    fades.checked = now.fade !== null;
    fading.hidden = now.fade === null;
    most.value = numberText(now.fade);
  };
  follow();
  const element = h(
    "div",
    { class: "style-editor" },
    quantities.length > 1 ? h("div", { class: "pair" }, quantity) : null,
    h("div", { class: "pair" }, ramp),
    h("div", { class: "pair" }, low, h("span", { class: "dim" }, "to"), high),
    h("label", { class: "inline" }, "hide below", floor),
    ...(canFade(layer)
      ? [h("label", { class: "inline" }, fades, "fade by standard deviation"), fading]
      : []),
    h("div", { class: "actions" }, stretch, reset),
  );
  return { element, follow };
}
