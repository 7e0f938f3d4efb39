/** A layer in the tree: its switch and its actions. */

import { isBand } from "../../map/bands";
import { type Blend, BLEND_NAMES } from "../../map/blending";
import { kindTitle } from "../../map/layers";
import { hasValues } from "../../map/raster-style";
import { classesOf, isImagery } from "../../map/imagery-style";
import { button, facts, h, icon } from "../../page/dom";
import { compact, metres, sols, time, unitSign } from "../../page/format";
import type { Layer } from "../../server/records";
import type { Following, LayerActions } from "./actions";
import { legendOf } from "./legend";
import { classEditor, imageryEditor } from "./imagery-editor";
import { choice, styleEditor } from "./style-editor";
import { versionsOf } from "./versions";

export function opacitySlider(layer: Layer, actions: LayerActions): HTMLInputElement {
  const slider = h("input", {
    type: "range",
    min: 0,
    max: 1,
    step: 0.05,
    "aria-label": `opacity of ${kindTitle(layer.kind)}, ${layer.scope}`,
    oninput: () => actions.setOpacity(layer, Number(slider.value)),
  });
  slider.value = String(actions.stateOf(layer).opacity);
  return slider;
}

function files(layer: Layer): HTMLElement[] {
  const link = (href: string, name: string) =>
    h("a", { class: "text download", href, download: true }, icon("down"), name);
  if (layer.type === "raster") return [link(layer.download, "GeoTIFF")];
  return [link(layer.download, "GeoJSON"), link(`${layer.download}.gpkg`, "GeoPackage")];
}

function editorOf(layer: Layer, actions: LayerActions): Following | null {
  if (layer.type !== "raster") return null;
  if (hasValues(layer)) return styleEditor(layer, actions);
  if (isImagery(layer)) return imageryEditor(layer, actions);
  return classesOf(layer).length > 0 ? classEditor(layer, actions) : null;
}

function details(layer: Layer, actions: LayerActions): Following {
  const unit = unitSign(layer.unit);
  const range = layer.range && `${compact(layer.range[0])} to ${compact(layer.range[1])}${unit}`;
  const slider = opacitySlider(layer, actions);
  const blend = choice<Blend | "">(
    "blend",
    [["", "normal"], ...BLEND_NAMES.map((name) => [name, name] as const)],
    (name) => actions.setBlend(layer, name || null),
  );
  blend.value = actions.stateOf(layer).blend ?? "";
  const style = editorOf(layer, actions);
  const isChoice = layer.type === "raster" && classesOf(layer).length > 0; // the classes to choose from are the legend
  const drawn = () => (isChoice ? null : legendOf(layer, actions));
  const legend = h("div", {}, drawn());
  const element = h(
    "div",
    { class: "details" },
    h("label", { class: "inline opacity" }, "opacity", slider),
    h("label", { class: "inline" }, "blend", blend),
    style?.element,
    legend,
    facts([
      ["cell", layer.cell_m ? metres(layer.cell_m) : null],
      ["stretch", range],
      ["seen on", layer.sols.length > 0 ? sols(layer.sols) : null],
      ["made", `${time(layer.made_at)} UTC`],
      ["digest", h("code", {}, layer.digest)],
    ]),
    h(
      "div",
      { class: "actions" },
      h(
        "button",
        { type: "button", class: "text provenance", onclick: () => actions.showProvenance(layer) },
        icon("tree"),
        "provenance",
      ),
      ...files(layer),
    ),
    isBand(layer) ? null : versionsOf(layer, actions),
  );
  const follow = () => {
    const state = actions.stateOf(layer);
    slider.value = String(state.opacity);
    blend.value = state.blend ?? "";
    style?.follow();
    const renewed = drawn();
    legend.replaceChildren(...(renewed ? [renewed] : []));
  };
  return { element, follow };
}

export function row(layer: Layer, actions: LayerActions): Following {
  const name = kindTitle(layer.kind);
  const box = h("input", {
    type: "checkbox",
    "aria-label": `show ${name}, ${layer.scope}`,
    onchange: () => actions.setVisible(layer, box.checked),
  });
  let opened: Following | null = null;
  const toggle = () => {
    const open = more.getAttribute("aria-expanded") !== "true";
    more.setAttribute("aria-expanded", String(open));
    element.classList.toggle("open", open);
    if (!open || opened) return;
    opened = details(layer, actions);
    element.append(opened.element);
  };
  const more = h(
    "button",
    {
      type: "button",
      class: "more",
      "aria-expanded": "false",
      "aria-label": `details of ${name}, ${layer.scope}`,
      title: "style, legend, opacity, provenance, download",
      onclick: toggle,
    },
    "▸",
  );
  const element = h(
    "li",
    { class: "layer", "data-layer": layer.id, "data-kind": layer.kind },
    h(
      "div",
      { class: "line" },
      h("label", { title: layer.title }, box, h("span", {}, name)),
      layer.cell_m ? h("small", { title: "cell size" }, metres(layer.cell_m)) : null,
      button(`zoom to ${name}`, "fit", () => actions.zoomTo(layer), { class: "ghost" }),
      more,
    ),
  );
  const follow = () => {
    box.checked = actions.stateOf(layer).visible;
    opened?.follow();
  };
  follow();
  return { element, follow };
}
