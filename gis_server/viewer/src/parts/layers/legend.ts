/** Legend on the map. */

import { isBand } from "../../map/bands";
import { kindTitle } from "../../map/layers";
import { contourInterval, rasterLegend, symbolLegend } from "../../map/legend";
import { quantityTitle } from "../../map/raster-style";
import { h } from "../../page/dom";
import type { Layer } from "../../server/records";
import type { LayerActions } from "./actions";

/** Legend of a layer as it is drawn now; null if it has none. */
export function legendOf(layer: Layer, actions: LayerActions): HTMLElement | null {
  return layer.type === "vector"
    ? symbolLegend(
        layer,
        actions.ellipseFactor(),
        actions.setEllipseFactor,
        contourInterval(actions.elevationsOf(layer)),
      )
    : rasterLegend(layer, actions.stateOf(layer).style);
}

export interface MapLegend {
  readonly element: HTMLElement;
  readonly draw: (layers: readonly Layer[]) => void;
}

/** Least size of a map, in pixels, that has room beside its legend. */
const ROOM_PX = [600, 420] as const;

/**
 * Legends of the drawn layers, on the map. Layers of several stops that look alike share one. It folds when the map
 * becomes small, and opens when it becomes large.
 */
export function mapLegend(actions: LayerActions, map: HTMLElement): MapLegend {
  const list = h("div", {});
  const element = h("details", { class: "map-legend" }, h("summary", {}, "Legend"), list);
  let isLarge = false;
  const fit = () => {
    const wasLarge = isLarge;
    isLarge = map.clientWidth >= ROOM_PX[0] && map.clientHeight >= ROOM_PX[1];
    if (isLarge !== wasLarge) element.open = isLarge;
  };
  new ResizeObserver(fit).observe(map);
  fit();
  const draw = (layers: readonly Layer[]) => {
    const entries = new Map<string, HTMLElement>();
    for (const layer of layers) {
      const found = legendOf(layer, actions);
      if (!found) continue;
      const quantity = actions.stateOf(layer).style?.quantity ?? "value";
      const of = quantity === "value" || isBand(layer) ? "" : `: ${quantityTitle(quantity)}`;
      const title = kindTitle(layer.kind) + of;
      entries.set(title + found.innerHTML, h("section", {}, h("h2", {}, title), found));
    }
    element.hidden = entries.size === 0;
    list.replaceChildren(...entries.values());
  };
  return { element, draw };
}
