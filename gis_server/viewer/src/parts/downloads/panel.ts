/** The tab of downloads: the map as an image, files of layers, parts of them, models, URLs. */

import { kindTitle } from "../../map/layers";
import { h, icon } from "../../page/dom";
import { metres, scopeTitle } from "../../page/format";
import {
  type Address,
  clipUrl,
  type Collection,
  FEATURE_FORMATS,
  type ModelFile,
  stlUrl,
} from "../../server/downloads";
import type { Bounds, Layer } from "../../server/records";

const nameOf = ({ kind, scope }: Pick<Layer, "kind" | "scope">) =>
  `${kindTitle(kind)} · ${scopeTitle(scope)}`;

const file = (href: string, name: string) =>
  h("a", { class: "text download", href, download: true }, icon("down"), name);

/** A part of the tab that opens and closes; its content alone changes later. */
function section(title: string, open: boolean, content: HTMLElement): HTMLElement {
  return h("details", { class: "downloads-section", open }, h("summary", {}, title), content);
}

function rows(entries: readonly (readonly [string, readonly HTMLElement[]])[]): HTMLElement {
  return h(
    "ul",
    { class: "files" },
    ...entries.map(([name, links]) =>
      h("li", {}, h("span", {}, name), h("span", { class: "links" }, ...links)),
    ),
  );
}

function layerFiles(layers: readonly Layer[]): HTMLElement {
  if (layers.length === 0) return h("p", { class: "hint" }, "No layer is on the map.");
  return rows(
    layers.map((layer) => [
      nameOf(layer),
      layer.type === "raster"
        ? [file(layer.download, "GeoTIFF")]
        : [file(layer.download, "GeoJSON"), file(`${layer.download}.gpkg`, "GeoPackage")],
    ]),
  );
}

function clips(layers: readonly Layer[], box: Bounds | null, draw: () => void): HTMLElement {
  const begin = h("button", { type: "button", class: "mode box", onclick: draw }, "Draw a box");
  if (!box) return h("div", {}, begin);
  const [west, south, east, north] = box;
  const inside = layers.filter(
    ({ bounds }) => bounds[0] < east && bounds[2] > west && bounds[1] < north && bounds[3] > south,
  );
  return h(
    "div",
    {},
    begin,
    h("p", { class: "hint" }, `${metres(east - west)} × ${metres(north - south)}`),
    rows(
      inside.map((layer) => [
        nameOf(layer),
        layer.type === "raster"
          ? [file(clipUrl(layer, box), "GeoTIFF")]
          : [file(clipUrl(layer, box), "GeoJSON"), file(clipUrl(layer, box, "gpkg"), "GeoPackage")],
      ]),
    ),
  );
}

function addressRow(
  { title, service, url, how }: Address,
  copy: (text: string) => void,
): HTMLElement {
  const text = h("input", {
    type: "text",
    readonly: true,
    value: url,
    class: "wide",
    "aria-label": `address: ${service}, ${title}`,
  });
  return h(
    "li",
    { title: how },
    h("span", {}, `${service}: ${title}`),
    h(
      "span",
      { class: "inline" },
      text,
      h("button", { type: "button", class: "text", onclick: () => copy(url) }, "copy"),
    ),
    h("small", {}, how),
  );
}

export interface Offered {
  readonly shown: readonly Layer[];
  readonly box: Bounds | null;
  readonly collections: readonly Collection[];
  readonly models: readonly ModelFile[];
  /** Terrain models of single stops. */
  readonly terrains: readonly Layer[];
  readonly addresses: readonly Address[];
}

export interface DownloadActions {
  readonly drawBox: () => void;
  readonly copy: (text: string) => void;
}

const MODEL_FORMATS: Readonly<Record<string, string>> = {
  tileset: "3D Tiles",
  "point-tiles": "3D Tiles",
  points: "PLY",
  model: "glTF",
};

function featureFiles(collections: readonly Collection[]): HTMLElement {
  return rows(
    collections.map(({ title, items }) => [
      title,
      FEATURE_FORMATS.map(([form, name]) =>
        h("a", { class: "text", href: `${items}?f=${form}`, download: true }, name),
      ),
    ]),
  );
}

function modelFiles(models: readonly ModelFile[], terrains: readonly Layer[]): HTMLElement {
  if (models.length + terrains.length === 0) {
    return h("p", { class: "hint" }, "No model is published yet.");
  }
  const [made, solids] = [
    models.map(
      (model) =>
        [nameOf(model), [file(model.download, MODEL_FORMATS[model.kind] ?? "glTF")]] as const,
    ),
    terrains.map(
      (layer) =>
        [`solid to print · ${scopeTitle(layer.scope)}`, [file(stlUrl(layer), "STL")]] as const,
    ),
  ];
  return rows([...made, ...solids]);
}

/** The list of files: what is offered changes by parts, and only their own rows with it. */
export class FilesPanel {
  readonly element: HTMLElement;
  readonly #holders: Readonly<Record<Exclude<keyof Offered, "terrains">, HTMLElement>>;
  #offered: Offered = {
    shown: [],
    box: null,
    collections: [],
    models: [],
    terrains: [],
    addresses: [],
  };

  constructor(private readonly actions: DownloadActions) {
    this.#holders = {
      shown: h("div"),
      box: h("div"),
      collections: h("div"),
      models: h("div"),
      addresses: h("div"),
    };
    const { shown, box, collections, models, addresses } = this.#holders;
    this.element = h(
      "div",
      {},
      section("Layers on the map", true, shown),
      section("Parts of them", true, box),
      section("Features of the mission", false, collections),
      section("Models in three dimensions", false, models),
      section("Addresses for QGIS, GDAL and others", false, addresses),
    );
    shown.replaceChildren(layerFiles([]));
    this.show(this.#offered);
  }

  /** Replace the rows of what has changed; focus and open sections elsewhere stay. */
  show(part: Partial<Offered>): void {
    const { shown, box, collections, models, addresses } = this.#holders;
    const { drawBox, copy } = this.actions;
    const before = this.#offered.shown;
    const offered = { ...this.#offered, ...part };
    this.#offered = offered;
    const isOther =
      offered.shown.length !== before.length || offered.shown.some((one, k) => one !== before[k]);
    if (isOther) shown.replaceChildren(layerFiles(offered.shown));
    if (isOther || part.box !== undefined) {
      box.replaceChildren(clips(offered.shown, offered.box, drawBox));
    }
    if (part.collections) collections.replaceChildren(featureFiles(offered.collections));
    if (part.models) models.replaceChildren(modelFiles(offered.models, offered.terrains));
    if (part.addresses) {
      addresses.replaceChildren(
        h("ul", { class: "files" }, ...offered.addresses.map((one) => addressRow(one, copy))),
      );
    }
  }
}
