/** A layer of a dropped file in the list. */

import { button, h } from "../../page/dom";
import type { FileLayer } from "./read";

export interface RowActions {
  readonly setVisible: (visible: boolean) => void;
  readonly setOpacity: (opacity: number) => void;
  readonly setColour: ((colour: string) => void) | null;
  readonly zoomTo: () => void;
  readonly remove: () => void;
  readonly publish: (() => void) | null;
}

export function fileRow(layer: FileLayer, colour: string, actions: RowActions): HTMLElement {
  const { name, crs } = layer;
  const { setColour, publish } = actions;
  const shown = h("input", {
    type: "checkbox",
    "aria-label": `show ${name}`,
    onchange: () => actions.setVisible(shown.checked),
  });
  shown.checked = true;
  const opacity = h("input", {
    type: "range",
    min: 0,
    max: 1,
    step: 0.05,
    value: 1,
    "aria-label": `opacity of ${name}`,
    oninput: () => actions.setOpacity(opacity.valueAsNumber),
  });
  const colours =
    setColour &&
    h("input", {
      type: "color",
      value: colour,
      "aria-label": `colour of ${name}`,
      oninput: () => setColour(colours?.value ?? colour),
    });
  const remove = () => {
    actions.remove();
    element.remove();
  };
  const what =
    layer.type === "features" ? `${layer.features.length} features` : layer.note || "raster";
  const element = h(
    "div",
    { class: "local-file", "data-file": name },
    h("label", { title: name }, shown, h("span", {}, name)),
    button(`zoom to ${name}`, "fit", actions.zoomTo, { class: "ghost" }),
    button(`remove ${name}`, "close", remove, { class: "ghost" }),
    h("small", {}, `${what} · ${crs.title}`),
    h(
      "div",
      { class: "inline" },
      colours,
      opacity,
      publish &&
        h(
          "button",
          {
            type: "button",
            class: "text publish",
            title: "publish the features as draft annotations",
            onclick: publish,
          },
          "Publish as drafts",
        ),
    ),
  );
  return element;
}
