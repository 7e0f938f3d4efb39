/** The line below the map: where the pointer is, and what was measured there. */

import { type CoordinateFormat, lonLatText } from "../../map/coordinates";
import { h } from "../../page/dom";
import { measured } from "../../page/format";
import { kindTitle } from "../../map/layers";
import { elevationText, valueText } from "./panel";
import type { LocalMap } from "../../map/projection";
import type { Identified, MapPoint } from "../../server/records";

function field(name: string, value: string, key: string): HTMLElement {
  return h("span", { class: "field", "data-field": key }, h("i", {}, name), h("b", {}, value));
}

const isElevation = (kind: string) => ["dtm", "region-dtm", "far-dtm"].includes(kind);

/** The value that is uppermost on the screen; elevation is always given. */
function uppermost(found: Identified | null, heightOf: (layer: string) => number | null) {
  const shown = (found?.layers ?? [])
    .map((layer) => ({ layer, height: heightOf(layer.id) }))
    .filter(({ layer, height }) => !isElevation(layer.kind) && height !== null);
  return shown.sort((a, b) => (b.height ?? 0) - (a.height ?? 0))[0]?.layer;
}

/**
 * `found` is the server's answer for this point, if it has arrived; `heightOf` gives a layer's position in the stack of
 * the map, null if it is off.
 */
export function readout(
  point: MapPoint,
  resolution: number,
  local: LocalMap,
  format: CoordinateFormat,
  found: Identified | null,
  heightOf: (layer: string) => number | null,
): Node[] {
  const [east, north] = point;
  const lonLat = local.toLonLat(point);
  const [lat, lon] = lonLatText(lonLat, format);
  const value = uppermost(found, heightOf);
  return [
    field("N", measured(north, "m", null, resolution), "north"),
    field("E", measured(east, "m", null, resolution), "east"),
    ...(lonLat.some(Number.isNaN) ? [] : [field("lat", lat, "lat"), field("lon", lon, "lon")]),
    field("elevation", found ? elevationText(found) : "…", "elevation"),
    ...(value ? [field(kindTitle(value.kind).toLowerCase(), valueText(value), "value")] : []),
  ];
}
