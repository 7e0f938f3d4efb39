/** The list of layers: groups of one scope each, with all that can be done with a layer. */

import { button, facts, h, icon } from "../../page/dom";
import { compact, metres, sols, time, unitSign } from "../../page/format";
import { groupLayers, kindTitle, type LayerGroup, type LayerState } from "../../map/layers";
import type { Layer, Legend, VectorLayer } from "../../server/records";
import {
  ADJUSTED,
  CONTOUR,
  ELLIPSE_FACTORS,
  HAVEN,
  TELEMETRY,
  UNPAIRED,
  VIEWING,
} from "../../map/styles";

export interface LayerActions {
  readonly setVisible: (layer: Layer, visible: boolean) => void;
  readonly setOpacity: (layer: Layer, opacity: number) => void;
  readonly zoomTo: (layer: Layer) => void;
  readonly showProvenance: (layer: Layer) => void;
  readonly setEllipseFactor: (factor: number) => void;
}

export interface LayerPanel {
  readonly element: HTMLElement;
  /** Puts a row's switch and slider where `state` says. */
  readonly set: (id: string, state: LayerState) => void;
  readonly setEllipseFactor: (factor: number) => void;
}

function classLegend(classes: NonNullable<Legend["classes"]>): HTMLElement {
  const rows = classes.map(({ name, colour }) =>
    swatch(`background:${colour};width:14px;height:14px`, name),
  );
  return h("div", { class: "legend" }, ...rows);
}

function rampLegend({ stops, unit, classes }: Legend): HTMLElement | null {
  if (classes?.length) return classLegend(classes);
  const first = stops[0];
  const last = stops.at(-1);
  if (!first || !last || first === last) return null;
  const span = last[0] - first[0] || 1;
  const parts = stops.map(([value, colour]) => {
    const share = (100 * (value - first[0])) / span;
    return `${colour} ${share.toFixed(1)}%`;
  });
  const ticks = [0, 0.25, 0.5, 0.75, 1].map((share) => compact(first[0] + share * span, 3));
  return h(
    "div",
    { class: "legend" },
    h("div", { class: "ramp", style: `background:linear-gradient(90deg, ${parts.join(", ")})` }),
    h("div", { class: "ticks" }, ...ticks.map((tick) => h("span", {}, tick))),
    unit ? h("div", { class: "unit" }, unit) : null,
  );
}

const swatch = (style: string, text: string) =>
  h("div", { class: "swatch" }, h("i", { style }), text);
const stroke = (width: number, kind: string, colour: string) =>
  `border-top:${width}px ${kind} ${colour}`;

function symbolLegend(layer: VectorLayer, actions: LayerActions): HTMLElement | null {
  switch (layer.kind) {
    case "traverse":
      return h(
        "div",
        { class: "legend" },
        swatch(stroke(2.5, "solid", ADJUSTED), "adjusted"),
        swatch(stroke(2, "dashed", TELEMETRY), "telemetry"),
      );
    case "mission-traverse":
    case "mission-stops":
      return h(
        "div",
        { class: "legend" },
        swatch(stroke(2.5, "solid", ADJUSTED), "localised"),
        swatch(stroke(2, "dashed", TELEMETRY), "telemetry"),
      );
    case "stops":
      return h(
        "div",
        { class: "legend" },
        swatch(
          `border:4px solid ${ADJUSTED};border-radius:50%;width:0`,
          "adjusted, 1σ error ellipse",
        ),
        swatch(`border:2px solid ${ADJUSTED};border-radius:50%;width:5px;height:5px`, "held fixed"),
        swatch(`border:2px solid ${TELEMETRY};width:5px;height:5px`, "telemetry"),
        h(
          "label",
          { class: "inline" },
          "ellipses drawn",
          h(
            "select",
            {
              class: "ellipse-factor",
              onchange: (event) =>
                actions.setEllipseFactor(Number((event.target as HTMLSelectElement).value)),
            },
            ...ELLIPSE_FACTORS.map((factor) => h("option", { value: factor }, `×${factor}`)),
          ),
        ),
      );
    case "contours":
    case "region-contours":
    case "far-contours":
      return h(
        "div",
        { class: "legend" },
        swatch(stroke(2, "solid", CONTOUR), "index contour, labelled"),
        swatch(stroke(1, "solid", CONTOUR), "contour"),
      );
    case "havens":
    case "region-havens":
      return h(
        "div",
        { class: "legend" },
        swatch(`border:2px solid ${HAVEN};width:12px;height:10px`, "room for a rover in winter"),
      );
    case "footprints":
    case "pointing":
      return h(
        "div",
        { class: "legend" },
        swatch(stroke(1.5, "solid", VIEWING), "image with stereo partner"),
        swatch(stroke(1.5, "dashed", UNPAIRED), "image without partner"),
      );
    default:
      return null;
  }
}

