/** Facts of the clicked point: elevation, value of every layer, images that see it. */

import { type CoordinateFormat, inFrames, lonLatText } from "../../map/coordinates";
import { button, facts, h } from "../../page/dom";
import { decimalsFor, measured, scopeTitle } from "../../page/format";
import { kindTitle } from "../../map/layers";
import { isElevation } from "../../map/raster-style";
import {
  type Identified,
  type IdentifiedLayer,
  imagesAt,
  propertiesOf,
} from "../../server/records";
import type { SceneStops } from "../../server/scene";

export function elevationText({ elevation_m, elevation_sigma_m, layers }: Identified): string {
  if (elevation_m === null) return "not measured";
  return measured(elevation_m, "m", elevation_sigma_m, finestCell(layers));
}

/** Smallest cell of the layers that have a value at a place; a centimetre if none has. */
function finestCell(layers: readonly IdentifiedLayer[]): number {
  const cells = layers.flatMap(({ cell_m }) => cell_m ?? []);
  return cells.length > 0 ? Math.min(...cells) : 0.01;
}

/** The resolution of an elevation without standard deviation is its cell size. */
export const valueText = ({ value, sigma, unit, label, kind, cell_m }: IdentifiedLayer) =>
  label ?? measured(value, unit, sigma, isElevation({ kind }) ? cell_m : null);

/** Names of the stops at the point. */
function stopsAt({ features }: Identified): string[] {
  const stops = features
    .map(propertiesOf)
    .filter((properties) => "stop" in properties && !("image" in properties))
    .map(({ stop }) => String(stop));
  return [...new Set(stops)];
}

/** Layers grouped by scope, in the order in which the scopes first appear. */
export function byScope(layers: readonly IdentifiedLayer[]): [string, IdentifiedLayer[]][] {
  const groups = new Map<string, IdentifiedLayer[]>();
  for (const layer of layers) groups.set(layer.scope, [...(groups.get(layer.scope) ?? []), layer]);
  return [...groups];
}

function table(layers: readonly IdentifiedLayer[]): HTMLElement {
  const rows = byScope(layers).flatMap(([scope, found]) => [
    h("tr", { class: "scope" }, h("th", { colspan: 2 }, scopeTitle(scope))),
    ...found.map((layer) =>
      h(
        "tr",
        { "data-layer": layer.id },
        h("td", {}, kindTitle(layer.kind)),
        h("td", { class: layer.label === null ? "number" : "label" }, valueText(layer)),
      ),
    ),
  ]);
  return h("table", { class: "values" }, h("tbody", {}, ...rows));
}

export interface PointActions {
  readonly openImage: (id: string) => void;
  readonly hoverImage: (id: string | null) => void;
  readonly copy: (text: string) => void;
}

/** Decimals of a degree of Mars (59 km) that distinguish metres. */
const METRE_DECIMALS = 5;

/** A place in every coordinate format, as text that the search box accepts. */
export function coordinateRows(
  { north, east, lon, lat, elevation_m, layers }: Identified,
  format: CoordinateFormat,
  frames: SceneStops,
): readonly (readonly [name: string, text: string])[] {
  const cell = finestCell(layers);
  const decimals = decimalsFor(cell);
  const onMars: (readonly [string, string])[] =
    lon === null || lat === null
      ? []
      : [["lat, lon", lonLatText([lon, lat], format, decimals + METRE_DECIMALS).join(", ")]];
  return [
    ...onMars,
    ["map", `N ${measured(north, "m", null, cell)}, E ${measured(east, "m", null, cell)}`],
    ...inFrames([east, north], elevation_m, frames, decimals),
  ];
}

export function pointPanel(
  found: Identified,
  coordinates: readonly (readonly [name: string, text: string])[],
  { openImage, hoverImage, copy }: PointActions,
): HTMLElement {
  const images = imagesAt(found);
  const stops = stopsAt(found);
  const entry = (id: string) =>
    h(
      "li",
      {},
      h(
        "button",
        {
          type: "button",
          class: "link",
          onclick: () => openImage(id),
          onmouseenter: () => hoverImage(id),
          onmouseleave: () => hoverImage(null),
          onfocus: () => hoverImage(id),
        },
        id,
      ),
    );
  return h(
    "div",
    { class: "point" },
    facts([
      ...coordinates.map(
        ([name, text]) =>
          [
            name,
            h(
              "span",
              { class: "coordinates" },
              text,
              button(`copy ${name}`, "copy", () => copy(text), { class: "ghost" }),
            ),
          ] as const,
      ),
      ["elevation", elevationText(found)],
      ["stop", stops.length > 0 ? stops.map(scopeTitle).join(", ") : null],
    ]),
    h("h2", {}, "Layers here"),
    found.layers.length > 0
      ? table(found.layers)
      : h("p", { class: "hint" }, "No raster has a value here: nothing was measured."),
    h("h2", {}, `Images that see it (${images.length})`),
    images.length > 0
      ? h("ul", { class: "image-ids" }, ...images.map(entry))
      : h("p", { class: "hint" }, "No footprint holds this point."),
  );
}
