/** Layers on the map, the uppermost first; their order is changed here, by buttons or by dragging. */

import { kindTitle } from "../../map/layers";
import { button, h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import type { Layer } from "../../server/records";
import type { LayerActions } from "./actions";
import { opacitySlider } from "./row";

const DRAGGED = "application/x-solmap-layer";

/** Puts the layer that is dropped on an entry over or below it. */
function dropping(element: HTMLElement, layer: Layer, actions: LayerActions): void {
  const half = (event: DragEvent) => {
    const box = element.getBoundingClientRect();
    return event.clientY < box.top + box.height / 2 ? 1 : -1;
  };
  const mark = (step: 1 | -1 | 0) => {
    element.classList.toggle("drop-over", step === 1);
    element.classList.toggle("drop-below", step === -1);
  };
  element.addEventListener("dragstart", (event) => {
    event.dataTransfer?.setData(DRAGGED, layer.id);
  });
  element.addEventListener("dragover", (event) => {
    if (!event.dataTransfer?.types.includes(DRAGGED)) return;
    event.preventDefault();
    mark(half(event));
  });
  element.addEventListener("dragleave", () => mark(0));
  element.addEventListener("drop", (event) => {
    const id = event.dataTransfer?.getData(DRAGGED);
    mark(0);
    if (!id) return;
    event.preventDefault();
    actions.place({ id }, layer, half(event));
  });
}

function entry(layer: Layer, actions: LayerActions): HTMLElement {
  const name = kindTitle(layer.kind);
  const pressed = (is: boolean) => ({ class: "ghost", "aria-pressed": String(is) });
  const isSolo = actions.solo() === layer.id;
  const isFlickering = actions.flickering() === layer.id;
  const element = h(
    "li",
    { class: "on-map", draggable: "true", "data-layer": layer.id },
    h("span", { class: "name", title: layer.title }, name, " ", h("small", {}, layerPlace(layer))),
    h(
      "span",
      { class: "tools" },
      opacitySlider(layer, actions),
      button(`${name}: up`, "raise", () => actions.move(layer, 1), { class: "ghost" }),
      button(`${name}: down`, "lower", () => actions.move(layer, -1), { class: "ghost" }),
      button(`${name} alone`, "eye", () => actions.toggleSolo(layer), pressed(isSolo)),
      button(
        `${name}: flicker`,
        "flicker",
        () => actions.toggleFlicker(layer),
        pressed(isFlickering),
      ),
      button(`take ${name} off the map`, "close", () => actions.setVisible(layer, false), {
        class: "ghost",
      }),
    ),
  );
  dropping(element, layer, actions);
  return element;
}

const layerPlace = ({ scope, level, version }: Layer) =>
  [...(level === "region" ? [] : [scopeTitle(scope)]), ...(version ? [version] : [])].join(" · ");

/** Puts the focus on the same tool of the same layer again. */
function keepFocus(list: HTMLElement, redraw: () => void): void {
  const focused = list.contains(document.activeElement) ? document.activeElement : null;
  const name = focused?.getAttribute("aria-label");
  const id = focused?.closest<HTMLElement>("li")?.dataset["layer"];
  redraw();
  if (!name || !id) return;
  const row = [...list.children].find((one) => (one as HTMLElement).dataset["layer"] === id);
  const tools = row?.querySelectorAll<HTMLElement>("[aria-label]") ?? [];
  [...tools].find((tool) => tool.getAttribute("aria-label") === name)?.focus();
}

export interface ShownList {
  readonly element: HTMLElement;
  readonly draw: (layers: readonly Layer[]) => void;
  /** Puts a slider where the layer's opacity is. */
  readonly follow: (layer: Layer) => void;
}

export function shownList(actions: LayerActions): ShownList {
  const list = h("ul", { class: "shown", "aria-label": "layers on the map, uppermost first" });
  const count = h("small", {});
  const element = h(
    "details",
    { class: "group", open: true },
    h("summary", {}, h("span", {}, "Active layers"), count),
    list,
  );
  return {
    element,
    draw: (layers) => {
      count.textContent = String(layers.length);
      keepFocus(list, () => list.replaceChildren(...layers.map((one) => entry(one, actions))));
    },
    follow: (layer) => {
      const row = [...list.children].find(
        (one) => (one as HTMLElement).dataset["layer"] === layer.id,
      );
      const slider = row?.querySelector<HTMLInputElement>('input[type="range"]');
      if (slider) slider.value = String(actions.stateOf(layer).opacity);
    },
  };
}