function legendOf(layer: Layer, actions: LayerActions): HTMLElement | null {
  switch (layer.type) {
    case "raster":
      return layer.legend ? rampLegend(layer.legend) : null;
    case "vector":
      return symbolLegend(layer, actions);
    default:
      throw new Error(`unknown layer ${JSON.stringify(layer satisfies never)}`);
  }
}

interface Row {
  readonly element: HTMLElement;
  readonly set: (state: LayerState) => void;
}

function details(layer: Layer, slider: HTMLElement, actions: LayerActions): HTMLElement {
  const unit = unitSign(layer.unit);
  const range = layer.range && `${compact(layer.range[0])} to ${compact(layer.range[1])}${unit}`;
  return h(
    "div",
    { class: "details" },
    h("label", { class: "inline opacity" }, "opacity", slider),
    legendOf(layer, actions),
    facts([
      ["cell", layer.cell_m ? metres(layer.cell_m) : null],
      ["colours", range],
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
      h(
        "a",
        { class: "text download", href: layer.download, download: true },
        icon("down"),
        layer.type === "raster" ? "GeoTIFF" : "GeoJSON",
      ),
      layer.type === "vector"
        ? h(
            "a",
            { class: "text download", href: `${layer.download}.gpkg`, download: true },
            icon("down"),
            "GeoPackage",
          )
        : null,
    ),
  );
}

function row(layer: Layer, first: LayerState, actions: LayerActions): Row {
  const name = kindTitle(layer.kind);
  const box = h("input", {
    type: "checkbox",
    "aria-label": `show ${name}, ${layer.scope}`,
    onchange: () => actions.setVisible(layer, box.checked),
  });
  const slider = h("input", {
    type: "range",
    min: 0,
    max: 1,
    step: 0.05,
    "aria-label": `opacity of ${name}, ${layer.scope}`,
    oninput: () => actions.setOpacity(layer, Number(slider.value)),
  });
  const more = h(
    "button",
    {
      type: "button",
      class: "more",
      "aria-expanded": "false",
      "aria-label": `details of ${name}, ${layer.scope}`,
      title: "legend, opacity, provenance, download",
      onclick: () => {
        const open = more.getAttribute("aria-expanded") !== "true";
        more.setAttribute("aria-expanded", String(open));
        if (open && element.children.length === 1) element.append(details(layer, slider, actions));
        element.classList.toggle("open", open);
      },
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
  const set = ({ visible, opacity }: LayerState) => {
    box.checked = visible;
    slider.value = String(opacity);
  };
  set(first);
  return { element, set };
}

function group(item: LayerGroup, rows: readonly Row[], open: boolean): HTMLElement {
  const days = item.level === "stop" ? sols(item.layers.flatMap((layer) => layer.sols)) : "";
  return h(
    "details",
    { class: "group", open },
    h("summary", {}, h("span", {}, item.title), days ? h("small", {}, days) : null),
    h("ul", {}, ...rows.map(({ element }) => element)),
  );
}

export function layerPanel(
  layers: readonly Layer[],
  stateOf: (layer: Layer) => LayerState,
  actions: LayerActions,
): LayerPanel {
  const rows = new Map<string, Row>();
  const groups = groupLayers(layers).map((item) => {
    const members = item.layers.map((layer) => {
      const made = row(layer, stateOf(layer), actions);
      rows.set(layer.id, made);
      return made;
    });
    const shown = item.layers.some((layer) => stateOf(layer).visible);
    return group(item, members, shown || item.level === "region");
  });
  const element = h("div", { class: "layers" }, ...groups);
  if (groups.length === 0) element.append(h("p", { class: "hint" }, "No layer is published yet."));
  let factor = 1;
  const putFactor = () => {
    for (const select of element.querySelectorAll<HTMLSelectElement>(".ellipse-factor"))
      select.value = String(factor);
  };
  element.addEventListener("click", putFactor);
  return {
    element,
    set: (id, state) => rows.get(id)?.set(state),
    setEllipseFactor: (value) => {
      factor = value;
      putFactor();
    },
  };
}
