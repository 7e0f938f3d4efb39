/** The pointer over the map: what it touches, and the cursor that other parts see. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import { isUnpaired } from "../../map/styles";
import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import type { Layer } from "../../server/records";
import type { Context, Pointed } from "../../session/context";

export function cursorPart({ page, view, signals, alive }: Context): void {
  const over = (pointed: Pointed) => {
    const { touched, pixel } = pointed;
    page.map.style.cursor = touched ? "pointer" : "";
    page.tip.hidden = !touched;
    if (touched) {
      page.tip.replaceChildren(...tipOf(touched.feature, touched.layer));
      placeTip(page.tip, page.map, pixel);
    }
    signals.pointer.emit(pointed);
  };
  view.onPointer((event, point) => {
    if (event.dragging) return;
    const touched = view.isClaimed ? null : view.touched(event.pixel);
    over({ point, pixel: event.pixel, touched });
  });
  view.onClick((event, point) => {
    page.tip.hidden = true;
    signals.click.emit({ point, pixel: event.pixel, touched: view.touched(event.pixel) });
  });
  page.map.addEventListener(
    "pointerleave",
    () => {
      page.tip.hidden = true;
      signals.pointer.emit(null);
    },
    { signal: alive },
  );
  signals.cursor.on((point) => view.setCursor(point));
}

/** Beside the pointer, on the side where there is room. */
function placeTip(tip: HTMLElement, map: HTMLElement, [x = 0, y = 0]: readonly number[]): void {
  const left = x + 14 + tip.offsetWidth > map.clientWidth ? x - 10 - tip.offsetWidth : x + 14;
  const top = y + 14 + tip.offsetHeight > map.clientHeight ? y - 10 - tip.offsetHeight : y + 14;
  tip.style.transform = `translate(${Math.max(4, left)}px, ${Math.max(4, top)}px)`;
}

function tipOf(feature: Feature<Geometry>, layer: Layer): Node[] {
  const image = feature.get("image");
  if (typeof image === "string") {
    const reason = feature.get("unpaired_because");
    const alone = isUnpaired(feature) ? `without partner: ${reason ?? "no reason recorded"}` : "";
    const facts = `sol ${feature.get("sol") ?? "?"} · ${feature.get("instrument") ?? ""} ${feature.get("eye") ?? ""}`;
    return [h("b", {}, image), h("span", {}, facts), ...(alone ? [h("em", {}, alone)] : [])];
  }
  const stop = String(feature.get("stop") ?? layer.title);
  return [h("b", {}, scopeTitle(stop)), h("span", {}, String(feature.get("solution") ?? ""))];
}
