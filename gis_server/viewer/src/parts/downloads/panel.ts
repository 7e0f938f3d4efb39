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
  const made = models.map(
    (model) =>
      [nameOf(model), [file(model.download, MODEL_FORMATS[model.kind] ?? "glTF")]] as const,
  );
  const solids = terrains.map(
    (layer) =>
      [`solid to print · ${scopeTitle(layer.scope)}`, [file(stlUrl(layer), "STL")]] as const,
  );
  return rows([...made, ...solids]);
}

interface Section {
  readonly title: string;
  readonly open: boolean;
  /** What its rows are drawn from. */
  readonly of: readonly (keyof Offered)[];
  readonly draw: (offered: Offered, actions: DownloadActions) => HTMLElement;
}

const SECTIONS: readonly Section[] = [
  {
    title: "Layers on the map",
    open: true,
    of: ["shown"],
    draw: ({ shown }) => layerFiles(shown),
  },
  {
    title: "Parts of them",
    open: true,
    of: ["shown", "box"],
    draw: ({ shown, box }, { drawBox }) => clips(shown, box, drawBox),
  },
  {
    title: "Features of the mission",
    open: false,
    of: ["collections"],
    draw: ({ collections }) => featureFiles(collections),
  },
  {
    title: "Models in three dimensions",
    open: false,
    of: ["models", "terrains"],
    draw: ({ models, terrains }) => modelFiles(models, terrains),
  },
  {
    title: "Addresses for QGIS, GDAL and others",
    open: false,
    of: ["addresses"],
    draw: ({ addresses }, { copy }) =>
      h("ul", { class: "files" }, ...addresses.map((one) => addressRow(one, copy))),
  },
];

const NOTHING: Offered = {
  shown: [],
  box: null,
  collections: [],
  models: [],
  terrains: [],
  addresses: [],
};

const isSame = (one: Offered[keyof Offered], other: Offered[keyof Offered]) =>
  one?.length === other?.length && (one ?? []).every((each, k) => each === other?.[k]);

/** The sections of files; each draws its rows again when what they are of has changed. */
export class FilesPanel {
  readonly element: HTMLElement;
  readonly #holders: readonly (readonly [Section, HTMLElement])[];
  #offered = NOTHING;

  constructor(private readonly actions: DownloadActions) {
    this.#holders = SECTIONS.map((section) => [
      section,
      h("div", {}, section.draw(NOTHING, actions)),
    ]);
    const sections = this.#holders.map(([{ title, open }, rows]) =>
      h("details", { class: "downloads-section", open }, h("summary", {}, title), rows),
    );
    this.element = h("div", {}, ...sections);
  }

  /** Focus and open sections stay. */
  show(part: Partial<Offered>): void {
    const before = this.#offered;
    this.#offered = { ...before, ...part };
    for (const [{ of, draw }, holder] of this.#holders) {
      if (of.some((name) => !isSame(this.#offered[name], before[name])))
        holder.replaceChildren(draw(this.#offered, this.actions));
    }
  }
}
