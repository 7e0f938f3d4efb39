/** The line below the map: where the pointer is, and what was measured there. */

import { h } from "./dom";
import { fixed } from "./format";
import { kindTitle } from "./layers";
import { elevationText, valueText } from "./point-panel";
import type { LocalMap } from "./projection";
import type { Identified, MapPoint } from "./records";

function field(name: string, value: string, key: string): HTMLElement {
  return h("span", { class: "field", "data-field": key }, h("i", {}, name), h("b", {}, value));
}

/** Decimals worth showing when a pixel of the map is `resolution` metres. */
export function decimalsFor(resolution: number): number {
  return Math.min(3, Math.max(0, Math.ceil(-Math.log10(resolution))));
}

/** `found` is what the server said about the very point, if it has answered. */
export function readout(
  point: MapPoint,
  resolution: number,
  local: LocalMap,
  found: Identified | null,
  isShown: (layer: string) => boolean,
): Node[] {
  const [east, north] = point;
  const [lon, lat] = local.toLonLat(point);
  const decimals = decimalsFor(resolution);
  const value = found?.layers.find((layer) => layer.kind !== "dtm" && isShown(layer.id));
  return [
    field("N", `${fixed(north, decimals)} m`, "north"),
    field("E", `${fixed(east, decimals)} m`, "east"),
    field("lat", `${fixed(lat, 6)}°`, "lat"),
    field("lon", `${fixed(lon, 6)}° E`, "lon"),
    field("elevation", found ? elevationText(found) : "…", "elevation"),
    ...(value ? [field(kindTitle(value.kind).toLowerCase(), valueText(value), "value")] : []),
  ];
}
