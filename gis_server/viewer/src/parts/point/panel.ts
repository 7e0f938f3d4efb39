/** What lies at the clicked point: elevation, value of every layer, images that see it. */

import { facts, h } from "../../page/dom";
import { compact, fixed, scopeTitle, unitSign } from "../../page/format";
import { kindTitle } from "../../map/layers";
import { type Identified, type IdentifiedLayer, propertiesOf } from "../../server/records";

export function elevationText({ elevation_m, elevation_sigma_m }: Identified): string {
  if (elevation_m === null) return "not measured";
  const sigma = elevation_sigma_m === null ? "" : ` ± ${fixed(elevation_sigma_m, 3)}`;
  return `${fixed(elevation_m, 3)}${sigma} m`;
}

export const valueText = ({ value, unit, label }: IdentifiedLayer) =>
  label ?? (value === null ? "\u2013" : `${compact(value)}${unitSign(unit)}`);

/** Ids of the images whose footprint holds the point, each once; pointing lines only pass by. */
export function imagesAt({ features }: Identified): string[] {
  const ids = features
    .filter(({ kind }) => kind === "footprints")
    .map((feature) => propertiesOf(feature)["image"]);
  return [...new Set(ids.filter((id): id is string => typeof id === "string"))];
}

/** Names of the stops at the point. */
function stopsAt({ features }: Identified): string[] {
  const stops = features
    .map(propertiesOf)
    .filter((properties) => "stop" in properties && !("image" in properties))
    .map(({ stop }) => String(stop));
  return [...new Set(stops)];
}

/** Layers by what they are about, in the order in which the scopes first appear. */
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
        h("td", { class: "number" }, valueText(layer)),
      ),
    ),
  ]);
  return h("table", { class: "values" }, h("tbody", {}, ...rows));
}

export function pointPanel(
  found: Identified,
  openImage: (id: string) => void,
  hoverImage: (id: string | null) => void,
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
      ["north (LSL x)", `${fixed(found.north, 3)} m`],
      ["east (LSL y)", `${fixed(found.east, 3)} m`],
      ["latitude", found.lat === null ? null : `${fixed(found.lat, 7)}°`],
      ["longitude", found.lon === null ? null : `${fixed(found.lon, 7)}° E`],
      ["elevation", elevationText(found)],
      ["stop", stops.length > 0 ? stops.map(scopeTitle).join(", ") : null],
    ]),
    h("h3", {}, "Layers here"),
    found.layers.length > 0
      ? table(found.layers)
      : h("p", { class: "hint" }, "No raster has a value here: nothing was measured."),
    h("h3", {}, `Images that see it (${images.length})`),
    images.length > 0
      ? h("ul", { class: "image-ids" }, ...images.map(entry))
      : h("p", { class: "hint" }, "No footprint holds this point."),
  );
}
