/** Style of images and classes: grey values, colours, and the classes that are drawn. */

import { classesOf } from "../../map/imagery-style";
import { RAMP_NAMES, type RampName } from "../../map/ramps";
import { isPlain, PLAIN, type RasterStyle } from "../../map/raster-style";
import { h } from "../../page/dom";
import type { RasterLayer } from "../../server/records";
import type { Following, LayerActions } from "./actions";
import { choice, number } from "./style-editor";

const PERCENT = 0.02;

function changing(layer: RasterLayer, actions: LayerActions) {
  const style = () => actions.stateOf(layer).style ?? PLAIN;
  const change = (part: Partial<RasterStyle>) => {
    const next = { ...style(), ...part };
    actions.setStyle(layer, isPlain(next) ? null : next);
  };
  return { style, change };
}

const text = (name: string, run: () => void, extra = "") =>
  h("button", { type: "button", class: `text ${extra}`, onclick: run }, name);

export function imageryEditor(layer: RasterLayer, actions: LayerActions): Following {
  const { style, change } = changing(layer, actions);
  const ramp = choice<RampName | "">(
    "colours",
    [["", "as photographed"], ...RAMP_NAMES.map((name) => [name, name] as const)],
    (name) => change({ ramp: name || null }),
  );
  const low = number("black at", (value) => change({ low: value }));
  const high = number("white at", (value) => change({ high: value }));
  const gamma = h("input", {
    type: "range",
    min: 0.3,
    max: 3,
    step: 0.05,
    "aria-label": "gamma",
    oninput: () => change({ gamma: Number(gamma.value) === 1 ? null : Number(gamma.value) }),
  });
  const readout = h("output", {});
  const reset = text("reset", () => actions.setStyle(layer, null));
  const follow = () => {
    const now = style();
    ramp.value = now.ramp ?? "";
    [low.value, high.value] = [String(now.low ?? 0), String(now.high ?? 255)];
    gamma.value = String(now.gamma ?? 1);
    readout.textContent = (now.gamma ?? 1).toFixed(2);
    reset.hidden = isPlain(now);
  };
  follow();
  const element = h(
    "div",
    { class: "style-editor" },
    layer.kind === "colour" ? null : h("div", { class: "pair" }, ramp),
    h("div", { class: "pair" }, low, h("span", { class: "dim" }, "to"), high),
    h("label", { class: "inline" }, "gamma", gamma, readout),
    h(
      "div",
      { class: "actions" },
      text("least to most", () => actions.stretchImagery(layer, 0), "stretch-all"),
      text("2 % to 98 %", () => actions.stretchImagery(layer, PERCENT), "stretch-percent"),
      reset,
    ),
  );
  return { element, follow };
}

export function classEditor(layer: RasterLayer, actions: LayerActions): Following {
  const { style, change } = changing(layer, actions);
  const toggle = (one: number, shown: boolean) => {
    const others = style().hidden.filter((each) => each !== one);
    change({ hidden: shown ? others : [...others, one].toSorted((a, b) => a - b) });
  };
  const boxes = classesOf(layer).map(({ name, colour }, one) => {
    const box = h("input", {
      type: "checkbox",
      onchange: () => toggle(one, box.checked),
    });
    const swatch = h("span", { class: "class-swatch", style: `background:${colour}` });
    return { box, line: h("label", { class: "inline class-choice" }, box, swatch, name) };
  });
  const follow = () => {
    const { hidden } = style();
    for (const [one, { box }] of boxes.entries()) box.checked = !hidden.includes(one);
  };
  follow();
  const lines = boxes.map(({ line }) => line);
  return {
    element: h("div", { class: "style-editor", role: "group", "aria-label": "classes" }, ...lines),
    follow,
  };
}
